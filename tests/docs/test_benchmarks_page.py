"""The page about device cycles in pytest-benchmark: its commands and its suite do what it says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.boards import default_firmware

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
(COMMANDS,) = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
(TABLE,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
MODULES = {"hiltest": "hiltest", "pytest": "pytest", "pytest-benchmark": "pytest_benchmark"}


def run(command: str, folder: Path, **more: str) -> str:
    """Run one of the page's commands, with `more` in the environment, and return what it prints."""
    program, *arguments = shlex.split(command)
    if program == "cp":
        shutil.copy(*(folder / argument for argument in arguments))
        return ""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")} | more
    done = run_module(MODULES[program], *arguments, folder=folder, environment=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What each of the page's commands prints, one after the other in one folder."""
    folder = tmp_path_factory.mktemp("bench")
    shutil.copy(default_firmware(), folder / "new.elf")
    return [run(line, folder) for line in COMMANDS.splitlines()]


def rows(text: str) -> set[str]:
    return {" ".join(line.split()) for line in text.splitlines() if line.startswith("test_")}


def test_the_table_is_the_one_that_is_printed(printed: list[str]) -> None:
    assert {row.removesuffix(" 5") for row in rows(printed[2])} >= rows(TABLE)


def test_the_same_firmware_compares_as_the_same(printed: list[str]) -> None:
    *_, compared = printed
    assert "Name (time in cycles)" in compared
    assert "Name (time in s)" not in compared
    pairs = [line for line in compared.splitlines() if line.startswith("test_calibrator[direct-100]")]
    assert [line.split()[1:] for line in pairs] == [
        [f"({name})", "11,270.0000", "(1.0)", "11,270.0000", "(1.0)"] for name in ("new", "old")
    ]
