"""A calibration for other programs: as JSON, and as a C header."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltest import __version__
from hiltest.calibration.acceptance import Acceptance
from hiltest.calibration.c_source import c_float, comment_text
from hiltest.errors import ConfigError
from hiltest.json_files import json_text
from hiltest.log_fitting.fit_result import CalibratorFit, Matrix, SampleFit, Triple
from hiltest.measurement.units import MICROTESLA, FieldUnit
from hiltest.run_record.files import write_asked_for, write_document

CALIBRATION_SCHEMA, FIT_SCHEMA = "hiltest.calibration/1", "hiltest.fit/1"
FORMULA = "corrected = soft_iron * (reading - hard_iron)"

_FOLLOWING_FORMULA = "corrected = soft_iron * (reading - hard_iron - sum of vector * (value - reference))"
# Milligauss, ArduPilot's unit, in a microtesla.
_MILLIGAUSS = 10.0
# Kinds of COMPASS_MOTCT by the column's name.
_MOTOR_KINDS = {1: re.compile("thr|pwm|rc", re.IGNORECASE), 2: re.compile("cur|amp", re.IGNORECASE)}

_AXES = "in the axes of the sensor; soft_iron is symmetric"
_SYMMETRIC = "That does not exclude a rotation: fit error is not heading error."
_TURN = "They are for headings of a turn about {axis} only: the component along it is not corrected."
_REFUSED = "this magnetometer calibration was refused: hiltest fit prints the reason"

_HEADER = """\
/*
 * Magnetometer calibration by hiltest {version}: {calibrator}, verdict {verdict}.
 *
 *     {formula}
 *
 * reading, hard_iron, radius and corrected are in {unit}, {axes}, has the
 * determinant 1 and maps readings to corrected ones. Corrected readings have the length radius within {residual:.2f} %.
 * {caution}
 *
 * From {n_in} readings in {file}, of which the calibrator used {n_used}.
 */
#ifndef HILTEST_MAGNETOMETER_CALIBRATION_H
#define HILTEST_MAGNETOMETER_CALIBRATION_H
{warning}
/* [{unit}] */
static const float magnetometer_hard_iron[3] = {hard_iron};

/* [1], row by row */
static const float magnetometer_soft_iron[3][3] = {{
    {soft_iron},
}};

/* [{unit}] */
static const float magnetometer_radius = {radius};
{following}{accelerometer}
#endif
"""
# Replacements of `_AXES` and `_SYMMETRIC` if gravity was used.
_GRAVITY_AXES = "corrected in the accelerometer's axes; soft_iron turns it"
_GRAVITY = """\
Calibrated against gravity: the dip of readings that it was not fitted to varies by {dip:.2f} deg. For that the
 * accelerometer has to be calibrated as below. These columns of the log are reading:
 * {columns}\
"""
_ACCELEROMETER = """
/* gravity = gain * (reading - offset) has length 1, in the sign of the readings; offset [{unit}] */
static const float accelerometer_offset[3] = {offset};

