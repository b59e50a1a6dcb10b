"""The shipped ELFs: built from these sources, byte for byte, and nothing in them that a bare board must not have."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from hiltest.virtual.processor.stack_bounds import NoBound, StackBounds
from hiltest.virtual.program.elf import load_image

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware_stub"
SHIPPED = ROOT / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf"
OUTPUTS = ("lines", "packets", "lis3mdl", "fxos8700cq", "stm32f411")
COMPASSES = [SHIPPED.with_name(f"compass-{output}.elf") for output in OUTPUTS]
MANIFESTS = {SHIPPED: SHIPPED.with_name("manifest.json"), **{elf: elf.with_suffix(".json") for elf in COMPASSES}}
DISCO = SHIPPED.with_name("compass-stm32f411.elf")
FLASH = range(0x0000_0000, 0x0010_0000)
SRAM_L = range(0x1FFF_0000, 0x2000_0000)
SRAM_U = range(0x2000_0000, 0x2003_0000)
DISCO_CODE = range(0x0800_0000, 0x0806_0000)  # without sector 7, which keeps the calibration
DISCO_SRAM = range(0x2000_0000, 0x2002_0000)


def load_script(name: str) -> ModuleType:
    """Import a script of the firmware folder, which is no package."""
    sys.path.insert(0, str(FIRMWARE))
    try:
        spec = importlib.util.spec_from_file_location(f"firmware_{name}", FIRMWARE / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # where dataclasses look for it
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(FIRMWARE))
    return module


def loadable(elf: Path) -> list[tuple[int, int, int, bytes]]:
    """Where each segment lies in flash and when running, its size in memory, and its bytes."""
    with elf.open("rb") as stream:
        segments = [segment for segment in ELFFile(stream).iter_segments() if segment["p_type"] == "PT_LOAD"]
        return [(part["p_paddr"], part["p_vaddr"], part["p_memsz"], part.data()) for part in segments]


def manifest_of(elf: Path) -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads(MANIFESTS[elf].read_text())
    return manifest


def symbols_of(elf: Path) -> dict[str, tuple[int, int]]:
    """Address and size by name."""
    with elf.open("rb") as stream:
        table = ELFFile(stream).get_section_by_name(".symtab")
        assert isinstance(table, SymbolTableSection)
        return {symbol.name: (symbol["st_value"] & ~1, symbol["st_size"]) for symbol in table.iter_symbols()}


@pytest.fixture(scope="module")
def symbols() -> dict[str, tuple[int, int]]:
    return symbols_of(SHIPPED)


@pytest.fixture(params=MANIFESTS, ids=lambda elf: elf.stem)
def shipped(request: pytest.FixtureRequest) -> Path:
    """Each of the ELFs that ship."""
    elf: Path = request.param
    return elf


def files_of(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc"}


def run_build(sources: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, sources / "build.py", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)  # it takes seconds


@pytest.fixture(scope="module")
def rebuilt(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    """Build folder of a copy of the sources; beside it are those of the compass and, in `elf`, what was built."""
    for tool in ("arm-none-eabi-gcc", "cmake"):
        require_tool(tool)
    folder = tmp_path_factory.mktemp("build of a copy")
    sources = copy_sources(tmp_path_factory.mktemp("somewhere else"))
    before = files_of(sources.parent)
    done = run_build(sources, "--build", folder / "build", "--out", folder / "elf")
    assert done.returncode == 0, done.stderr
    assert files_of(sources.parent) == before, "it touches its neighbours"
    shutil.move(folder / "build" / "compass", folder / "compass")  # its stack is not the firmware's
    return folder / "build"


def build_folder(rebuilt: Path, shipped: Path) -> Path:
    """Where an ELF was built."""
    return rebuilt if shipped == SHIPPED else rebuilt.with_name("compass")


def copy_sources(folder: Path) -> Path:
    """Copy the sources into a folder of the user's, who has a folder ``build/firmware`` there."""
    shutil.copytree(FIRMWARE, folder / "firmware_stub", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "build" / "firmware").mkdir(parents=True)
    (folder / "build" / "firmware" / "thesis.txt").write_text("the only copy")
    return folder / "firmware_stub"


def test_the_manifest_is_of_these_sources(shipped: Path) -> None:
    digest = load_script("build").source_hash(compass=shipped != SHIPPED)
    assert manifest_of(shipped)["source_sha256"] == digest, "run firmware_stub/build.py and commit"


