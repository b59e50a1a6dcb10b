"""The advice to keep what got better does it, followed word for word, and leaves the run that was judged alone."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.boards import default_firmware
from hiltest.session.settings import run_options

pytestmark = pytest.mark.slow

LAMP = """
from hiltest.measurement import Limit

def test_current(measure, board, hil_settings):
    # Better only with the user's own firmware, on the rig and with the poses of the run.
    mine = str(hil_settings.firmware) == "my lamp.elf" and hil_settings.rig == "mine.toml"
    mine = mine and hil_settings.poses == "level" and hil_settings.label == "v2"
    measure("lamp.current", 1 if mine else 2, "mA", limit=Limit(max=9))
"""


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A bench with a firmware and a rig of its own, and a baseline of two seeds, which the packaged firmware made."""
    (tmp_path / "hil" / "suites").mkdir(parents=True)
    (tmp_path / "hil" / "suites" / "test_lamp.py").write_text(LAMP)
    rig = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
    text = rig.read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text[: text.index("[limits]")], encoding="utf-8")
    shutil.copy(default_firmware(), tmp_path / "my lamp.elf")
    assert hiltest(tmp_path, "run --rig mine.toml --poses level --seeds 1..2 --out base").returncode == 0
    assert hiltest(tmp_path, "baseline save base base.json").returncode == 0
    return tmp_path


def hiltest(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Run a command as it would be typed."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    return run_module("hiltest", *shlex.split(command), folder=folder, environment={**environment, "COLUMNS": "200"})


@pytest.mark.parametrize("seeds", ["", " --seeds 1..1"], ids=["run", "campaign"])
def test_it_is_of_the_same_firmware_and_rig_and_takes_no_place_of_the_judged_run(bench: Path, seeds: str) -> None:
    done = hiltest(
        bench, "run --rig mine.toml --firmware 'my lamp.elf' --poses level --label v2 --baseline base.json" + seeds
    )
    assert done.returncode == 0, done.stdout
    match = re.search(r"1 better; keep it: run its seeds, hiltest (.*), then hiltest (.*) TEXT$", done.stdout, re.M)
    assert match, done.stdout
    judged = {path: path.read_bytes() for path in (bench / "hil-out").rglob("*.json")}
    assert hiltest(bench, match[1]).returncode == 0
    updated = hiltest(bench, match[2] + " faster")
    assert (updated.returncode, updated.stdout.splitlines()[0]) == (0, "lamp.current: 2 -> 1"), updated.stderr
    assert {item: item.read_bytes() for item in judged} == judged
    assert json.loads((bench / "base.json").read_text())["history"][0]["name"] == "lamp.current"


def test_options_of_pytest_are_those_of_the_command() -> None:
    options = ["--hil-rig=a b.toml", "-k", "heading", "--hil-suite", "full", "--hil-seed=3", "--hil-calibration=c.json"]
    assert run_options(options) == "--rig 'a b.toml' --suite full --calibration c.json"
