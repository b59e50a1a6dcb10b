"""Which part of firmware that speaks its own language makes a wrong heading: frame, calibration, or filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

from hiltest.angles import circular_mean_deg, wrap_180
from hiltest.measurement import Measurement
from hiltest.record.run import Table
from hiltest.verdict.calibrators import maximum_of, value_of
from hiltest.verdict.causes import Cause

#: Subjects of such firmware's headings: its own, that of its calibrated vectors, and that of its calibration alone.
FIRMWARE, ECOMPASS, CALIBRATED = "firmware", "ecompass", "calibrated"

_PARTS = {ECOMPASS: "without its filter", CALIBRATED: "by its calibration alone"}
# Headings in another frame differ by whole quarters of a turn, or grow the other way: errors of tens of degrees, which
# are gone but for these few once the frame is the right one.
_LEFT_DEG = 10.0
_QUARTERS_DEG = (0.0, 90.0, 180.0, 270.0)
_FROM = {0.0: "north", 90.0: "east", 180.0: "south", 270.0: "west"}
_POSES = "heading.poses"


def diagnose_firmware(found: Mapping[str, Measurement], tables: Mapping[str, Table]) -> tuple[Cause, list[str]]:
    """Return the likely cause of the firmware's own heading out of its limit, and what speaks for it.

    Parameters
    ----------
    found : mapping of str to Measurement
        All of the run.
    tables : mapping of str to Table
        With the answered headings pose by pose.
    """
    limit_deg = maximum_of(found.get(f"heading.{FIRMWARE}.max"))
    frame = _other_frame(tables)
    if frame:
        return Cause.FRAME, [frame]
    right = [source for source in (CALIBRATED, ECOMPASS) if _within(found.get(f"heading.{source}.max"), limit_deg)]
    errors = {source: value_of(found.get(f"heading.{source}.max")) for source in (CALIBRATED, ECOMPASS)}
    if right:
        said = f"calibration right ({errors[right[0]]:.2f} deg)"
        unsettled = value_of(found.get("device.unsettled")) or 0.0
        bias_dps = value_of(found.get("gyroscope.firmware.bias_error"))
        details = [said]
        if unsettled:
            details.append(f"not settled at {unsettled:.0f} known angles")
        if bias_dps is not None:
            details.append(f"gyroscope offset wrong by {bias_dps:.2f} dps")
        return (Cause.NOT_SETTLED if unsettled else Cause.FILTER), details
    offset_ut = value_of(found.get("fit.firmware.offset_error"))
    rotation_deg = value_of(found.get("fit.firmware.rotation_left"))
    details = [f"its calibration alone errs by {errors[CALIBRATED]:.2f} deg"] if errors[CALIBRATED] is not None else []
    if offset_ut is not None:
        details.append(f"hard iron wrong by {offset_ut:.2f} uT")
    if rotation_deg is not None:
        details.append(f"residual rotation {rotation_deg:.2f} deg")
    return (Cause.OWN_CALIBRATION if details else Cause.NONE), details


def parts_in_words(worst_deg: Mapping[str, float | None]) -> str:
    """Return how far the firmware's calibrated vectors and its calibration alone err, in a sentence; may be empty."""
    parts = [
        f"{words} {value:.2f} deg" for name, words in _PARTS.items() if (value := worst_deg.get(name)) is not None
    ]
    words = ", ".join(parts)
    return f"{words[0].upper()}{words[1:]}." if words else ""


def _within(measurement: Measurement | None, limit_deg: float | None) -> bool:
    value = value_of(measurement)
    return value is not None and limit_deg is not None and value <= limit_deg


def _other_frame(tables: Mapping[str, Table]) -> str:
    """Return the frame in which the answered headings are right, if the declared one is not; empty otherwise."""
    poses = tables.get(_POSES)
    if poses is None or f"answered.{FIRMWARE}" not in [each.name for each in poses.columns]:
        return ""
    pairs = [
        (float(answered), float(reference))
        for answered, reference in zip(poses.column(f"answered.{FIRMWARE}"), poses.column("reference"), strict=True)
        if isinstance(answered, int | float) and isinstance(reference, int | float)
    ]
    if not pairs or _largest(pairs, 1.0, 0.0) <= _LEFT_DEG:
        return ""
    tried = {(sign, zero): _largest(pairs, sign, zero) for sign, zero in product((1.0, -1.0), _QUARTERS_DEG)}
    (sign, zero), left_deg = min(tried.items(), key=lambda each: each[1])
    if left_deg > _LEFT_DEG:
        return ""
    way = "clockwise" if sign > 0.0 else "counterclockwise"
    return f"headings are right, within {left_deg:.1f} deg, once they are taken to grow {way} from {_FROM[zero]}"


def _largest(pairs: Sequence[tuple[float, float]], sign: float, zero_deg: float) -> float:
    """Return the largest error of headings that are read otherwise, their mean error taken off."""
    errors = [wrap_180(zero_deg + sign * answered - reference) for answered, reference in pairs]
    try:
        mean = circular_mean_deg(errors)
    except ValueError:
        return 180.0
    if abs(wrap_180(mean)) > _LEFT_DEG:
        return 180.0
    return max(abs(wrap_180(each)) for each in errors)
