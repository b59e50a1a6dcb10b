"""A library in C is used when it was built from the sources that are there, and never otherwise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.c_library import compiled, loaded

TEXT = "const char *source(void) { return HILTEST_SOURCE_SHA256; }\nint answer(void) { return %d; }\n"


@pytest.fixture(autouse=True)
def _compiler(require_tool: Callable[[str], object], monkeypatch: pytest.MonkeyPatch) -> None:
    require_tool("gcc")
    monkeypatch.setenv("CC", "gcc")


def test_a_library_of_another_source_is_not_loaded_and_a_new_one_is_in_the_same_process(tmp_path: Path) -> None:
    source, library = tmp_path / "answer.c", tmp_path / "answer.so"
    source.write_text(TEXT % 1)
    assert loaded(library, [source]) == (None, f"{library} was not built")
    assert compiled(library, [source]) == ""
    source.write_text(TEXT % 2)
    assert loaded(library, [source]) == (None, f"{library} was built from another answer.c")
    assert compiled(library, [source]) == ""
    found, reason = loaded(library, [source])
    assert found is not None, reason
    assert found.answer() == 2


def test_a_source_that_does_not_compile_leaves_no_older_library(tmp_path: Path) -> None:
    source, library = tmp_path / "answer.c", tmp_path / "answer.so"
    source.write_text(TEXT % 1)
    assert compiled(library, [source]) == ""
    source.write_text("int answer(")
    assert "the C compiler failed" in compiled(library, [source])
    assert [each.name for each in tmp_path.iterdir()] == ["answer.c"]


def test_what_is_no_library_is_a_reason(tmp_path: Path) -> None:
    source, library = tmp_path / "answer.c", tmp_path / "answer.so"
    source.write_text(TEXT % 1)
    assert compiled(library, [source]) == ""
    library.write_bytes(b"no ELF file, but " + library.read_bytes()[64:])
    found, reason = loaded(library, [source])
    assert found is None
    assert "cannot be loaded" in reason
