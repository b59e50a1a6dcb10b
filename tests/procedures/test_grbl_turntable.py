"""A motor table over a real line: the virtual board's own, which speaks as Grbl does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.boards import VirtualBench, open_board, simulated_grbl
from hiltest.boards.paced import PacedBench
from hiltest.boards.served_lines import PseudoTerminal
from hiltest.boards.simulated_grbl import GrblTable
from hiltest.boards.table_axes import TableAxes
from hiltest.calibration.dpi import fit_dpi
from hiltest.calibration.still_pose import Face
from hiltest.errors import TurntableError
from hiltest.link import grbl
from hiltest.link.gyroscope import Axis
from hiltest.orientation.angles import Pose, rotation_body_from_ned
from hiltest.procedures import Achieved, GrblTurntable, grbl_turntable, open_grbl_turntable
from hiltest.procedures.grbl_turntable import sway_poses, tumble_poses
from hiltest.procedures.turntables import AFTER_TURN_S, BEFORE_TURN_S
from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.world.earth_field import EarthField

pytestmark = pytest.mark.slow

MODEL = "cortex-m4-trm/3"


class Bench:
    """A paced virtual board on its table, and the rig by which a host reaches both."""

    def __init__(self) -> None:
        self.board_line, self.table_line = PseudoTerminal(), PseudoTerminal()
        stepped = VirtualBench(load_rig(shipped() / "rigs" / "virtual-k64f.toml"))
        self.world, self.machine = stepped._world, stepped.machine
        self.axes = TableAxes(stepped)
        table = GrblTable(self.axes, about=f"virtual FRDM-K64F {MODEL}", reset=lambda: None)
        self.paced = PacedBench(stepped, self.board_line, (self.table_line, table))
        self.paced.start()
        served = load_rig(shipped() / "rigs" / "served-k64f.toml")
        self.rig: Rig = replace(
            served,
            board=replace(served.board, port=self.board_line.path),
            turntable=replace(served.turntable, port=self.table_line.path),
        )

    @property
    def pose(self) -> Pose:
        return self.world.state_at(self.machine.time_s).pose

    def close(self) -> None:
        self.paced.stop()
        self.board_line.close()
        self.table_line.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture
def table(bench: Bench) -> Iterator[GrblTurntable]:
    with open_board(bench.rig):
        table = open_grbl_turntable(bench.rig)
        yield table
        table.close()


def test_it_comes_back_when_the_table_stands_and_says_where(bench: Bench, table: GrblTurntable) -> None:
    assert table.turn_to(Pose(330.0, -20.0, 5.0), known_angle=3) == Achieved(330.0, -20.0, 5.0, 0.1)
    assert (bench.pose.pitch_deg, bench.pose.roll_deg) == pytest.approx((-20.0, 5.0), abs=1e-9)
    assert bench.pose.heading_deg == pytest.approx(331.7, abs=1e-9)  # mounted 1.7 degrees further
    assert not bench.axes.busy
    table.rest()
    assert bench.pose == Pose(1.7, 0.0, 0.0)


def test_a_tumble_begins_at_its_first_pose_and_takes_about_as_long_as_it_says(
    bench: Bench, table: GrblTurntable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grbl_turntable, "_CIRCLES_DEG", (75.0, 105.0))  # of six, to be over sooner
    poses = tumble_poses(62.0, mounting_yaw_deg=1.7)
    takes_s = table.tumble(5.6)
    assert bench.axes.busy
    last = poses[-1]
    # Angles travel with three decimals.
    assert bench.axes.last_target_deg == pytest.approx((last.heading_deg, last.pitch_deg, last.roll_deg), abs=1e-3)
    table.rest()  # waits for what is under way
    # Power-on, to the first pose, over the two circles, and home.
    begins_s, ends_s = zip(*((move.start_s, move.end_s) for move in bench.world._segments), strict=True)
    assert len(begins_s) == 2 + (len(poses) - 1) + 1
    assert begins_s[2] - ends_s[1] >= 0.25  # settled at the first pose
    # From move to move the estimate allows 0.1 s, of which the world's grid takes between 0 and 0.05, and the
    # time between two looks at the table at most 0.02.
    assert takes_s - 0.1 * len(poses) <= ends_s[-2] - begins_s[2] <= takes_s


def test_a_sway_takes_about_as_long_as_it_says(
    bench: Bench, table: GrblTurntable, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of 14 moves three, and as fast as the motors, to be over sooner.
    monkeypatch.setattr(grbl_turntable, "_SWAY_HEADINGS_DEG", (0.0, 45.0, 0.0, 0.0))
    monkeypatch.setattr(grbl_turntable, "SWAY_S", 1.0)
    table.rest()
    moves = len(bench.world._segments)
    takes_s = table.sway()
    assert bench.axes.busy
    assert bench.axes.last_target_deg == (0.0, 0.0, 0.0)
    table.rest()
    begins_s, ends_s = zip(*((move.start_s, move.end_s) for move in bench.world._segments[moves:]), strict=True)
    assert len(begins_s) == 3
    # As above: 0.1 s are allowed for between moves.
    assert takes_s - 0.1 * 4 * 2 <= ends_s[-1] - begins_s[0] <= takes_s


def test_a_sway_tilts_to_all_sides_without_winding_up_a_cable() -> None:
    poses = sway_poses()
    assert poses[0] == poses[-1] == Pose(0.0, 0.0, 0.0)
    assert len(poses) - 1 <= 15  # what a planner of Grbl's holds
    assert max(abs(pose.heading_deg) for pose in poses) == 180.0
    assert {(pose.pitch_deg, pose.roll_deg) for pose in poses} >= {(20.0, 0.0), (-20.0, 0.0), (0.0, 20.0), (0.0, -20.0)}


def test_a_turn_begins_after_it_has_come_back_and_is_over_when_it_says(bench: Bench, table: GrblTurntable) -> None:
    table.mount(Axis.Y)
    assert (bench.pose.pitch_deg, bench.pose.roll_deg) == (0.0, 90.0)
    before_s = bench.machine.time_s
    takes_s = table.turn(Axis.Y, -180.0, rate_dps=90.0)
    table.rest()  # waits for the turn first
    # Power-on, to the axis, the turn, and home. It may have come back a little later than the turn was asked for.
    _, _, turn, _ = bench.world._segments
    assert turn.start_s - before_s >= BEFORE_TURN_S - 0.1
    assert turn.end_s - turn.start_s == pytest.approx(2.0, abs=0.05)
    assert turn.end_s - before_s <= takes_s - AFTER_TURN_S + 0.2
    assert bench.pose == Pose(1.7, 0.0, 0.0)


@pytest.mark.parametrize("face", [Face.MINUS_X, Face.PLUS_Y, Face.MINUS_Z])
def test_it_puts_the_board_on_a_face(bench: Bench, table: GrblTurntable, face: Face) -> None:
    table.turn_to_face(face)
    gravity_g = bench.world.state_at(bench.machine.time_s).gravity_body_g
    assert gravity_g == pytest.approx(face.gravity_g, abs=1e-9)


def test_a_table_that_does_not_reach_a_face_says_which_and_what_to_do(
    table: GrblTurntable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulated_grbl, "FURTHEST_DEG", 45.0)
    words = r'cannot put the board nose up \(pitch \+90, .*error:33.* accelerometer_calibration = "none"'
    with pytest.raises(TurntableError, match=words):
        table.turn_to_face(Face.MINUS_X)


def test_a_table_that_cannot_tilt_so_far_says_so(table: GrblTurntable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated_grbl, "FURTHEST_DEG", 45.0)
    with pytest.raises(TurntableError, match=r"Y-90.*' was answered by error:33: .* beyond the table's travel"):
        table.mount(Axis.X)


def test_a_table_that_is_locked_is_sent_home_first(bench: Bench) -> None:
    with open_board(bench.rig):
        table = open_grbl_turntable(bench.rig)
        table._line.ask("G0 X170")
        table._line._write(b"\x18")
        table.close()
        table = open_grbl_turntable(bench.rig)
        assert bench.pose == Pose(1.7, 0.0, 0.0)
        table.close()


def test_a_rig_that_the_table_contradicts_is_refused(bench: Bench) -> None:
    wrong = replace(bench.rig, board=replace(bench.rig.board, cycle_model="cortex-m4-trm/0"))
    with (
        open_board(wrong),
        pytest.raises(
            TurntableError,
            match=rf'is cortex-m4-trm/0, the turntable that it is {MODEL}\. Write cycle_model = "{MODEL}"',
        ),
    ):
        open_grbl_turntable(wrong)
    undeclared = replace(bench.rig, board=replace(bench.rig.board, cycle_model=None))
    with open_board(undeclared) as board:
        assert board.cycle_model == "undeclared@sram"
        open_grbl_turntable(undeclared).close()


def test_every_wait_has_an_end_and_says_what_to_do(
    bench: Bench, table: GrblTurntable, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(TurntableError, match=r"'G0 X40000.*' was answered by error:33: .* beyond the table's travel"):
        table.turn_to(Pose(40_000.0))
    monkeypatch.setattr(grbl, "_STALLED_S", 1.0)
    table._line._write(b"!")
    stalled = r"no answer to 'G4 P0\.25' within 1 s; it is in state Hold at .* not on hold"
    with pytest.raises(TurntableError, match=stalled):
        table.turn_to(Pose(10.0))
    bench.paced.stop()
    bench.table_line.unplug()
    with pytest.raises(TurntableError, match=rf"turntable on {bench.table_line.path}: lost: .*Check cable"):
        table.rest()


def test_a_port_where_nobody_or_somebody_else_answers_is_no_turntable(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grbl, "_START_S", 1.0)
    silent = PseudoTerminal()
    with open_board(bench.rig):
        wrong = replace(bench.rig, turntable=replace(bench.rig.turntable, port=silent.path))
        with pytest.raises(TurntableError, match=r"nothing answered '\?' as Grbl 1\.1 does within 1 s"):
            open_grbl_turntable(wrong)
        gone = replace(bench.rig, turntable=replace(bench.rig.turntable, port="/dev/ttyNOSUCH7"))
        with pytest.raises(TurntableError, match=r"turntable\.port in .*served-k64f\.toml: no serial port"):
            open_grbl_turntable(gone)
    silent.close()


@pytest.mark.parametrize(
    "report",
    ["<Idle|MPos:1.000,-2.5,0|FS:0,0>", "<Run|MPos:1.000,-2.500,0.000,7.000|F:0>", "<Hold:1|MPos:1,-2.5,0>"],
    ids=["spindle", "four axes", "bare"],
)
def test_status_reports_of_other_builds_are_understood(report: str) -> None:
    status = grbl._status(report)
    assert status is not None
    assert status.position == (1.0, -2.5, 0.0)
    assert grbl._status(report.replace("MPos", "WPos")) is None


@given(st.floats(-89.0, 89.0), st.floats(-180.0, 180.0))
def test_a_tumble_shows_the_field_from_all_sides_without_winding_up_a_cable(dip_deg: float, yaw_deg: float) -> None:
    poses = tumble_poses(dip_deg, mounting_yaw_deg=yaw_deg)
    assert all(abs(pose.pitch_deg) <= 90.0 and abs(pose.roll_deg) <= 180.0 for pose in poses)
    assert all(abs(pose.heading_deg) <= 180.0 for pose in poses)
    field = np.array(EarthField(1.0, dip_deg).ned_ut)
    observations = []
    for begin, end in zip(poses[::2], poses[1::2], strict=True):  # each circle; the ways between come on top
        for share in np.linspace(0.0, 1.0, 73):
            roll_deg = begin.roll_deg + share * (end.roll_deg - begin.roll_deg)
            board = Pose(begin.heading_deg + yaw_deg, begin.pitch_deg, roll_deg)
            observations.append(rotation_body_from_ned(board) @ field)
    index = np.arange(200) + 0.5  # directions spread evenly over the sphere
    height, around = 1.0 - index / 100.0, index * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height**2)
    directions = np.column_stack([width * np.cos(around), width * np.sin(around), height])
    nearest = np.degrees(np.arccos(np.clip((directions @ np.array(observations).T).max(axis=1), -1.0, 1.0)))
    # Circles 30 degrees apart, points on them 5 degrees apart at most: half of both, at right angles.
    assert nearest.max() <= np.hypot(15.0, 2.5) + 0.1


@given(st.floats(5.0, 70.0), st.sampled_from((-1.0, 1.0)), st.floats(-180.0, 180.0))
def test_a_tumble_determines_the_magnetometer_against_gravity(dip: float, sign: float, yaw_deg: float) -> None:
    dip_deg = sign * dip
    poses = tumble_poses(dip_deg, mounting_yaw_deg=yaw_deg)
    field, observations, gravity = np.array(EarthField(400.0, dip_deg).ned_ut), [], []
    for begin, end in zip(poses[::2], poses[1::2], strict=True):
        for share in np.linspace(0.0, 1.0, 50, endpoint=False):
            roll_deg = begin.roll_deg + share * (end.roll_deg - begin.roll_deg)
            to_body = rotation_body_from_ned(Pose(begin.heading_deg + yaw_deg, begin.pitch_deg, roll_deg))
            observations.append(to_body @ field)
            gravity.append(to_body @ [0.0, 0.0, 1.0])
    # Tilts of 30 degrees at most give 38, and headings within the limit.
    assert fit_dpi(observations, gravity).calibration.coverage < 38.0


@settings(max_examples=20)
@given(st.floats(-70.0, 70.0), st.integers(0, 2**32 - 1), st.floats(0.005, 0.05))
def test_where_the_table_is_says_how_much_of_the_tumble_is_over(dip_deg: float, seed: int, step: float) -> None:
    poses = tumble_poses(dip_deg)
    corners = [np.array((pose.heading_deg, pose.pitch_deg, pose.roll_deg)) for pose in poses]
    # On the axis that has furthest to go, as a motor table takes its time.
    lengths = [np.abs(end - begin).max() for begin, end in pairwise(corners)]
    ends = np.cumsum(lengths) / sum(lengths)
    way, random = grbl_turntable._TumblePath(poses), np.random.default_rng(seed)
    part = 0.0
    while part < 1.0:
        leg = int(np.searchsorted(ends, part, side="right"))
        along = (part - (ends[leg - 1] if leg else 0.0)) / (lengths[leg] / sum(lengths))
        position = corners[leg] + along * (corners[leg + 1] - corners[leg])
        # A position within a degree of the leg before counts as that leg's end.
        assert way.part_at(tuple(position)) == pytest.approx(part, abs=2.0 / sum(lengths) * 2.0)
        part += step * float(random.random())
    assert way.part_at(tuple(corners[-1])) == pytest.approx(1.0)
