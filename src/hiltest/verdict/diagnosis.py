"""Likely cause of each failed heading, with its size, from the measurements of a run and its evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltest.calibration.error_sources import ErrorSource, Source
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.sensor_axes import SensorAxes
from hiltest.measurement import Measurement, Outcome
from hiltest.run_record.run import Table
from hiltest.text import join_words
from hiltest.verdict.calibrators import fit_status, maximum_of, value_of
from hiltest.verdict.causes import ADVICE, GOOD_FIT_FACTOR, OF_SOURCE, Cause, HeadingSymptoms, name_cause
from hiltest.verdict.heading_evidence import CALIBRATION_FILE, HeadingEvidence, read_heading_evidence
from hiltest.verdict.reported_headings import (
    CALIBRATED,
    ECOMPASS,
    FIRMWARE,
    diagnose_firmware,
    diagnose_parts,
    other_frame,
    sample_faults,
)

# The firmware's own arithmetic is the cause if it contributes at least half of the largest error.
_MAKES_MOST = 0.5
# A rotation is about one axis of the board if its components about the others are below this fraction.
_ABOUT_ONE_AXIS = 0.3
_AGAINST_GRAVITY = ("joint", "dpi", "dpi-poses")
_OF_HEADINGS = ("max", "rms", "bias", "max_centred", "float32_error")
_NAMED_AT_MOST = 3
_OF_THE_FIT = (Cause.POOR_COVERAGE, Cause.GOOD_FIT_BAD_HEADING, Cause.BAD_FIT)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Likely cause, its description, and the next step; both texts are empty without a cause."""

    cause: Cause
    words: str
    advice: str = ""
    predicted_deg: Sequence[float] = ()
    """Heading errors that the cause predicts at the known angles [deg]; empty if it predicts none."""


NOTHING = Diagnosis(Cause.NONE, "")


# Description of a calibration against gravity that is refused although axes and dip are right.
_REFUSED = (
    "{} refuses points as MIRRORED although the known angles confirm their axes: its dip or gravity has the "
    "opposite sign, or it exchanges axes"
)


def diagnose_run(
    names: Sequence[str], measurements: Sequence[Measurement], tables: Mapping[str, Table], *, is_broken: bool
) -> dict[str, Diagnosis]:
    """Return the likely causes in a red run by calibrator, and that of otherwise failed tests under ``""``.

    Parameters
    ----------
    names
        Calibrators with a heading.
    is_broken
        True if tests failed for another reason than a limit.
    """
    by_name, evidence = {measurement.name: measurement for measurement in measurements}, read_heading_evidence(tables)
    axes = None if evidence is None else evidence.axes()
    causes = {name: diagnose(name, by_name, evidence, axes) for name in names}
    own = [name for name in (FIRMWARE, ECOMPASS, CALIBRATED) if _is_off(name, by_name)]
    if (faults := sample_faults(tables)) and not other_frame(tables):  # the first link from sensor to heading
        places = "; ".join(dict.fromkeys(faults.values()))
        causes |= dict.fromkeys(own or [""], Diagnosis(Cause.SAMPLES, "; ".join(faults), f"Check {places}."))
    elif own:
        causes |= dict.fromkeys(own, _diagnose_reported(by_name, tables, is_heading=FIRMWARE in own))
    if unset := tables.get("heading.unset"):  # nothing can be concluded from headings at such poses
        poses = join_words([f"pose {pose}: {fault}" for pose, fault in unset.rows], _NAMED_AT_MOST)
        named = [name for name, diagnosis in causes.items() if name and diagnosis.cause is not Cause.NONE]
        causes |= dict.fromkeys(named, Diagnosis(Cause.NOT_SET, _append_details(Cause.NOT_SET, [poses])))
    if axes is not None and is_broken and not any(diagnosis.cause is Cause.AXES for diagnosis in causes.values()):
        statuses = {name: value_of(by_name.get(f"fit.{name}.status")) for name in _AGAINST_GRAVITY}
        mirrored = [name for name, status in statuses.items() if status == FitStatus.MIRRORED]
        words = str(axes) or (_REFUSED.format(mirrored[0]) if mirrored and axes.are_as_declared else "")
        causes[""] = Diagnosis(Cause.AXES, words) if words else NOTHING
    return {
        name: diagnosis if diagnosis.advice else replace(diagnosis, advice=ADVICE[diagnosis.cause])
        for name, diagnosis in causes.items()
        if diagnosis.cause is not Cause.NONE
    }


