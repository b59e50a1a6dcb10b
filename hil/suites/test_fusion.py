"""Attitude of the Kalman filter during a motion, compared with each half alone: gyroscope; accelerometer and field."""

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
    filter_noise,
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
    """Errors of the fusion filter during turns and tilts, with the stored gyroscope calibration."""
    noise = filter_noise(
        magnetometer_sigma_ut=rig.sensors.magnetometer_noise_ut,
        field_ut=rig.field.strength_ut,
        dip_deg=rig.field.dip_deg,
    )
    return measure_fusion(
        board,
        turntable,
        slot=calibrations[CALIBRATOR].slot,
        noise=noise,
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
    summary = motion.summary
    left_out = summary.no_attitude + summary.accelerated + summary.bad_steps + summary.overruns
    measure("fusion.corrections", summary.updated.steps, "")
    measure("fusion.left_out", left_out, "")


def test_cycles_of_a_step(motion: FusionResult, measure: Measure) -> None:
    predicted, updated = motion.summary.predicted, motion.summary.updated
    for name, costs, band in (("predict", predicted, motion.predict_range), ("update", updated, motion.update_range)):
        largest = costs.largest and costs.largest.cycles
        measure(f"cycles.fusion.{name}", largest, "cycle", cycle_model=motion.cycle_model, band=band)
        measure(f"cycles.fusion.{name}.mean", costs.mean_cycles, "cycle", cycle_model=motion.cycle_model)


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
