"""The page about runs that are gates: its commands are understood, and its options are the program's."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.session.settings import OPTIONS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gate.md").read_text(encoding="utf-8")
FIRST, OWN = (block.splitlines() for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S))
SUITE = "def test_current(measure, board):\n    measure('lamp.current', 2.0, 'mA')\n"


def run(command: str, folder: Path) -> str:
    """Run a command of the page, which must end with 0; return what it printed, unfolded."""
    done = run_module(*shlex.split(command), folder=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return " ".join(done.stdout.split())


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """What the page's first command makes, and two ELF files."""
    run(FIRST[0], tmp_path)
    for name in ("new.elf", "old.elf"):
        shutil.copy(ROOT / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf", tmp_path / name)
    return tmp_path


@pytest.fixture
def quick(bench: Path) -> Path:
    """The same with a suite that takes no time, and a rig without limits, which it would not meet."""
    shutil.rmtree(bench / "hil" / "suites")
    (bench / "hil" / "suites").mkdir()
    (bench / "hil" / "suites" / "test_lamp.py").write_text(SUITE, encoding="utf-8")
    rig = bench / "hil" / "rigs" / "virtual-k64f.toml"
    text = rig.read_text(encoding="utf-8")
    rig.write_text(text[: text.index("[limits]")], encoding="utf-8")
    return bench


def test_a_fresh_folder_has_a_gate_from_the_first_minute(bench: Path) -> None:
    last = run(FIRST[1], bench)
    (answer,) = re.findall(r"\*(May be\smerged as far as the gate set shows.*)\*", PAGE)
    assert f"{answer} (against hil/baselines/virtual-k64f.json): PASS: " in last
    assert json.loads((bench / "hil-out" / "run.json").read_text(encoding="utf-8"))["comparison"]["obstacles"] == []


def test_two_firmwares_are_compared(quick: Path) -> None:
    assert "May be merged (against hil-out/against/run.json): " in run(FIRST[2], quick)
    assert (quick / "hil-out" / "against" / "run.json").exists()
    assert FIRST[3] == f"{FIRST[2]} --seeds 1..8"


def test_a_firmware_of_ones_own_gets_a_baseline_of_its_own(quick: Path) -> None:
    for command in OWN:
        last = run(command, quick)
    assert "May be merged (against hil/baselines/mine.json): " in last


def test_the_option_has_the_names_that_the_page_gives_it() -> None:
    (option,) = [option for option in OPTIONS if option.name == "baseline"]
    assert all(f"`{item}`" in PAGE for item in (option.flag, option.variable, option.ini))