def test_the_manifest_is_of_this_elf(shipped: Path) -> None:
    manifest = manifest_of(shipped)
    assert manifest["elf_sha256"] == hashlib.sha256(shipped.read_bytes()).hexdigest()
    identity = f"{manifest['source_sha256']}\n{manifest['compiler']}\n" + f"{shipped.stem}\n" * (shipped != SHIPPED)
    assert hashlib.sha256(identity.encode()).hexdigest().startswith(manifest["build_id"])
    with shipped.open("rb") as stream:
        (note,) = ELFFile(stream).get_section_by_name(".note.gnu.build-id").iter_notes()
    assert note["n_desc"] == manifest["build_id"]


def test_the_firmwares_build_says_its_own_name() -> None:
    assert manifest_of(SHIPPED)["build_id"].encode() in SHIPPED.read_bytes()


def test_the_compass_is_no_source_of_the_firmware_but_the_firmware_is_of_the_compass(tmp_path: Path) -> None:
    source_hash = load_script("build").source_hash
    (tmp_path / "compass").mkdir()
    (tmp_path / "a.c").write_text("int a;\n")
    before = source_hash(tmp_path), source_hash(tmp_path, compass=True)
    (tmp_path / "compass" / "main.c").write_text("int b;\n")
    assert source_hash(tmp_path) == before[0]
    assert source_hash(tmp_path, compass=True) != before[1]
    (tmp_path / "a.c").write_text("int c;\n")
    assert source_hash(tmp_path, compass=True) not in before


def test_a_changed_or_renamed_source_changes_the_hash(tmp_path: Path) -> None:
    source_hash = load_script("build").source_hash
    (tmp_path / "a.c").write_text("int a;\n")
    first = source_hash(tmp_path)
    (tmp_path / "a.c").write_text("int b;\n")
    second = source_hash(tmp_path)
    (tmp_path / "a.c").rename(tmp_path / "b.c")
    assert len({first, second, source_hash(tmp_path)}) == 3


def test_a_rebuild_elsewhere_gives_the_same_bytes(rebuilt: Path, shipped: Path) -> None:
    assert loadable(build_folder(rebuilt, shipped) / shipped.name) == loadable(shipped)


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    return copy_sources(tmp_path)


def test_a_copy_puts_elfs_and_manifests_where_it_is_told(rebuilt: Path) -> None:
    out = rebuilt.with_name("elf")
    assert files_of(out) == {out / path.name for pair in MANIFESTS.items() for path in pair}
    assert all(loadable(out / elf.name) == loadable(elf) for elf in MANIFESTS)


def test_a_copy_that_is_told_no_build_folder_builds_in_one_that_is_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    script, folders = load_script("build"), list[Path]()
    monkeypatch.setattr(script, "install", lambda build, _out: folders.append(build) if build.is_dir() else None)
    monkeypatch.setattr(script, "require", lambda *_tools: None)
    monkeypatch.setattr(script, "IN_REPOSITORY", False)
    monkeypatch.setattr(sys, "argv", ["build.py", "--out", "elf"])
    script.main()
    (folder,) = folders
    assert not folder.exists()


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


def test_no_folder_of_a_machine_is_in_the_elf(rebuilt: Path, shipped: Path) -> None:
    assert str(rebuilt.parent).encode() not in (build_folder(rebuilt, shipped) / shipped.name).read_bytes()
    assert str(ROOT).encode() not in shipped.read_bytes()


def test_the_stack_is_bounded_and_nothing_recurses(rebuilt: Path, shipped: Path) -> None:
    depth = load_script("stack_check").stack_bytes(build_folder(rebuilt, shipped))
    assert depth == manifest_of(shipped)["deepest_stack_bytes"]
    assert depth <= load_script("build").STACK_LIMIT_BYTES


def test_the_stack_check_is_never_below_what_the_code_itself_can_take(rebuilt: Path, shipped: Path) -> None:
    """Of frames that compilers list, of those of assembly and libraries in its tables, and of what both add up to."""
    check = load_script("stack_check")
    frames, calls = check.read_call_graph(build_folder(rebuilt, shipped))
    image = load_image(shipped)
    bounds, below, judged = StackBounds(image), {}, 0
    for name in {*frames, *(target for targets in calls.values() for target in targets)} & image.symbols.keys():
        with contextlib.suppress(NoBound):
            bound, summed = bounds.bound(image.symbols[name].address), check.deepest(name, frames, calls)
            below.update({name: (summed, bound)} if summed < bound else {})
            judged += 1
    # It jumps to C from assembly, which no call graph has; what a fault leaves is not in the sum.
    assert set(below) <= {"Fault_Handler"}
    # Functions that wait, and those that time others, call through pointers.
    assert judged > len(frames.keys() & image.symbols.keys()) / 3


