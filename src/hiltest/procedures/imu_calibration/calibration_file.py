"""Reader and writer of calibration files, which are untrusted JSON; and of their numbers as a C header."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from hiltest.budgets import CALIBRATION
from hiltest.calibration.c_source import c_constant, comment_text
from hiltest.json_files import json_text, read_as, read_json
from hiltest.procedures.imu_calibration.contents import (
    SCHEMA,
    AccelerometerPart,
    GyroscopePart,
    ImuCalibration,
    MagnetometerPart,
)

# Largest size: a calibration file has some 4 kB.
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
    return json_text(calibration, numbers_in_line=True) + "\n"


def load_calibration(path: Path) -> CalibrationFile:
    """Read and check a calibration file.

    Raises
    ------
    ConfigError
        If it cannot be read, is not a calibration file, or has another number, unit, frame or formula; the message has
        the place and a remedy.
    """
    file = read_json(path, budget=CALIBRATION, otherwise=_OTHERWISE)
    return CalibrationFile(path, file.sha256, read_as(file, ImuCalibration, SCHEMA, otherwise=_OTHERWISE))


def to_header(calibration: ImuCalibration) -> str:
    """Return the text of a C header: C11, float, no code."""
    sensors = {
        "magnetometer": calibration.magnetometer,
        "accelerometer": calibration.accelerometer,
        "gyroscope": calibration.gyroscope,
    }
    parts = [_part_text(name, part) for name, part in sensors.items() if part is not None]
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


def _part_text(name: str, part: MagnetometerPart | AccelerometerPart | GyroscopePart) -> str:
    lines = [f"/* {comment_text(part.sensor)}, {comment_text(part.method)}: {part.formula} */"]
    lines += [c_constant(f"{name}_{field}", getattr(part, field), unit) for field, unit in asdict(part.units).items()]
    return "\n".join([*lines, ""])
