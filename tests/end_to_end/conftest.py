"""Runs of the real command, each in a folder of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ..finished_run import Finished, run_hiltest
from .firmware_edits import FirmwareCopy

RIGS = Path(__file__).parents[2] / "hil" / "rigs"


Run = Callable[..., Finished]


@pytest.fixture(scope="session")
def run_in() -> Run:
    """Return a function that runs ``hiltest run`` in a folder."""
    return run_hiltest


@pytest.fixture(scope="session")
def good_run(default_run: Finished) -> Finished:
    """The main job on the default bench."""
    return default_run


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
