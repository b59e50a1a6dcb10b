"""The turntable's end of its serial line: Grbl's dialect, and a board that turns as it says."""

from __future__ import annotations

import math
import re
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.boards.simulated_grbl import BANNER, GrblTable
from hiltest.boards.table_axes import CAPACITY, TableAxes
from hiltest.orientation.angles import Pose
from hiltest.world.earth_field import EarthField
from hiltest.world.motion import BRAKE_S, MOVE_GRID_S, TURN_SPEED_DPS, MotionSegment
from hiltest.world.world import World

LOOK_S = 0.002  # how often the paced board looks after its lines


class Bench:
    """A real world and a clock that the test moves."""

    def __init__(self) -> None:
        self.time_s = 1.0
        self.world = World(EarthField(50.0, 60.0))
        self.moves: list[MotionSegment] = []

    def next_move_s(self) -> float:
        return self.world.hold(time_s=self.time_s)

    def begin_move(self, move: MotionSegment) -> None:
        self.world.follow(move)
        self.moves.append(move)


class Table:
    """A table and the client that speaks to it."""

    def __init__(self) -> None:
        self.bench = Bench()
        self.grbl = GrblTable(TableAxes(self.bench), about="a test", reset=lambda: None)
        assert self.grbl.say() == BANNER.encode()

    def send(self, data: str | bytes) -> list[str]:
        self.grbl.hear(data.encode() if isinstance(data, str) else data)
        return self.heard()

    def heard(self) -> list[str]:
        return self.grbl.say().decode("ascii").split("\r\n")[:-1]

    def wait(self, seconds: float) -> list[str]:
        heard = []
        for _ in range(math.ceil(seconds / LOOK_S)):
            self.bench.time_s += LOOK_S
            heard += self.heard()
        return heard

    def status(self) -> tuple[str, tuple[float, ...]]:
        (report,) = self.send("?")
        match = re.fullmatch(r"<(\S+)\|MPos:(\S+),(\S+),(\S+)\|F:\d+>", report)
        assert match, report
        return match[1], tuple(float(angle) for angle in match.groups()[1:])

    @property
    def board(self) -> Pose:
        return self.bench.world.state_at(self.bench.time_s).pose


@pytest.fixture
def table() -> Table:
    return Table()


def test_a_move_is_acknowledged_takes_its_time_and_ends_where_it_was_asked_to(table: Table) -> None:
    assert table.send("G90 G0 X90 Y20 Z-10\n") == ["ok"]
    assert table.status()[0] == "Run"
    table.wait(0.3)
    state, under_way = table.status()
    assert state == "Run"
    assert 0.0 < under_way[0] < 90.0
    # All axes go together: one course in three angles.
    assert under_way[1] / under_way[0] == pytest.approx(20.0 / 90.0, abs=1e-4)  # shown to 0.001
    assert table.board.heading_deg == pytest.approx(under_way[0], abs=1e-3)
    table.wait(90.0 / TURN_SPEED_DPS)
    assert table.status() == ("Idle", (90.0, 20.0, -10.0))
    assert table.board == Pose(90.0, 20.0, -10.0)


def test_g0_is_as_fast_as_the_table_and_g1_as_its_feed(table: Table) -> None:
    table.send("G0 X90\nG1 X120 F1800\nG1 X120 Y40 Z30 F600\nX480 Z30 Y40 F100000\n")
    table.wait(20.0)
    durations = [move.end_s - move.start_s for move in table.bench.moves]
    # 90 deg at 120 deg/s; 30 at 30; 50 (of 40 and 30) at 10; 360 at no more than the table's own 120.
    assert durations == pytest.approx([0.75, 1.0, 5.0, 3.0], abs=1e-9)


def test_a_dwell_is_answered_when_the_moves_before_it_are_over(table: Table) -> None:
    assert table.send("G0X60\nG4P0.5\nG0X0\n") == ["ok"]
    assert table.wait(0.9) == []
    # 0.5 s of turn, begun on the grid, and 0.5 s of dwell.
    assert table.wait(0.2) == ["ok", "ok"]
    assert table.bench.moves[1].start_s >= table.bench.moves[0].end_s + 0.5


def test_relative_moves_add_up_over_whole_turns(table: Table) -> None:
    table.send("G91\nG0X300\nX300\nX300 Y10\n")
    table.wait(10.0)
    assert table.status() == ("Idle", (900.0, 10.0, 0.0))
    assert table.board.heading_deg == pytest.approx(180.0, abs=1e-9)
    table.send("G90 X890\n")
    table.wait(0.5)
    assert table.status()[1] == (890.0, 10.0, 0.0)


def test_home_is_the_short_way_and_counts_from_zero(table: Table) -> None:
    table.send("G0 X725 Y-15\n")
    assert table.send("$H\n") == ["error:8"]
    table.wait(7.0)
    assert table.send("$H\n") == []
    assert table.status()[0] == "Home"
    assert table.wait(1.0) == ["ok"]
    assert table.status() == ("Idle", (0.0, 0.0, 0.0))
    assert table.board == Pose(0.0, 0.0, 0.0)
    assert table.bench.moves[-1].end_s - table.bench.moves[-1].start_s < 0.5


