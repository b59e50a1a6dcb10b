"""The page about runs that are gates: its commands are understood, and its options are the program's."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hiltest.session import GROUP
from hiltest.settings import OPTIONS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gate.md").read_text(encoding="utf-8")
(COMMANDS,) = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
SUITE = "def test_current(measure):\n    measure('lamp.current', 2.0, 'mA')\n"


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A bench of one's own with the page's files and a suite that takes no time."""
    for name in ("suites", "rigs", "baselines"):
        (tmp_path / "hil" / name).mkdir(parents=True)
    (tmp_path / "hil" / "suites" / "test_lamp.py").write_text(SUITE, encoding="utf-8")
    shutil.copy(ROOT / "hil" / "baselines" / "virtual-k64f.json", tmp_path / "hil" / "baselines")
    rig = (ROOT / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    (tmp_path / "hil" / "rigs" / "virtual-k64f.toml").write_text(rig[: rig.index("[limits]")], encoding="utf-8")
    for name in ("new.elf", "old.elf"):
        shutil.copy(ROOT / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf", tmp_path / name)
    return tmp_path


# The lamp is none of the baseline's measurements, which are all gone; the two firmwares are the same.
@pytest.mark.parametrize(("command", "code"), list(zip(COMMANDS.splitlines()[:2], (22, 0), strict=True)))
def test_the_commands_end_as_the_page_says(bench: Path, command: str, code: int) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    done = subprocess.run(
        [sys.executable, "-m", *shlex.split(command)], cwd=bench, env=environment, capture_output=True, text=True,
        check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr
    last = done.stdout.rstrip().splitlines()[-1]
    assert f"{'May' if code == 0 else 'Cannot say whether it may'} be merged (against hil" in last
    assert (bench / "hil-out" / "against" / "run.json").exists() == ("--against" in command)


def test_the_option_has_the_names_that_the_page_gives_it() -> None:
    (option,) = [each for each in OPTIONS if each.name == "baseline"]
    assert all(f"`{each}`" in PAGE for each in (option.flag, option.variable, option.ini))


def test_the_group_is_called_as_the_page_says() -> None:
    assert f"in the group `{GROUP}`" in PAGE
