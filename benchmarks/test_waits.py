"""How fast virtual time passes while firmware waits by polling."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.boards.bench import VirtualBench
from hiltest.rig import Rig
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import TEST_PROGRAMS, Build, Report

START_S = 0.5  # what programs set up first is not counted


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
    benchmark: BenchmarkFixture,
    report: Report,
    rig: Rig,
    foreign_elf: Callable[[str], Path],
    program: str,
    run_s: float,
    aim: float,
) -> None:
    elf = foreign_elf(f"{program}.elf")
    ratio = _ratio(benchmark, VirtualBench(rig, firmware=elf).machine, run_s)
    report(f"{program}: virtual time against processor time", ratio, "x real time", f"at least {aim}")


@pytest.mark.benchmark(timer=time.process_time)
def test_polling_a_sensor_and_printing(benchmark: BenchmarkFixture, report: Report, rig: Rig, build: Build) -> None:
    machine = VirtualBench(rig, firmware=build(TEST_PROGRAMS / "polls_fxos8700.c")).machine
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
    benchmark: BenchmarkFixture, report: Report, build: Build, name: str, flags: tuple[str, ...]
) -> None:
    board = VirtualK64F(build(TEST_PROGRAMS / "pulse_widths.c", *flags))
    report(f"two pulse widths at 24 kHz, {name}", _ratio(benchmark, board, 2.0), "x real time", "at least 1.0")