def _diagnose_reported(
    measurements: Mapping[str, Measurement], tables: Mapping[str, Table], *, is_heading: bool
) -> Diagnosis:
    """Return the likely cause if values that firmware reports by itself are wrong: its heading, or only its vectors."""
    if not is_heading:
        cause, details = diagnose_parts(tables)
        return Diagnosis(cause, _append_details(cause, details))
    cause, details, bugs = diagnose_firmware(measurements, tables)
    if bugs is None:
        return Diagnosis(cause, _append_details(cause, details))
    errors = bugs.errors_deg.tolist() if bugs.causes else ()
    return Diagnosis(cause, "; ".join([bugs.words, *details]), f"Check {bugs.places}.", errors)


@dataclass(frozen=True, slots=True)
class _Suspect:
    """One calibrator, the measurements by name, and the evidence of the run."""

    name: str
    measurements: Mapping[str, Measurement]
    evidence: HeadingEvidence | None
    axes: SensorAxes | None
    calibrated_axes: SensorAxes | None = None

    @property
    def sensors_have_wrong_axes(self) -> bool:
        """True if the sensors' own axes explain the heading."""
        return self.axes is not None and self.axes.explain_headings

    @property
    def has_wrong_axes(self) -> bool:
        """True if the axes of the sensors, or those after calibration, explain the heading."""
        calibrated = self.calibrated_axes is not None and self.calibrated_axes.explain_headings
        return self.sensors_have_wrong_axes or calibrated

    def measurement(self, name: str) -> Measurement | None:
        """Return a measurement of this calibrator: ``heading.max`` is ``heading.direct.max``."""
        section, _, quantity = name.partition(".")
        return self.measurements.get(f"{section}.{self.name}.{quantity}")


def diagnose(
    name: str, measurements: Mapping[str, Measurement], evidence: HeadingEvidence | None, axes: SensorAxes | None
) -> Diagnosis:
    """Return the likely cause if a calibrator's heading is out of its limit.

    Parameters
    ----------
    name
        Name of the calibrator.
    measurements
        All measurements of the run.
    evidence
        Evidence of the run; without tables for it (None) the measurements alone decide.
    axes
        Axes according to the evidence.
    """
    maximum = measurements[f"heading.{name}.max"]
    mean = measurements.get(f"heading.{name}.bias")
    undeclared_deg = value_of(mean) if maximum.outcome is Outcome.UNSET else None
    if evidence is not None:
        evidence = evidence.turned(undeclared_deg or 0.0) if name in evidence.held else None
    suspect = _Suspect(name, measurements, evidence, axes)
    if evidence is not None and not suspect.sensors_have_wrong_axes:
        suspect = replace(suspect, calibrated_axes=evidence.axes_under(name))
    if not _is_off(name, measurements):
        return NOTHING
    is_arithmetic, source = _source(suspect, maximum)
    same_as = evidence.same_as(name) if evidence and _fails(suspect.measurement("heading.float32_error")) else ""
    is_moved = source is not None and not is_arithmetic and _is_moved(suspect, source)
    symptoms = _symptoms(suspect, source, is_arithmetic=is_arithmetic, is_stale=bool(same_as) or is_moved)
    cause = Cause.NONE if symptoms is None else name_cause(symptoms)
    if cause is Cause.NONE and is_arithmetic and source is not None:
        cause = Cause.STALE if same_as else OF_SOURCE[source.source]
    words = _words(suspect, cause, source, same_as=same_as, is_arithmetic=is_arithmetic)
    return Diagnosis(cause, words, predicted_deg=_predicted_errors(suspect, cause, source))


