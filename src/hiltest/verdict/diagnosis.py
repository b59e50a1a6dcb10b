"""Likely cause of each failed heading, with its size, from the measurements of a run and its evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltest.calibration.error_sources import ErrorSource, Source
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.sensor_axes import SensorAxes
from hiltest.measurement import Measurement, Outcome
from hiltest.record.run import Table
from hiltest.verdict.calibrators import fit_status, maximum_of, value_of
from hiltest.verdict.causes import GOOD_FIT_FACTOR, OF_SOURCE, Cause, HeadingSymptoms, name_cause
from hiltest.verdict.heading_evidence import CALIBRATION_FILE, HeadingEvidence, read_heading_evidence
from hiltest.verdict.own_language import CALIBRATED, ECOMPASS, FIRMWARE, diagnose_firmware, diagnose_parts

# The firmware's own arithmetic is the cause where it makes at least half of the largest error.
_MAKES_MOST = 0.5
# A rotation is about one axis of the board where the others have less of it than this part.
_ABOUT_ONE_AXIS = 0.3
_AGAINST_GRAVITY = ("dpi", "dpi-poses")
_OF_HEADINGS = ("max", "rms", "bias", "max_centred", "float32_error")
_OF_THE_FIT = (Cause.POOR_COVERAGE, Cause.GOOD_FIT_BAD_HEADING, Cause.BAD_FIT)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Likely cause, and the words for it; empty where there is none."""

    cause: Cause
    words: str


NOTHING = Diagnosis(Cause.NONE, "")


# The words of the calibration against gravity that is refused though axes and dip are right.
_REFUSED = (
    "dpi refuses as MIRRORED what the known angles show to be right: the firmware takes the dip or gravity with the "
    "opposite sign there, or exchanges axes"
)


def diagnose_run(
    names: Sequence[str], measurements: Sequence[Measurement], tables: Mapping[str, Table], *, is_broken: bool
) -> dict[str, Diagnosis]:
    """Return the likely causes in a red run by calibrator, and that of tests which failed otherwise under ``""``.

    Parameters
    ----------
    names
        Calibrators with a heading.
    is_broken
        Whether tests failed by something else than a limit.
    """
    found, evidence = {measurement.name: measurement for measurement in measurements}, read_heading_evidence(tables)
    axes = None if evidence is None else evidence.axes()
    causes = {name: diagnose(name, found, evidence, axes) for name in names}
    if own := [each for each in (FIRMWARE, ECOMPASS, CALIBRATED) if _is_off(each, found)]:
        cause, details = diagnose_firmware(found, tables) if FIRMWARE in own else diagnose_parts(tables)
        causes |= dict.fromkeys(own, Diagnosis(cause, _with(cause, details)))
    if axes is not None and is_broken and not any(each.cause is Cause.AXES for each in causes.values()):
        mirrored = value_of(found.get("fit.dpi.status")) == FitStatus.MIRRORED
        words = str(axes) or (_REFUSED if mirrored and axes.are_as_declared else "")
        causes[""] = Diagnosis(Cause.AXES, words) if words else NOTHING
    return {name: each for name, each in causes.items() if each.cause is not Cause.NONE}


@dataclass(frozen=True, slots=True)
class _Patient:
    """One calibrator, all measurements by name, and the evidence of the run."""

    name: str
    found: Mapping[str, Measurement]
    evidence: HeadingEvidence | None
    axes: SensorAxes | None
    calibrated_axes: SensorAxes | None = None

    @property
    def sensors_have_wrong_axes(self) -> bool:
        """Whether the sensors' own axes explain the heading."""
        return self.axes is not None and self.axes.explain_headings

    @property
    def has_wrong_axes(self) -> bool:
        """Whether those do, or what the calibration makes of them."""
        calibrated = self.calibrated_axes is not None and self.calibrated_axes.explain_headings
        return self.sensors_have_wrong_axes or calibrated

    def of(self, name: str) -> Measurement | None:
        """Return a measurement of this calibrator: ``heading.max`` is ``heading.direct.max``."""
        section, _, what = name.partition(".")
        return self.found.get(f"{section}.{self.name}.{what}")


