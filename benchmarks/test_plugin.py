"""What the plugin costs a project that does not use it."""

from __future__ import annotations

import subprocess
import sys

from pytest_benchmark.fixture import BenchmarkFixture

from .conftest import Report

IMPORT = """
import pytest, time
start = time.perf_counter()
import hiltest.plugin
print(1e3 * (time.perf_counter() - start))
"""


def test_the_import_of_an_unused_plugin(benchmark: BenchmarkFixture, report: Report) -> None:
    spent_ms: list[float] = []

    def start_python() -> None:
        done = subprocess.run([sys.executable, "-c", IMPORT], capture_output=True, text=True, check=True)
        spent_ms.append(float(done.stdout))

    benchmark.pedantic(start_python, rounds=10, warmup_rounds=1)
    report("the plugin in a project that does not use it, beside pytest's own", min(spent_ms), "ms", "less than 20")
