"""Random faults on the line, through framing and session, with the real firmware at the end.

How many sessions is in HILTEST_FAULT_SESSIONS: 500, and 10 000 in tox's reliability.
"""

from __future__ import annotations

import os
import random
from collections import Counter

import pytest
import serial
from tests.totals import session_totals

from hiltest.boards import VirtualBench
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import DeviceTimeoutError, LinkLostError, SyncError
from hiltest.link.messages import MAX_POINTS_READ, ClearPoints, Identify, LinkStatistics, Points, Upload
from hiltest.link.ports import READ_SLICE_S
from hiltest.link.session import RequestOutcome, Session
from hiltest.link.transcript import Direction, Transcript
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

SESSIONS = int(os.environ.get("HILTEST_FAULT_SESSIONS", "500"))
PARTS = 20
REQUESTS = 8
FAULTS = ("drop", "flip", "double", "insert", "burst", "delay", "split", "disconnect")
# Much shorter than a session's: the firmware answers in 2 ms, and what is delayed here comes later than that.
DEADLINE_S = 0.1


class FaultyPort(VirtualPort):
    """The virtual board's port on a line with one kind of fault, or several.

    Attributes
    ----------
    happened : Counter
        Faults so far, by kind.
    written, given : bytes
        What the session wrote, and what it was given to read.
    """

    def __init__(self, dice: random.Random) -> None:
        super().__init__()
        self.name = "faulty"
        self.timeout = READ_SLICE_S
        self.happened: Counter[str] = Counter()
        self.written, self.given = bytearray(), bytearray()
        self._dice = dice
        self._kinds = dice.sample(FAULTS, dice.choice((0, 1, 1, 2, 3, len(FAULTS))))
        self._rate = dice.choice((0.01, 0.03, 0.1))
        self._late: list[tuple[float, bytes]] = []
        self._torn = False

    def quiet(self) -> None:
        """Let no further fault happen."""
        self._kinds = []

    def write(self, data: bytes) -> int:
        self.written += data
        pieces = self._spoilt(bytes(data))
        for number, piece in enumerate(pieces):
            if number:  # the rest comes some time later
                self.machine.run_until(self.machine.time_s + self._dice.choice((0.001, 0.03, 0.3)))
            super().write(piece)
        return len(data)

    def read_until(self, expected: bytes = b"\n", size: int | None = None) -> bytes:
        data = super().read_until(expected, size)
        self.given += data
        return data

    def _take(self) -> None:
        before = len(self._arrived)
        super()._take()
        data = bytes(self._arrived[before:])
        del self._arrived[before:]
        if data:
            for number, piece in enumerate(self._spoilt(data)):
                last_s = self._late[-1][0] if self._late else 0.0  # no byte overtakes another
                due_s = self.machine.time_s + (self._dice.choice((0.001, 0.03, 0.3)) if number else 0.0)
                self._late.append((max(last_s, due_s), piece))
        while self._late and self._late[0][0] <= self.machine.time_s:
            self._arrived += self._late.pop(0)[1]

    def _spoilt(self, data: bytes) -> list[bytes]:
        """Return the pieces that are left of bytes, all but the first of which come later."""
        if self._torn:
            raise serial.SerialException("device disconnected")
        dice, cut = self._dice, 0
        for kind in self._kinds:
            if dice.random() >= self._rate:
                continue
            self.happened[kind] += 1
            at = dice.randrange(len(data)) if data else 0
            if kind == "drop":
                data = data[:at] + data[at + dice.choice((1, 1, 2, 5)) :]
            elif kind == "flip":
                data = data[:at] + bytes(item ^ (1 << dice.randrange(8)) for item in data[at : at + 1]) + data[at + 1 :]
            elif kind == "double":
                end = dice.choice((at + 1, len(data)))
                data = data[:end] + data[dice.choice((0, at)) : end] + data[end:]
            elif kind == "insert":
                data = data[:at] + dice.randbytes(dice.choice((1, 3, 40))) + data[at:]
            elif kind == "burst":
                length = dice.choice((2, 8, 30))
                data = data[:at] + dice.randbytes(len(data[at : at + length])) + data[at + length :]
            elif kind in ("delay", "split"):
                cut = 0 if kind == "delay" else at
                return [data[:cut], data[cut:]]
            elif dice.random() < 0.2:
                self._torn = True
        return [data]


