"""Heading against known angles, and the quality of each fit: a good fit does not imply a right heading."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.boards.board import NO_REQUEST_COST
from hiltest.calibration.heading_bound import HeadingBound
from hiltest.link.replies import SensorKind
from hiltest.measurement import Limit
from hiltest.procedures import (
    UNCALIBRATED,
    CalibratorRun,
    KnownAngles,
    RequestedAngles,
    Tumble,
    float32_error_deg,
)
from hiltest.procedures.expected_errors import expected_errors, refuse_impossible_errors
from hiltest.procedures.reported_headings import FIRMWARE, ReportedAngles
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure
from hiltest.world import EarthField

pytestmark = pytest.mark.hil

# Limit for headings that are computed from the field and the calibration that the firmware reports. A larger error
# means that they do not match its reported heading: a field in whole uT errs by 2 degrees, exchanged numbers by over 7.
CONSISTENT = Limit(max=5.0)


def test_points_cover_the_sphere(board: Board, tumble: Tumble, rig: Rig, measure: Measure) -> None:
    measure("tumble.points", len(tumble.points), "", limit=Limit(min=rig.procedure.tumble_points))
    measure("tumble.coverage", 100.0 * tumble.coverage_of(rig.procedure.calibration_points), "%")
    measure(
        "cycles.collect.point",
        tumble.cycles_per_point,
        "cycle",
        cycle_model=board.cycle_model,
        not_offered="" if tumble.cycles_per_point is not None else NO_REQUEST_COST,
    )
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
    known_angles: KnownAngles,
    board: Board,
    rig: Rig,
    measure: Measure,
    limits_of_calibration: Callable[[str], dict[str, Limit]],
    record_settings: Callable[..., int | None],
    request: pytest.FixtureRequest,
) -> None:
    # The mounting turns every heading, so only a centred error can be checked without a declared mounting.
    missing = known_angles.not_measured
    if known_angles.decision:
        measure("heading.poses", len(known_angles.poses), note=known_angles.decision)
    not_checked = missing or ("" if rig.mounting else "the rig declares no mounting")
    for source in known_angles.heading_deg:
        if source == UNCALIBRATED:
            continue
        errors = known_angles.summary(source)
        if isinstance(known_angles, RequestedAngles):
            limit = limits_of_calibration(source)
        else:
            limit = limits_of_calibration(source) if source == FIRMWARE else {"max": CONSISTENT}
        limit = {name: range_ for name, range_ in limit.items() if f"heading.{source}.{name}" not in rig.information}
        values = {
            "max": errors.max_deg,
            "rms": errors.rms_deg,
            "bias": value_or_nan(errors.bias_deg),
            "max_centred": value_or_nan(errors.max_centred_deg),
        }
        estimates = known_angles.estimates.get(source, {})
        for statistic, value in values.items():
            reason = missing if statistic == "max_centred" else not_checked
            name = f"heading.{source}.{statistic}"
            if statistic in estimates:
                value, uncertainty = estimates[statistic]
                measure(name, value, "deg", limit=limit.get(statistic), uncertainty=uncertainty)
            else:
                measure(name, value, "deg", limit=limit.get(statistic), not_checked=reason)
        measure(f"heading.{source}.worst_sector", errors.worst_sector.start_deg, "deg")
        measure(f"heading.{source}.tilt_sensitivity", errors.tilt_sensitivity_deg, "deg")
    measure.table(*table_of_poses(known_angles))
    if known_angles.unset:
        measure.table("heading.unset", {"pose": "", "fault": ""}, map(list, known_angles.unset.items()))
    measure.table(*table_of_true_vectors(known_angles, rig))
    if isinstance(known_angles, RequestedAngles):
        record_evidence(known_angles, measure)
        tumble, calibrations = request.getfixturevalue("tumble"), request.getfixturevalue("calibrations")
    else:
        tumble = calibrations = None
    field_ned_ut = EarthField(rig.field.strength_ut, rig.field.dip_deg).ned_ut
    bounds = expected_errors(known_angles, rig, field_ned_ut=field_ned_ut, tumble=tumble, calibrations=calibrations)
    measure.table(*table_of_expected_errors(bounds))
    if isinstance(known_angles, ReportedAngles):
        measure.table("heading.contradictions", {"of": "", "said": ""}, map(list, known_angles.contradictions.items()))
        iron_ut = known_angles.belief.hard_iron_ut
        measure.table("heading.hard_iron", dict.fromkeys("xyz", "uT"), [] if iron_ut is None else [iron_ut.tolist()])
        inverse = known_angles.belief.inverse_soft_iron
        rows = [] if inverse is None else [inverse.ravel().tolist()]
        measure.table("heading.inverse_soft_iron", matrix("inverse", ""), rows)
    in_use = (SensorKind.MAGNETOMETER, SensorKind.ACCELEROMETER) if board.answers_requests else ()
    registers = record_settings("known_angles", *map(board.sensor, in_use))
    not_offered = "" if registers else "this board does not show the registers of its sensors"
    measure("sensor.registers", registers, "", not_offered=not_offered)
    refuse_impossible_errors(known_angles, bounds)


def table_of_poses(known_angles: KnownAngles) -> tuple[str, dict[str, str], list[list[object]]]:
    """Return the table of headings at each pose: name, units of the columns, and rows."""
    columns: dict[str, tuple[str, list[object]]] = {
        "heading": ("deg", [pose.heading_deg for pose in known_angles.poses]),
        "pitch": ("deg", [pose.pitch_deg for pose in known_angles.poses]),
        "roll": ("deg", [pose.roll_deg for pose in known_angles.poses]),
        "level": ("", [bool(is_level) for is_level in known_angles.level]),
        "reference": ("deg", known_angles.reference_deg.tolist()),
    }
    if isinstance(known_angles, RequestedAngles):
        columns["answered_pitch"] = ("deg", known_angles.pitch_deg[UNCALIBRATED].tolist())
        columns["answered_roll"] = ("deg", known_angles.roll_deg[UNCALIBRATED].tolist())
    elif isinstance(known_angles, ReportedAngles):
        columns["settled"] = ("", [pose.settled.is_settled for pose in known_angles.held])
        columns["step.firmware"] = ("deg", [pose.settled.step_deg for pose in known_angles.held])
    for prefix, by_source in (("answered", known_angles.heading_deg), ("error", known_angles.error_deg)):
        columns |= {f"{prefix}.{source}": ("deg", values.tolist()) for source, values in by_source.items()}
    rows = [list(row) for row in zip(*(values for _, values in columns.values()), strict=True)]
    return "heading.poses", {name: unit for name, (unit, _) in columns.items()}, rows


def table_of_expected_errors(bounds: dict[str, HeadingBound]) -> tuple[str, dict[str, str], list[list[object]]]:
    """Return the table of errors that noise makes unavoidable: its name, its columns with their units, and its rows."""
    numbers = ("rms", "fit_rms", "readings_rms", "expected_largest", "largest_in_99_percent")
    rows = [
        [source, *(round(getattr(bound, f"{number}_deg"), 4) for number in numbers)] for source, bound in bounds.items()
    ]
    return "heading.expected", {"source": "", **dict.fromkeys(numbers, "deg")}, rows


def table_of_true_vectors(known_angles: KnownAngles, rig: Rig) -> tuple[str, dict[str, str], list[list[float]]]:
    """Return the table of true field and gravity in the board's axes: name, units of the columns, and rows."""
    field = EarthField(rig.field.strength_ut, rig.field.dip_deg)
    vectors = known_angles.rotate_to_body(field.ned_ut), known_angles.rotate_to_body((0.0, 0.0, 1.0))
    units = {"field": "uT", "gravity": "g"}
    columns = {f"{vector}_{axis}": unit for vector, unit in units.items() for axis in "xyz"}
    return "heading.known", columns, np.hstack(vectors).tolist()


