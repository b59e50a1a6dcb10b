"""Tests of programs that others wrote are skipped if the program is missing, and never fail for that."""

from __future__ import annotations

from pathlib import Path

import pytest

from .foreign_elf import foreign_elf


@pytest.mark.parametrize("folder", ["", "missing", "."])
def test_a_missing_program_skips_its_test_even_if_tools_are_required(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HILTEST_REQUIRE_TOOLS", "1")
    monkeypatch.setenv("HILTEST_PROGRAMS", folder and str(tmp_path / folder))
    with pytest.raises(pytest.skip.Exception, match=r"z_hello\.elf"):
        foreign_elf("z_hello.elf")
    (tmp_path / "z_hello.elf").touch()
    if folder == ".":
        assert foreign_elf("z_hello.elf") == tmp_path / "z_hello.elf"