@pytest.fixture(scope="module")
def bench() -> VirtualBench:
    bench = VirtualBench(load_rig(shipped() / "rigs" / "virtual-k64f.toml"))
    bench.power_on()
    return bench


@pytest.fixture
def totals(pytestconfig: pytest.Config) -> Counter[str]:
    """Totals of all parts, printed at the end."""
    return session_totals(pytestconfig, "fault sessions")


class Model:
    """What the board holds, by what it has acknowledged."""

    def __init__(self) -> None:
        self.stored: list[list[int]] = []
        self.unsure: list[list[int]] | None = None  # were the request that was not answered carried out


def one_request(session: Session, model: Model, dice: random.Random, identity: object) -> None:
    """Make one request, and check its answer; one that is not answered leaves the model unsure."""
    kind = dice.choice(("upload", "upload", "clear", "points", "identify", "statistics"))
    if kind == "upload":
        points = [[dice.randrange(-32768, 32768) for _ in range(3)] for _ in range(dice.choice((1, 3, 9)))]
        model.unsure = model.stored + points
        assert session.request(Upload(len(model.stored), points)) == len(model.unsure)
        model.stored, model.unsure = model.unsure, None
    elif kind == "clear":
        model.unsure = []
        session.request(ClearPoints())
        model.stored, model.unsure = [], None
    elif kind == "points":
        assert session.request(Points(0, MAX_POINTS_READ)).magnetometer.tolist() == model.stored
    elif kind == "identify":
        assert session.request(Identify()) == identity
    else:
        session.request(LinkStatistics())


def opened(bench: VirtualBench, port: FaultyPort, seed: int) -> Session:
    port.attach(bench.machine)
    port.open()
    return Session(port, transcript=Transcript(), nonce_seed=seed, reply_deadline_s=DEADLINE_S)


def check_kept(session: Session, port: FaultyPort) -> None:
    """Check that every byte of both directions is in the transcript."""
    assert session.transcript is not None
    stored = dict.fromkeys(Direction, b"")
    for entry in session.transcript.entries:
        stored[entry.direction] += entry.data
    assert stored[Direction.TO_BOARD] == bytes(port.written)
    assert stored[Direction.TO_HOST] == bytes(port.given)


def hold_session(bench: VirtualBench, seed: int, totals: Counter[str]) -> None:
    """Hold one session on a faulty line, and look over a quiet one at what it has left on the board."""
    dice = random.Random(seed)
    quiet = FaultyPort(random.Random(seed))
    quiet.quiet()
    clean = opened(bench, quiet, seed)
    clean.synchronise()
    identity = clean.identify()
    clean.request(ClearPoints())
    port, model, ended = FaultyPort(dice), Model(), "finished"
    session = opened(bench, port, seed + 1)
    try:
        session.synchronise()
        for _ in range(REQUESTS):
            one_request(session, model, dice, identity)
    except (DeviceTimeoutError, LinkLostError, SyncError) as error:  # what docs/reliability.md says may be raised
        ended = type(error).__name__
    totals.update({"sessions": 1, ended: 1, "requests": sum(attempt.number == 1 for attempt in session.attempts)})
    totals.update({"sent again": sum(attempt.number > 1 for attempt in session.attempts), **port.happened})
    check_kept(session, port)
    assert (session.attempts[-1].outcome is RequestOutcome.ANSWERED) == (ended == "finished")
    # Whatever was acknowledged is on the board, once, and what was not is there as a whole or not at all.
    bench.machine.run_until(bench.time_s + 1.0)
    clean.synchronise()
    magnetometer = clean.request(Points(0, MAX_POINTS_READ)).magnetometer.tolist()
    assert magnetometer == model.stored or magnetometer == model.unsure


@pytest.mark.slow  # sessions by the hundred
@pytest.mark.parametrize("part", range(PARTS))
def test_no_fault_on_the_line_makes_a_wrong_answer_or_an_undocumented_error(
    bench: VirtualBench, totals: Counter[str], part: int
) -> None:
    for seed in range(part, SESSIONS, PARTS):
        try:
            hold_session(bench, seed, totals)
        except Exception as error:
            error.add_note(f"session {seed}")
            raise
