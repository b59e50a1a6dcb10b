"""Test of a calibration file on this board; the heading suite measures its headings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.measurement import Limit
from hiltest.procedures import MeasuredTurn, RequestedAngles, Turntable
from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.on_board import NAME, field_norm_rms_percent, gyroscope_bias_error_dps
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil

# Defaults for measurements without a limit in the rig. A field error of 3.5 % perpendicular to the field is 2 degrees,
# the goal for a heading; a tilt error of 0.5 degree turns a heading by 1 degree at a dip of 62; a bias of 0.1 deg/s
# turns the gyroscope's heading by 2 degrees in 20 s.
FIELD = Limit(max=3.5)
GRAVITY = Limit(max=10.0)
TILT = Limit(max=0.5)
RATE = Limit(max=0.1)
TURN_DEG = 0.36  # 0.1 % of a full turn


def test_rate_at_rest_under_the_file(
    board: Board, turntable: Turntable, rig: Rig, hil_calibration: ImuCalibration, measure: Measure
) -> None:
    if hil_calibration.gyroscope is None:
        pytest.skip("the file calibrates no gyroscope")
    turntable.rest()
    error_dps = gyroscope_bias_error_dps(board, hil_calibration.gyroscope, seconds=rig.procedure.gyroscope_rest_s)
    limit = measure.limit("gyroscope.bias_error") or RATE
    measure(f"gyroscope.{NAME}.bias_error", error_dps, "dps", limit=limit)


def test_turn_under_the_file(
    turn_about_z: MeasuredTurn, rig: Rig, hil_calibration: ImuCalibration, measure: Measure
) -> None:
    measure_turn_errors("turn_error", [turn_about_z], rig, hil_calibration, measure)


# One turn about z does not show errors of x and y.
@pytest.mark.full
def test_every_turn_under_the_file(
    gyroscope_turns: list[MeasuredTurn], rig: Rig, hil_calibration: ImuCalibration, measure: Measure
) -> None:
    measure_turn_errors("largest_turn_error", gyroscope_turns, rig, hil_calibration, measure)


def measure_turn_errors(
    name: str, turns: Sequence[MeasuredTurn], rig: Rig, calibration: ImuCalibration, measure: Measure
) -> None:
    part = calibration.gyroscope
    if part is None:
        pytest.skip("the file calibrates no gyroscope")
    # The table's uncertainty counts at both ends of a turn. A file with a bias only keeps the data sheet's sensitivity.
    table = Limit(max=TURN_DEG + 2.0 * rig.turntable.uncertainty_deg)
    limit = (measure.limit("gyroscope.turn_error") or table) if part.method != "rest" else None
    errors_deg = [np.array(part.matrix) @ turn.turn.integral - turn.turn.turned_deg for turn in turns]
    measure(
        f"gyroscope.{NAME}.{name}",
        max(float(np.linalg.norm(error_deg)) for error_deg in errors_deg),
        "deg",
        limit=limit,
    )


def test_gravity_under_the_file(known_angles: RequestedAngles, measure: Measure) -> None:
    norm_limit = measure.limit("accelerometer.norm_rms") or GRAVITY
    tilt_limit = measure.limit("accelerometer.tilt_error") or TILT
    measure(f"accelerometer.{NAME}.norm_rms", known_angles.accelerometer_norm_rms_mg(NAME), "mg", limit=norm_limit)
    measure(f"accelerometer.{NAME}.tilt_error", known_angles.max_tilt_error_deg(NAME), "deg", limit=tilt_limit)


def test_field_under_the_file(known_angles: RequestedAngles, hil_calibration: ImuCalibration, measure: Measure) -> None:
    measure(f"magnetometer.{NAME}.norm_rms", field_norm_rms_percent(known_angles, hil_calibration), "%", limit=FIELD)
