"""What the benchmarks share: a list of ratios, printed at the end beside what was aimed at."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from hiltest.rig import Rig
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig


@dataclass(frozen=True, slots=True)
class Figure:
    """One result, and what it should be."""

    what: str
    value: float
    unit: str
    aim: str


FIGURES = pytest.StashKey[list[Figure]]()
Report = Callable[[str, float, str, str], None]
Build = Callable[..., Path]

TEST_PROGRAMS = Path(__file__).parents[1] / "tests" / "virtual" / "programs"
FLAGS = (
    "-mcpu=cortex-m4",
    "-mfpu=fpv4-sp-d16",
    "-mfloat-abi=hard",
    "-mthumb",
    "-O2",
    "-fno-math-errno",
    "-nostdlib",
    "-ffreestanding",
    "-Wl,--build-id=none",
    f"-Wl,-T,{TEST_PROGRAMS / 'flash.ld'}",
    "-include",
    str(TEST_PROGRAMS / "prelude.h"),
)


def pytest_configure(config: pytest.Config) -> None:
    config.stash[FIGURES] = []


@pytest.fixture
def report(request: pytest.FixtureRequest) -> Report:
    """Return a function that keeps a figure: what, value, unit, aim. Nothing is asserted: machines are noisy."""
    figures = request.config.stash[FIGURES]
    return lambda what, value, unit, aim: figures.append(Figure(what, value, unit, aim))


@pytest.fixture(scope="session")
def rig() -> Rig:
    """The default rig."""
    return load_rig(shipped() / "rigs" / "virtual-k64f.toml")


@pytest.fixture
def build(tmp_path: Path) -> Build:
    """Return a function that compiles a program for the board: its source, and more flags of the compiler."""
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("arm-none-eabi-gcc is not installed")

    def compile_program(source: Path, *flags: str) -> Path:
        elf = tmp_path / f"{source.stem}.elf"
        sources = [str(TEST_PROGRAMS / "start.S"), str(source)]
        subprocess.run([compiler, *FLAGS, *flags, *sources, "-lgcc", "-o", str(elf)], check=True, timeout=60)
        return elf

    return compile_program


@pytest.fixture(scope="session")
def foreign_elf() -> Callable[[str], Path]:
    """Return a function that takes a program from the folder that HILTEST_PROGRAMS names, or skips the benchmark."""

    def find(name: str) -> Path:
        folder = os.environ.get("HILTEST_PROGRAMS")
        if not folder or not (path := Path(folder, name)).is_file():
            pytest.skip(f"HILTEST_PROGRAMS names no folder with {name}")
        return path

    return find


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    figures = config.stash[FIGURES]
    if not figures:
        return
    terminalreporter.section("figures of this run")
    busy = f"{os.getloadavg()[0]:.1f} processes on {os.cpu_count()} processors"
    terminalreporter.write_line(f"load {busy}")
    for figure in figures:
        terminalreporter.write_line(f"{figure.what:<72} {figure.value:8.3f} {figure.unit:<14} {figure.aim}")