def _predicted_errors(suspect: _Suspect, cause: Cause, source: ErrorSource | None) -> Sequence[float]:
    """Return the heading errors that the named source alone makes at the known angles [deg]; empty without one."""
    evidence = suspect.evidence
    if evidence is not None and cause is Cause.ACCELEROMETER:
        gravity = evidence.accelerometer_source(suspect.name)
        return evidence.errors_by(gravity[1], of_gravity=True) if gravity else ()
    is_named = source is not None and cause is not Cause.AXES
    return evidence.errors_by(source) if evidence is not None and source is not None and is_named else ()


def _source(suspect: _Suspect, maximum: Measurement) -> tuple[bool, ErrorSource | None]:
    """Return whether the firmware's arithmetic causes most of the error, and the source."""
    if suspect.evidence is None:
        return False, None
    arithmetic, largest = suspect.measurement("heading.float32_error"), value_of(maximum) or 0.0
    if _fails(arithmetic) and (not _fails(maximum) or (value_of(arithmetic) or 0.0) >= _MAKES_MOST * largest):
        # The known angles show a large source even if the calibrator has no reference.
        return True, suspect.evidence.arithmetic_source(suspect.name) or suspect.evidence.field_source(suspect.name)
    return False, suspect.evidence.field_source(suspect.name)


def _is_moved(suspect: _Suspect, source: ErrorSource) -> bool:
    predicted = value_of(suspect.measurement("fit.residual_predicted")) or next(
        (
            value_of(measurement)
            for name, measurement in sorted(suspect.measurements.items())
            if name.endswith(".residual_predicted")
        ),
        None,
    )
    return bool(
        suspect.evidence and predicted and suspect.evidence.is_stale(suspect.name, source, GOOD_FIT_FACTOR * predicted)
    )


def _symptoms(
    suspect: _Suspect, source: ErrorSource | None, *, is_arithmetic: bool, is_stale: bool
) -> HeadingSymptoms | None:
    measurements, maximum = suspect.measurements, suspect.measurements[f"heading.{suspect.name}.max"]
    norm, tilt = measurements.get("accelerometer.norm_rms"), measurements.get("accelerometer.tilt_error")
    coverage = value_of(measurements.get("tumble.coverage"))
    centred, bias = suspect.measurement("heading.max_centred"), suspect.measurement("heading.bias")
    residual, predicted = (
        value_of(suspect.measurement("fit.residual")),
        value_of(suspect.measurement("fit.residual_predicted")),
    )
    # Without a declared mounting only the centred error can be compared with the limit.
    max_deg = value_of(centred if maximum.outcome is Outcome.UNSET else maximum)
    if max_deg is None or (suspect.evidence is None and (residual is None or predicted is None)):
        return None
    # A calibration against gravity contains the accelerometer's errors: the limits of the accelerometer then decide.
    of_fields = None if suspect.name in _AGAINST_GRAVITY else suspect.evidence
    gravity = of_fields and of_fields.accelerometer_source(suspect.name)
    return HeadingSymptoms(
        max_deg=max_deg,
        max_limit_deg=maximum_of(maximum),
        bias_deg=value_of(bias),
        bias_limit_deg=None if bias is None or bias.outcome is Outcome.UNSET else maximum_of(bias),
        max_centred_deg=value_of(centred),
        residual_percent=residual or 0.0,
        residual_predicted_percent=predicted or 0.0,
        accelerometer_norm_rms_mg=value_of(norm) or 0.0,
        accelerometer_limit_mg=maximum_of(norm),
        tilt_error_deg=value_of(tilt) or 0.0,
        tilt_limit_deg=maximum_of(tilt),
        fit=fit_status(suspect.name, measurements),
        coverage_percent=100.0 if coverage is None else coverage,
        wrong_axes=suspect.has_wrong_axes,
        accelerometer_makes_more=gravity[0] if gravity else None,
        source=source.source if source else None,
        is_arithmetic=is_arithmetic,
        is_stale=is_stale,
    )


