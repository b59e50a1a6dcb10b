"""Diagnosis of a wrong heading of firmware that reports by itself: frame, calibration, or filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from hiltest.measurement import KINDS, Measurement
from hiltest.orientation.heading_models import AVERAGED, Explanation, Poses, Stage, fit_causes
from hiltest.run_record.run import Cell, Table
from hiltest.text import format_number
from hiltest.verdict.calibrators import CalibratorResult, maximum_of, value_of
from hiltest.verdict.causes import Cause
from hiltest.verdict.heading_evidence import read_vectors, turn_field

#: Subjects of such firmware's headings: its own, and those from its calibrated vectors and its calibration alone.
FIRMWARE, ECOMPASS, CALIBRATED = "firmware", "ecompass", "calibrated"

_PARTS = {ECOMPASS: "without its filter", CALIBRATED: "by its calibration alone"}
_CONTRADICTIONS = "heading.contradictions"
_SAMPLES = "device.samples"
_TILT_ERROR = KINDS["accelerometer.tilt_error"]
_OTHER_TILT = (
    "Declare pitch and roll so under [device] in the rig, negated ones with scale = -1, or correct the firmware."
)


# A limit is far enough from the errors of right firmware: their rms is at most about a quarter of it.
_NOISE_OF_LIMIT = 0.25
_USUAL_LIMIT_DEG = 2.0
# Share of poses that noise leaves not settled.
_MOST_UNSETTLED = 0.1
# Range of frozen headings, as a multiple of their noise.
_STANDS_STILL = 5.0
# Difference from a wrong hard iron that noise and directions of a tumble leave: the least, and by the field's range.
_LEAST_IRON_UT, _IRON_TOLERANCE = 0.7, 0.03


def diagnose_firmware(
    measurements: Mapping[str, Measurement], tables: Mapping[str, Table]
) -> tuple[Cause, list[str], Explanation | None]:
    """Return the likely cause if the firmware's own heading is out of its limit, the evidence, and the known bugs.

    Parameters
    ----------
    measurements
        All measurements of the run.
    tables
        Tables with headings, true vectors, and the conventions that the procedure detected.
    """
    limit_deg = maximum_of(measurements.get(f"heading.{FIRMWARE}.max"))
    contradictions = _contradictions(tables)
    right = [
        source for source in (CALIBRATED, ECOMPASS) if _is_within(measurements.get(f"heading.{source}.max"), limit_deg)
    ]
    noise_deg = noise_of_limit(limit_deg)
    poses = _read_poses(tables, noise_deg, right)
    mistake = "" if right else _hard_iron_mistake(tables)
    if mistake and contradictions.get("still"):
        return Cause.HARD_IRON, [mistake], None
    if still := contradictions.get("still"):
        moves = poses is not None and np.ptp(poses.answered_deg) > _STANDS_STILL * noise_deg
        bugs = fit_causes(poses) if poses and moves else None
        right_samples = ["its samples are right"] if _SAMPLES in tables else []
        return (
            (Cause.KNOWN_BUG, [], bugs) if bugs and bugs.is_complete else (Cause.STILL, [still, *right_samples], None)
        )
    errors = {source: value_of(measurements.get(f"heading.{source}.max")) for source in (CALIBRATED, ECOMPASS)}
    bias_dps = value_of(measurements.get("gyroscope.firmware.bias_error"))
    unsettled = value_of(measurements.get("device.unsettled")) or 0.0
    details = [f"calibration right ({errors[right[0]]:.2f} deg)"] if right else []
    if frame := other_frame(tables):
        return Cause.FRAME, [frame], None
    bugs = None
    is_settled = poses is not None and unsettled <= _MOST_UNSETTLED * len(poses.answered_deg)
    if poses and right and (not is_settled or bias_dps is not None):  # either would make a filter lag
        bugs = fit_causes(replace(poses, stages=(Stage.SEQUENCE,)))
        bugs = bugs if bugs.is_complete and bugs.words.startswith(AVERAGED) else None
    elif poses:
        bugs = _fit_bugs(poses, is_field_right=bool(right))
    if right:
        if bugs and bugs.causes:
            return Cause.KNOWN_BUG, details, bugs
        if isolated := value_of(measurements.get("device.unconfirmed")):
            return Cause.ISOLATED, [f"{isolated:.0f} of the lines at known angles", *details], None
        if bugs and bugs.pattern:
            details.append(bugs.pattern)
        if unsettled:
            details.append(f"not settled at {unsettled:.0f} known angles")
        if bias_dps is not None:
            details.append(f"gyroscope offset wrong by {bias_dps:.2f} dps")
        return (Cause.NOT_SETTLED if unsettled else Cause.FILTER), details, None
    offset_ut = value_of(measurements.get("fit.firmware.offset_error"))
    rotation_deg = value_of(measurements.get("fit.firmware.rotation_left"))
    details = [f"its calibration alone errs by {errors[CALIBRATED]:.2f} deg"] if errors[CALIBRATED] is not None else []
    if offset_ut is not None:
        details.append(f"hard iron wrong by {offset_ut:.2f} uT")
    if rotation_deg is not None:
        details.append(f"residual rotation {rotation_deg:.2f} deg")
    if mistake:
        return Cause.HARD_IRON, [mistake, *details], None
    if bugs and bugs.causes:
        return Cause.KNOWN_BUG, details, bugs
    return (Cause.OWN_CALIBRATION if details else Cause.NONE), details, None


def noise_of_limit(limit_deg: float | None) -> float:
    """Return the noise of right firmware's headings [deg] that a limit of their largest error allows for."""
    return _NOISE_OF_LIMIT * (limit_deg or _USUAL_LIMIT_DEG)


