"""A line that loses and changes bytes, with the real firmware at its end: retried, counted, done once."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hiltest.boards import VirtualBench
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import BoardFault, DeviceTimeoutError, SequenceError
from hiltest.link.framing import Frame, encode_frame
from hiltest.link.messages import ClearPoints, Identify, LinkStatistics, Points, Upload
from hiltest.link.ports import READ_SLICE_S
from hiltest.link.replies import LinkCounters
from hiltest.link.session import Attempt, RequestOutcome, Session
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

Fault = Callable[[bytes], bytes]

# Each point is another one, so that a second storing would show.
THREE_POINTS = [(1, 2, 3), (0x7E, 0x7D, -1), (-32767, 0, 32767)]


class DamagedPort(VirtualPort):
    """The virtual board's port on a bad cable: what passes next goes through the planned faults, one each."""

    def __init__(self) -> None:
        super().__init__()
        self.to_board: list[Fault] = []
        self.to_host: list[Fault] = []

    def write(self, data: bytes) -> int:
        fault = self.to_board.pop(0) if self.to_board else _nothing
        super().write(fault(bytes(data)))
        return len(data)

    def read_until(self, expected: bytes = b"\n", size: int | None = None) -> bytes:
        data = super().read_until(expected, size)
        if len(data) <= 1:  # nothing came, or the delimiter that a frame begins with
            return data
        fault = self.to_host.pop(0) if self.to_host else _nothing
        return fault(data)


def _nothing(data: bytes) -> bytes:
    return data


def _one_bit(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 0x01]) + data[middle + 1 :]


def _lost(_: bytes) -> bytes:
    return b""


@pytest.fixture
def bench() -> VirtualBench:
    bench = VirtualBench(load_rig(shipped() / "rigs" / "virtual-k64f.toml"))
    bench.power_on()
    return bench


@pytest.fixture
def port(bench: VirtualBench) -> DamagedPort:
    port = DamagedPort()
    port.timeout = READ_SLICE_S
    port.attach(bench.machine)
    port.open()
    return port


@pytest.fixture
def session(port: DamagedPort) -> Iterator[Session]:
    session = Session(port, nonce_seed=1, reply_deadline_s=0.2)
    session.synchronise()
    session.request(ClearPoints())
    yield session
    session.close()


def counters(session: Session) -> LinkCounters:
    return session.request(LinkStatistics())


def last(session: Session, count: int) -> list[Attempt]:
    return session.attempts[-count:]


def test_a_damaged_request_is_dropped_counted_and_sent_again(session: Session, port: DamagedPort) -> None:
    before = counters(session)
    port.to_board = [_one_bit]
    assert session.request(Upload(0, THREE_POINTS)) == 3
    first, second = last(session, 2)
    assert (first.outcome, second.outcome) == (RequestOutcome.TIMEOUT, RequestOutcome.ANSWERED)
    assert first.sequence == second.sequence
    # The deadline of the first attempt was kept, on the board's clock; a read slice is the grain. The session forms
    # the same sum: a difference could be rounded to less than 0.2.
    assert first.sent_s + 0.2 <= first.ended_s <= first.sent_s + 0.2 + READ_SLICE_S
    after = counters(session)
    assert (after.damaged - before.damaged, after.repeated - before.repeated) == (1, 0)


@pytest.mark.parametrize(("fault", "damaged"), [(_one_bit, 1), (_lost, 0)])
def test_a_request_whose_reply_is_spoilt_is_answered_again_and_done_once(
    fault: Fault, damaged: int, session: Session, port: DamagedPort
) -> None:
    before = counters(session)
    port.to_host = [fault]
    # Done twice it would be refused: the points no longer begin where it says.
    assert session.request(Upload(0, THREE_POINTS)) == 3
    first, second = last(session, 2)
    assert (first.number, second.number, first.damaged) == (1, 2, damaged)
    assert session.retried == 1
    after = counters(session)
    assert (after.damaged - before.damaged, after.repeated - before.repeated) == (0, 1)
    assert session.request(Points(0, 3)).magnetometer.tolist() == [list(point) for point in THREE_POINTS]


def test_a_reply_after_its_deadline_is_not_taken_for_the_next_one(session: Session, port: DamagedPort) -> None:
    held: list[bytes] = []

    def keep(data: bytes) -> bytes:
        held.append(data)
        return b""

    port.to_host = [keep]
    assert session.request(Upload(0, THREE_POINTS)) == 3  # by the repeated answer
    # Now the first answer turns up, before the one to the next request.
    port.to_host = [lambda data: held[0] + data]
    assert session.request(Upload(3, THREE_POINTS)) == 6
    assert (last(session, 1)[0].number, last(session, 1)[0].stale) == (1, 1)


def test_an_answer_to_nobody_s_request_is_an_error(session: Session, port: DamagedPort) -> None:
    stranger = encode_frame(Frame(LinkStatistics.code | 0x80, 200, bytes(17)))
    port.to_host = [lambda data: stranger + data]
    with pytest.raises(SequenceError, match="sequence number 200, request had 2"):
        session.request(LinkStatistics())


def test_a_line_that_loses_everything_ends_in_a_timeout_that_says_what_the_firmware_does(
    session: Session, port: DamagedPort
) -> None:
    port.to_board = [_lost] * 3
    before_s = session.now()
    with pytest.raises(DeviceTimeoutError, match=r"no answer to UPLOAD within 0\.2 s \(virtual time\)") as caught:
        session.request(Upload(0, THREE_POINTS))
    assert caught.value.state.startswith("asleep in ")
    assert 0.6 <= session.now() - before_s <= 0.6 + 3 * READ_SLICE_S
    assert len({attempt.sequence for attempt in last(session, 3)}) == 1
    # The session is still good: nothing was half done.
    assert session.request(Upload(0, THREE_POINTS)) == 3


def _replace_code(bench: VirtualBench, function: str, code: bytes) -> None:
    """Overwrite the beginning of a function that has not run yet."""
    bench.machine.processor.memory.write(bench.machine.image.symbols[function].address & ~1, code)


def test_firmware_that_loops_for_ever_is_named_with_its_place(session: Session, bench: VirtualBench) -> None:
    _replace_code(bench, "command_identity", b"\xfe\xe7")  # b .
    with pytest.raises(DeviceTimeoutError) as caught:
        session.request(Identify())
    assert caught.value.command == "IDENTITY"
    assert "at rest, in a branch to itself in command_identity" in str(caught.value)


def test_firmware_that_faults_is_named_at_once_and_not_asked_again(session: Session, bench: VirtualBench) -> None:
    _replace_code(bench, "command_identity", b"\x00\xde")  # udf #0
    with pytest.raises(BoardFault, match="command_identity"):
        session.request(Identify())
    assert (last(session, 1)[0].number, last(session, 1)[0].outcome) == (1, RequestOutcome.ERROR)
