"""The shipped ELF: built from these sources, byte for byte, and nothing in it that a bare board must not have."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware_stub"
SHIPPED = ROOT / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf"
MANIFEST = json.loads(SHIPPED.with_name("manifest.json").read_text())
FLASH = range(0x0000_0000, 0x0010_0000)
SRAM_L = range(0x1FFF_0000, 0x2000_0000)
SRAM_U = range(0x2000_0000, 0x2003_0000)


def load_script(name: str) -> ModuleType:
    """Import a script of the firmware folder, which is no package."""
    sys.path.insert(0, str(FIRMWARE))
    try:
        spec = importlib.util.spec_from_file_location(f"firmware_{name}", FIRMWARE / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(FIRMWARE))
    return module


def loadable(elf: Path) -> list[tuple[int, int, int, bytes]]:
    """Where each segment lies in flash and when running, its size in memory, and its bytes."""
    with elf.open("rb") as stream:
        segments = [segment for segment in ELFFile(stream).iter_segments() if segment["p_type"] == "PT_LOAD"]
        return [(part["p_paddr"], part["p_vaddr"], part["p_memsz"], part.data()) for part in segments]


@pytest.fixture(scope="module")
def symbols() -> dict[str, tuple[int, int]]:
    """Address and size by name."""
    with SHIPPED.open("rb") as stream:
        table = ELFFile(stream).get_section_by_name(".symtab")
        assert isinstance(table, SymbolTableSection)
        return {symbol.name: (symbol["st_value"] & ~1, symbol["st_size"]) for symbol in table.iter_symbols()}


@pytest.fixture(scope="module")
def rebuilt(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    """Build folder of the same sources at another place."""
    for tool in ("arm-none-eabi-gcc", "cmake"):
        require_tool(tool)
    folder = tmp_path_factory.mktemp("somewhere else")
    source = folder / "copied firmware"
    shutil.copytree(FIRMWARE, source, ignore=shutil.ignore_patterns("__pycache__"))
    build = load_script("build")
    build.compile_firmware(folder / "build", build.source_hash(source), source=source)
    return folder / "build"


def test_the_manifest_is_of_these_sources() -> None:
    assert MANIFEST["source_sha256"] == load_script("build").source_hash(), "run firmware_stub/build.py and commit"


def test_the_manifest_is_of_this_elf() -> None:
    assert MANIFEST["elf_sha256"] == hashlib.sha256(SHIPPED.read_bytes()).hexdigest()
    identity = f"{MANIFEST['source_sha256']}\n{MANIFEST['compiler']}\n"
    assert hashlib.sha256(identity.encode()).hexdigest().startswith(MANIFEST["build_id"])
    assert MANIFEST["build_id"].encode() in SHIPPED.read_bytes()


def test_a_changed_or_renamed_source_changes_the_hash(tmp_path: Path) -> None:
    source_hash = load_script("build").source_hash
    (tmp_path / "a.c").write_text("int a;\n")
    first = source_hash(tmp_path)
    (tmp_path / "a.c").write_text("int b;\n")
    second = source_hash(tmp_path)
    (tmp_path / "a.c").rename(tmp_path / "b.c")
    assert len({first, second, source_hash(tmp_path)}) == 3


def test_a_rebuild_elsewhere_gives_the_same_bytes(rebuilt: Path) -> None:
    assert loadable(rebuilt / SHIPPED.name) == loadable(SHIPPED)


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of the sources in a folder of the user's, who has a folder ``build/firmware`` there."""
    shutil.copytree(FIRMWARE, tmp_path / "firmware_stub", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "build" / "firmware").mkdir(parents=True)
    (tmp_path / "build" / "firmware" / "thesis.txt").write_text("the only copy")
    return tmp_path / "firmware_stub"


def run_build(sources: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, sources / "build.py", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)  # it takes seconds


def test_a_copy_is_built_without_touching_its_neighbours(copied: Path, require_tool: Callable[[str], str]) -> None:
    for tool in ("arm-none-eabi-gcc", "cmake"):
        require_tool(tool)
    files = {path for path in copied.parent.rglob("*") if path.is_file() and path.suffix != ".pyc"}
    out = copied.parent / "elf"
    done = run_build(copied, "--out", out)
    assert done.returncode == 0, done.stderr
    assert loadable(out / SHIPPED.name) == loadable(SHIPPED)
    after = {path for path in copied.parent.rglob("*") if path.is_file() and path.suffix != ".pyc"}
    assert after - files == {out / SHIPPED.name, out / "manifest.json"}
    assert files <= after


def test_a_copy_asks_where_its_elf_goes(copied: Path) -> None:
    done = run_build(copied)
    assert done.returncode == 2
    assert "outside hiltest's repository: say where the ELF goes, --out DIR" in done.stderr
    assert sorted(path.name for path in copied.parent.iterdir()) == ["build", "firmware_stub"]


