"""Reader and writer of calibration files, which are untrusted JSON; and of their numbers as a C header."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from hiltest.calibration.c_source import c_constant, comment_text
from hiltest.errors import ConfigError
from hiltest.procedures.imu_calibration.contents import SCHEMA, ImuCalibration, Matrix, Triple
from hiltest.strict_json import JsonFile, read_json, shown

# Largest size: a calibration file has some 4 kB.
_LARGEST_BYTES = 1_000_000
# A list of only numbers, which is written on one line. No string has a line break after a bracket.
_NUMBERS = re.compile(r"\[\n([^\[\]{}]*?)\n\s*\]")
_OTHERWISE = "calibrate again: hiltest calibrate"
_GUARD = "HILTEST_IMU_CALIBRATION_H"


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """A calibration, and the file that it was read from."""

    path: Path
    sha256: str
    calibration: ImuCalibration


def to_json(calibration: ImuCalibration) -> str:
    """Return the text of a calibration file."""
    text = json.dumps(asdict(calibration), indent=1, ensure_ascii=False, allow_nan=False)
    return _NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text) + "\n"


def load_calibration(path: Path) -> CalibrationFile:
    """Read and check a calibration file.

    Raises
    ------
    ConfigError
        If it cannot be read, is not a calibration file, or has another number, unit, frame or formula; the message has
        the place and a remedy.
    """
    file = read_json(path, largest_bytes=_LARGEST_BYTES, otherwise=_OTHERWISE)
    _check_schema(file)
    return CalibrationFile(path, file.sha256, _validate(file))


def _check_schema(file: JsonFile) -> None:
    path, schema = file.path, file.schema
    if schema == SCHEMA:
        return
    if str(schema).partition("/")[0] == SCHEMA.partition("/")[0]:
        raise ConfigError(
            f"{path}: schema is {schema!r}, this hiltest reads {SCHEMA!r}; use the version that wrote "
            f"it, or {_OTHERWISE}"
        )
    raise ConfigError(
        f"{path}: not a calibration of an IMU: its schema is {shown(schema)}, not {SCHEMA!r}; {_OTHERWISE}"
    )


def _validate(file: JsonFile) -> ImuCalibration:
    from pydantic import TypeAdapter, ValidationError

    try:
        return TypeAdapter(ImuCalibration).validate_json(json.dumps(file.content))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(step) for step in first["loc"])
        raise ConfigError(f"{file.path}: {_complaint(place, first['type'], first['msg'], first['input'])}") from error


def _complaint(place: str, kind: str, message: str, value: object) -> str:
    if kind in ("missing", "missing_argument"):
        return f"{place} is missing; {_OTHERWISE}"
    if kind in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown key {place}; a newer hiltest may have written it: use that one, or {_OTHERWISE}"
    message = message.removeprefix("Value error, ")
    if kind == "value_error":
        return f"{place + ': ' if place else ''}{message}; {_OTHERWISE}"
    text = f"{place}: {message[0].lower()}{message[1:]}, not {shown(value)}"
    if kind == "literal_error":
        return f"{text}; units are not converted: {_OTHERWISE}"
    return f"{text}; {_OTHERWISE}"


def to_header(calibration: ImuCalibration) -> str:
    """Return the text of a C header: C11, float, no code."""
    parts = [_magnetometer(calibration)]
    if calibration.accelerometer is not None:
        part = calibration.accelerometer
        parts.append(
            _part(
                "accelerometer",
                part.sensor,
                part.method,
                part.formula,
                [
                    ("gain", part.units.gain, part.gain),
                    ("offset", part.units.offset, part.offset),
                ],
            )
        )
    if calibration.gyroscope is not None:
        gyroscope = calibration.gyroscope
        parts.append(
            _part(
                "gyroscope",
                gyroscope.sensor,
                gyroscope.method,
                gyroscope.formula,
                [
                    ("matrix", gyroscope.units.matrix, gyroscope.matrix),
                    ("bias", gyroscope.units.bias, gyroscope.bias),
                ],
            )
        )
    origin = calibration.made_on
    lines = [
        "/*",
        f" * Calibration of an IMU by hiltest {comment_text(calibration.hiltest)}, {calibration.made_utc}.",
        f" * Board: chip {origin.unique_id}, firmware {comment_text(origin.firmware)} build "
        f"{comment_text(origin.build_id)}, rig {comment_text(origin.rig)}.",
        f" * Frame: {calibration.frame}.",
        " * Matrices are row by row; every product is matrix times column.",
        " */",
    ]
    return "\n".join([*lines, f"#ifndef {_GUARD}", f"#define {_GUARD}", "", *parts, "#endif", ""])


def _magnetometer(calibration: ImuCalibration) -> str:
    part = calibration.magnetometer
    return _part(
        "magnetometer",
        part.sensor,
        part.method,
        part.formula,
        [
            ("soft_iron", part.units.soft_iron, part.soft_iron),
            ("hard_iron", part.units.hard_iron, part.hard_iron),
            ("hard_iron_ut", part.units.hard_iron_ut, part.hard_iron_ut),
        ],
    )


def _part(
    name: str, sensor: str, method: str, formula: str, numbers: Sequence[tuple[str, str, Matrix | Triple]]
) -> str:
    lines = [f"/* {comment_text(sensor)}, {comment_text(method)}: {formula} */"]
    lines += [c_constant(f"{name}_{quantity}", values, unit) for quantity, unit, values in numbers]
    return "\n".join([*lines, ""])
