"""The page about ``hiltest fit``: its example runs as it stands, and its table is what decides."""

from __future__ import annotations

import json
import math
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike
from tests.finished_run import run_module

from hiltest.calibration.acceptance import BOUNDS, Acceptance
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.iterative import fit_iterative

PAGE = (Path(__file__).parents[2] / "docs" / "fit.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S) for line in block.splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a reader has run the example."""
    path = tmp_path_factory.mktemp("reader")
    subprocess.run([sys.executable, "-c", EXAMPLE], cwd=path, check=True)
    return path


def _truth() -> tuple[np.ndarray, np.ndarray]:
    """Return directions and readings of the example, all round."""
    names: dict[str, np.ndarray] = {}
    exec(compile(EXAMPLE.split("for name, samples")[0], "docs/fit.md", "exec"), names)
    return names["directions"], names["readings"]


def _run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    _, *arguments = shlex.split(command)
    return run_module("hiltest", *arguments, folder=folder)


def test_the_commands_do_what_the_page_says(folder: Path) -> None:
    all_round, little, following, of_a_folder, for_programs = COMMANDS
    done = _run(all_round, folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "good" in done.stdout
    assert [line.split()[:2] for line in done.stdout.splitlines() if "refused" in line] == [["as", "read"]]
    assert {"fit.html", "magnetometer_calibration.h"} <= {path.name for path in folder.iterdir()}
    done = _run(little, folder)
    assert done.returncode == 1
    sentences = " ".join(done.stdout.split())
    assert "is above 300 (refused)" in sentences
    assert "direct, direct-fast, corrected, iterative: the fit ended as 'poor coverage'" in sentences
    assert re.search(r"^ verdict +fair +refused $", done.stdout, re.M)
    readings = np.loadtxt(folder / "all-round.csv", delimiter=",", skiprows=1)
    current_a, temperature_c = np.linspace(0.0, 20.0, len(readings)), 30.0 + np.cos(np.arange(len(readings)))
    flight = np.column_stack([readings + np.outer(current_a, [0.5, -0.2, 0.3]), current_a, temperature_c])
    header = "mx_uT,my_uT,mz_uT,current_A,temperature_C"
    np.savetxt(folder / "flight.csv", flight, fmt="%.3f", delimiter=",", header=header, comments="")
    done = _run(following, folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "COMPASS_MOT_X" in (folder / "compass.param").read_text(encoding="utf-8")
    assert {"all-round.csv", "little.csv"} <= set(_run(of_a_folder, folder).stdout.split())
    done = _run(for_programs, folder)
    assert done.returncode == 0
    assert json.loads(done.stdout)["verdict"] == "good"


def test_a_calibration_of_the_little_cloud_is_as_wrong_as_the_page_says(folder: Path) -> None:
    """Small residual, wrong field strength: every calibrator refuses the ellipsoid, and only a ridge is believed."""
    content = json.loads(_run("hiltest fit little.csv --on host --json", folder).stdout)
    calibrators = {calibrator["name"]: calibrator for calibrator in content["calibrators"]}
    ridge = calibrators.pop(content["best"])
    assert {(each["status"], each["verdict"]) for each in calibrators.values()} == {("poor coverage", "refused")}
    assert "iterative" in calibrators
    assert ridge["name"] == "ridge"
    assert round(ridge["direction_error_deg"], 1) == 1.9
    assert _off_deg(ridge["soft_iron"], ridge["hard_iron"]) == pytest.approx(1.1, abs=0.05)
    little = 10.0 * np.loadtxt(folder / "little.csv", delimiter=",", skiprows=1)
    iterative = fit_iterative(little, largest_error_deg=math.inf)
    assert iterative.status is FitStatus.ELLIPSOID
    # "1 %", "a tenth" of 48.5 uT, "about 10 degrees".
    lengths = np.linalg.norm(iterative.corrected(little), axis=1)
    assert 100.0 * np.sqrt(np.mean((lengths - 1.0) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert 0.1 * iterative.radius == pytest.approx(0.9 * 48.5, abs=0.05 * 48.5)
    assert _off_deg(iterative.soft_iron, 0.1 * iterative.hard_iron) == pytest.approx(10.0, abs=1.5)


def _off_deg(soft_iron: ArrayLike, hard_iron: ArrayLike) -> float:
    """Return how far directions that a calibration corrects are off, rms over all of the example's."""
    directions, readings = _truth()
    corrected = (readings - np.asarray(hard_iron)) @ np.asarray(soft_iron)
    cosines = (corrected * directions).sum(axis=1) / np.linalg.norm(corrected, axis=1)
    return float(np.degrees(np.sqrt(np.mean(np.arccos(cosines) ** 2))))


def test_the_table_has_every_threshold() -> None:
    rows = re.findall(r"^\| (\w+) \| .* \| ?([^|]*?) ?\| ?([^|]*?) ?\| ?([^|]*?) \|$", PAGE, re.M)
    messages = {
        name: dict(zip((Acceptance.FAIR, Acceptance.POOR, Acceptance.REFUSED), cells, strict=True))
        for name, *cells in rows
        if name != "figure"
    }
    for bound in BOUNDS:
        side = "below" if bound.below else "above"
        assert f"{side} {bound.limit:g}" in messages[bound.figure][bound.verdict].split(", ")
    numbers = [number for item in messages.values() for cell in item.values() for number in re.findall(r"[\d.]+", cell)]
    assert len(numbers) == len(BOUNDS)
