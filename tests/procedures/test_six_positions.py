"""Six faces from the table to the board's fit, and each way in which they can go wrong."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.boards import Board, open_board
from hiltest.boards.bench import VirtualBench
from hiltest.boards.board import Stage
from hiltest.calibration.accelerometer import CROSS_AXIS, NOMINAL, fit_six_position, is_on_face
from hiltest.calibration.still_pose import FACES, Face
from hiltest.errors import CalibrationError, FaceError, OperatorAbsentError
from hiltest.link.accelerometer import GetAccelerometer
from hiltest.link.messages import Average, SetCalibration
from hiltest.link.poses import Poses
from hiltest.measurement import Limit
from hiltest.orientation.angles import Pose
from hiltest.procedures import (
    OperatorTurntable,
    SimulatedTurntable,
    collect_still_poses,
    fit_poses,
    measure_six_positions,
    run_calibrators,
    spread_poses,
    store_accelerometer,
    store_untrimmed,
)
from hiltest.procedures.calibrate import CalibratorRun
from hiltest.procedures.tumble import collect_tumble
from hiltest.rig import Rig
from hiltest.rig.rig_file import load_rig
from hiltest.world.motion import Turn

DECLARED_DEG = 0.1


def table_of(board: Board) -> SimulatedTurntable:
    table = SimulatedTurntable(board.stage, uncertainty_deg=0.1)
    assert isinstance(table, SimulatedTurntable)
    return table


@contextmanager
def untrimmed(rig: Rig, **world: object) -> Iterator[Board]:
    """A board whose part is 20 mg and 2.5 % wrong on every axis."""
    assert rig.world is not None
    wrong = replace(
        rig.world,
        accelerometer_offset_mg=(20.0, -20.0, 20.0),
        accelerometer_gain_error_percent=(2.5, -2.5, 2.5),
        **world,  # type: ignore[arg-type]
    )
    with open_board(replace(rig, world=wrong)) as board:
        yield board


def test_the_board_fits_its_faces_as_the_reference_does_and_is_held_against_the_truth(bench_rig: Rig) -> None:
    with untrimmed(bench_rig) as board:
        run = measure_six_positions(board, table_of(board), uncertainty_deg=DECLARED_DEG)
        poses = board.session.request(Poses(0, 20))
    assert [pose.face for pose in poses] == list(FACES)
    assert np.array_equal(run.counts, [pose.accelerometer for pose in poses])
    assert [pose.readings for pose in poses] == [64] * 6
    expected = fit_six_position(poses)
    assert np.allclose(run.fit.gain, expected.fit.gain, rtol=1e-6)
    assert run.solution.residual_mg == pytest.approx(expected.residual_mg, abs=1e-3)
    # Six faces within 0.1 degree; simulated 0.067 and 0.36 in the 99th percentile, 0.071 and 0.55 at most.
    assert run.axis_error_deg is not None
    assert run.offset_error_mg is not None
    assert run.axis_error_deg < 0.1
    assert run.offset_error_mg < 0.7
    assert run.cost is not None
    assert run.cost.cycles > 1000


def test_faces_without_error_leave_the_noise_alone(bench_rig: Rig) -> None:
    with untrimmed(bench_rig, face_errors_deg=()) as board:
        run = measure_six_positions(board, table_of(board), uncertainty_deg=DECLARED_DEG)
    # 1.3 mg over the root of 64 readings, and a quarter of a step of 0.5 mg: 0.2 mg, 0.01 degree; five times that.
    assert run.axis_error_deg is not None
    assert run.offset_error_mg is not None
    assert run.axis_error_deg < 0.05
    assert run.offset_error_mg < 0.8
    assert run.solution.residual_mg < 1.0


@pytest.mark.parametrize("face", FACES)
def test_a_face_is_down_when_it_is_asked_for(virtual_board: Board, face: Face) -> None:
    table_of(virtual_board).turn_to_face(face)
    assert is_on_face(virtual_board.session.request(Average(4)).accelerometer.mean, face)


class WrongTable(SimulatedTurntable):
    """A table that does something else at one face."""

    def __init__(self, stage: Stage, wrong: Face, instead: Callable[[], object]) -> None:
        super().__init__(stage, uncertainty_deg=0.1)
        self._wrong = wrong
        self._instead = instead

    def turn_to_face(self, face: Face) -> None:
        super().turn_to_face(face)
        if face is self._wrong:
            self._instead()


def bench_of(board: Board) -> VirtualBench:
    assert isinstance(board.stage, VirtualBench)
    return board.stage


def test_a_board_on_another_face_is_refused_by_the_names_of_both(virtual_board: Board) -> None:
    stage = bench_of(virtual_board)
    table = WrongTable(stage, Face.MINUS_Y, lambda: stage.turn_to(Face.PLUS_Y.pose))
    words = r"asked for left side down, .*\(\+0\.00, \+1\.00, .*lies right side down;"
    with pytest.raises(FaceError, match=words) as caught:
        measure_six_positions(virtual_board, table, uncertainty_deg=DECLARED_DEG)
    assert caught.value.faces == (Face.MINUS_Y,)


def test_a_board_between_two_faces_is_on_none(virtual_board: Board) -> None:
    stage = bench_of(virtual_board)
    table = WrongTable(stage, Face.PLUS_Z, lambda: stage.turn_to(Pose(0.0, 0.0, 30.0)))
    with pytest.raises(FaceError, match=r"asked for level, .* it lies on none of the six faces"):
        measure_six_positions(virtual_board, table, uncertainty_deg=DECLARED_DEG)


def test_a_board_that_is_turned_while_its_readings_come_is_refused_by_their_spread(virtual_board: Board) -> None:
    stage = bench_of(virtual_board)
    table = WrongTable(stage, Face.PLUS_X, lambda: stage.begin_turn(Pose(0.0, -80.0)))
    with pytest.raises(FaceError, match=r"moved while it lay nose down: its readings spread by \d+\.\d mg rms"):
        measure_six_positions(virtual_board, table, uncertainty_deg=DECLARED_DEG)


def test_a_board_that_sinks_slowly_is_refused_by_its_halves(virtual_board: Board) -> None:
    stage = bench_of(virtual_board)

    def sink() -> None:
        stage.turn_to(Face.PLUS_Z.pose)
        begin = stage.next_move_s()
        stage.begin_move(Turn(begin, begin + 1.0, Face.PLUS_Z.pose, (0.0, 0.3, 0.0)))

    table = WrongTable(stage, Face.PLUS_Z, sink)
    with pytest.raises(FaceError, match=r"moved while it lay level: gravity changed by \d\.\d mg within the second"):
        measure_six_positions(virtual_board, table, uncertainty_deg=DECLARED_DEG)


@pytest.mark.slow  # two seconds for each face
@pytest.mark.parametrize("face", FACES)
def test_a_face_that_is_askew_by_more_than_declared_is_found_with_its_opposite(bench_rig: Rig, face: Face) -> None:
    errors = [(0.0, 0.0, 0.0)] * 6
    turn = [0.0, 0.0, 0.0]
    turn[(face // 2 + 1) % 3] = 1.0
    errors[face] = (turn[0], turn[1], turn[2])
    with untrimmed(bench_rig, face_errors_deg=tuple(errors)) as board:
        table = table_of(board)
        words = r"contradict each other: one of .* is askew by some (0\.9|1\.[01]) deg"
        with pytest.raises(FaceError, match=words) as caught:
            measure_six_positions(board, table, uncertainty_deg=DECLARED_DEG)
        assert set(caught.value.faces) == {face, Face(face ^ 1)}
        if face is Face.PLUS_X:  # where faces are declared no better than that, nothing contradicts the declaration
            run = measure_six_positions(board, table, uncertainty_deg=1.0)
        else:  # the same fit, of the poses that the board still holds
            run = fit_poses(board, "six-position", len(FACES), 25)
    # One of six middles is off by half of it: by the root of 2/6 of that the faces are askew.
    assert run.solution.faces_askew_deg == pytest.approx(0.5 * math.sqrt(2 / 6), abs=0.02)
    # Half of it is seen across, and of that the part is taken to have c^2 / (c^2 + sigma^2 / 2).
    share = CROSS_AXIS**2 / (CROSS_AXIS**2 + math.radians(run.solution.faces_askew_deg) ** 2 / 2)
    assert run.axis_error_deg == pytest.approx(0.5 * share, abs=0.05)


def test_faces_that_are_too_askew_for_a_limit_are_refused_by_the_name_of_the_limit(bench_rig: Rig) -> None:
    by_hand = load_rig(Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f-hand-laid.toml")
    assert by_hand.world is not None
    limits = {"accelerometer.norm_rms": Limit(max=0.1), "heading.direct.bias": Limit(max=0.1), **by_hand.limits}
    tight = {"heading.corrected.max_centred": Limit(max=2.0)}
    asked: list[FaceError] = []

    def again(error: FaceError) -> bool:
        asked.append(error)
        return len(asked) == 1

    with untrimmed(bench_rig, face_errors_deg=by_hand.world.face_errors_deg) as board:
        table = table_of(board)
        run = measure_six_positions(board, table, uncertainty_deg=2.5, limits=limits, dip_deg=62.0)
        assert run.solution.faces_askew_deg == pytest.approx(1.0, abs=0.05)
        # A third of the dip's tangent, and so of what they turn a heading by.
        measure_six_positions(board, table, uncertainty_deg=2.5, limits=tight, dip_deg=30.0)
        words = (
            r"the faces were askew by (0\.9|1\.0)\d deg rms, too much for limits\.heading\.corrected\.max_centred "
            r"of 2 deg: .* by up to 2\.1 deg \(99th percentile, at a dip of 62 deg\)"
        )
        with pytest.raises(FaceError, match=words):
            measure_six_positions(board, table, uncertainty_deg=2.5, limits=tight, dip_deg=62.0, again=again)
    assert len(asked) == 2


def test_what_the_board_refuses_is_said_with_the_pose(virtual_board: Board) -> None:
    collect_still_poses(virtual_board, table_of(virtual_board), spread_poses(9)[:4])
    with pytest.raises(FaceError, match="refuses the ellipsoid fit of 4 poses: TOO_FEW_POSES; an ellipsoid needs"):
        fit_poses(virtual_board, "ellipsoid", 4, 25)
    with pytest.raises(FaceError, match=r"MISSING_FACE, nose down \(\+x down\), nose up \(-x down\)"):
        fit_poses(virtual_board, "six-position", 4, 25)


def test_still_poses_all_round_give_the_ellipsoid_of_a_part(bench_rig: Rig) -> None:
    with untrimmed(bench_rig, accelerometer_cross_axis_percent=((0.0,) * 3,) * 3) as board:
        collect_still_poses(board, table_of(board), spread_poses(20))
        run = fit_poses(board, "ellipsoid", 20, 25)
    assert len(run.counts) == 20
    # Half of forty poses: 0.029 degree and 0.4 mg in the 99th percentile, and as much again.
    assert run.axis_error_deg is not None
    assert run.offset_error_mg is not None
    assert run.axis_error_deg < 0.06
    assert run.offset_error_mg < 0.8


def test_spread_poses_show_gravity_from_all_sides() -> None:
    assert len({pose.heading_deg for pose in spread_poses(40)}) == 40
    with pytest.raises(ValueError, match="no poses"):
        collect_still_poses(None, None, [])  # type: ignore[arg-type]


def test_slots_get_the_calibration_and_an_untrimmed_copy_does_not(virtual_board: Board) -> None:
    tumble = collect_tumble(virtual_board, table_of(virtual_board), points=100)
    runs: dict[str, CalibratorRun] = run_calibrators(virtual_board, tumble, calibrators=["direct"])
    fit = replace(NOMINAL, offset=np.array([100.0, -50.0, 25.0]))
    store_accelerometer(virtual_board, fit, [0, 1, 9])
    assert [virtual_board.session.request(GetAccelerometer(slot)).offset.tolist() for slot in (0, 1, 9)] == [
        [100.0, -50.0, 25.0]
    ] * 3
    virtual_board.session.request(SetCalibration(9, np.eye(3), np.zeros(3)))
    assert store_untrimmed(virtual_board, runs, first_slot=9) == {"direct-untrimmed": 9}
    table_of(virtual_board).rest()
    reply = virtual_board.session.request(Average(4, 1 << 1 | 1 << 9))
    with_it, without = reply.headings[1].attitude, reply.headings[9].attitude
    assert with_it is not None
    assert without is not None
    # 100 counts of x are 12 mg: 0.7 degree of pitch.
    assert with_it.pitch_deg - without.pitch_deg == pytest.approx(0.7, abs=0.02)
    with pytest.raises(CalibrationError, match=r"no slots for direct-untrimmed: the board has 16, and 16 are taken"):
        store_untrimmed(virtual_board, runs, first_slot=16)
    assert store_untrimmed(virtual_board, runs, first_slot=15) == {"direct-untrimmed": 15}
    store_accelerometer(virtual_board, NOMINAL, [0, 1])


def test_an_operator_is_asked_for_each_face_by_the_side_that_is_down() -> None:
    asked: list[str] = []
    table = OperatorTurntable(prompt=lambda text: asked.append(text) or "", uncertainty_deg=0.5)
    for face in FACES:
        table.turn_to_face(face)
    sides = ("nose down", "nose up", "right side down", "left side down", "level", "upside down")
    for number, (text, side) in enumerate(zip(asked, sides, strict=True), start=1):
        assert f"face {number} of 6: put the board {side}, square on a level surface" in text.splitlines()[-1]

    def nobody(_: str) -> str:
        raise EOFError

    with pytest.raises(OperatorAbsentError, match="at the terminal: face 5 of 6"):
        OperatorTurntable(prompt=nobody, uncertainty_deg=0.5).turn_to_face(Face.PLUS_Z)
