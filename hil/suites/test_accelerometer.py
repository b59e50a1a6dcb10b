"""Accelerometer: its errors tilt the horizon of every heading, however good the magnetometer is."""

from __future__ import annotations

import pytest

from hiltest.boards import Board
from hiltest.calibration.accelerometer import NOMINAL
from hiltest.procedures import (
    UNCALIBRATED,
    AccelerometerRun,
    RequestedAngles,
    Turntable,
    measure_accelerometer_rest,
)
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil


def test_gravity_at_rest(board: Board, turntable: Turntable, measure: Measure) -> None:
    turntable.rest()
    rest = measure_accelerometer_rest(board)
    measure("accelerometer.rest_norm_error", rest.norm_error_mg, "mg")


def test_six_faces_are_fitted(board: Board, six_positions: AccelerometerRun | None, measure: Measure) -> None:
    if six_positions is None:
        pytest.skip('the rig asks for no calibration: accelerometer_calibration = "none"')
    record_fit("six_position", six_positions, board, measure)
    measure("accelerometer.faces_askew", six_positions.solution.faces_askew_deg, "deg")


def test_gravity_at_the_known_angles(known_angles: RequestedAngles, measure: Measure) -> None:
    # All magnetometer calibrations use the same accelerometer calibration, so one source is enough.
    measure("accelerometer.norm_rms", known_angles.accelerometer_norm_rms_mg(UNCALIBRATED), "mg")
    measure("accelerometer.tilt_error", known_angles.max_tilt_error_deg(UNCALIBRATED), "deg")
    measure("accelerometer.untrimmed_norm_rms", known_angles.norm_rms_mg(NOMINAL), "mg")


def test_six_faces_at_the_known_angles(
    known_angles: RequestedAngles, six_positions: AccelerometerRun | None, measure: Measure
) -> None:
    if six_positions is None:
        pytest.skip('the rig asks for no calibration: accelerometer_calibration = "none"')
    measure("accelerometer.six_position.norm_rms", known_angles.norm_rms_mg(six_positions.fit), "mg")


@pytest.mark.full
def test_an_ellipsoid_of_still_poses(
    board: Board, known_angles: RequestedAngles, ellipsoid: AccelerometerRun, measure: Measure
) -> None:
    record_fit("ellipsoid", ellipsoid, board, measure)
    measure("accelerometer.ellipsoid.residual", ellipsoid.solution.residual_mg, "mg")
    measure("accelerometer.ellipsoid.norm_rms", known_angles.norm_rms_mg(ellipsoid.fit), "mg")


def record_fit(name: str, run: AccelerometerRun, board: Board, measure: Measure) -> None:
    measure(f"accelerometer.{name}.axis_error", run.axis_error_deg, "deg")
    measure(f"accelerometer.{name}.offset_error", run.offset_error_mg, "mg")
    cycles = run.cost and run.cost.cycles
    measure(f"accelerometer.{name}.cycles", cycles, "cycle", cycle_model=board.cycle_model, band=run.band)
    measure.table(f"accelerometer.{name}.poses", dict.fromkeys("xyz", "count"), run.counts.tolist())
