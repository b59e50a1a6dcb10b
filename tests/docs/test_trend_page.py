"""The page about numbers over time: its commands run, and say what it says."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.measurement import Limit, check
from hiltest.run_record.run_json import write_run

from ..trend.runs import finished_run

PAGE = (Path(__file__).parents[2] / "docs" / "trend.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S) for line in block.splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a reader keeps a history of three runs, the last of which is still in hil-out."""
    path = tmp_path_factory.mktemp("reader")
    for place, day in (("history/a", 1), ("history/b", 2), ("history/c", 3), ("hil-out", 3)):
        (path / place).mkdir(parents=True)
        total = check("cycles.direct.total", 11_000 + 100 * (day > 2), unit="cycle", cycle_model="m")
        bias = check("heading.direct.bias", -0.1, unit="deg", limit=Limit.within(0.7))
        points = check("tumble.points", 300, unit="")
        write_run(finished_run(day, total, bias, points, build=f"b{day}"), path / place)
    return path


def run(command: str, folder: Path) -> str:
    _, *arguments = shlex.split(command)
    done = run_module("hiltest", *arguments, folder=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_trend_is_shown_and_drawn(folder: Path) -> None:
    plain, everything, as_json, *_ = COMMANDS
    answer = run(plain, folder)
    assert "worse: cycles.direct.total" in answer
    assert "build b2 -> b3" in answer
    assert "cycles.direct.total" in (folder / "history" / "trend.html").read_text(encoding="utf-8")
    assert "tumble.points" not in answer
    assert "tumble.points" in run(everything, folder)
    content = json.loads(run(as_json, folder))
    assert content["schema"] == "hiltest.trend/1"
    assert "`hiltest.trend/1`" in PAGE
    for name in content["measurements"][0]["series"][0].keys() - {"line", "cycle_model"}:
        assert f"`{name}`" in PAGE, name
    assert (folder / "trend.html").exists()


def test_the_exports_are_what_the_page_says(folder: Path) -> None:
    for command in COMMANDS[3:]:
        run(command, folder)
    bmf, smaller, larger = (json.loads((folder / f"{name}.json").read_text()) for name in ("bmf", "smaller", "larger"))
    assert bmf["heading.direct.bias, magnitude"] == {"deg, smaller is better": {"value": 0.1}}
    assert "`deg, smaller is better`" in PAGE
    assert bmf.keys() == {item["name"] for item in [*smaller, *larger]}
    assert [item["name"] for item in larger] == ["tumble.points"]
