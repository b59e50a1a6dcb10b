"""GDB at the virtual board: it halts, looks, steps and goes on, and the firmware is none the wiser."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

import hiltest.boards  # noqa: F401  # makes hil:// known
from hiltest.boards import VirtualBench
from hiltest.boards.gdb_server import GdbServer
from hiltest.boards.gdb_session import GdbSession
from hiltest.boards.paced import PacedBench
from hiltest.boards.served_lines import PseudoTerminal
from hiltest.budgets import GDB
from hiltest.errors import BoardFault
from hiltest.link.gdb_packets import ACKNOWLEDGED, packet
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.debugger import Debugger
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.program.elf import load_image

from ..virtual.conftest import FLAGS, PROGRAMS
from .gdb_client import WALL_LIMIT_S, GdbClient

SOURCE = Path(__file__).parent / "programs" / "debugged.c"
UNTIL_S = 0.02
SP, LR, PC, XPSR, D3 = 13, 14, 15, 16, 26


def weighed(count: int) -> list[int]:
    values = [k * 3 if k & 1 else k + 5 for k in range(count)]
    return [y + (7 if y > 20 else 2 if y < 9 else 0) for y in values]


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    path = tmp_path_factory.mktemp("debugged") / "debugged.elf"
    command = [require_tool("arm-none-eabi-gcc"), *FLAGS, str(PROGRAMS / "start.S"), str(SOURCE), "-o", str(path)]
    subprocess.run(command, check=True, timeout=60)
    return path


class Debugged:
    """A board that runs in a thread, with a GDB server; `at` has addresses by name."""

    def __init__(self, elf: Path) -> None:
        self.machine = VirtualK64F(elf)
        self.machine.boot()
        self.at = {name: symbol.address for name, symbol in self.machine.image.symbols.items()}
        self.server = GdbServer(self.machine, 0)
        self.error: Exception | None = None
        self.goes_on = False  # beyond its time
        self.thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            self.machine.run_until(UNTIL_S)
            while self.goes_on:
                self.machine.run_until(self.machine.time_s + UNTIL_S)
        except BoardFault as error:
            self.error = error

    def client(self) -> GdbClient:
        """Connect; from then on the board is halted."""
        client = GdbClient(self.server.port)
        assert client.ask(b"?") == b"T02thread:1;"
        return client

    def ended(self) -> None:
        """Wait until the board has run its time."""
        self.thread.join(WALL_LIMIT_S)
        assert not self.thread.is_alive()


@pytest.fixture
def debugged(elf: Path) -> Iterator[Debugged]:
    """A board that is halted at its reset vector by a client that has left again."""
    result = Debugged(elf)
    try:
        yield result
    finally:
        result.server.close()
        result.goes_on = False
        if result.thread.ident is not None:
            result.ended()


@contextmanager
def started(debugged: Debugged) -> Iterator[GdbClient]:
    """Connect before the first instruction, and let the board's thread begin."""
    with debugged.client() as client:
        debugged.thread.start()
        yield client


def state(machine: VirtualK64F) -> tuple[object, ...]:
    return machine.cycles, machine.instructions, machine.time_s, bytes(machine.processor.memory.sram.view)


def test_counts_stay_when_the_board_is_halted_again_and_again_at_moments_of_the_hosts_choice(
    elf: Path, debugged: Debugged
) -> None:
    alone = VirtualK64F(elf)
    alone.run_until(UNTIL_S)
    with started(debugged) as client:
        for _ in range(20):
            client.send(b"c")
            client.socket.sendall(b"\x03")
            assert client.receive().startswith(b"T02")
        client.send(b"c")
        debugged.ended()
    assert state(debugged.machine) == state(alone)


def test_a_breakpoint_halts_before_its_instruction_each_time_and_time_stands_still(debugged: Debugged) -> None:
    with started(debugged) as client:
        assert client.ask(b"Z1,%x,2" % debugged.at["work"]) == b"OK"
        for visit in range(3):
            assert client.ask(b"c") == b"T05thread:1;hwbreak:;"
            assert (client.pc, client.register(0)) == (debugged.at["work"], 20)
            assert client.word(debugged.at["count"]) == 20 * visit
            answer = client.monitor("cycles")
            assert answer == (
                f"{debugged.machine.cycles} cycles, {debugged.machine.instructions} instructions, "
                f"{debugged.machine.time_s:.9f} s\n"
            )
            time.sleep(0.02)
            assert client.monitor("cycles") == answer
        assert client.ask(b"z1,%x,2" % debugged.at["work"]) == b"OK"
        client.send(b"c")
        debugged.ended()
    assert debugged.machine.time_s == pytest.approx(UNTIL_S, abs=5e-6)  # an instruction may pass it