def _fit_bugs(poses: Poses, *, is_field_right: bool) -> Explanation:
    """Return the bugs; if the firmware shows right vectors, bugs behind them come first."""
    behind = replace(poses, stages=[stage for stage in poses.stages if stage >= Stage.FORMULA])
    bugs = fit_causes(behind) if is_field_right else None
    return bugs if bugs and bugs.is_complete else fit_causes(poses)


def _hard_iron_mistake(tables: Mapping[str, Table]) -> str:
    """Return how the hard iron that the firmware reports follows from its own samples of the tumble; empty if unknown.

    Those samples have a minimum, a maximum, and a centre, by a fit of hiltest's own.
    """
    field_ut = {str(row[0]): np.array(row[1:], np.float64) for row in _rows(tables, "device.tumble_field")}
    iron_ut = next((np.array(row, np.float64) for row in _rows(tables, "heading.hard_iron")), None)
    if iron_ut is None or "centre" not in field_ut:
        return ""
    centre, least, most = (field_ut[name] for name in ("centre", "minimum", "maximum"))
    mistakes = {
        "": centre,
        "it is 0": 0.0 * centre,
        "it has the opposite sign": -centre,
        "it has lost its sign": np.abs(centre),
        "it is half of the difference of maximum and minimum, not half of their sum": (most - least) / 2.0,
        "it is the sum of maximum and minimum, not half of it": most + least,
        "its axes are exchanged": min(
            (centre[list(order)] for order in permutations(range(3))), key=lambda other: np.abs(other - iron_ut).max()
        ),
    }
    away_ut = {mistake: float(np.abs(value - iron_ut).max()) for mistake, value in mistakes.items()}
    nearest = min(away_ut, key=lambda mistake: away_ut[mistake])
    tolerance_ut = max(_LEAST_IRON_UT, _IRON_TOLERANCE * float((most - least).max()))
    if not nearest or away_ut[nearest] > tolerance_ut or away_ut[""] <= 2.0 * away_ut[nearest]:
        return ""
    rows = zip("xyz", iron_ut, centre, strict=True)
    places = ", ".join(f"{name} {is_ut:.1f} in place of {ut:.1f}" for name, is_ut, ut in rows)
    return f"{nearest}: {places} uT"


def _rows(tables: Mapping[str, Table], name: str) -> Sequence[Sequence[Cell]]:
    return tables[name].rows if name in tables else ()