def diagnose(
    name: str, found: Mapping[str, Measurement], evidence: HeadingEvidence | None, axes: SensorAxes | None
) -> Diagnosis:
    """Return the likely cause of a calibrator's heading out of its limit.

    Parameters
    ----------
    name
        Calibrator.
    found
        All of the run.
    evidence
        None where the record has no tables for it: the measurements alone then decide.
    axes
        As the evidence shows them.
    """
    maximum = found[f"heading.{name}.max"]
    mean = found.get(f"heading.{name}.bias")
    undeclared_deg = value_of(mean) if maximum.outcome is Outcome.UNSET else None
    if evidence is not None:
        evidence = evidence.turned(undeclared_deg or 0.0) if name in evidence.held else None
    patient = _Patient(name, found, evidence, axes)
    if evidence is not None and not patient.sensors_have_wrong_axes:
        patient = replace(patient, calibrated_axes=evidence.axes_under(name))
    if not _is_off(name, found):
        return NOTHING
    is_arithmetic, source = _source(patient, maximum)
    same_as = evidence.same_as(name) if evidence and _fails(patient.of("heading.float32_error")) else ""
    is_moved = source is not None and not is_arithmetic and _is_moved(patient, source)
    seen = _symptoms(patient, source, is_arithmetic=is_arithmetic, is_stale=bool(same_as) or is_moved)
    cause = Cause.NONE if seen is None else name_cause(seen)
    if cause is Cause.NONE and is_arithmetic and source is not None:
        cause = Cause.STALE if same_as else OF_SOURCE[source.source]
    return Diagnosis(cause, _words(patient, cause, source, same_as=same_as, is_arithmetic=is_arithmetic))


def _source(patient: _Patient, maximum: Measurement) -> tuple[bool, ErrorSource | None]:
    """Return whether the firmware's arithmetic makes most of the error, and the source."""
    if patient.evidence is None:
        return False, None
    arithmetic, largest = patient.of("heading.float32_error"), value_of(maximum) or 0.0
    if _fails(arithmetic) and (
        not _fails(maximum) or (value_of(arithmetic) or 0.0) >= _MAKES_MOST * largest
    ):
        # Of a calibrator without a reference the known angles show the source as well, if it is large.
        return True, patient.evidence.arithmetic_source(patient.name) or patient.evidence.field_source(patient.name)
    return False, patient.evidence.field_source(patient.name)


def _is_moved(patient: _Patient, source: ErrorSource) -> bool:
    predicted = value_of(patient.of("fit.residual_predicted")) or next((
        value_of(each) for name, each in sorted(patient.found.items()) if name.endswith(".residual_predicted")
    ), None)
    return bool(
        patient.evidence and predicted
        and patient.evidence.is_stale(patient.name, source, GOOD_FIT_FACTOR * predicted)
    )


def _symptoms(
    patient: _Patient, source: ErrorSource | None, *, is_arithmetic: bool, is_stale: bool
) -> HeadingSymptoms | None:
    found, maximum = patient.found, patient.found[f"heading.{patient.name}.max"]
    norm, tilt = found.get("accelerometer.norm_rms"), found.get("accelerometer.tilt_error")
    coverage = value_of(found.get("tumble.coverage"))
    centred, bias = patient.of("heading.max_centred"), patient.of("heading.bias")
    residual, predicted = value_of(patient.of("fit.residual")), value_of(patient.of("fit.residual_predicted"))
    # With no mounting declared only the centred error can be compared with the limit.
    max_deg = value_of(centred if maximum.outcome is Outcome.UNSET else maximum)
    if max_deg is None or (patient.evidence is None and (residual is None or predicted is None)):
        return None
    # Gravity has made the calibration too where that is against gravity: the limits of the accelerometer then decide.
    of_fields = None if patient.name in _AGAINST_GRAVITY else patient.evidence
    gravity = of_fields and of_fields.accelerometer_source(patient.name)
    return HeadingSymptoms(
        max_deg=max_deg, max_limit_deg=maximum_of(maximum), bias_deg=value_of(bias),
        bias_limit_deg=None if bias is None or bias.outcome is Outcome.UNSET else maximum_of(bias),
        max_centred_deg=value_of(centred),
        residual_percent=residual or 0.0, residual_predicted_percent=predicted or 0.0,
        accelerometer_norm_rms_mg=value_of(norm) or 0.0, accelerometer_limit_mg=maximum_of(norm),
        tilt_error_deg=value_of(tilt) or 0.0, tilt_limit_deg=maximum_of(tilt), fit=fit_status(patient.name, found),
        coverage_percent=100.0 if coverage is None else coverage,
        wrong_axes=patient.has_wrong_axes,
        accelerometer_makes_more=gravity[0] if gravity else None, source=source.source if source else None,
        is_arithmetic=is_arithmetic, is_stale=is_stale,
    )


