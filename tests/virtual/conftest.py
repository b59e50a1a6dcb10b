"""Small programs for the virtual board, built with the cross compiler where there is one."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.virtual.accounting import AccountingFactory, BlockAccounting
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.native import CHOICE
from hiltest.virtual.native.accounting import NativeBlockAccounting
from hiltest.virtual.native.library import missing_because

HERE = Path(__file__).parent
PROGRAMS = HERE / "programs"
SHIPPED = Path(__file__).parents[2] / "src/hiltest/firmware/hiltest-frdm-k64f.elf"
FLAGS = [
    "-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O1", "-g", "-nostdlib",
    "-ffreestanding", "-Wl,--build-id=none", f"-Wl,-T,{PROGRAMS / 'flash.ld'}",
]  # fmt: skip

Build = Callable[..., Path]

# Fixtures that say what counts, so that HILTEST_BLOCK_HOOK changes nothing for a test that uses one.
HOOKS_BY_NAME = {"block_hook", "native_hook", "counting"}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Where the environment chooses the hook in Python, leave out the tests that choose for themselves."""
    if os.environ.get(CHOICE) != "python":
        return
    chosen = [item for item in items if HERE in item.path.parents and HOOKS_BY_NAME.intersection(item.fixturenames)]
    config.hook.pytest_deselected(items=chosen)
    items[:] = [item for item in items if item not in chosen]


@pytest.fixture
def build(tmp_path: Path, require_tool: Callable[[str], str]) -> Build:
    """Return a function that compiles sources (files in programs/, or text) into an ELF."""
    compiler = require_tool("arm-none-eabi-gcc")

    def compile_program(source: str | Path, *flags: str, with_start: bool = True) -> Path:
        path = source
        if isinstance(source, str):
            path = tmp_path / "program.S"
            path.write_text(source)
        elf = tmp_path / "program.elf"
        start = [str(PROGRAMS / "start.S")] if with_start else ["-Wl,-e,main"]
        command = [compiler, *FLAGS, *flags, *start, str(path), "-o", str(elf)]
        subprocess.run(command, check=True, timeout=60)
        return elf

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
def native_hook() -> AccountingFactory:
    """What counts in C; where it was not built, as `require_tool`."""
    if reason := missing_because():
        if os.environ.get("HILTEST_REQUIRE_TOOLS"):
            pytest.fail(f"{reason}, and HILTEST_REQUIRE_TOOLS is set", pytrace=False)
        pytest.skip(reason)
    return NativeBlockAccounting


@pytest.fixture(params=["python", "native"])
def block_hook(request: pytest.FixtureRequest) -> AccountingFactory:
    """Each of the two that count by block."""
    if request.param == "python":
        return BlockAccounting
    hook: AccountingFactory = request.getfixturevalue("native_hook")
    return hook


@pytest.fixture
def shipped_board() -> VirtualK64F:
    """The virtual board with the firmware that ships in the package."""
    return VirtualK64F(SHIPPED)