@pytest.mark.parametrize("cache", [None, "CMAKE_HOME_DIRECTORY:INTERNAL=/another/project\n"])
def test_only_an_earlier_build_of_the_same_sources_is_removed(copied: Path, cache: str | None) -> None:
    build, script = copied.parent / "build" / "firmware", load_script("build")
    if cache is not None:
        (build / "CMakeCache.txt").write_text(cache)
    with pytest.raises(SystemExit, match=r"is no build of .* name another folder with --build"):
        script.remove_build(build, copied)
    assert (build / "thesis.txt").exists()
    (build / "CMakeCache.txt").write_text(f"# made by CMake\nCMAKE_HOME_DIRECTORY:INTERNAL={copied}\n")
    script.remove_build(build, copied)
    assert not build.exists()


def test_no_folder_of_a_machine_is_in_the_elf(rebuilt: Path) -> None:
    assert str(rebuilt.parent).encode() not in (rebuilt / SHIPPED.name).read_bytes()
    assert str(ROOT).encode() not in SHIPPED.read_bytes()


def test_the_stack_is_bounded_and_nothing_recurses(rebuilt: Path) -> None:
    depth = load_script("stack_check").stack_bytes(rebuilt)
    assert depth == MANIFEST["deepest_stack_bytes"]
    assert depth <= load_script("build").STACK_LIMIT_BYTES


def test_the_stack_check_sees_recursion_and_unknown_pointers() -> None:
    check = load_script("stack_check")
    frames = {"a": 8, "b": 16, "magnetometer_x": 100, "count_cycles": 24}
    assert check.deepest("a", frames, {"a": {"b"}, "b": {"memcpy"}}) == 8 + 16 + check.LIBRARY_BYTES
    assert check.deepest("count_cycles", frames, {"count_cycles": {"__indirect_call"}}) == 124
    with pytest.raises(check.StackError, match="a -> b -> a"):
        check.deepest("a", frames, {"a": {"b"}, "b": {"a"}})
    with pytest.raises(check.StackError, match="pointer"):
        check.deepest("b", frames, {"b": {"__indirect_call"}})


def test_every_segment_lies_in_one_memory_and_is_loaded_from_flash() -> None:
    for flash_address, address, size, data in loadable(SHIPPED):
        if data:
            assert flash_address in FLASH
            assert flash_address + len(data) - 1 in FLASH
        assert any(address in memory and address + size - 1 in memory for memory in (FLASH, SRAM_L, SRAM_U))


def test_the_flash_configuration_field_leaves_the_chip_unsecured() -> None:
    (field,) = [data for _, address, _, data in loadable(SHIPPED) if address == 0x400]
    assert field == bytes.fromhex("ffffffff ffffffff ffffffff feffffff")


def test_the_vector_table_starts_the_stack_at_the_top_and_points_into_flash(
    symbols: dict[str, tuple[int, int]],
) -> None:
    (table,) = [data for _, address, _, data in loadable(SHIPPED) if address == 0]
    stack, *entries = (int.from_bytes(table[i : i + 4], "little") for i in range(0, len(table), 4))
    assert stack == SRAM_U.stop
    assert len(entries) == 15 + 86  # exceptions of the core, interrupts of the MK64F12
    assert all(entry & 1 for entry in entries)
    supervisor_call = entries.pop(11 - 1)  # timed itself, so where timed code is
    assert supervisor_call & ~1 == symbols["SVC_Handler"][0]
    assert supervisor_call in SRAM_L
    assert all(entry in FLASH for entry in entries)


def test_calibrators_and_what_times_them_run_from_sram(symbols: dict[str, tuple[int, int]]) -> None:
    timing = ("count_cycles", "cycle_counter_read", "magnetometer_empty")
    assert all(symbols[name][0] in SRAM_L for name in ("magnetometer_direct", "magnetometer_iterative", *timing))
    steps = {name for name in symbols if name.endswith(("_stream_add", "_stream_remove", "_stream_report"))}
    assert {"direct_stream_add", "direct_stream_remove", "iterative_stream_add", "empty_stream_add"} <= steps
    assert all(symbols[name][0] in SRAM_L for name in {*steps, "count_step_cycles", "count_report_cycles"})
    # The linker puts a veneer beside code that calls too far: with none, fast code calls nothing in flash.
    assert [name for name, (address, _) in symbols.items() if name.endswith("_veneer") and address in SRAM_L] == []


def test_there_is_no_heap_and_no_double_arithmetic(symbols: dict[str, tuple[int, int]]) -> None:
    heap = {"malloc", "free", "realloc", "calloc", "_malloc_r", "_sbrk"}
    double = {"__aeabi_dadd", "__aeabi_dsub", "__aeabi_dmul", "__aeabi_ddiv", "__aeabi_f2d", "__aeabi_d2f"}
    assert (heap | double).isdisjoint(symbols)


def test_the_elf_stays_small_enough_to_ship() -> None:
    # Debug information included, nine tenths of it; a wheel holds it compressed, to less than half.
    assert SHIPPED.stat().st_size < 800_000