def _words(suspect: _Suspect, cause: Cause, source: ErrorSource | None, *, same_as: str, is_arithmetic: bool) -> str:
    evidence = suspect.evidence
    if cause is Cause.NONE:
        return ""
    if cause is Cause.AXES:
        return str(suspect.axes) if suspect.sensors_have_wrong_axes else f"after calibration, {suspect.calibrated_axes}"
    if evidence is not None and cause is Cause.ACCELEROMETER:
        gravity = evidence.accelerometer_source(suspect.name)
        return _append_details(cause, [f"{gravity[1].source}: {_size(gravity[1], 1000.0, 'mg')}"] if gravity else [])
    if evidence is None or source is None or cause in (Cause.POOR_COVERAGE, Cause.BAD_FIT):
        return _append_details(cause, _fit_details(suspect, cause))
    if same_as:
        return _append_details(cause, [f"it is that of {same_as}"])
    beside = ["beside its fit in float64"] if is_arithmetic else []
    # An excess in the calibration is missing in the calibrated field.
    size = [_size(source, -evidence.strength_ut, "uT"), *beside]
    if cause is Cause.STALE:
        since = "it was made" if suspect.name == CALIBRATION_FILE else "its points were taken"
        return _append_details(cause, [f"{OF_SOURCE[source.source]} of {size[0]}, since {since}"])
    if cause is Cause.CONSTANT_OFFSET:
        return _append_details(
            cause, [f"{value_of(suspect.measurement('heading.bias')) or 0.0:+.2f} deg", *_turned_axes(suspect)]
        )
    return _append_details(cause, size + _fit_details(suspect, cause))


def _turned_axes(suspect: _Suspect) -> list[str]:
    """Return the axes that look the same as a turn of the board while it is level."""
    return [f"or {suspect.axes}"] if suspect.axes is not None and str(suspect.axes) else []


def _fit_details(suspect: _Suspect, cause: Cause) -> list[str]:
    residual, predicted = (
        value_of(suspect.measurement("fit.residual")),
        value_of(suspect.measurement("fit.residual_predicted")),
    )
    if cause not in _OF_THE_FIT or residual is None or predicted is None:
        return []
    sphere = fit_status(suspect.name, suspect.measurements) is not FitStatus.ELLIPSOID
    return [
        *(["only a sphere was fitted"] if sphere else []),
        f"residual {residual:.2f} %, noise predicts {predicted:.2f} %",
    ]


def _append_details(cause: Cause, details: list[str]) -> str:
    return f"{cause} ({', '.join(details)})" if details else str(cause)


def _size(source: ErrorSource, strength: float, unit: str) -> str:
    """Return the size of a source, in the unit of the vectors or in its own."""
    match source.source:
        case Source.OFFSET:
            parts = strength * source.size
            components = ", ".join(
                f"{name} {_format_signed(part, 2)}" for name, part in zip("xyz", parts.tolist(), strict=True)
            )
            return f"{float(np.linalg.norm(parts)):.2f} {unit}: {components}"
        case Source.SCALE:
            return _format_percents(("x", "y", "z"), source.size.tolist())
        case Source.SOFT_IRON:
            return _format_percents(("yz", "zx", "xy"), source.size.tolist())
        case Source.CONSTANT_TURN:
            return f"{source.size[2]:+.2f} deg about the vertical"
    return _rotation(source)


def _format_percents(names: Sequence[str], shares: Sequence[float]) -> str:
    return ", ".join(f"{name} {_format_signed(100 * share, 1)} %" for name, share in zip(names, shares, strict=True))


def _format_signed(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:+.{digits}f}"  # + 0.0 turns a negative zero positive


def _rotation(source: ErrorSource) -> str:
    angle = float(np.linalg.norm(source.size))
    largest = int(np.argmax(np.abs(source.size)))
    others = float(np.linalg.norm(np.delete(source.size, largest)))
    about = f"about {'xyz'[largest]}" if others <= _ABOUT_ONE_AXIS * angle else "about a slanting axis"
    return f"rotated by {angle:.3g} deg {about}"


def _is_off(name: str, measurements: Mapping[str, Measurement]) -> bool:
    return any(_fails(measurements.get(f"heading.{name}.{quantity}")) for quantity in _OF_HEADINGS)


def _fails(measurement: Measurement | None) -> bool:
    return measurement is not None and measurement.outcome is Outcome.FAIL