/* [{gain_unit}], row by row, symmetric */
static const float accelerometer_gain[3][3] = {{
    {gain},
}};
"""


def export_json(fit: SampleFit, path: Path) -> None:
    """Write the best calibration of a sample file as JSON, so that a reader sees the whole file or none."""
    best = fit.best
    content: dict[str, Any] = {
        "schema": CALIBRATION_SCHEMA,
        "hiltest": __version__,
        "calibrator": best.name,
        "verdict": best.verdict,
        "formula": FORMULA,
        "direction": "soft_iron maps readings, less hard_iron, to corrected ones",
        "unit": fit.unit,
        "hard_iron": best.hard_iron,
        "soft_iron": best.soft_iron,
        "radius": best.radius,
        "source": fit.file,
        "n_in": fit.n_in,
        "n_used": best.n_used,
        "quality": {
            "residual_percent": best.residual_percent,
            "coverage": best.coverage,
            "axis_ratio": best.axis_ratio,
            "condition": fit.condition,
            "direction_error_deg": best.direction_error_deg,
        },
    }
    if fit.following is not None:
        content |= {"formula": _FOLLOWING_FORMULA, "following": [asdict(column) for column in fit.following.columns]}
    if best.gravity is not None and fit.gravity is not None:
        content |= {
            "axes": "corrected is in the axes of the accelerometer",
            "columns": fit.columns,
            "held_out_dip_deg": best.gravity.held_out_dip_deg,
            "rotation_deg": best.gravity.rotation_deg,
            "accelerometer": {
                "formula": "gravity = gain * (reading - offset)",
                "unit": fit.gravity.unit,
                "offset": best.gravity.accelerometer_offset,
                "gain": best.gravity.accelerometer_gain,
            },
        }
    write_document(path, content)


def export_header(fit: SampleFit, path: Path) -> None:
    """Write the best calibration of a sample file as a C header, so that a reader sees the whole file or none."""
    best = fit.best
    hard_iron, soft_iron, radius, residual = _numbers(best)
    refused = best.verdict is Acceptance.REFUSED
    warning = f'\n#warning "{_REFUSED}"\n' if refused else ""
    text = _HEADER.format(
        warning=warning,
        **_gravity_words(fit),
        version=__version__,
        calibrator=comment_text(best.name),
        verdict=best.verdict,
        formula=FORMULA if fit.following is None else _FOLLOWING_FORMULA,
        following=_following_constants(fit),
        unit=fit.unit,
        residual=residual,
        n_in=fit.n_in,
        file=comment_text(Path(fit.file).name),
        n_used=best.n_used,
        hard_iron=_row(hard_iron),
        soft_iron=_rows(soft_iron),
        radius=c_float(radius),
    )
    write_asked_for(path, text)


def export_ardupilot(fit: SampleFit, path: Path) -> None:
    """Write the best calibration as a file of ArduPilot's parameters for the first compass.

    Raises
    ------
    ConfigError
        When these parameters cannot express it.

    Notes
    -----
    ``corrected = M (field + COMPASS_OFS) + COMPASS_MOT value`` in milligauss, with the symmetric matrix M of
    COMPASS_DIA and COMPASS_ODI (ArduPilot, AP_Compass_Backend::correct_field).
    """
    best, unit = fit.best, MICROTESLA[FieldUnit(fit.unit)]
    hard_iron, soft_iron = (np.array(number) for number in _numbers(best)[:2])
    if unit is None or best.gravity is not None:
        reason = "the unit of the log is unknown (--unit)" if unit is None else "it has a rotation, from gravity"
        raise ConfigError(f"{path}: ArduPilot's parameters cannot express this calibration: {reason}")
    scale, motor = _MILLIGAUSS * unit, ["COMPASS_MOTCT 0"]
    for column in () if fit.following is None else fit.following.columns:
        vector = np.array(column.vector)
        hard_iron = hard_iron - column.reference * vector
        kind = next((kind for kind, word in _MOTOR_KINDS.items() if word.search(column.name)), None)
        if kind is None or len(motor) > 1:
            raise ConfigError(f"{path}: ArduPilot's parameters have one current or throttle; {column.name} is another")
        motor = [f"COMPASS_MOTCT {kind}", *_parameters("MOT", -scale * soft_iron @ vector)]
    lines = [
        f"# Magnetometer calibration by hiltest {__version__}: {best.name}, verdict {best.verdict}, in the log's axes",
        *_parameters("OFS", -scale * hard_iron),
        *_parameters("DIA", np.diag(soft_iron)),
        *_parameters("ODI", soft_iron[[0, 0, 1], [1, 2, 2]]),
        *motor,
    ]
    write_asked_for(path, "\n".join(lines) + "\n")


def _parameters(name: str, values: NDArray[np.float64]) -> list[str]:
    return [f"COMPASS_{name}_{axis} {value:.6f}" for axis, value in zip("XYZ", values, strict=True)]


def _following_constants(fit: SampleFit) -> str:
    columns = () if fit.following is None else fit.following.columns
    return "".join(
        f"\n/* [{fit.unit} per unit] vector, and reference, of the value {comment_text(column.name)} */\n"
        f"static const float magnetometer_following_{number}[3] = {_row(column.vector)};\n"
        f"static const float magnetometer_following_{number}_reference = {c_float(column.reference)};\n"
        for number, column in enumerate(columns, start=1)
    )


def _numbers(best: CalibratorFit) -> tuple[Triple, Matrix, float, float]:
    if best.hard_iron is None or best.soft_iron is None or best.radius is None or best.residual_percent is None:
        raise ValueError(f"{best.name} has no calibration to export")
    return best.hard_iron, best.soft_iron, best.radius, best.residual_percent


def _gravity_words(fit: SampleFit) -> dict[str, str]:
    """Return a header's texts about axes, heading and accelerometer."""
    gravity, turn = fit.best.gravity, fit.best.turn
    if gravity is None or fit.gravity is None or not gravity.accelerometer_offset or not gravity.accelerometer_gain:
        caution = _SYMMETRIC if turn is None else _TURN.format(axis=turn.axis)
        return {"axes": _AXES, "caution": caution, "accelerometer": ""}
    caution = _GRAVITY.format(dip=gravity.held_out_dip_deg, columns=", ".join(map(comment_text, fit.columns)))
    accelerometer = _ACCELEROMETER.format(
        unit=fit.gravity.unit,
        gain_unit=fit.gravity.gain_unit,
        offset=_row(gravity.accelerometer_offset),
        gain=_rows(gravity.accelerometer_gain),
    )
    return {"axes": _GRAVITY_AXES, "caution": caution, "accelerometer": accelerometer}


def _rows(matrix: Matrix) -> str:
    return ",\n    ".join(map(_row, matrix))


def _row(values: Triple) -> str:
    return f"{{{', '.join(map(c_float, values))}}}"


@dataclass(frozen=True, slots=True)
class FitHead:
    """First keys of the document of a fit; those of `SampleFit` follow."""

    hiltest: str
    """Version."""
    verdict: Acceptance
    best: str
    """Verdict and name of the best calibrator."""


def to_json(fit: SampleFit) -> str:
    """Return the text of a fit of samples, checked by ``fit.schema.json``."""
    head = FitHead(__version__, fit.best.verdict, fit.best.name)
    return json_text({"schema": FIT_SCHEMA, **asdict(head), **asdict(fit)}) + "\n"
