"""Inputs kept beside the suites are measured by a run, and a limit on them is red when it does not hold."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.rig.bench_files import shipped
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Run
from hiltest.studies.worst_case import load_worst_case

pytestmark = pytest.mark.slow

KEPT = shipped() / "suites" / "worst" / "iterative.json"
NAME = "cycles.iterative.worst_found"


def run(bench: Path, limit: int) -> tuple[int, Run]:
    """Run the suite of the worst cases on the default rig, with a limit of its own; return exit code and record."""
    rig = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    mine = f'[limits]\n"{NAME}" = {{ max = {limit}, unit = "cycle" }}\n'
    limited = re.sub(r"(?ms)^\[limits\]\n.*?(?=^\[)", mine, rig)
    (bench / "limited.toml").write_text(limited, encoding="utf-8")
    done = run_module("hiltest", "run", "--rig", "limited.toml", "--", "-k", "worst_case", folder=bench)
    return done.returncode, read_record(bench / "hil-out" / "run.json").run


def test_a_run_measures_the_cycles_that_the_search_has_found(tmp_path: Path) -> None:
    cycles = load_worst_case(KEPT).cycles
    code, record = run(tmp_path, cycles)
    measurement = record.measurement(NAME)
    assert measurement is not None
    assert (code, measurement.value, measurement.cycle_model) == (0, cycles, load_worst_case(KEPT).cycle_model)
    code, record = run(tmp_path, cycles - 1)
    assert code == 1


def test_points_that_the_firmware_refuses_leave_a_limit_unevaluated(tmp_path: Path) -> None:
    suites = tmp_path / "hil" / "suites"
    shutil.copytree(shipped() / "suites", suites)
    content = json.loads(KEPT.read_text(encoding="utf-8"))
    content["points"] = [[x, y, 0] for x, y, _ in content["points"]]
    (suites / "worst" / "iterative.json").write_text(json.dumps(content), encoding="utf-8")
    code, record = run(tmp_path, content["cycles"])
    measurement = record.measurement(NAME)
    assert measurement is not None
    assert (code, measurement.value) == (22, None)
    assert "search again with hiltest profile worst iterative" in measurement.note