def test_hold_stops_softly_and_resume_goes_on_to_the_same_place(table: Table) -> None:
    table.send("G0 X180\n")
    table.wait(0.5)
    assert table.send("!") == []
    assert table.status()[0] == "Hold:1"
    table.wait(BRAKE_S + MOVE_GRID_S)
    state, held = table.status()
    assert state == "Hold:0"
    assert 20.0 < held[0] < 160.0
    table.wait(3.0)
    assert table.status() == ("Hold:0", held)
    assert table.send("~") == []
    table.wait(3.0)
    assert table.status() == ("Idle", (180.0, 0.0, 0.0))


def test_a_reset_in_motion_stops_and_locks_until_home_or_unlocked(table: Table) -> None:
    table.send("G0 X180\nG0 X0\n")
    table.wait(0.5)
    assert table.send("\x18") == ["ALARM:3", "", "Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"]
    assert table.status()[0] == "Alarm"
    assert table.send("G0 X1\n") == ["error:9"]
    table.wait(2.0)
    stopped = table.status()[1]
    assert 20.0 < stopped[0] < 160.0
    assert table.send("$X\n") == ["[MSG:Caution: Unlocked]", "ok"]
    assert table.status() == ("Idle", stopped)
    assert table.send("\x18") == ["", "Grbl 1.1h ['$' for help]"]
    table.send("G0 X180\n")
    table.wait(0.3)
    table.send("\x18")
    # Home at once, still coming to rest.
    assert table.send("$H\n") == []
    assert table.wait(3.0) == ["ok"]
    assert table.status() == ("Idle", (0.0, 0.0, 0.0))


def test_when_all_places_are_taken_the_answer_waits(table: Table) -> None:
    lines = "".join(f"X{number}\n" for number in range(1, CAPACITY + 3))
    # One is under way, as many wait as Grbl's planner holds, and the next is not taken yet.
    assert table.send(lines) == ["ok"] * (CAPACITY + 1)
    assert table.wait(0.2) == ["ok"]
    assert table.status()[0] == "Run"


@pytest.mark.parametrize(
    ("message", "answers"),
    [
        ("\r", ["ok"]),
        ("\n", ["ok"]),
        ("\r\n", ["ok"]),
        ("\r\n\r\n", ["ok", "ok"]),
        ("\n\n", ["ok", "ok"]),
        ("(all of it) ; and this\n", ["ok"]),
        ("g0 x1 (heading) y 2\n", ["ok"]),
        ("G38.2 X1 F1\n", ["error:20"]),
        ("X36001\n", ["error:33"]),
        ("G0 X1" + " " * 90 + "\n", ["error:11"]),
        ("$J=X1\n", ["error:3"]),
        ("$\n", ["[HLP:$$ $G $I $X $H ~ ! ? ctrl-x]", "ok"]),
        ("%\n", ["ok"]),
        ("$I\n", ["[VER:1.1h.20190825:a test]", "[OPT:,15,128]", "ok"]),
        ("G91 F30\n$G\n", ["ok", "[GC:G0 G54 G17 G21 G91 G94 F30]", "ok"]),
        (b"\x90\xff\x00G0\n", ["ok"]),
    ],
)
def test_lines_and_their_answers(table: Table, message: str | bytes, answers: list[str]) -> None:
    assert table.send(message) == answers


def test_the_settings_name_the_rates_that_hold(table: Table) -> None:
    assert {f"$11{axis}={60 * TURN_SPEED_DPS:.3f}" for axis in range(3)} <= set(table.send("$$\n"))


def test_moves_one_after_the_other_give_the_world_a_smooth_attitude(table: Table) -> None:
    table.send("G0 X-30 Y-50 Z-180\nZ180\nX40 Y20 Z90\nG1 Z-180 F3000\nX0 Y0 Z0\n")
    began_s = table.bench.time_s
    step_s = 0.001
    states = []
    for count in range(17_000):
        table.bench.time_s = began_s + count * step_s
        table.heard()
        if count == 2_000:
            table.send("!")
        if count == 3_000:
            table.send("~")
        states.append(table.bench.world.state_at(table.bench.time_s))
    assert table.status() == ("Idle", (0.0, 0.0, 0.0))
    for before, after in pairwise(states):
        # Between two looks the field turns by no more than the rates say, and the rates themselves
        # change by no more than the steepest course does: peak 5.8 x 360 deg / (3 s)^2, brake 1.5 x 225 / 0.25 s.
        turned = math.dist(before.field_body_ut, after.field_body_ut) / 50.0
        rate_dps = max(math.hypot(*before.rate_body_dps), math.hypot(*after.rate_body_dps))
        assert math.degrees(turned) <= 1.01 * rate_dps * step_s + 2e-3
        assert math.dist(before.rate_body_dps, after.rate_body_dps) <= 4_000.0 * step_s
    assert max(math.hypot(*state.rate_body_dps) for state in states) > 150.0


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=40),
            st.sampled_from(
                [b"G0X10\n", b"G1Y5F900\r\n", b"$H\n", b"!", b"~", b"?", b"\x18", b"$X\n", b"G91\n", b"G4P.1\n"]
            ),
        ),
        max_size=30,
    )
)
def test_no_bytes_ever_kill_the_table(chunks: list[bytes]) -> None:
    table = Table()
    for chunk in chunks:
        table.send(chunk)
        table.wait(0.01)
    table.send(b"\x18\n$X\n~")
    table.wait(1.0)  # comes to rest
    table.send("$X\nG90\n")
    assert table.status()[0] == "Idle"
    assert table.send("G0X1Y2Z3\n") == ["ok"]
    table.bench.time_s += 700.0  # the furthest that it may be is 72 000 degrees away
    table.heard()
    assert table.status() == ("Idle", (1.0, 2.0, 3.0))
