"""The page about the gyroscope: its commands run as they stand, and its table has every measurement."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.measurement import KINDS

PAGE = (Path(__file__).parents[2] / "docs" / "gyroscope.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S) for line in block.splitlines()]


def _run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    _, *arguments = shlex.split(command)
    return run_module("hiltest", *arguments, folder=folder)


def test_the_commands_do_what_the_page_says(tmp_path: Path) -> None:
    run, log, page, for_programs = COMMANDS
    done = _run(run, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    assert "gyroscope.noise_density" in {measurement["name"] for measurement in record["measurements"]}
    done = _run(log, tmp_path)
    assert (done.returncode, done.stdout) == (0, "rest.csv: 4000 of the gyroscope\n"), done.stderr
    done = _run(page, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "deg/rth" in done.stdout
    assert "<svg" in (tmp_path / "rest.html").read_text(encoding="utf-8")
    columns = json.loads(_run(for_programs, tmp_path).stdout)["columns"]
    for column in columns:
        # One-sided; 20 s with averages from 0.05 s on leave 4 %.
        density, walk = column["noise_density"], column["angle_random_walk"]
        assert (density["value"], density["unit"]) == (pytest.approx(25.0, rel=0.15), "mdps/rtHz")
        assert (walk["value"], walk["unit"]) == (pytest.approx(60.0 * 0.025 / 2**0.5, rel=0.15), "deg/rth")
        assert column["bias_instability"]["value"] is None  # the virtual part has none


def test_the_table_has_every_measurement() -> None:
    matches = set(re.findall(r"`(gyroscope\.[a-z_.]+)`", PAGE))
    matches |= {f"gyroscope.{rest}" for rest in re.findall(r"`\.([a-z_.]+)`", PAGE)}
    ours = {kind.replace("{axis}", "z") for kind in KINDS if kind.startswith("gyroscope.") and "{fit}" not in kind}
    assert ours <= matches