def test_the_stack_check_sees_recursion_and_unknown_pointers() -> None:
    check = load_script("stack_check")
    frames = {"a": 8, "b": 16, "magnetometer_x": 100, "count_cycles": 24}
    assert check.deepest("a", frames, {"a": {"b"}, "b": {"memcpy"}}) == 8 + 16 + check.LIBRARY_BYTES
    assert check.deepest("count_cycles", frames, {"count_cycles": {"__indirect_call"}}) == 124
    with pytest.raises(check.StackError, match="a -> b -> a"):
        check.deepest("a", frames, {"a": {"b"}, "b": {"a"}})
    with pytest.raises(check.StackError, match="pointer"):
        check.deepest("b", frames, {"b": {"__indirect_call"}})


def test_every_segment_lies_in_one_memory_and_is_loaded_from_flash(shipped: Path) -> None:
    flash, *memories = (DISCO_CODE, DISCO_SRAM) if shipped == DISCO else (FLASH, SRAM_L, SRAM_U)
    for flash_address, address, size, data in loadable(shipped):
        if data:
            assert flash_address in flash
            assert flash_address + len(data) - 1 in flash
        assert any(address in memory and address + size - 1 in memory for memory in (flash, *memories))


@pytest.mark.parametrize("shipped", [elf for elf in MANIFESTS if elf != DISCO], ids=lambda elf: elf.stem)
def test_the_flash_configuration_field_leaves_the_chip_unsecured(shipped: Path) -> None:
    (field,) = [data for _, address, _, data in loadable(shipped) if address == 0x400]
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


def test_the_discoverys_vector_table_has_an_entry_for_each_of_its_interrupts() -> None:
    address, size = symbols_of(DISCO)["vector_table"]
    assert address == DISCO_CODE.start
    (segment,) = [data for _, begin, _, data in loadable(DISCO) if begin == address]
    stack, *entries = (int.from_bytes(segment[i : i + 4], "little") for i in range(0, size, 4))
    assert stack == DISCO_SRAM.stop
    assert len(entries) == 15 + 86  # exceptions of the core, interrupts of the STM32F411
    assert all(entry & 1 and entry in DISCO_CODE for entry in entries)
    handlers = {symbols_of(DISCO)[name][0]: name for name in symbols_of(DISCO) if name.endswith("_Handler")}
    named = {number - 15: handlers[entry & ~1] for number, entry in enumerate(entries) if number >= 15}
    # Numbers: stm32f411xe.h of STMicroelectronics/cmsis_device_f4 @ cdbad761, IRQn_Type.
    assert {number: name for number, name in named.items() if name != "Fault_Handler"} == {
        8: "EXTI2_Handler",
        17: "DMA1_Stream6_Handler",
        28: "TIM2_Handler",
        31: "I2C1_Event_Handler",
        32: "I2C1_Error_Handler",
        38: "USART2_Handler",
    }


def test_there_is_no_heap_and_no_double_arithmetic(shipped: Path) -> None:
    heap = {"malloc", "free", "realloc", "calloc", "_malloc_r", "_sbrk"}
    double = {"__aeabi_dadd", "__aeabi_dsub", "__aeabi_dmul", "__aeabi_ddiv", "__aeabi_f2d", "__aeabi_d2f"}
    assert (heap | double).isdisjoint(symbols_of(shipped))


def test_the_elf_stays_small_enough_to_ship(shipped: Path) -> None:
    # Debug information included, nine tenths of it; a wheel holds it compressed, to less than half.
    assert shipped.stat().st_size < (800_000 if shipped == SHIPPED else 300_000)


def test_where_the_passes_run_out_the_last_choice_of_places_is_what_is_assembled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, require_tool: Callable[[str], str]
) -> None:
    compiler = require_tool("arm-none-eabi-gcc")
    place, assembly, object_file = load_script("place"), tmp_path / "kernel.s", tmp_path / "kernel.o"
    monkeypatch.setattr(place, "PASSES", 1)
    code = "\t.syntax unified\n\t.thumb\n\t.section .fast_code\n\tmovs\tr0, #1\n\tvadd.f32\ts0, s0, s0\n"
    assembly.write_text(code)
    machine = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
    place.place(assembly, [compiler, *machine, "-c", str(assembly), "-o", str(object_file)])
    with object_file.open("rb") as stream:
        section = ELFFile(stream).get_section_by_name(".fast_code")
        assert section is not None
        assert section.data() == bytes.fromhex("5ff00100 30ee000a")  # MOVS.W R0, #1, and VADD at a word
