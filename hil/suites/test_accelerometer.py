"""Is gravity right? A wrong accelerometer spoils every heading, whatever the magnetometer does."""

from __future__ import annotations

import pytest

from hiltest.boards import Board
from hiltest.fixtures import Measure
from hiltest.procedures import UNCALIBRATED, KnownAngles, Turntable, measure_accelerometer_rest

pytestmark = pytest.mark.hil


def test_gravity_at_rest(board: Board, turntable: Turntable, measure: Measure) -> None:
    turntable.rest()
    rest = measure_accelerometer_rest(board)
    measure("accelerometer.rest_norm_error", rest.norm_error_mg, "mg")


def test_gravity_at_the_known_angles(known_angles: KnownAngles, measure: Measure) -> None:
    # Every calibration of the magnetometer is judged beside the same one of the accelerometer.
    measure("accelerometer.norm_rms", known_angles.accelerometer_norm_rms_mg(UNCALIBRATED), "mg")
    measure("accelerometer.tilt_error", known_angles.max_tilt_error_deg(UNCALIBRATED), "deg")
