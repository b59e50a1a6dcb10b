"""The page about ``hiltest fit imu``: its example runs as it stands, and finds what it put in."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.finished_run import run_module

PAGE = (Path(__file__).parents[2] / "docs" / "fit-imu.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S) for line in block.splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a reader has run the example."""
    path = tmp_path_factory.mktemp("reader")
    subprocess.run([sys.executable, "-c", EXAMPLE], cwd=path, check=True, timeout=60)
    return path


def _run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    _, *arguments = shlex.split(command)
    return run_module("hiltest", *arguments, folder=folder)


def test_the_commands_do_what_the_page_says(folder: Path) -> None:
    for_people, for_programs = COMMANDS
    done = _run(for_people, folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "accelerometer, six-position: fair; " in done.stdout
    assert re.search(r"faces askew, rms \[deg\] +0\.70 ", done.stdout)  # "by 0.7 degree rms"
    assert "faces +x -x +y -y +z -z" in done.stdout
    assert "4 turns" in done.stdout
    assert (folder / "imu_log_calibration.h").exists()
    done = _run(for_programs, folder)
    content = json.loads(done.stdout)
    assert content == json.loads((folder / "imu_log_calibration.json").read_text())
    assert content["complete"]
    # "within 0.001 on the diagonal", "beside it within 0.01", "within 0.3 mg"
    for sensor, matrix in (("accelerometer", "gain"), ("gyroscope", "matrix")):
        (written,) = re.findall(rf"^{sensor} = np\.array\((.*)\)$", EXAMPLE, re.M)
        remainder = np.abs(np.array(content[sensor][matrix]) @ np.array(json.loads(written)) - np.eye(3))
        assert np.diag(remainder).max() < 0.001
        assert remainder.max() < 0.01
    assert np.abs(np.array(content["accelerometer"]["offset"]) - [0.03, -0.02, 0.015]).max() < 0.0003
    assert np.abs(np.array(content["gyroscope"]["bias"]) - [0.6, -0.4, 0.9]).max() < 0.01


def test_the_header_is_c_and_has_the_same_numbers(folder: Path, require_tool: Callable[[str], str]) -> None:
    compiler = [require_tool("gcc"), "-std=c11", "-Wall", "-Wextra", "-Werror"]
    content = json.loads(_run("hiltest fit imu imu.csv --json --export-header own.h", folder).stdout)
    program = folder / "print.c"
    program.write_text(
        '#include <stdio.h>\n#include "own.h"\nint main(void) { for (int i = 0; i < 9; i++) printf("%.9g %.9g\\n", '
        "(double)(&accelerometer_gain[0][0])[i], (double)(&gyroscope_matrix[0][0])[i]); "
        'for (int i = 0; i < 3; i++) printf("%.9g %.9g\\n", (double)accelerometer_offset[i], '
        "(double)gyroscope_bias[i]); }\n"
    )
    subprocess.run([*compiler, "-o", "print", "print.c"], cwd=folder, check=True, timeout=60)
    printed = subprocess.run([folder / "print"], capture_output=True, text=True, check=True, timeout=60).stdout
    numbers = np.array([line.split() for line in printed.splitlines()], dtype=float)
    expected = [
        [*np.ravel(content[sensor][matrix]), *content[sensor][vector]]
        for sensor, matrix, vector in (("accelerometer", "gain", "offset"), ("gyroscope", "matrix", "bias"))
    ]
    assert np.allclose(numbers.T, expected, rtol=2.0**-23, atol=0)


def test_a_log_that_supports_nothing_is_exported_nowhere(folder: Path) -> None:
    lines = (folder / "imu.csv").read_text().splitlines()
    (folder / "short.csv").write_text("\n".join(lines[:900]) + "\n")
    done = _run("hiltest fit imu short.csv --export-header short.h", folder)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "refused: fewer than 9 rests, and not on the six faces" in done.stdout
    assert "the calibration was not exported" in done.stderr
    assert not (folder / "short.h").exists()
    done = _run("hiltest fit imu nothing.csv", folder)
    assert done.returncode == 4
    assert "nothing.csv" in done.stderr


def test_the_verdicts_of_the_page_are_those_that_are_given() -> None:
    from hiltest.calibration.acceptance import Acceptance
    from hiltest.log_fitting import imu_accelerometer as accelerometer
    from hiltest.log_fitting import imu_gyroscope as gyroscope

    severity = list(Acceptance)
    rows = {
        "error of gravity's direction, predicted [deg]": "direction_error_deg",
        "spread of norms [%]": "spread_after_percent",
        "rests of an ellipsoid, at least": "rests",
        "condition of readings in motion": "condition",
        "readings in motion that are left out [%]": "left_out_percent",
        "longest over shortest axis": "axis_ratio",
    }
    for label, figure in rows.items():
        (row,) = re.findall(rf"^\| {re.escape(label)} \|(.*)\|$", PAGE, re.M)
        cells = [float(cell) for cell in row.split("|") if cell.strip() not in ("", "any")]
        bounds = [bound for bound in accelerometer.BOUNDS if bound.figure == figure]
        limits = [item.limit for item in sorted(bounds, key=lambda bound: severity.index(bound.verdict))]
        assert cells[: len(limits)] == limits != [], label
    turns, poor, fair = (bound.limit for bound in gyroscope.BOUNDS)
    assert (turns, f"up to {fair:g} % of a turn, poor beyond {poor:g} %" in " ".join(PAGE.split())) == (4, True)


def test_the_table_tells_the_limits_that_decide() -> None:
    from hiltest.log_fitting import imu_accelerometer as accelerometer
    from hiltest.log_fitting import imu_gyroscope as gyroscope
    from hiltest.log_fitting import intervals

    cells = dict(re.findall(r"^\| (a \w+) \| (.*) \|$", PAGE, re.M))
    assert f"by more than {intervals._MOTION:g} times the quietest tenth" in cells["a rest"]
    assert f"within {np.degrees(np.arccos(accelerometer._FACE_COSINE)):.0f} degrees of an axis" in cells["a face"]
    assert f"within {gyroscope._SAME_GRAVITY_DEG:g} degrees" in cells["a turn"]
    assert f"within {gyroscope._ABOUT_VERTICAL_DEG:g} degrees" in cells["a turn"]
    assert f"within {100 * gyroscope._SCALE:g} %" in cells["a turn"]
