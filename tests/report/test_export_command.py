"""``hiltest report export`` as a user calls it."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from hiltest.measurement import Limit, check
from hiltest.run_record.run_json import write_run

from ..in_process import hiltest
from ..trend.runs import finished_run

pytestmark = pytest.mark.slow

TOTAL = check("cycles.direct.total", 11_061, unit="cycle", limit=Limit(max=12_500), cycle_model="m")


def export(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return hiltest("report", "export", *arguments, folder=folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where there are a run, and a campaign of three seeds."""
    for name, seed in (("run", 1), ("night/seed-0001", 1), ("night/seed-0002", 2), ("night/seed-0003", 3)):
        (tmp_path / name).mkdir(parents=True)
        points = check("tumble.points", 300 + seed, unit="")
        write_run(finished_run(1, TOTAL, points, seed=seed), tmp_path / name)
    return tmp_path


@pytest.mark.parametrize("run", ["run", "run/run.json"])
def test_bencher_has_both_senses_in_one_file(folder: Path, run: str) -> None:
    done = export(folder, run, "--format", "bencher")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == {
        "cycles.direct.total (m)": {"cycle, smaller is better": {"value": 11_061}},
        "tumble.points": {"value, larger is better": {"value": 301}},
    }


def test_the_action_has_one_sense_a_file_and_the_others_are_counted(folder: Path) -> None:
    smaller = export(folder, "run", "--format", "github-action-benchmark")
    larger = export(folder, "run", "--format", "github-action-benchmark", "--better", "larger", "--out", "l.json")
    assert [load["name"] for load in json.loads(smaller.stdout)] == ["cycles.direct.total (m)"]
    assert smaller.stderr == "1 numbers are better when larger: --better larger exports them\n"
    assert [load["name"] for load in json.loads((folder / "l.json").read_text())] == ["tumble.points"]
    assert larger.stdout == ""
    assert larger.stderr.endswith("l.json: 1 numbers\n")


def test_a_campaign_has_its_spread(folder: Path) -> None:
    content = json.loads(export(folder, "night", "--format", "bencher").stdout)
    assert content["tumble.points"] == {
        "value, larger is better": {"value": 302, "lower_value": 301, "upper_value": 303},
    }


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["gone", "--format", "bencher"], "gone"),
        (["run"], "--format"),
        (["run", "--format", "bencher", "--better", "larger"], "--better is for github-action-benchmark"),
        (["run", "--format", "bencher", "--out", "no/such/file"], "no/such"),
    ],
)
def test_a_wrong_command_line_ends_with_4(folder: Path, arguments: list[str], complaint: str) -> None:
    done = export(folder, *arguments)
    assert done.returncode == 4
    assert complaint in done.stderr
    assert "Traceback" not in done.stderr


def test_a_run_without_a_number_to_export_is_refused(tmp_path: Path) -> None:
    write_run(finished_run(1, check("a.fact", 1, unit="mT"), TOTAL), tmp_path)
    done = export(tmp_path, ".", "--format", "github-action-benchmark", "--better", "larger")
    assert (done.returncode, done.stderr) == (4, "ERROR: .: the run has no number that is better when larger\n")
