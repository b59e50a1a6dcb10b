"""The core's library and its binding are those of machine.h, need nothing else, and follow their sources."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cffi
import pytest
from elftools.elf.elffile import ELFFile

from hiltest.virtual.core.c_library import CORE, CORE_INTERFACE
from hiltest.virtual.core.library import ffi, lib

ROOT = Path(__file__).parents[3]


def declared_functions() -> set[str]:
    """Names of machine.h that are no constants."""
    return {name for name in dir(lib) if not isinstance(getattr(lib, name, None), int)}


def imported_by(code: str, *, path: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables, **({"PYTHONPATH": str(path)} if path else {})}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)


def test_a_memory_for_which_the_computer_has_none_left_is_a_lack_of_memory() -> None:
    code = (
        "import resource; from hiltest.virtual.core.machine import Machine; "
        "from hiltest.virtual.model.profile_file import load_profile; "
        "machine = Machine(load_profile('cortex-m4-trm/3')); "
        "resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30)); "
        "machine.add_memory(0, 1 << 31, writable=True)"
    )
    ended = imported_by(code)
    assert ended.stderr.splitlines()[-1].startswith("MemoryError: ")


def test_the_interface_is_plain_for_c_and_cffi() -> None:
    text = CORE_INTERFACE.read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if line.lstrip().startswith("#")] == []
    parsed = cffi.FFI()
    parsed.cdef(text)
    assert parsed.sizeof("struct core") == ffi.sizeof("struct core")
    assert parsed.list_types() == ffi.list_types()


def test_the_library_exports_the_functions_of_the_interface_and_no_others() -> None:
    with CORE.open("rb") as file:
        symbols = ELFFile(file).get_section_by_name(".dynsym").iter_symbols()
        exported = {symbol.name for symbol in symbols if symbol["st_shndx"] != "SHN_UNDEF" and symbol.name}
    assert len(exported) > 20
    assert exported == declared_functions()


def test_the_library_needs_only_the_c_library() -> None:
    assert ffi.dlopen(str(CORE), ffi.RTLD_NOW)  # with every symbol resolved
    with CORE.open("rb") as file:
        tags = list(ELFFile(file).get_section_by_name(".dynamic").iter_tags())
    needed = [tag.needed for tag in tags if tag.entry.d_tag == "DT_NEEDED"]
    assert [name for name in needed if not name.startswith(("libc.", "libm."))] == []


def test_a_machine_that_outlives_the_library_is_destroyed_all_the_same() -> None:
    # When Python ends, the order in which it drops modules and machines is anybody's guess.
    result = (
        "from hiltest.virtual.core.library import ffi, lib\n"
        "machine = ffi.gc(lib.machine_create(False), lib.machine_destroy)\n"
        "ffi.dlclose(lib)\n"
        "del machine\n"
    )
    assert imported_by(result).returncode == 0


def test_the_library_is_stripped() -> None:
    with CORE.open("rb") as file:
        assert ELFFile(file).get_section_by_name(".symtab") is None


def test_loading_the_library_parses_nothing() -> None:
    code = "import sys, hiltest.virtual.core.library; print({'cffi', 'pycparser'} & set(sys.modules))"
    result = imported_by(code)
    assert result.stdout == "set()\n", result.stderr


@pytest.fixture
def checkout(tmp_path: Path, require_tool: Callable[[str], object]) -> Path:
    """An editable install, with neither the library nor its binding built, and a core of one line."""
    require_tool("gcc")
    built = shutil.ignore_patterns("*.so", "_machine.py", "__pycache__")
    shutil.copytree(ROOT / "src" / "hiltest", tmp_path / "src" / "hiltest", ignore=built)
    core = tmp_path / "src" / "hiltest" / "virtual" / "core"
    for source in core.glob("*.c"):
        source.unlink()
    (core / "machine.c").write_text("int machine_answer(void) { return 42; }\n")
    shutil.copy(ROOT / "hatch_build.py", tmp_path)
    return tmp_path


LOAD = """
import sys
sys.modules["ziglang"] = None  # as where it is not installed: only CC says which compiler there is
from hiltest.errors import ConfigError
try:
    from hiltest.virtual.core.library import lib
    print(lib.EXCEPTION_SYSTICK)
except ConfigError as error:
    print(error)
"""


def test_an_editable_install_builds_the_library_anew_if_a_source_has_changed(checkout: Path) -> None:
    sources = checkout / "src"
    header = sources / "hiltest" / "virtual" / "core" / "machine.h"
    assert imported_by(LOAD, path=sources, CC="gcc").stdout == "15\n"
    assert imported_by(LOAD, path=sources, CC="").stdout == "15\n"
    text = header.read_text()
    header.write_text(text.replace("EXCEPTION_SYSTICK = 15", "EXCEPTION_SYSTICK = 1234"))
    stale = imported_by(LOAD, path=sources, CC="").stdout
    assert "no core for the virtual board" in stale
    assert f"pip install -e {checkout}" in stale
    assert imported_by(LOAD, path=sources, CC="gcc").stdout == "1234\n"
    header.with_name("machine.c").write_text("int machine_answer(")
    assert "the C compiler failed" in imported_by(LOAD, path=sources, CC="gcc").stdout


def test_an_installed_package_whose_library_is_missing_says_so_and_builds_none(checkout: Path) -> None:
    (checkout / "hatch_build.py").unlink()
    output = imported_by(LOAD, path=checkout / "src", CC="gcc").stdout
    assert "core.so was not built. Install hiltest again" in output
    assert not list(checkout.rglob("core.so"))
