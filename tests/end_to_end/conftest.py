"""Runs of the real command, each in a folder of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from .firmware_edits import FirmwareCopy

RIGS = Path(__file__).parents[2] / "hil" / "rigs"


@dataclass(frozen=True, slots=True)
class Finished:
    """A command that has ended, and the record it left."""

    code: int
    output: str
    errors: str
    folder: Path

    @property
    def record(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads((self.folder / "run.json").read_text(encoding="utf-8"))
        return content

    @property
    def measured(self) -> dict[str, dict[str, Any]]:
        return {each["name"]: each for each in self.record["measurements"]}

    def value(self, name: str) -> float:
        return float(self.measured[name]["value"])

    @property
    def sentence(self) -> str:
        """The verdict of the record, which the output must have too, folded at the width of the terminal."""
        sentence: str = self.record["verdict"]["sentence"]
        assert " ".join(sentence.split()) in " ".join(self.output.split())
        return sentence


Run = Callable[..., Finished]


@pytest.fixture(scope="session")
def run_in() -> Run:
    """Return a function that runs ``hiltest run`` in a folder."""

    def run(folder: Path, *arguments: str) -> Finished:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
        done = subprocess.run(
            [sys.executable, "-m", "hiltest", "run", *arguments], cwd=folder, env=environment, capture_output=True,
            text=True, check=False, timeout=300,
        )
        return Finished(done.returncode, done.stdout, done.stderr, folder / "hil-out")

    return run


@pytest.fixture(scope="session")
def good_run(run_in: Run, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The main job on the default bench."""
    return run_in(tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="session")
def full_run(run_in: Run, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The full set of tests on the default bench."""
    return run_in(tmp_path_factory.mktemp("full"), "--suite", "full")


@pytest.fixture(scope="session")
def copy_of_the_firmware(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> FirmwareCopy:
    """The firmware's sources, to be built with an edit."""
    require_tool("arm-none-eabi-gcc")
    require_tool("cmake")
    return FirmwareCopy(tmp_path_factory.mktemp("firmware"))


@pytest.fixture
def edited(tmp_path: Path) -> Callable[..., str]:
    """Return a function that writes a changed copy of the default rig and returns its name."""

    def edit(*changes: tuple[str, str]) -> str:
        text = (RIGS / "virtual-k64f.toml").read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, f"{old!r} must stand once in the default rig"
            text = text.replace(old, new)
        (tmp_path / "edited.toml").write_text(text, encoding="utf-8")
        return "edited.toml"

    return edit
