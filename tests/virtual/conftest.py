"""Small programs for the virtual board, built with the cross compiler where there is one."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

HERE = Path(__file__).parent
PROGRAMS = HERE / "programs"
SHIPPED = Path(__file__).parents[2] / "src/hiltest/firmware/hiltest-frdm-k64f.elf"
FLAGS = [
    "-mcpu=cortex-m4",
    "-mthumb",
    "-mfpu=fpv4-sp-d16",
    "-mfloat-abi=hard",
    "-O1",
    "-g",
    "-nostdlib",
    "-ffreestanding",
    "-Wl,--build-id=none",
    f"-Wl,-T,{PROGRAMS / 'flash.ld'}",
    "-include",
    str(PROGRAMS / "prelude.h"),
]

Build = Callable[..., Path]


def word(board: VirtualK64F, name: str) -> int:
    """Read a variable of the program that a board runs."""
    return board.processor.memory.read_words(board.image.symbols[name].address, 1)[0]


def follow(board: VirtualK64F, course: dict[float, dict[str, int]]) -> None:
    """Run a board to one time after the other; at each, variables of its program must have these values."""
    for until_s, values in course.items():
        board.run_until(until_s)
        assert {name: word(board, name) for name in values} == values, f"at {until_s} s"


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, ...], Path]:
    """Programs that a test has built already, by their source and flags."""
    return {("",): tmp_path_factory.mktemp("built")}


@pytest.fixture
def build(tmp_path: Path, built: dict[tuple[str, ...], Path], require_tool: Callable[[str], str]) -> Build:
    """Return a function that compiles sources (files in programs/, or text) into an ELF."""
    compiler = require_tool("arm-none-eabi-gcc")

    def compile_program(source: str | Path, *flags: str, with_start: bool = True) -> Path:
        path = source
        if isinstance(source, str):
            path = tmp_path / "program.S"
            path.write_text(source)
        start = [str(PROGRAMS / "start.S")] if with_start else ["-Wl,-e,main"]
        command = [compiler, *FLAGS, *flags, *start]
        key = (Path(path).name, Path(path).read_text(), *command)
        if key not in built:
            elf = built["",] / f"program-{len(built)}.elf"
            subprocess.run([*command, str(path), "-o", str(elf)], check=True, timeout=60)
            built[key] = elf
        return built[key]

    return compile_program


@pytest.fixture
def build_c(tmp_path: Path, build: Build) -> Build:
    """Return a function that compiles the text of a C program into an ELF."""

    def compile_text(source: str, *flags: str) -> Path:
        path = tmp_path / "program.c"
        path.write_text(source)
        return build(path, *flags)

    return compile_text


@pytest.fixture
def shipped_board() -> VirtualK64F:
    """The virtual board with the firmware that ships in the package."""
    return VirtualK64F(SHIPPED)
