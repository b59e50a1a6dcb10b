"""The page about profiles: its commands run and print what it shows, its suite passes, its tables are complete."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.virtual.counts.cost_classes import Stall
from hiltest.virtual.profiling.profile_tables import _NAMES

PAGE = (Path(__file__).parents[2] / "docs" / "profile.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^```sh\n(hiltest .*?)\n```", PAGE, re.M | re.S)
SHOWN = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
(SUITE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)


def run(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return run_module(*arguments, folder=folder)


@pytest.mark.parametrize("command", COMMANDS, ids=["crc32", "direct", "machines"])
def test_every_command_runs(command: str, tmp_path: Path) -> None:
    done = run(shlex.split(command), tmp_path)
    assert done.returncode == 0, done.stderr
    named = set(re.findall(r"\S+\.(?:folded|svg)", command))
    assert {path.name for path in tmp_path.iterdir()} == named


def test_the_first_command_prints_what_the_page_shows(tmp_path: Path) -> None:
    printed = [line.strip() for line in run(shlex.split(COMMANDS[0]), tmp_path).stdout.splitlines()]
    assert [line.strip() for line in SHOWN[0].splitlines() if line.strip() and line.strip() not in printed] == []


def test_the_suite_passes_and_a_tighter_limit_is_red(tmp_path: Path) -> None:
    (tmp_path / "test_page.py").write_text(SUITE, encoding="utf-8")
    done = run(["pytest", "-q"], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    (tmp_path / "test_page.py").write_text(SUITE.replace("max=150", "max=140"), encoding="utf-8")
    done = run(["pytest", "-q"], tmp_path)
    assert done.returncode == 1
    assert "cycles.crc32 147 cycles (limit 140), test_page.py:" in done.stdout


def test_every_stall_is_named() -> None:
    assert [item for item in Stall if f"| {_NAMES[item]} |" not in PAGE] == []