def _words(
    patient: _Patient, cause: Cause, source: ErrorSource | None, *, same_as: str, is_arithmetic: bool
) -> str:
    evidence = patient.evidence
    if cause is Cause.NONE:
        return ""
    if cause is Cause.AXES:
        return str(patient.axes) if patient.sensors_have_wrong_axes else f"after calibration, {patient.calibrated_axes}"
    if evidence is not None and cause is Cause.ACCELEROMETER:
        gravity = evidence.accelerometer_source(patient.name)
        return _with(cause, [f"{gravity[1].source}: {_size(gravity[1], 1000.0, 'mg')}"] if gravity else [])
    if evidence is None or source is None or cause in (Cause.POOR_COVERAGE, Cause.BAD_FIT):
        return _with(cause, _of_the_fit(patient, cause))
    if same_as:
        return _with(cause, [f"it is that of {same_as}"])
    beside = ["beside its fit in float64"] if is_arithmetic else []
    # What a calibration takes off too much the calibrated field has too little.
    size = [_size(source, -evidence.strength_ut, "uT"), *beside]
    if cause is Cause.STALE:
        since = "it was made" if patient.name == CALIBRATION_FILE else "its points were taken"
        return _with(cause, [f"{OF_SOURCE[source.source]} of {size[0]}, since {since}"])
    if cause is Cause.CONSTANT_OFFSET:
        return _with(cause, [f"{value_of(patient.of('heading.bias')) or 0.0:+.2f} deg", *_turned_axes(patient)])
    return _with(cause, size + _of_the_fit(patient, cause))


def _turned_axes(patient: _Patient) -> list[str]:
    """Return the axes that look the same as a turn of the board, as long as it is level."""
    return [f"or {patient.axes}"] if patient.axes is not None and str(patient.axes) else []


def _of_the_fit(patient: _Patient, cause: Cause) -> list[str]:
    residual, predicted = value_of(patient.of("fit.residual")), value_of(patient.of("fit.residual_predicted"))
    if cause not in _OF_THE_FIT or residual is None or predicted is None:
        return []
    sphere = fit_status(patient.name, patient.found) is not FitStatus.ELLIPSOID
    return [*(["only a sphere was fitted"] if sphere else []),
            f"residual {residual:.2f} %, noise predicts {predicted:.2f} %"]


def _with(cause: Cause, details: list[str]) -> str:
    return f"{cause} ({', '.join(details)})" if details else str(cause)


def _size(source: ErrorSource, strength: float, unit: str) -> str:
    """Return how large a source is, in the unit of the vectors or in its own."""
    x, y, z = source.size.tolist()
    match source.source:
        case Source.OFFSET:
            parts = strength * source.size
            each = ", ".join(f"{name} {_signed(part, 2)}" for name, part in zip("xyz", parts.tolist(), strict=True))
            return f"{float(np.linalg.norm(parts)):.2f} {unit}: {each}"
        case Source.SCALE:
            return f"x {_signed(100 * x, 1)} %, y {_signed(100 * y, 1)} %, z {_signed(100 * z, 1)} %"
        case Source.SOFT_IRON:
            return f"yz {_signed(100 * x, 1)} %, zx {_signed(100 * y, 1)} %, xy {_signed(100 * z, 1)} %"
        case Source.CONSTANT_TURN:
            return f"{z:+.2f} deg about the vertical"
    return _rotation(source)


def _signed(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:+.{digits}f}"  # + 0.0 turns a negative zero positive


def _rotation(source: ErrorSource) -> str:
    angle = float(np.linalg.norm(source.size))
    largest = int(np.argmax(np.abs(source.size)))
    others = float(np.linalg.norm(np.delete(source.size, largest)))
    about = f"about {'xyz'[largest]}" if others <= _ABOUT_ONE_AXIS * angle else "about a slanting axis"
    return f"rotated by {angle:.3g} deg {about}"


def _is_off(name: str, found: Mapping[str, Measurement]) -> bool:
    return any(_fails(found.get(f"heading.{name}.{each}")) for each in _OF_HEADINGS)


def _fails(measurement: Measurement | None) -> bool:
    return measurement is not None and measurement.outcome is Outcome.FAIL
