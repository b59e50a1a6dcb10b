"""Attitude of the filter during a motion, compared with each half alone: gyroscope; accelerometer and field."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from hiltest.boards import Board
from hiltest.procedures import (
    AttitudeErrors,
    CalibratorRun,
    FittedTurns,
    FusionResult,
    Progress,
    Turntable,
    measure_fusion,
)
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure

pytestmark = [pytest.mark.hil, pytest.mark.full]

# The first calibration of the heading suite.
CALIBRATOR = "direct"


@pytest.fixture(scope="module")
def motion(
    board: Board,
    turntable: Turntable,
    rig: Rig,
    calibrations: Mapping[str, CalibratorRun],
    gyroscope_calibration: FittedTurns,
    hil_progress: Progress,
) -> FusionResult:
    """Errors of the attitude filter during turns and tilts, with the stored gyroscope calibration."""
    return measure_fusion(
        board,
        turntable,
        slot=calibrations[CALIBRATOR].slot,
        readings=rig.procedure.readings_per_pose,
        bias_s=rig.procedure.gyroscope_rest_s,
        progress=hil_progress,
    )


def test_attitude_during_a_motion(motion: FusionResult, measure: Measure) -> None:
    for name, errors in alternatives(motion).items():
        prefix = "fusion" if name == "fused" else f"fusion.{name}"
        measure(f"{prefix}.heading.rms", errors and errors.heading_rms_deg, "deg")
        measure(f"{prefix}.heading.max", errors and errors.heading_max_deg, "deg")
        measure(f"{prefix}.tilt.rms", errors and errors.tilt_rms_deg, "deg")


def test_every_sample_of_the_motion_is_used(motion: FusionResult, measure: Measure) -> None:
    measure("fusion.updates", motion.summary.costs.updates, "")
    measure("fusion.left_out", motion.summary.left_out, "")


def test_cycles_of_an_update(motion: FusionResult, measure: Measure) -> None:
    costs, model = motion.summary.costs, motion.cycle_model
    largest = costs.largest and costs.largest.cycles
    measure("cycles.fusion.update", largest, "cycle", cycle_model=model, band=motion.cycle_range)
    measure("cycles.fusion.update.mean", costs.mean_cycles, "cycle", cycle_model=model)


def test_errors_over_time(motion: FusionResult, measure: Measure) -> None:
    errors_by_name = alternatives(motion)
    if motion.truth is None or any(errors is None for errors in errors_by_name.values()):
        pytest.skip("the truth is not known here")
    measure.table(
        "fusion.motion",
        {"time": "s", "heading": "deg"} | dict.fromkeys(errors_by_name, "deg"),
        zip(
            motion.time_s.tolist(),
            (pose.heading_deg for pose in motion.truth),
            *(map(finite_or_none, errors.heading_deg.tolist()) for errors in errors_by_name.values() if errors),
            strict=True,
        ),
    )


def finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def alternatives(motion: FusionResult) -> dict[str, AttitudeErrors | None]:
    """Return the errors of the filter and of each half alone."""
    return {
        "fused": motion.fused,
        "accelerometer_magnetometer": motion.accelerometer_magnetometer,
        "gyroscope": motion.gyroscope,
    }
