"""Programs that others wrote, for tests: none of them is in the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def foreign_elf(name: str) -> Path:
    """Return an ELF file of the folder that HILTEST_PROGRAMS names; if there is none, skip the test.

    HILTEST_REQUIRE_TOOLS does not change that: no package has these programs.
    """
    folder = os.environ.get("HILTEST_PROGRAMS")
    if not folder or not (path := Path(folder, name).resolve()).is_file():
        pytest.skip(f"HILTEST_PROGRAMS names no folder with {name}")
    return path
