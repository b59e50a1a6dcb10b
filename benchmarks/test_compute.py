"""How fast the virtual board computes, counting and not, against the 120 MHz of the real one.

In processor time, which on a quiet machine is the time on the wall: other programs disturb it less.
"""

from __future__ import annotations

import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.virtual.accounting import AccountingFactory, BlockAccounting
from hiltest.virtual.call_clock import CALL_HZ
from hiltest.virtual.native.accounting import NativeBlockAccounting
from hiltest.virtual.native.library import missing_because

from .conftest import Report
from .kernel_loop import KernelLoop, Uncounted

KERNELS = pytest.mark.parametrize(
    ("kernel", "rounds"), [("magnetometer_direct", 400), ("magnetometer_iterative", 60)], ids=["direct", "iterative"]
)
HOOKS = pytest.mark.parametrize("hook", [NativeBlockAccounting, BlockAccounting], ids=["in C", "in Python"])


@pytest.mark.benchmark(timer=time.process_time)
@KERNELS
@HOOKS
def test_counting(
    benchmark: BenchmarkFixture, report: Report, hook: AccountingFactory, kernel: str, rounds: int
) -> None:
    slow = hook is BlockAccounting
    if not slow and (reason := missing_because()):
        pytest.skip(reason)
    rounds = rounds // 10 if slow else rounds
    counted, uncounted = KernelLoop(kernel, rounds, hook), KernelLoop(kernel, rounds, Uncounted)
    uncounted_s = []

    def run_uncounted() -> None:
        # Between the counted ones, so that both meet the same machine.
        began = time.process_time()
        uncounted.run()
        uncounted_s.append(time.process_time() - began)

    cycles = benchmark.pedantic(counted.run, setup=run_uncounted, rounds=50, warmup_rounds=1)
    fastest_s = benchmark.stats.stats.min
    how = "in Python" if slow else "in C"
    aims = ("", "") if slow else ("at most 1.10", "at least 1.5")
    report(f"{kernel}: counting {how} against not counting", fastest_s / min(uncounted_s), "x time", aims[0])
    report(f"{kernel}: counting {how} against 120 MHz", cycles / CALL_HZ / fastest_s, "x real time", aims[1])
