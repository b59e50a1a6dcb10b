"""A library in C is used when it was built from the sources that are there; some compiler is there for every build."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import capstone
import pytest
from build import BuildBackendException, ProjectBuilder
from build.env import DefaultIsolatedEnv
from elftools.elf.elffile import ELFFile

from hiltest.virtual.core import c_library
from hiltest.virtual.core.c_library import ZIG_REQUIREMENT, build_requirements, compiled, loaded

ROOT = Path(__file__).parents[1]
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
    result, reason = loaded(library, [source])
    assert result is not None, reason
    assert result.answer() == 2


def test_a_source_that_does_not_compile_leaves_no_older_library(tmp_path: Path) -> None:
    source, library = tmp_path / "answer.c", tmp_path / "answer.so"
    source.write_text(TEXT % 1)
    assert compiled(library, [source]) == ""
    source.write_text("int answer(")
    assert "the C compiler failed" in compiled(library, [source])
    assert [path.name for path in tmp_path.iterdir()] == ["answer.c"]


def test_what_is_no_library_is_a_reason(tmp_path: Path) -> None:
    source, library = tmp_path / "answer.c", tmp_path / "answer.so"
    source.write_text(TEXT % 1)
    assert compiled(library, [source]) == ""
    library.write_bytes(b"no ELF file, but " + library.read_bytes()[64:])
    result, reason = loaded(library, [source])
    assert result is None
    assert "cannot be loaded" in reason


def test_a_build_needs_no_other_compiler_if_one_is_there() -> None:
    assert build_requirements() == []


@pytest.mark.parametrize(
    "broken",
    [
        pytest.param("no-such-compiler", id="missing"),
        pytest.param("gcc -nostdinc", id="without headers"),
        pytest.param("gcc -c", id="no linker"),
        pytest.param("gcc -Wl,--no-such-option", id="unfit linker"),
    ],
)
def test_a_build_asks_for_zig_if_the_compiler_does_not_work(monkeypatch: pytest.MonkeyPatch, broken: str) -> None:
    monkeypatch.setenv("CC", broken)
    assert build_requirements() == [ZIG_REQUIREMENT]


def test_a_build_asks_for_zig_if_there_is_no_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert build_requirements() == [ZIG_REQUIREMENT]


def test_a_compiler_of_another_name_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    gcc = shutil.which("gcc")
    monkeypatch.delenv("CC")
    (tmp_path / "clang").write_text(f'#!/bin/sh\nPATH={os.environ["PATH"]} exec {gcc} "$@"\n')
    (tmp_path / "clang").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert build_requirements() == []
    source = tmp_path / "answer.c"
    source.write_text(TEXT % 1)
    assert compiled(tmp_path / "answer.so", [source]) == ""


def test_a_change_of_a_header_makes_a_library_another_one(tmp_path: Path) -> None:
    header, source, library = tmp_path / "answer.h", tmp_path / "answer.c", tmp_path / "answer.so"
    header.write_text("#define ANSWER 1\n")
    source.write_text('#include "answer.h"\nint answer(void) { return ANSWER; }\n')
    assert compiled(library, [source, header]) == ""
    header.write_text("#define ANSWER 2\n")
    assert loaded(library, [source, header])[0] is None


def test_a_library_shows_only_the_functions_that_it_is_to_export(tmp_path: Path) -> None:
    source, library = tmp_path / "answer.c", tmp_path / "answer.so"
    source.write_text("int inner(int n) { return n + 1; }\nint answer_of(int n) { return inner(n); }\n")
    assert compiled(library, [source], exports="answer_*") == ""
    result, reason = loaded(library, [source])
    assert result is not None, reason
    assert result.answer_of(1) == 2
    assert not hasattr(result, "inner")


def test_a_library_with_an_undefined_function_is_not_built(tmp_path: Path) -> None:
    source = tmp_path / "answer.c"
    source.write_text("int elsewhere(void);\nint answer(void) { return elsewhere(); }\n")
    assert "elsewhere" in compiled(tmp_path / "answer.so", [source])


def test_without_any_compiler_the_reason_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    source = tmp_path / "answer.c"
    source.write_text(TEXT % 1)
    monkeypatch.setenv("CC", "")
    monkeypatch.setattr(c_library, "find_spec", lambda name: None)
    reason = compiled(tmp_path / "answer.so", [source])
    assert "gcc" in reason
    assert ZIG_REQUIREMENT in reason


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what a package is built from, so that a build changes nothing here."""
    copy = tmp_path_factory.mktemp("project")
    for name in ("src", "hil"):
        built = shutil.ignore_patterns("*.so", "_machine.py", "__pycache__")
        shutil.copytree(ROOT / name, copy / name, ignore=built)
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, copy)
    return copy


@pytest.fixture(scope="module")
def isolated() -> Iterator[DefaultIsolatedEnv]:
    """An environment as pip, build and tox make one for a build: with the build requirements alone."""
    with DefaultIsolatedEnv() as environment:
        environment.install(ProjectBuilder(ROOT).build_system_requires)
        yield environment


@pytest.mark.slow
def test_the_build_hook_asks_for_zig_only_if_there_is_no_compiler(
    monkeypatch: pytest.MonkeyPatch, project: Path, isolated: DefaultIsolatedEnv
) -> None:
    builder = ProjectBuilder.from_isolated_env(isolated, project)
    assert ZIG_REQUIREMENT not in builder.get_requires_for_build("wheel")
    monkeypatch.setenv("CC", "")
    for kind in ("wheel", "editable"):
        assert ZIG_REQUIREMENT in builder.get_requires_for_build(kind)
    assert ZIG_REQUIREMENT not in builder.get_requires_for_build("sdist")


@pytest.mark.slow
def test_a_build_without_isolation_and_compiler_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
    project: Path,
    isolated: DefaultIsolatedEnv,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("CC", "")
    with pytest.raises(BuildBackendException):
        ProjectBuilder.from_isolated_env(isolated, project).build("wheel", tmp_path)
    output = "".join(capfd.readouterr())
    assert "core in C was not built: there is no C compiler (CC is empty). Install one" in output
    assert "Traceback" not in output


@pytest.mark.ci
@pytest.mark.slow
def test_zig_builds_a_wheel_where_no_compiler_is_on_the_path(
    monkeypatch: pytest.MonkeyPatch, project: Path, tmp_path: Path
) -> None:
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.delenv("CC")
    with DefaultIsolatedEnv() as environment:
        builder = ProjectBuilder.from_isolated_env(environment, project)
        environment.install(builder.build_system_requires)
        environment.install(builder.get_requires_for_build("wheel"))
        wheel = Path(builder.build("wheel", tmp_path))
    assert wheel.name.endswith(f"-py3-none-linux_{platform.machine()}.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    code = "from hiltest.virtual.core.library import ffi, lib; print(lib.machine_create(False) != ffi.NULL)"
    outside = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": str(tmp_path / "site")}}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, **outside)
    assert result.stdout == "True\n", result.stderr
    assert not uses_avx(tmp_path / "site" / "hiltest" / "virtual" / "core" / "core.so")


def uses_avx(library: Path) -> bool:
    """Say whether code for x86-64 has instructions of AVX, which not all of these processors have: `v` begins them."""
    with library.open("rb") as file:
        elf = ELFFile(file)
        if elf.get_machine_arch() != "x64":
            return False
        code = elf.get_section_by_name(".text").data()
    decoder = capstone.Cs(capstone.CS_ARCH_X86, capstone.CS_MODE_64)
    decoder.skipdata = True
    return any(mnemonic.startswith("v") for _, _, mnemonic, _ in decoder.disasm_lite(code, 0))
