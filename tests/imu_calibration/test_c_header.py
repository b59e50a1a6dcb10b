"""The C header holds the file's numbers, compiles without a warning, and says the units."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.procedures.imu_calibration import ImuCalibration
from hiltest.procedures.imu_calibration.calibration_file import to_header

_PROGRAM = """
#include <stdio.h>
#include "imu.h"
#include "imu.h" /* its guard lets it be included twice */

#define PRINT(name) for (unsigned k = 0; k < sizeof name / sizeof(float); k++) { \\
    printf("%.9g ", (double)((const float *)name)[k]); }

int main(void)
{
    PRINT(magnetometer_soft_iron)
    PRINT(magnetometer_hard_iron)
    PRINT(magnetometer_hard_iron_ut)
    PRINT(accelerometer_gain)
    PRINT(accelerometer_offset)
    PRINT(gyroscope_matrix)
    PRINT(gyroscope_bias)
    return 0;
}
"""


@pytest.mark.parametrize("sensor", ["MAG3110", "*/ int main(void) {} /*??/", "zwei\nZeilen \\"])
def test_c_has_the_numbers_of_the_file(
    calibration: ImuCalibration, tmp_path: Path, require_tool: Callable[[str], str], sensor: str
) -> None:
    calibration = replace(calibration, magnetometer=replace(calibration.magnetometer, sensor=sensor))
    (tmp_path / "imu.h").write_text(to_header(calibration), encoding="utf-8")
    (tmp_path / "program.c").write_text(_PROGRAM, encoding="utf-8")
    flags = ["-Wall", "-Wextra", "-Wconversion", "-Werror", "-std=c11"]
    subprocess.run([require_tool("gcc"), *flags, "program.c", "-o", "program"], cwd=tmp_path, check=True)
    done = subprocess.run(["./program"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert calibration.accelerometer is not None
    assert calibration.gyroscope is not None
    parts = [
        calibration.magnetometer.soft_iron,
        calibration.magnetometer.hard_iron,
        calibration.magnetometer.hard_iron_ut,
        calibration.accelerometer.gain,
        calibration.accelerometer.offset,
        calibration.gyroscope.matrix,
        calibration.gyroscope.bias,
    ]
    expected = np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)
    # Nine digits are every digit of a float32.
    assert [np.float32(part) for part in done.stdout.split()] == expected.tolist()


def test_units_and_frame_stand_beside_the_numbers(calibration: ImuCalibration) -> None:
    text = to_header(calibration)
    units = dict(re.findall(r"(\w+)(?:\[3\])+ = [^;]*; /\* (\S+) \*/", text))
    assert units == {
        "magnetometer_soft_iron": "1/count",
        "magnetometer_hard_iron": "count",
        "magnetometer_hard_iron_ut": "uT",
        "accelerometer_gain": "g/count",
        "accelerometer_offset": "count",
        "gyroscope_matrix": "dps/count",
        "gyroscope_bias": "count",
    }
    assert calibration.frame in text
    assert calibration.made_utc in text


def test_a_sensor_without_calibration_is_not_in_it(calibration: ImuCalibration) -> None:
    assert "accelerometer_" not in to_header(replace(calibration, accelerometer=None))
