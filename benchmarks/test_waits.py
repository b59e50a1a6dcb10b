"""How fast virtual time passes while firmware waits by polling."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.boards.bench import VirtualBench
from hiltest.rig import Rig
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Report

PROGRAMS = Path(__file__).parents[1] / "tests" / "virtual" / "programs"
FLAGS = (
    "-mcpu=cortex-m4", "-mthumb", "-O2", "-nostdlib", "-ffreestanding", "-Wl,--build-id=none",
    f"-Wl,-T,{PROGRAMS / 'flash.ld'}",
)  # fmt: skip
START_S = 0.5  # what programs set up first is not counted


@pytest.fixture
def build(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that compiles a program for the board; further arguments are flags of the compiler."""
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("arm-none-eabi-gcc is not installed")

    def compile_program(source: Path, *flags: str) -> Path:
        elf = tmp_path / f"{source.stem}.elf"
        sources = [str(PROGRAMS / "start.S"), str(source)]
        subprocess.run([compiler, *FLAGS, *flags, *sources, "-lgcc", "-o", str(elf)], check=True, timeout=60)
        return elf

    return compile_program


def _ratio(benchmark: BenchmarkFixture, board: VirtualK64F, run_s: float) -> float:
    board.run_until(START_S)
    began_s = board.time_s
    benchmark.pedantic(board.run_until, args=(began_s + run_s,), rounds=1)
    return (board.time_s - began_s) / benchmark.stats.stats.min


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize(
    ("program", "run_s", "aim"),
    [("nxp_hello_world", 100.0, 100.0), ("sdk_uart_polling", 100.0, 100.0), ("nxp_sensor_fusion", 2.0, 1.5)],
)
def test_foreign_firmware(
    benchmark: BenchmarkFixture, report: Report, rig: Rig, foreign_elf: Callable[[str], Path],
    program: str, run_s: float, aim: float,
) -> None:  # fmt: skip
    elf = foreign_elf(f"{program}.elf")
    ratio = _ratio(benchmark, VirtualBench(rig, firmware=elf).machine, run_s)
    report(f"{program}: virtual time against processor time", ratio, "x real time", f"at least {aim}")


@pytest.mark.benchmark(timer=time.process_time)
def test_polling_a_sensor_and_printing(
    benchmark: BenchmarkFixture, report: Report, rig: Rig, build: Callable[..., Path]
) -> None:
    machine = VirtualBench(rig, firmware=build(PROGRAMS / "polls_fxos8700.c")).machine
    ratio = _ratio(benchmark, machine, 2.0)
    assert machine.uart0.host_waiting > 1000
    report("FXOS8700CQ polled over I2C and printed", ratio, "x real time", "at least 2.0")


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize(
    ("name", "flags"),
    [
        ("asleep", ()),
        ("counting in a loop", ("-DCOUNTS",)),
        ("asleep, each overflow interrupts", ("-DINTERRUPTS",)),
    ],
)
def test_two_pulse_widths_at_24_khz(
    benchmark: BenchmarkFixture, report: Report, build: Callable[..., Path], name: str, flags: tuple[str, ...]
) -> None:
    board = VirtualK64F(build(PROGRAMS / "pulse_widths.c", *flags))
    report(f"two pulse widths at 24 kHz, {name}", _ratio(benchmark, board, 2.0), "x real time", "at least 1.0")
