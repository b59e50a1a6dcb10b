"""What a paced board takes from its line: no more than the line brings."""

from __future__ import annotations

from hiltest.boards import VirtualBench
from hiltest.boards.paced import SerialPortOfBoard
from hiltest.link.framing import Frame, encode_frame
from hiltest.link.messages import Sync
from hiltest.rig import Rig


def test_a_client_that_floods_the_line_waits_as_long_as_the_line_needs(rig: Rig) -> None:
    bench = VirtualBench(rig)
    bench.power_on()
    port = SerialPortOfBoard(bench.machine)
    began_s, heard = bench.time_s, 0
    while bench.time_s < began_s + 1.0:
        heard += port.room()
        port.hear(bytes(port.room()))
        bench.machine.run_until(bench.time_s + 0.01)
    # 11 520 bytes a second; what was read last, a quarter of that, is still on its way.
    assert 11_520 - 2880 <= heard <= 11_520 + 2880
    assert port.say() == b""  # zeros between no delimiters are no frame


def test_a_board_understands_only_the_rate_that_its_firmware_has_set_up(rig: Rig) -> None:
    bench = VirtualBench(rig)
    bench.power_on()
    port = SerialPortOfBoard(bench.machine)
    request = Sync(0x12345678)
    frame = encode_frame(Frame(request.code, 0, request.payload()))
    answers = []
    for bench.machine.uart0.line_baud in (115_200, 9600):
        port.hear(frame)
        bench.machine.run_until(bench.time_s + 0.1)  # at 9600 baud the request takes 0.02 s
        answers.append(port.say())
    assert request.payload() in answers[0]
    assert answers[1] == b""
