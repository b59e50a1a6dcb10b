"""Heading against known angles, beside the quality of the fit: the second does not imply the first."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltest.measurement import Limit
from hiltest.procedures import DPI, UNCALIBRATED, CalibratorRun, KnownAngles, Tumble, float32_error_deg
from hiltest.procedures.imu_calibration.on_board import NAME as CALIBRATION_FILE
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure
from hiltest.world import EarthField

pytestmark = pytest.mark.hil

# The limit of a calibrator that the rig does not name: the thesis' goal for a compass heading.
# A measurement under [information] has no limit.
GOAL = Limit(max=2.0)
# Largest bias beyond what is not known of the mounting, or of angles that a hand sets [deg]; the shipped rigs allow the
# same. What is measured up to here is then proven to be within the limit.
BIAS_BEYOND_MOUNTING_DEG = 0.5


def test_points_cover_the_sphere(tumble: Tumble, rig: Rig, measure: Measure) -> None:
    measure("tumble.points", len(tumble.points), "", limit=Limit(min=rig.procedure.tumble_points))
    measure("tumble.coverage", 100.0 * tumble.coverage_of(rig.procedure.calibration_points), "%")
    measure.table("tumble.points", dict.fromkeys("xyz", "count"), tumble.points.tolist())


def test_every_calibrator_fits_the_points(calibrations: dict[str, CalibratorRun], measure: Measure) -> None:
    for name, run in calibrations.items():
        measure(f"fit.{name}.status", int(run.fit), "")
        measure(f"fit.{name}.residual", run.residual_percent, "%")
        measure(f"fit.{name}.residual_predicted", run.residual_predicted_percent, "%")
        measure(f"fit.{name}.offset_error", run.offset_error_ut, "uT")
        measure(f"fit.{name}.rotation_left", run.rotation_left_deg, "deg")
        measure(f"fit.{name}.coverage", run.coverage, "")
    measure.table(
        "calibration.results",
        {"calibrator": "", "fit": "", "sphere": "", "iterations": "", "points": ""}
        | matrix("soft_iron", "1/count")
        | {f"hard_iron_{row}": "count" for row in "xyz"},
        [
            [
                name,
                run.fit.name,
                run.is_sphere,
                run.iterations,
                run.n,
                *run.soft_iron.ravel().tolist(),
                *run.hard_iron.tolist(),
            ]
            for name, run in calibrations.items()
        ],
    )
    refused = [f"{name}: {run.fit.name}" for name, run in calibrations.items() if not run.usable]
    assert not refused, f"no calibration to test: {', '.join(refused)}"


def test_heading_at_known_angles(
    known_angles: KnownAngles, calibrations: dict[str, CalibratorRun], rig: Rig, measure: Measure
) -> None:
    # What a limit of the whole error means rests on a declared mounting; a centred error does without.
    missing = known_angles.not_measured
    not_checked = missing or ("" if rig.mounting else "the rig declares no mounting")
    by_hand_deg, mounting_deg = rig.guard_band_deg(f"heading.{DPI}.bias"), rig.mounting and rig.mounting.uncertainty_deg
    unnamed = {
        "max": GOAL,
        "max_centred": GOAL,
        "bias": Limit.within(round(by_hand_deg or mounting_deg or 0.0, 2) + BIAS_BEYOND_MOUNTING_DEG),
    }
    for name in known_angles.error_deg:
        if name == UNCALIBRATED:
            continue
        errors = known_angles.summary(name)
        # A streaming calibrator has only the limits of the rig: its accuracy depends on the points so far.
        judged = name in calibrations or name in (DPI, CALIBRATION_FILE)
        limit = {
            what: most if judged and f"heading.{name}.{what}" not in rig.information else None
            for what, most in unnamed.items()
        }
        measure(f"heading.{name}.max", errors.max_deg, "deg", limit=limit["max"], not_checked=not_checked)
        measure(f"heading.{name}.rms", errors.rms_deg, "deg", not_checked=not_checked)
        bias_deg, centred_deg = or_nan(errors.bias_deg), or_nan(errors.max_centred_deg)
        measure(f"heading.{name}.bias", bias_deg, "deg", limit=limit["bias"], not_checked=not_checked)
        measure(f"heading.{name}.max_centred", centred_deg, "deg", limit=limit["max_centred"], not_checked=missing)
        measure(f"heading.{name}.worst_sector", errors.worst_sector.start_deg, "deg")
        measure(f"heading.{name}.tilt_sensitivity", errors.tilt_sensitivity_deg, "deg")
    measure.table(
        "heading.poses",
        {"heading": "deg", "pitch": "deg", "roll": "deg", "level": "", "reference": "deg"}
        | {"answered_pitch": "deg", "answered_roll": "deg"}
        | {f"answered.{name}": "deg" for name in known_angles.heading_deg}
        | {f"error.{name}": "deg" for name in known_angles.error_deg},
        [
            [pose.heading_deg, pose.pitch_deg, pose.roll_deg, bool(level), *numbers]
            for pose, level, *numbers in zip(
                known_angles.poses,
                known_angles.level,
                known_angles.reference_deg.tolist(),
                known_angles.pitch_deg[UNCALIBRATED].tolist(),
                known_angles.roll_deg[UNCALIBRATED].tolist(),
                *(headings.tolist() for headings in known_angles.heading_deg.values()),
                *(errors.tolist() for errors in known_angles.error_deg.values()),
                strict=True,
            )
        ],
    )
    # Another firmware's headings can be computed from these: the same readings, without noise between the two.
    measure.table(
        "heading.means",
        {f"{sensor}_{axis}": "count" for sensor in ("magnetometer", "accelerometer") for axis in "xyz"},
        np.hstack([known_angles.magnetometer, known_angles.accelerometer]).tolist(),
    )
    # What the causes of a wrong heading are found from: what there is to read at each pose, and what is made of it.
    field = EarthField(rig.field.strength_ut, rig.field.dip_deg)
    known = known_angles.in_body(field.ned_ut), known_angles.in_body((0.0, 0.0, 1.0))
    units = {"field": "uT", "gravity": "g"}
    measure.table(
        "heading.known",
        {f"{what}_{axis}": unit for what, unit in units.items() for axis in "xyz"},
        np.hstack(known).tolist(),
    )
    measure.table(
        "heading.calibrations",
        {"calibration": ""}
        | matrix("soft_iron", "1/count")
        | {f"hard_iron_{axis}": "count" for axis in "xyz"}
        | matrix("gain", "g/count")
        | {f"offset_{axis}": "count" for axis in "xyz"},
        [
            [
                name,
                *held.soft_iron.ravel().tolist(),
                *held.hard_iron.tolist(),
                *known_angles.accelerometer_fits[name].gain.ravel().tolist(),
                *known_angles.accelerometer_fits[name].offset.tolist(),
            ]
            for name, held in known_angles.calibrations.items()
        ],
    )


def test_the_boards_arithmetic_does_not_enter(
    known_angles: KnownAngles, calibrations: dict[str, CalibratorRun], tumble: Tumble, measure: Measure
) -> None:
    for name, run in calibrations.items():
        if run.usable:
            measure(f"heading.{name}.float32_error", float32_error_deg(known_angles, run, tumble), "deg")


def test_headings_are_from_0_to_360(known_angles: KnownAngles) -> None:
    outside = {
        name: [each for each in headings.tolist() if not 0.0 <= each < 360.0]
        for name, headings in known_angles.heading_deg.items()
    }
    assert not any(outside.values()), f"answered headings outside of 0 to 360 degrees: {outside}"


def test_heading_without_calibration(known_angles: KnownAngles, measure: Measure) -> None:
    measure("heading.uncalibrated.max_level", known_angles.max_level_deg(UNCALIBRATED), "deg")
    measure("heading.uncalibrated.max", known_angles.summary(UNCALIBRATED).max_deg, "deg")


def matrix(name: str, unit: str) -> dict[str, str]:
    """Return the columns of a matrix in a table, by rows."""
    return {f"{name}_{row}{column}": unit for row in "xyz" for column in "xyz"}


def or_nan(value: float | None) -> float:
    """Errors that cancel all round have no mean: that is a failure, not something left out."""
    return math.nan if value is None else value
