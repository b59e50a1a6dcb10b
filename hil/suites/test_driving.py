"""Heading during disturbances of the field: errors, their duration, and whether the firmware reports them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration.accelerometer import AccelerometerFit
from hiltest.calibration.fit import MagnetometerFit
from hiltest.procedures import (
    CalibratorRun,
    DrivenCalibrations,
    DrivenStage,
    DrivingResult,
    Progress,
    RequestedAngles,
    Tumble,
    Turntable,
    calibrate_while_driving,
    heading_errors_deg,
    measure_driving,
)
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil

# The first calibration of the heading suite.
CALIBRATOR = "direct"
# The thesis' goal for a compass heading: a smaller error counts as right.
RIGHT_DEG = 2.0


# Session scope, because the test that also needs the known angles runs later, after other suites.
@pytest.fixture(scope="session")
def drive(board: Board, turntable: Turntable, rig: Rig, calibrations: Mapping[str, CalibratorRun]) -> DrivingResult:
    """Headings of the filter, of the gyroscope alone and of the magnetometer alone during the disturbances."""
    assert rig.world is not None
    return measure_driving(
        board,
        turntable,
        begins_s=min(disturbance.begins_s for disturbance in rig.world.disturbances.values()),
        slot=calibrations[CALIBRATOR].slot,
        readings=rig.procedure.readings_per_pose,
    )


@pytest.fixture(scope="session")
def driven(
    board: Board, turntable: Turntable, rig: Rig, tumble: Tumble, drive: DrivingResult, hil_progress: Progress
) -> DrivenCalibrations:
    """Calibrations from points that were taken during the disturbances and after them."""
    return calibrate_while_driving(
        board,
        turntable,
        tumble=tumble,
        calibrator=CALIBRATOR,
        n=rig.procedure.calibration_points,
        progress=hil_progress,
    )


def test_heading_while_driving(drive: DrivingResult, measure: Measure) -> None:
    for source, errors in drive.headings.items():
        measure(f"driving.{source}.quiet_rms", errors.quiet_rms_deg, "deg")
        measure(f"driving.{source}.rms", errors.rms_deg, "deg")
        measure(f"driving.{source}.max", errors.max_deg, "deg")
        for cause, rms_deg in errors.rms_by_cause_deg.items():
            measure(f"driving.{source}.{cause}_rms", rms_deg, "deg")


def test_time_to_recover(drive: DrivingResult, measure: Measure) -> None:
    for source, errors in drive.headings.items():
        note = "" if errors.recovered else "still wrong then"
        measure(f"driving.{source}.recovery_time", errors.recovery_s, "s", note=note)


def test_whether_the_firmware_says_that_it_does_not_know(drive: DrivingResult, measure: Measure) -> None:
    summary = drive.motion.summary
    measure("driving.fusion.left_out", summary.no_attitude + summary.field_left_out, "")
    for source, errors in drive.headings.items():
        measure(f"driving.{source}.unsaid", errors.unsaid_s, "s")


def test_headings_over_time(drive: DrivingResult, measure: Measure) -> None:
    truth = drive.motion.truth or ()
    fields_ut = {cause: np.linalg.norm(field, axis=1).tolist() for cause, field in drive.field_ut.items()}
    measure.table(
        "driving.motion",
        {"time": "s", "heading": "deg"} | dict.fromkeys(fields_ut, "uT") | dict.fromkeys(drive.headings, "deg"),
        zip(
            drive.motion.time_s.tolist(),
            (pose.heading_deg for pose in truth),
            *fields_ut.values(),
            *(map(finite_or_none, heading.error_deg.tolist()) for heading in drive.headings.values()),
            strict=True,
        ),
    )


def test_what_a_calibration_from_disturbed_points_says_of_itself(driven: DrivenCalibrations, measure: Measure) -> None:
    measure(f"driving.{CALIBRATOR}.calibrated_error", driven.residual_percent, "%")
    for name, stages in driven.begun_disturbed.items():
        measure(
            f"driving.{name}.calibrated_error",
            disturbed(stages)[-1].stage.state.fit_error_percent,
            "%",
            not_offered="it has no measure of its own",
        )


def test_what_a_calibration_from_disturbed_points_is_worth(
    known_angles: RequestedAngles, driven: DrivenCalibrations, accelerometer_fit: AccelerometerFit, measure: Measure
) -> None:
    def max_error(fit: MagnetometerFit) -> float:
        errors = heading_errors_deg(known_angles, fit, accelerometer_fit)
        return math.nan if errors is None else float(np.abs(errors).max())

    measure(f"driving.{CALIBRATOR}.calibrated_max", max_error(driven.fit), "deg")
    rows = []
    for name, stages in driven.begun_disturbed.items():
        measure(f"driving.{name}.calibrated_max", max_error(disturbed(stages)[-1].stage.fit), "deg")
        after = [stage for stage in stages if not stage.disturbed]
        right = [max_error(stage.stage.fit) <= RIGHT_DEG for stage in after]
        first = next((at for at in range(len(after)) if all(right[at:])), None)
        measure(
            f"driving.{name}.recalibrated_after",
            after[-1 if first is None else first].time_s,
            "s",
            note="not right by then" if first is None else "",
        )
    for name, stages in driven.begun_before.items():
        measure(f"driving.{name}.kept_max", max(max_error(stage.stage.fit) for stage in disturbed(stages)), "deg")
    for begun, calibrations in (("before", driven.begun_before), ("disturbed", driven.begun_disturbed)):
        for name, stages in calibrations.items():
            rows += [
                [
                    name,
                    begun,
                    stage.disturbed,
                    stage.time_s,
                    stage.stage.state.elements,
                    stage.stage.state.held,
                    stage.stage.state.accepted,
                    stage.stage.state.fit_error_percent,
                    max_error(stage.stage.fit),
                ]
                for stage in stages
            ]
    measure.table(
        "driving.stages",
        {"calibrator": "", "begun": "", "disturbed": "", "time": "s", "elements": "", "held": "", "accepted": ""}
        | {"fit_error": "%", "max_error": "deg"},
        rows,
    )


def disturbed(stages: list[DrivenStage]) -> list[DrivenStage]:
    """Return the stages during disturbances."""
    return [stage for stage in stages if stage.disturbed]


def finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