def record_evidence(known_angles: RequestedAngles, measure: Measure) -> None:
    """Record readings and calibrations, from which the causes of a wrong heading are determined."""
    # Another firmware's headings can be computed from the same readings, so that noise does not differ.
    measure.table(
        "heading.means",
        {f"{sensor}_{axis}": "count" for sensor in ("magnetometer", "accelerometer") for axis in "xyz"},
        np.hstack([known_angles.magnetometer, known_angles.accelerometer]).tolist(),
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
                *calibration.soft_iron.ravel().tolist(),
                *calibration.hard_iron.tolist(),
                *known_angles.accelerometer_fits[name].gain.ravel().tolist(),
                *known_angles.accelerometer_fits[name].offset.tolist(),
            ]
            for name, calibration in known_angles.calibrations.items()
        ],
    )


def test_the_boards_arithmetic_does_not_enter(
    known_angles: RequestedAngles, calibrations: dict[str, CalibratorRun], tumble: Tumble, measure: Measure
) -> None:
    for name, run in calibrations.items():
        if run.usable:
            measure(f"heading.{name}.float32_error", float32_error_deg(known_angles, run, tumble), "deg")


def test_headings_are_from_0_to_360(known_angles: KnownAngles) -> None:
    outside = {
        source: [heading for heading in headings.tolist() if not 0.0 <= heading < 360.0]
        for source, headings in known_angles.heading_deg.items()
    }
    assert not any(outside.values()), f"answered headings outside of 0 to 360 degrees: {outside}"


def test_heading_without_calibration(uncalibrated_angles: tuple[KnownAngles | None, str], measure: Measure) -> None:
    known_angles, source = uncalibrated_angles
    if known_angles is None:
        for name in ("heading.uncalibrated.max_level", "heading.uncalibrated.max"):
            measure(name, None, "deg", not_offered="the firmware reports no heading before its calibration")
        return
    missing, level_deg = known_angles.not_measured, known_angles.max_level_deg(source)
    measure(
        "heading.uncalibrated.max_level",
        level_deg,
        "deg",
        not_checked=missing,
        not_offered="" if level_deg is not None else missing or "the rig has no level known angle",
    )
    measure("heading.uncalibrated.max", known_angles.summary(source).max_deg, "deg", not_checked=missing)


def matrix(name: str, unit: str) -> dict[str, str]:
    """Return the column names and units of a matrix, row by row."""
    return {f"{name}_{row}{column}": unit for row in "xyz" for column in "xyz"}


def value_or_nan(value: float | None) -> float:
    """Return NaN, which fails a limit, if the errors have no mean because they are spread around the circle."""
    return math.nan if value is None else value