def _read_poses(tables: Mapping[str, Table], noise_deg: float, right: Sequence[str] = ()) -> Poses | None:
    """Return the firmware's headings and the true vectors; records without vectors show bugs of the last stages.

    Errors of a right source, of the first one in `right`, are no bugs behind it: the field is turned by them.
    """
    headings, vectors = tables.get("heading.poses"), tables.get("heading.known")
    answered = None if headings is None else headings.column_if_any(f"answered.{FIRMWARE}")
    if headings is None or not answered or None in answered:
        return None
    stages: Sequence[Stage] = tuple(Stage)
    if vectors is not None and len(vectors.rows) == len(answered):
        field, gravity = (read_vectors(vectors, name) for name in ("field", "gravity"))
        errors_deg = headings.column_if_any(f"error.{right[0]}") if right else (None,)
        if None not in errors_deg:
            field = turn_field(field, gravity, np.array(errors_deg, dtype=np.float64)[:, None])
    else:
        stages = (Stage.HEADING, Stage.SEQUENCE)
        angle = np.radians(np.array(headings.column("reference"), dtype=np.float64))
        field = np.column_stack([np.cos(angle), -np.sin(angle), np.zeros_like(angle)])
        gravity = np.tile([0.0, 0.0, 1.0], (len(angle), 1))
    iron, soft_iron = (_rows(tables, f"heading.{name}") for name in ("hard_iron", "inverse_soft_iron"))
    return Poses(
        field,
        gravity,
        np.array(answered, dtype=np.float64),
        noise_deg,
        stages,
        np.array(iron[0], dtype=np.float64) if iron else None,
        np.array(soft_iron[0], dtype=np.float64).reshape(3, 3) if soft_iron else None,
    )


def diagnose_parts(tables: Mapping[str, Table]) -> tuple[Cause, list[str]]:
    """Return the likely cause if headings computed from the firmware's vectors are far from its own heading."""
    vectors = _contradictions(tables).get("vectors")
    return (Cause.FRAME, [vectors]) if vectors else (Cause.NOT_TOGETHER, [])


def next_step(measurement: Measurement, tables: Mapping[str, Table]) -> str:
    """Return the remedy for a measurement out of its limit; exchanged angles are no fault of a sensor."""
    is_other = measurement.kind is _TILT_ERROR and "tilt" in _contradictions(tables)
    return _OTHER_TILT if is_other else measurement.next_step


def parts_in_words(worst_deg: Mapping[str, float | None]) -> str:
    """Return the errors of the firmware's calibrated vectors and of its calibration alone as a sentence, or nothing."""
    parts = [f"{words} {value:.2f} deg" for name, words in _PARTS.items() if (value := worst_deg.get(name)) is not None]
    words = ", ".join(parts)
    return f"{words[0].upper()}{words[1:]}." if words else ""


def costs_in_words(results: Sequence[CalibratorResult]) -> str:
    """Return the cost of the firmware's own fit, and of the cheapest other calibrator on the same samples.

    Parameters
    ----------
    results
        Results, cheapest first.
    """
    own = next((result for result in results if result.name == CALIBRATED), None)
    cycles = value_of(own.cycles) if own else None
    if own is None or cycles is None:
        return ""
    waited = value_of(own.from_flash)
    cost = f"Its fit takes {format_number(cycles)} cycles"
    cost += "" if waited is None else f" without memory waits, {format_number(waited)} from flash"
    other = next((result for result in results if result is not own and value_of(result.cycles) is not None), None)
    parts = [f"{cost}{_note_in_brackets(own)}"]
    parts += [f"{other.name} {format_number(value_of(other.cycles))}{_note_in_brackets(other)}"] if other else []
    return f"{'; '.join(parts)}."


def _note_in_brackets(result: CalibratorResult) -> str:
    return f" ({result.cycles.note})" if result.cycles and result.cycles.note else ""


def _is_within(measurement: Measurement | None, limit_deg: float | None) -> bool:
    value = value_of(measurement)
    return value is not None and limit_deg is not None and value <= limit_deg


def other_frame(tables: Mapping[str, Table]) -> str:
    """Return the frame in which vectors or headings are right if the declared one is wrong; it may explain both."""
    contradictions = _contradictions(tables)
    return contradictions.get("vectors") or contradictions.get("heading") or ""


def sample_faults(tables: Mapping[str, Table]) -> dict[str, str]:
    """Return the faults of the samples that the firmware reports, each with the part of the firmware to check."""
    table = tables.get(_SAMPLES)
    return {} if table is None else {str(words): str(place) for words, place in table.rows}


def _contradictions(tables: Mapping[str, Table]) -> dict[str, str]:
    """Return the correction that each contradiction suggests, by its subject."""
    table = tables.get(_CONTRADICTIONS)
    return {} if table is None else {str(subject): str(correction) for subject, correction in table.rows}
