"""Exported calibrations: what C and Python make of them is the same."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.command_files import json_schema

from hiltest.errors import ConfigError
from hiltest.log_fitting import FieldUnit, Samples
from hiltest.log_fitting.fit_result import SampleFit
from hiltest.log_fitting.sample_fit import fit_on_host
from hiltest.log_fitting.sample_fit_exports import export_header, export_json, to_json
from hiltest.procedures.golden_points import golden_points

_PROGRAM = """
#include <stdio.h>
#include "calibration.h"
#include "calibration.h" /* its guard lets it be included twice */

int main(void)
{
    float r[3];
    while (scanf("%f %f %f", &r[0], &r[1], &r[2]) == 3) {
        for (int row = 0; row < 3; row++) {
            float corrected = 0.0f;
            for (int k = 0; k < 3; k++) {
                corrected += magnetometer_soft_iron[row][k] * (r[k] - magnetometer_hard_iron[k]);
            }
            printf("%.9g ", (double)corrected);
        }
    }
    printf("%.9g\\n", (double)magnetometer_radius);
    return 0;
}
"""


def _fit(name: str = "cloud.csv") -> SampleFit:
    return fit_on_host(Samples(Path(name), golden_points(100) / 10.0, FieldUnit.UT, "option", ("x", "y", "z"), 0))


def _corrected(content: dict[str, list[float]], readings: np.ndarray) -> np.ndarray:
    return (readings - content["hard_iron"]) @ np.array(content["soft_iron"]).T


@pytest.mark.parametrize("name", ["cloud.csv", "*/ int main(void) {} /*??/.csv", "zwei\nZeilen \\.csv"])
def test_c_and_python_correct_alike(tmp_path: Path, require_tool: Callable[[str], str], name: str) -> None:
    fit = _fit(name)
    export_json(fit, tmp_path / "calibration.json")
    export_header(fit, tmp_path / "calibration.h")
    (tmp_path / "program.c").write_text(_PROGRAM, encoding="utf-8")
    flags = ["-Wall", "-Wextra", "-Wconversion", "-Werror", "-std=c11"]
    subprocess.run([require_tool("gcc"), *flags, "program.c", "-o", "program"], cwd=tmp_path, check=True)
    readings = golden_points(50, index=1) / 10.0
    text = "\n".join(" ".join(map(str, row)) for row in readings)
    done = subprocess.run(["./program"], input=text, cwd=tmp_path, capture_output=True, text=True, check=True)
    *numbers, radius = map(float, done.stdout.split())
    content = json.loads((tmp_path / "calibration.json").read_text(encoding="utf-8"))
    # float32 of readings up to 110 uT: some 1e-5 uT.
    np.testing.assert_allclose(np.reshape(numbers, (50, 3)), _corrected(content, readings), atol=5e-5)
    assert radius == pytest.approx(content["radius"], rel=1e-7)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "calibration.h",
        "calibration.json",
        "program",
        "program.c",
    ]


def test_exported_json_takes_its_points_to_the_sphere_and_says_how(tmp_path: Path) -> None:
    export_json(_fit(), tmp_path / "calibration.json")
    content = json.loads((tmp_path / "calibration.json").read_text(encoding="utf-8"))
    assert (content["schema"], content["unit"]) == ("hiltest.calibration/1", "uT")
    assert content["direction"] == "soft_iron maps readings, less hard_iron, to corrected ones"
    lengths = np.linalg.norm(_corrected(content, golden_points(100) / 10.0), axis=1) / content["radius"]
    residual = 100.0 * np.sqrt(np.mean((lengths - 1.0) ** 2))
    assert residual == pytest.approx(content["quality"]["residual_percent"], rel=1e-9)
    assert np.linalg.det(content["soft_iron"]) == pytest.approx(1.0, rel=1e-12)


def test_a_place_that_cannot_be_written_to_is_a_usage_error(tmp_path: Path) -> None:
    for export in (export_json, export_header):
        with pytest.raises(ConfigError, match=r"cannot write .*gone/out: No such file"):
            export(_fit(), tmp_path / "gone" / "out")


def test_the_json_has_every_field_that_the_schema_requires() -> None:
    schema, content = json_schema("hiltest.fit/1"), json.loads(to_json(_fit()))
    assert list(content) == list(schema["properties"])
    (first, *_) = content["calibrators"]
    assert list(first) == list(schema["$defs"]["CalibratorFit"]["properties"])
    assert content["schema"] == schema["properties"]["schema"]["const"] == "hiltest.fit/1"
