"""How fast the virtual board computes, against the 120 MHz of the real one.

In processor time, which on a quiet machine is the time on the wall: other programs disturb it less.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.call_clock import CALL_HZ
from hiltest.virtual.part.part_file import load_part

from .conftest import Build, Report
from .kernel_loop import KernelLoop

COMPUTES = Path(__file__).parent / "programs" / "computes.c"
START_S, RUN_S = 0.01, 0.3  # of the 21 MHz that the core has out of reset


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize(
    ("kernel", "rounds"), [("magnetometer_direct", 400), ("magnetometer_iterative", 60)], ids=["direct", "iterative"]
)
def test_counting(benchmark: BenchmarkFixture, report: Report, kernel: str, rounds: int) -> None:
    loop = KernelLoop(kernel, rounds)
    cycles = benchmark.pedantic(loop.run, rounds=50, warmup_rounds=1)
    fastest_s, instructions = benchmark.stats.stats.min, loop.instructions / 51
    report(f"{kernel}: millions of instructions a second", instructions / fastest_s / 1e6, "MIPS", "at least 200")
    report(f"{kernel} against 120 MHz", cycles / CALL_HZ / fastest_s, "x real time", "at least 1.5")


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("part", ["mk64f12", "stm32f407"])
def test_counting_with_the_memories_of_a_part(benchmark: BenchmarkFixture, report: Report, part: str) -> None:
    plain = KernelLoop("magnetometer_direct", 400)
    loop = KernelLoop("magnetometer_direct", 400, load_part(part).timing(24_000_000))
    benchmark.pedantic(loop.run, rounds=50, warmup_rounds=1)
    began = time.process_time()
    for _ in range(50):
        plain.run()
    plain_s = (time.process_time() - began) / 50
    fastest_s, instructions = benchmark.stats.stats.min, loop.instructions / 51
    report(f"{part}: millions of instructions a second", instructions / fastest_s / 1e6, "MIPS", "at least 150")
    report(f"{part}: time, over that without memories", benchmark.stats.stats.mean / plain_s, "x", "at most 2")


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("work", ["integer", "load_store", "floating_point"])
def test_kinds_of_instructions(benchmark: BenchmarkFixture, report: Report, build: Build, work: str) -> None:
    board = VirtualK64F(build(COMPUTES, f"-DWORK={work}"))
    board.run_until(START_S)
    began = board.instructions
    benchmark.pedantic(lambda: board.run_until(board.time_s + RUN_S), rounds=50)
    instructions = (board.instructions - began) / 50
    fastest_s = benchmark.stats.stats.min
    report(f"{work}: millions of instructions a second", instructions / fastest_s / 1e6, "MIPS", "at least 200")
