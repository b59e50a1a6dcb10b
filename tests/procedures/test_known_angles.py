"""From the tumble to the heading errors, on the virtual board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hiltest.boards import Board, open_board
from hiltest.calibration import reference
from hiltest.errors import CalibrationError, DeviceError, PoorCoverageError
from hiltest.link.messages import Average, ClearCalibration
from hiltest.orientation.angles import Pose, wrap_180
from hiltest.orientation.tilt_heading import tilt_heading
from hiltest.procedures import (
    CalibratorRun,
    KnownAngles,
    SimulatedTurntable,
    Tumble,
    Turntable,
    collect_tumble,
    measure_known_angles,
    run_calibrators,
)
from hiltest.rig import Rig

SOME_POSES = (Pose(0.0), Pose(120.0), Pose(240.0), Pose(30.0, 20.0, 0.0), Pose(330.0, 0.0, -20.0))


@pytest.fixture(scope="module")
def tumble(virtual_board: Board) -> Tumble:
    return collect_tumble(virtual_board, SimulatedTurntable(virtual_board.stage, uncertainty_deg=0.1), points=120)


@pytest.fixture(scope="module")
def runs(virtual_board: Board, tumble: Tumble) -> dict[str, CalibratorRun]:
    return run_calibrators(virtual_board, tumble, calibrators=["direct", "iterative"])


@pytest.fixture(scope="module")
def angles(virtual_board: Board, runs: dict[str, CalibratorRun], bench_rig: Rig) -> KnownAngles:
    assert bench_rig.mounting is not None
    slots = {"uncalibrated": 0} | {name: run.slot for name, run in runs.items()}
    table = SimulatedTurntable(virtual_board.stage, uncertainty_deg=0.1)
    return measure_known_angles(
        virtual_board, table, poses=SOME_POSES, slots=slots, mounting_yaw_deg=bench_rig.mounting.yaw_deg
    )


def test_a_tumble_gives_fresh_points_from_all_sides(tumble: Tumble) -> None:
    assert tumble.points.shape == tumble.accelerometer.shape == (120, 3)
    middle = (tumble.points.min(axis=0).astype(float) + tumble.points.max(axis=0)) / 2.0
    assert len({tuple(octant) for octant in (tumble.points > middle).tolist()}) == 8
    # Ten points are one stroke. With a quarter of the sphere missing (0.75) a fit begins to suffer;
    # even 120 evenly spread points would leave a hole of 14 degrees.
    assert tumble.coverage_of(10) < 0.75 < tumble.coverage <= (1.0 + np.cos(np.radians(14.0))) / 2.0
    # 120 points at 80 Hz take 1.5 s, and reading them back not more than that again.
    assert 1.4 < tumble.duration_s < 3.0


def test_every_calibrator_sees_the_same_points_and_is_held_against_the_truth(runs: dict[str, CalibratorRun]) -> None:
    for slot, (name, run) in enumerate(runs.items(), start=1):
        assert (run.name, run.slot, run.n, run.usable, run.is_sphere) == (name, slot, 100, True, False)
        # The residual is noise alone: its rms scatters by 1/sqrt(2*91) = 7 %; 30 % are four sigma.
        assert run.residual_percent == pytest.approx(run.residual_predicted_percent, rel=0.3)
        assert run.offset_error_ut is not None
        assert run.rotation_left_deg is not None
        # sigma sqrt(3/n) times the dilution of a full sphere, below 3: 0.4 * 0.17 * 3.
        assert run.offset_error_ut < 0.21
        assert run.rotation_left_deg < 1.0
    direct, iterative = runs["direct"], runs["iterative"]
    assert direct.cost is not None
    assert iterative.cost is not None
    assert direct.cost.cycles < iterative.cost.cycles
    assert direct.coverage is not None
    assert 1.0 <= direct.coverage < 4.0  # of the whole sphere; above 4 a quarter of it is missing
    assert iterative.coverage == direct.coverage


def test_headings_are_judged_against_the_table_with_the_declared_mounting_off(
    angles: KnownAngles, bench_rig: Rig
) -> None:
    assert bench_rig.mounting is not None
    assert np.allclose(angles.reference_deg, [(p.heading_deg + bench_rig.mounting.yaw_deg) % 360 for p in SOME_POSES])
    assert angles.summary("direct").max_deg < 1.8  # the rig's limit
    assert angles.summary("uncalibrated").max_deg > angles.summary("direct").max_deg
    assert angles.level.tolist() == [True, True, True, False, False]
    # Tilt of the answer: accelerometer wrong by at most 3 mg + 0.3 %, that is 0.35 degrees.
    assert np.allclose(angles.pitch_deg["direct"], [p.pitch_deg for p in SOME_POSES], atol=0.35)
    assert np.allclose(angles.roll_deg["direct"], [p.roll_deg for p in SOME_POSES], atol=0.35)
    assert angles.max_tilt_error_deg("direct") == pytest.approx(
        max(
            np.abs(angles.pitch_deg["direct"] - [p.pitch_deg for p in SOME_POSES]).max(),
            np.abs(angles.roll_deg["direct"] - [p.roll_deg for p in SOME_POSES]).max(),
        )
    )
    assert angles.accelerometer_norm_rms_mg("direct") < 6.0
    assert angles.max_level_deg("direct") <= angles.summary("direct").max_deg


def test_an_undeclared_mounting_is_left_in_the_errors_as_bias(
    virtual_board: Board, simulated_turntable: Turntable, runs: dict[str, CalibratorRun], bench_rig: Rig
) -> None:
    assert bench_rig.mounting is not None
    poses = bench_rig.procedure.known_angle_poses("level")
    undeclared = measure_known_angles(
        virtual_board, simulated_turntable, poses=poses, slots={"direct": runs["direct"].slot}, mounting_yaw_deg=0.0
    )
    summary = undeclared.summary("direct")
    # The bias that noise and accelerometer leave is within 0.12 degrees over seeds; 0.3 is more than twice that.
    assert summary.bias_deg == pytest.approx(bench_rig.mounting.yaw_deg, abs=0.3)
    assert summary.max_deg > summary.bias_deg


def test_a_heading_that_the_board_refuses_says_at_which_pose(
    virtual_board: Board, simulated_turntable: Turntable
) -> None:
    virtual_board.session.request(ClearCalibration(7))
    with pytest.raises(DeviceError, match=r"NO_CALIBRATION: .*'empty' at heading 60, pitch \+20, roll \+0"):
        measure_known_angles(
            virtual_board, simulated_turntable, poses=[Pose(60.0, 20.0, 0.0)], slots={"empty": 7}, mounting_yaw_deg=0.0
        )


def test_more_than_the_board_can_do_is_refused_by_name(
    virtual_board: Board, simulated_turntable: Turntable, tumble: Tumble
) -> None:
    target = ", ".join(virtual_board.identity.calibrators)
    with pytest.raises(CalibrationError, match=f"no calibrator magic; it has {target}"):
        run_calibrators(virtual_board, tumble, calibrators=["magic"])
    with pytest.raises(CalibrationError, match="16 calibrations; the board has 15 slots"):
        run_calibrators(virtual_board, tumble, calibrators=[f"direct@{n}" for n in range(20, 36)])
    with pytest.raises(PoorCoverageError, match="the board's buffer holds 512"):
        collect_tumble(virtual_board, simulated_turntable, points=513)


def test_a_rotated_soft_iron_leaves_a_good_residual_and_a_bad_heading(bench_rig: Rig) -> None:
    assert bench_rig.world is not None
    assert bench_rig.mounting is not None
    tilted = np.array(bench_rig.world.soft_iron) @ _about_x(3.0)
    rows = tuple(tuple(float(value) for value in row) for row in tilted)
    rotated = replace(bench_rig, world=replace(bench_rig.world, soft_iron=rows))
    with open_board(rotated) as board:
        table = SimulatedTurntable(board.stage, uncertainty_deg=0.1)
        run = run_calibrators(board, collect_tumble(board, table, points=100), calibrators=["direct"])["direct"]
        known_angles = measure_known_angles(
            board,
            table,
            poses=rotated.procedure.known_angle_poses("level"),
            slots={"direct": run.slot},
            mounting_yaw_deg=bench_rig.mounting.yaw_deg,
        )
    assert run.residual_percent < 1.5 * run.residual_predicted_percent
    assert run.rotation_left_deg == pytest.approx(3.0, abs=0.6)  # 3 degrees by construction, noise beside it
    # 3 degrees about x turn the vertical field into y: 3 tan(62 degrees) = 5.6 degrees of heading at most.
    assert 4.0 < known_angles.summary("direct").max_deg < 7.5


def _about_x(angle_deg: float) -> np.ndarray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


@pytest.mark.parametrize("name", ["direct", "iterative"])
def test_the_board_s_headings_are_those_of_the_float64_references(
    name: str, virtual_board: Board, tumble: Tumble, runs: dict[str, CalibratorRun]
) -> None:
    table = SimulatedTurntable(virtual_board.stage, uncertainty_deg=0.1)
    fit = reference(name)(tumble.points[:100])
    assert np.allclose(runs[name].hard_iron, fit.hard_iron, atol=0.1)  # counts: 0.01 uT, what float32 may cost
    for pose in SOME_POSES:
        table.turn_to(pose)
        reply = virtual_board.session.request(Average(16, 1 << runs[name].slot))
        expected = tilt_heading(reply.accelerometer.mean, fit.corrected([reply.magnetometer.mean])[0])
        answered = reply.headings[runs[name].slot].attitude
        assert answered is not None
        # The limit for float32 against float64, fit and heading together.
        assert abs(wrap_180(answered.heading_deg - expected.heading_deg)) < 0.01
        assert answered.pitch_deg == pytest.approx(expected.pitch_deg, abs=0.001)
        assert answered.roll_deg == pytest.approx(expected.roll_deg, abs=0.001)


def test_headings_on_both_sides_of_north_err_by_little(
    virtual_board: Board, simulated_turntable: Turntable, runs: dict[str, CalibratorRun], bench_rig: Rig
) -> None:
    assert bench_rig.mounting is not None
    yaw_deg = bench_rig.mounting.yaw_deg
    around_north = [Pose(360.0 - yaw_deg + offset) for offset in (-1.5, -0.7, 0.0, 0.7, 1.5)]
    known_angles = measure_known_angles(
        virtual_board,
        simulated_turntable,
        poses=around_north,
        slots={"direct": runs["direct"].slot},
        mounting_yaw_deg=yaw_deg,
    )
    assert np.allclose(known_angles.reference_deg, [358.5, 359.3, 0.0, 0.7, 1.5])
    answers = known_angles.heading_deg["direct"]
    assert answers.min() < 2.5 < 357.5 < answers.max()
    errors = known_angles.error_deg["direct"]
    assert np.allclose(np.mod(known_angles.reference_deg + errors, 360.0), answers)
    assert np.abs(errors).max() < 1.8  # the rig's limit
    assert known_angles.summary("direct").max_deg == np.abs(errors).max()
