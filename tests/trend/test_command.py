"""``hiltest report trend`` as a user calls it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.measurement import Limit, check

from ..in_process import hiltest
from .entries import cycles, degrees

pytestmark = pytest.mark.slow

WriteRun = Callable[..., Path]


def trend(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return hiltest("report", "trend", ".", *arguments, folder=folder)


@pytest.fixture
def runs(tmp_path: Path, write: WriteRun) -> Path:
    for day in (1, 2, 3):
        write(str(day), day, cycles(11_061 + 100 * (day > 2)), degrees(1.0, "heading.direct.rms"), build=f"b{day}")
    (tmp_path / "other.json").write_text("{}")
    return tmp_path


def test_the_table_the_steps_and_the_sentence_are_printed_and_the_page_is_written(runs: Path) -> None:
    done = trend(runs)
    assert done.returncode == 0, done.stderr
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert "cycles.direct.total 3 11 061 11 161 11 061 11 161 cycle at most 12 500 1, last in run 3" in lines
    assert "cycles counted by cortex-m4-trm/3@sram" in lines
    assert "1 more without limit and change point (--all shows them)" in lines
    assert (
        "run 3, 2026-01-03T00:00:00Z: worse: cycles.direct.total "
        "11 061 -> 11 161 cycles (+100, +0.9 %; limit at most 12 500)"
    ) in lines
    assert "build b2 -> b3 (3/run.json)" in lines
    assert lines[-2].startswith("3 runs from 2026-01-01T00:00:00Z to 2026-01-03T00:00:00Z: 1 change point in 1 of 2")
    assert lines[-1] == "trend.html"
    assert done.stderr == "skipped other.json: not a record of hiltest: schema is null\n"
    assert "cycles.direct.total" in (runs / "trend.html").read_text()
    assert "heading.direct.rms" in trend(runs, "--all").stdout


def test_cycles_of_several_models_are_told_apart_in_the_table(tmp_path: Path, write: WriteRun) -> None:
    crc = check("crc32.cycles", 100, unit="cycle", cycle_model="m@flash", limit=Limit(max=200))
    write("1", 1, cycles(11_061), crc, degrees(1.0))
    done = trend(tmp_path)
    words = " ".join(done.stdout.split())
    assert "cycle counted by m@flash at most 200" in words
    assert "cycle counted by cortex-m4-trm/3@sram at most 12 500" in words
    assert "cycles counted by cortex-m4-trm/3@sram and m@flash" in done.stdout.splitlines()


def test_json_is_all_that_is_printed_and_holds_the_steps(runs: Path) -> None:
    done = trend(runs, "--json")
    content = json.loads(done.stdout)
    assert (done.returncode, done.stderr) == (0, "")
    assert not (runs / "trend.html").exists()
    assert content["schema"] == "hiltest.trend/1"
    assert [each["when_utc"][:10] for each in content["entries"]] == ["2026-01-01", "2026-01-02", "2026-01-03"]
    (total,) = [each for each in content["measurements"] if each["name"] == "cycles.direct.total"]
    (series,) = total["series"]
    assert series["values"] == [11_061, 11_061, 11_161]
    assert series["limits"] == [{"entry": 0, "limit": {"min": None, "max": 12_500}}]
    (step,) = series["steps"]
    assert (step["before"], step["after"], step["change"], step["delta"]) == (1, 2, "worse", 100)
    assert content["skipped"] == [{"file": "other.json", "reason": "not a record of hiltest: schema is null"}]


def test_a_step_within_the_tolerance_is_none(tmp_path: Path, write: WriteRun) -> None:
    for day in (1, 2):
        write(str(day), day, degrees(1.0 + 0.001 * day))
    assert "no change point in 1 measurements" in trend(tmp_path).stdout


def test_a_folder_without_runs_is_a_usage_error_that_names_what_was_skipped(tmp_path: Path) -> None:
    (tmp_path / "no-run.json").write_text("x")
    done = trend(tmp_path)
    assert done.returncode == 4
    assert "ERROR: . has no run\nskipped no-run.json: not JSON" in done.stderr


def test_the_page_goes_where_it_is_asked_for(runs: Path) -> None:
    assert trend(runs, "--html", "t/x.html").returncode == 4
    assert trend(runs, "--html", "x.html", "--json").stderr == "x.html\n"
    assert (runs / "x.html").exists()