def test_stepping_through_a_function_visits_every_instruction_and_changes_nothing(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"Z0,%x,2" % debugged.at["work"])
        assert client.ask(b"c") == b"T05thread:1;swbreak:;"
        back = client.register(LR) & ~1
        instructions, places = debugged.machine.instructions, []
        while client.pc != back:
            assert client.ask(b"s") == b"T05thread:1;"
            places.append(client.pc)
            assert len(places) < 1000
        assert client.register(0) == sum(weighed(20))
        assert client.word(debugged.at["count"]) == 20
        # Instructions that an IT block skips are counted, and not halted at.
        assert len(places) < debugged.machine.instructions - instructions < 1.5 * len(places)
        assert client.ask(b"vCont;s:1") == b"T05thread:1;"


def test_a_breakpoint_amid_a_block_of_code_is_hit_in_every_round(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        places = []
        for _ in range(40):
            client.ask(b"s")
            places.append(client.pc)
        loop = [place for place in dict.fromkeys(places) if places.count(place) == 2 and place > debugged.at["work"]]
        client.ask(b"z1,%x,2" % debugged.at["work"])
        amid = loop[len(loop) // 2]
        client.ask(b"Z1,%x,2" % amid)
        counts = []
        for _ in range(5):
            assert client.ask(b"c").startswith(b"T05")
            assert client.pc == amid
            counts.append(client.word(debugged.at["count"]))
        assert counts == list(range(counts[0], counts[0] + 5))


@pytest.mark.parametrize(("kind", "name"), [(b"2", b"watch"), (b"4", b"awatch"), (b"3", b"rwatch")])
def test_a_watchpoint_halts_behind_the_access_and_names_it(debugged: Debugged, kind: bytes, name: bytes) -> None:
    place = debugged.at["count"]
    with started(debugged) as client:
        assert client.ask(b"Z%s,%x,4" % (kind, place)) == b"OK"
        assert client.ask(b"c") == b"T05thread:1;%s:%x;" % (name, place)
        word = [client.word(place)]
        for _ in range(3):
            assert client.ask(b"c") == b"T05thread:1;%s:%x;" % (name, place)
            word.append(client.word(place))
        # Each round reads it and writes it.
        assert word == {b"2": [1, 2, 3, 4], b"3": [0, 1, 2, 3], b"4": [0, 1, 1, 2]}[kind]
        client.ask(b"z%s,%x,4" % (kind, place))
        client.send(b"c")
        debugged.ended()


def test_breakpoints_watchpoints_and_steps_change_no_count(elf: Path, debugged: Debugged) -> None:
    alone = VirtualK64F(elf)
    alone.run_until(UNTIL_S)
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["weigh"])
        client.ask(b"Z3,%x,4" % debugged.at["last"])
        for _ in range(20):
            assert client.ask(b"c").startswith(b"T05")
            for _ in range(5):
                assert client.ask(b"s").startswith(b"T05")
        client.ask(b"z1,%x,2" % debugged.at["weigh"])
        client.ask(b"z3,%x,4" % debugged.at["last"])
        client.send(b"c")
        debugged.ended()
    assert state(debugged.machine) == state(alone)


def test_a_watchpoint_on_a_register_of_a_device_halts_too(debugged: Debugged) -> None:
    reload = 0xE000E014  # of SysTick
    with started(debugged) as client:
        assert client.ask(b"Z2,%x,4" % reload) == b"OK"
        assert client.ask(b"c") == b"T05thread:1;watch:%x;" % reload
        assert client.word(reload) == 9999


@pytest.mark.parametrize("size", [1, 2, 4])
def test_a_watchpoint_on_a_part_of_a_word_is_met_by_an_access_to_all_of_it(debugged: Debugged, size: int) -> None:
    place = debugged.at["total"] + 4 - size
    with started(debugged) as client:
        assert client.ask(b"Z2,%x,%x" % (place, size)) == b"OK"
        assert client.ask(b"c") == b"T05thread:1;watch:%x;" % place


def test_a_breakpoint_at_an_instruction_that_jumps_to_itself_halts_in_every_round(debugged: Debugged) -> None:
    debugged.machine.may_rest = True
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        client.ask(b"M%x,2:fee7" % debugged.at["work"])  # b .
        cycles = debugged.machine.cycles
        for visit in range(1, 4):
            assert client.ask(b"c") == b"T05thread:1;hwbreak:;"
            assert client.pc == debugged.at["work"]
            assert debugged.machine.cycles == cycles + 2 * visit


def test_a_step_with_an_interrupt_pending_enters_its_handler_and_executes_nothing(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        assert client.ask(b"Me000ed04,4:" + (1 << 26).to_bytes(4, "little").hex().encode()) == b"OK"  # PENDSTSET
        instructions = debugged.machine.instructions
        assert client.ask(b"s") == b"T05thread:1;"
        assert client.pc == debugged.at["SysTick_Handler"]
        assert debugged.machine.instructions == instructions
        assert client.ask(b"s") == b"T05thread:1;"
        assert debugged.machine.instructions == instructions + 1


def test_a_step_within_addresses_ends_where_it_leaves_them(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        begin = debugged.at["work"]
        assert client.ask(b"vCont;r%x,%x:1" % (begin, begin + 8)) == b"T05thread:1;"
        assert not begin <= client.pc < begin + 8


def test_registers_and_memory_are_read_and_written(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        every = bytes.fromhex(client.ask(b"g").decode())
        assert len(every) == 23 * 4 + 16 * 8 + 4
        assert int.from_bytes(every[4 * PC : 4 * PC + 4], "little") == debugged.at["work"]
        assert client.ask(b"G" + every.hex().encode()) == b"OK"
        assert client.ask(b"P%x=%s" % (D3, b"0123456789abcdef")) == b"OK"
        assert client.ask(b"p%x" % D3) == b"0123456789abcdef"
        assert client.ask(b"P0=03000000") == b"OK"  # three rounds instead of twenty
        assert client.ask(b"X%x,3:\x7d\x03\x01\x02" % 0x20020000) == b"OK"
        assert client.ask(b"m%x,3" % 0x20020000) == b"230102"
        client.ask(b"Z2,%x,4" % debugged.at["total"])
        assert client.ask(b"c").startswith(b"T05thread:1;watch:")
        assert client.word(debugged.at["total"]) == sum(weighed(3))
        assert client.word(0xE000ED00) == 0x410FC241  # CPUID, of the bus
        assert client.ask(b"mE000E014,4") == (9999).to_bytes(4, "little").hex().encode()
        # SIM_SCGC4 opens the clock gate of the comparator, which is not modelled and keeps what is written.
        gates = client.word(0x40048034) | 1 << 19
        assert client.ask(b"m40073000,1") == b"E01"
        assert client.ask(b"M40048034,4:" + gates.to_bytes(4, "little").hex().encode()) == b"OK"
        assert client.ask(b"M40073000,1:11") == b"OK"
        assert client.ask(b"m40073000,1") == b"11"
        assert debugged.machine.unmodelled == ()  # GDB's accesses are not the firmware's
        assert client.ask(b"m60000000,4") == b"E01"


def test_code_that_is_written_is_what_runs(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        assert client.ask(b"M%x,4:2a207047" % debugged.at["work"]) == b"OK"  # movs r0, #42; bx lr
        back = client.register(LR) & ~1
        client.ask(b"Z1,%x,2" % back)
        client.ask(b"c")
        assert (client.pc, client.register(0)) == (back, 42)


def test_reset_starts_the_firmware_anew_and_halts_it_there(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        client.ask(b"c")
        assert client.word(debugged.at["count"]) == 20
        assert client.monitor("reset") == f"reset, halted at 0x{debugged.at['start']:08x}\n"
        assert client.pc == debugged.at["start"]
        assert client.ask(b"c").startswith(b"T05")
        assert client.pc == debugged.at["work"]
        assert client.word(debugged.at["count"]) == 20  # RAM is kept, and this start-up code zeroes none
        assert client.ask(b"qRcmd," + b"halt".hex().encode()) == b"OK"
        assert "reset" in client.monitor("what")


@pytest.mark.parametrize("leave", [b"D", b"k", b""], ids=["detach", "kill", "gone"])
def test_when_gdb_leaves_the_board_runs_on_and_another_gdb_may_come(debugged: Debugged, leave: bytes) -> None:
    debugged.goes_on = True
    debugged.thread.start()
    with debugged.client() as client:
        client.ask(b"Z1,%x,2" % debugged.at["work"])
        client.ask(b"c")
        halted_at = debugged.machine.cycles
        if leave:
            client.send(leave)
            assert client.receive() == b"OK"
    deadline_s = time.monotonic() + WALL_LIMIT_S
    while debugged.machine.cycles <= halted_at + 100_000:  # the breakpoint is gone
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    with debugged.client() as client, GdbClient(debugged.server.port) as second:
        assert second.socket.recv(1) == b""  # one at a time
        assert client.ask(b"qfThreadInfo") == b"m1"
        assert client.ask(b"qsThreadInfo") == b"l"


def test_a_fault_is_shown_before_it_ends_the_firmware(debugged: Debugged) -> None:
    debugged.machine.may_rest = False  # as under `hiltest run`
    with started(debugged) as client:
        client.ask(b"M%x,4:02000000" % debugged.at["beyond"])
        console = client.ask(b"c")
        assert b"hang: a branch to itself" in bytes.fromhex(console[1:].decode())
        assert client.receive() == b"T0bthread:1;"
        assert debugged.error is None
        client.send(b"c")
        debugged.ended()
        assert isinstance(debugged.error, BoardFault)
        assert "branch to itself" in debugged.error.cause


def test_a_bkpt_instruction_halts_and_is_gone_on_from(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.ask(b"M%x,4:01000000" % debugged.at["beyond"])
        assert client.ask(b"c") == b"T05thread:1;swbreak:;"
        assert client.word(client.pc) & 0xFFFF == 0xBE00
        client.send(b"c")
        debugged.ended()
    assert debugged.error is None
    assert debugged.machine.processor.memory.read_words(debugged.at["beyond"], 1) == (0,)


HOSTILE = [
    b"m",
    b"m0",
    b"m0,ffffffff",
    b"mffffffff,8",
    b"m-1,4",
    b"M0,4:00",
    b"Mzz",
    b"X0,1:",
    b"p",
    b"pff",
    b"p-1",
    b"P0",
    b"P0=",
    b"P1=zz",
    b"Pffff=00000000",
    b"G",
    b"G00",
    b"Z1,",
    b"Z9,0,2",
    b"Z1,f0000000,2",
    b"Z2,0,0",
    b"Z2,0,ffffffff",
    b"Z4,ffffffff,2",
    b"z1,0,2",
    b"z2,0,4",
    b"qRcmd,zz",
    b"qRcmd,",
    b"qXfer:features:read:target.xml:zz,1",
    b"qXfer:features:read:target.xml:ffffffff,ffff",
    b"qXfer:features:read:../etc:0,1",
    b"vCont;x",
    b"vCont;r1",
    b"vCont;r5,1,9",
    b"vRun;",
    b"vFile:open:",
    b"Fx",
    b"\x80\xff",
    b"",
    b"A" * 20_000,
    b"H",
    b"T7f",
    b"qCRC:0,1",
]


def test_wrong_packets_get_an_answer_and_harm_nobody(debugged: Debugged) -> None:
    with started(debugged) as client:
        for content in HOSTILE:
            client.send(content)
            client.socket.sendall(b"$#00" if content == b"" else b"")
        client.socket.sendall(b"$m0,4#00" + b"}#" + b"#" * 300 + b"$" * 5 + b"+" * 9)
        client.send(b"qAttached")
        answers = set()
        while b"1" not in answers:
            data = client.socket.recv(65536)
            assert data
            answers |= {part.partition(b"#")[0] for part in data.split(b"$")[1:]}
        assert answers <= {b"", b"E01", b"OK", b"1", b"l"} | {answer for answer in answers if len(answer) > 40}
        client.send(b"c")
        client.send(b"g")  # not while it runs
        assert client.receive() in (b"", b"E01", b"1")
        debugged.ended()


class Quiet:
    """A session of its own, without a network."""

    def __init__(self, elf: Path) -> None:
        self.machine = VirtualK64F(elf)
        self.debugger = Debugger(self.machine, on_stop=lambda: None)
        self.session = GdbSession(self.machine, self.debugger)


def test_a_debugger_that_is_earlier_than_the_board_reads_its_program_and_never_half_a_reset(elf: Path) -> None:
    quiet = Quiet(elf)
    vectors = load_image(elf).segments[0].data[:8]
    assert quiet.session.feed(b"$m0,8#01") == ACKNOWLEDGED + packet(vectors.hex().encode())
    for restart in (quiet.machine.boot, quiet.machine.reset):
        with quiet.debugger.halted():
            resetting = threading.Thread(target=restart)
            resetting.start()
            resetting.join(0.05)
            assert resetting.is_alive()  # a reset waits until the debugger has finished an access
        resetting.join()


def test_a_notice_of_a_halt_that_comes_when_the_processor_runs_again_says_nothing(elf: Path) -> None:
    quiet = Quiet(elf)
    quiet.session.feed(b"$QStartNoAckMode#b0")
    assert quiet.session.feed(b"$c#63") == b""
    assert quiet.session.feed(b"\x03").startswith(b"$T02")
    assert quiet.session.feed(b"$c#63") == b""
    assert quiet.session.stopped() == b""
    assert quiet.session.awaits_halt
    assert quiet.session.feed(b"\x03").startswith(b"$T02")


framed = (
    st.sampled_from(HOSTILE)
    | st.binary(max_size=40)
    | st.builds(
        lambda letter, rest: letter + rest,
        st.sampled_from(
            [b"m", b"M", b"X", b"p", b"P", b"Z", b"z", b"q", b"v", b"vCont;", b"H", b"T", b"c", b"s", b"\x03"]
        ),
        st.text("0123456789abcdef,:;=-x", max_size=24).map(str.encode),
    )
)


@settings(max_examples=60)
@given(contents=st.lists(framed, max_size=30), noise=st.binary(max_size=30))
def test_any_bytes_whatever_leave_the_session_and_the_board_alive(
    elf: Path, contents: list[bytes], noise: bytes
) -> None:
    quiet = Quiet(elf)
    for content in contents:
        quiet.session.feed(b"$%s#%02x" % (content, sum(content) & 0xFF))
    quiet.session.feed(noise)
    quiet.session.feed(b"\x03#00")
    assert not quiet.session.over or any(item[:1] in b"Dk" or item.startswith(b"vKill") for item in [*contents, noise])
    quiet.session.close()
    try:
        quiet.machine.run_until(0.0001)
    except BoardFault:  # of firmware whose registers or memory were written
        assert any(item[:1] in b"GPMXcCsS" or item.startswith(b"vCont") for item in contents)


def test_virtual_time_of_a_paced_board_does_not_catch_up_with_a_halt(elf: Path) -> None:
    bench = VirtualBench(load_rig(shipped() / "rigs" / "virtual-k64f.toml"), firmware=elf)
    line = PseudoTerminal()
    paced = PacedBench(bench, line)
    with GdbServer(bench.machine, 0) as server, paced:
        with GdbClient(server.port) as client:
            client.ask(b"?")
            before_s = paced.time_s
            time.sleep(1.0)
            assert paced.time_s == before_s
            assert client.ask(b"D") == b"OK"
        time.sleep(0.3)
        assert before_s < paced.time_s < before_s + 0.9  # it would be 1.3 s further on
    line.close()


def test_gdb_comes_to_a_board_in_stepped_time(elf: Path) -> None:
    with serial.serial_for_url(f"hil://?firmware={elf}&gdb=0", timeout=0.01) as port:
        with GdbClient(port.gdb.port) as client:
            client.ask(b"?")
            at = port.machine.time_s
            thread = threading.Thread(target=port.read)
            thread.start()
            thread.join(0.1)
            assert thread.is_alive()  # its 10 ms do not pass while the processor is halted
            assert port.machine.time_s == at
            client.ask(b"D")
        thread.join(WALL_LIMIT_S)
        assert port.machine.time_s == pytest.approx(at + 0.01, abs=1e-6)


SCRIPT = [
    "info threads",
    "break work",
    "continue",
    "backtrace",
    "print n",
    "print/x $pc",
    "finish",
    "delete",
    "set var total=0",
    "watch total",
    "continue",
    "delete",
    "tbreak SysTick_Handler",
    "continue",
    "backtrace",
    "stepi",
    "set var count=77",
    "print count",
    "print $d0",
    "print ratio",
    "info registers fpscr control basepri",
    "print/x *(unsigned *)0xE000ED00",
    "monitor cycles",
    "monitor reset",
    "maintenance flush register-cache",
    "print $pc",
    "detach",
]


def test_debians_gdb_debugs_the_board(debugged: Debugged, elf: Path, require_tool: Callable[[str], str]) -> None:
    debugged.goes_on = True
    debugged.thread.start()
    commands = [
        f"target remote 127.0.0.1:{debugged.server.port}",
        "monitor reset",
        "maintenance flush register-cache",
        *SCRIPT,
    ]
    arguments = [item for command in commands for item in ("-ex", command)]
    done = subprocess.run(
        [require_tool("gdb-multiarch"), "-nx", "-batch", *arguments, str(elf)],
        capture_output=True,
        text=True,
        timeout=WALL_LIMIT_S,
        check=False,
    )
    output = done.stdout
    for expected in (
        "Thread 1 (Cortex-M4F)",
        "Breakpoint 1, work (n=n@entry=20)",
        "#1  0x",
        "in main ()",
        "$1 = 20",
        f"= {debugged.at['work']:#x}",
        f"Value returned is $3 = {sum(weighed(20))}",
        "Hardware watchpoint 2: total",
        f"New value = {sum(weighed(20))}",
        "SysTick_Handler ()",
        "<signal handler called>",
        "= 77",
        "fpscr",
        "control",
        "0x410fc241",
        "<start>",
        "detached",
    ):
        assert expected in output, (expected, output, done.stderr)
    assert "cycles, " in done.stderr
    assert done.returncode == 0


def test_a_client_that_asks_again_60000_times_is_disconnected_and_the_next_gdb_is_served(debugged: Debugged) -> None:
    with started(debugged) as client:
        answer = client.ask(b"m0,1f00")
        assert len(answer) == 2 * 0x1F00
        client.socket.sendall(b"-" * 60_000)
        repeated = 0
        with suppress(ConnectionResetError):
            while data := client.socket.recv(1 << 16):
                repeated += len(data)
        assert repeated <= GDB.items * (len(answer) + 4)
    with debugged.client() as client:
        assert client.ask(b"qAttached") == b"1"


def test_a_server_ends_at_once_beside_a_client_that_does_not_read_its_answers(debugged: Debugged) -> None:
    with started(debugged) as client:
        client.socket.settimeout(0.2)
        with suppress(TimeoutError):
            for _ in range(100_000):
                client.socket.sendall(b"$m0,1f00#%02x" % (sum(b"m0,1f00") & 0xFF))
        cpu_s = time.process_time()
        closing = threading.Thread(target=debugged.server.close)
        closing.start()
        closing.join(WALL_LIMIT_S)
        assert not closing.is_alive()
        assert time.process_time() - cpu_s < 2.0  # of a thread that waits; the copies of 100 000 answers took minutes


@pytest.mark.parametrize("begin", [b"POST / HTTP/1.1\r\n", b"GET / HTTP/1.1\r\n", b"\x16\x03\x01\x02"])
def test_the_body_of_an_http_request_is_not_obeyed_and_halts_nothing(debugged: Debugged, begin: bytes) -> None:
    debugged.thread.start()
    with GdbClient(debugged.server.port) as client:
        client.socket.sendall(begin + b"Content-Length: 99\r\n\r\n" + packet(b"M20000000,4:deadbeef") + packet(b"k"))
        with suppress(ConnectionResetError):
            assert client.socket.recv(100) == b""
    debugged.ended()
    assert debugged.machine.time_s >= UNTIL_S
    assert debugged.machine.processor.memory.read(0x20000000, 4) != bytes.fromhex("deadbeef")
    with debugged.client() as client:
        assert client.ask(b"qAttached") == b"1"


def test_away_from_loopback_gdb_is_let_in_by_the_token_only(elf: Path) -> None:
    machine = VirtualK64F(elf)
    machine.boot()
    with GdbServer(machine, 0, host="0.0.0.0") as server:
        with GdbClient(server.port) as stranger:
            stranger.socket.sendall(b"$?#3f" * 10)
            with suppress(ConnectionResetError):
                assert stranger.socket.recv(100) == b""
        assert not server.connected
        with GdbClient(server.port) as client:
            client.socket.sendall(f"{server.token}\n".encode())
            assert client.ask(b"qAttached") == b"1"
