"""The numbers of a calibration file as a C header, in the same units."""

from __future__ import annotations

from collections.abc import Sequence

from hiltest.c_source import c_constant, in_comment
from hiltest.imu_calibration.contents import ImuCalibration, Matrix, Triple

_GUARD = "HILTEST_IMU_CALIBRATION_H"


def to_header(calibration: ImuCalibration) -> str:
    """Return the text of a C header: C11, float, no code."""
    parts = [_magnetometer(calibration)]
    if calibration.accelerometer is not None:
        part = calibration.accelerometer
        parts.append(_part("accelerometer", part.sensor, part.method, part.formula, [
            ("gain", part.units.gain, part.gain), ("offset", part.units.offset, part.offset),
        ]))
    if calibration.gyroscope is not None:
        gyroscope = calibration.gyroscope
        parts.append(_part("gyroscope", gyroscope.sensor, gyroscope.method, gyroscope.formula, [
            ("matrix", gyroscope.units.matrix, gyroscope.matrix), ("bias", gyroscope.units.bias, gyroscope.bias),
        ]))
    made = calibration.made_on
    lines = [
        "/*",
        f" * Calibration of an IMU by hiltest {in_comment(calibration.hiltest)}, {calibration.made_utc}.",
        f" * Board: chip {made.unique_id}, firmware {in_comment(made.firmware)} build {in_comment(made.build_id)}, "
        f"rig {in_comment(made.rig)}.",
        f" * Frame: {calibration.frame}.",
        " * Matrices are row by row; every product is matrix times column.",
        " */",
    ]
    return "\n".join([*lines, f"#ifndef {_GUARD}", f"#define {_GUARD}", "", *parts, "#endif", ""])


def _magnetometer(calibration: ImuCalibration) -> str:
    part = calibration.magnetometer
    return _part("magnetometer", part.sensor, part.method, part.formula, [
        ("soft_iron", part.units.soft_iron, part.soft_iron), ("hard_iron", part.units.hard_iron, part.hard_iron),
        ("hard_iron_ut", part.units.hard_iron_ut, part.hard_iron_ut),
    ])


def _part(
    name: str, sensor: str, method: str, formula: str, numbers: Sequence[tuple[str, str, Matrix | Triple]]
) -> str:
    lines = [f"/* {in_comment(sensor)}, {in_comment(method)}: {formula} */"]
    lines += [c_constant(f"{name}_{what}", values, unit) for what, unit, values in numbers]
    return "\n".join([*lines, ""])
