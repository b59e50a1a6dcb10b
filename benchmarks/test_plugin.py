"""What the plugin costs a project that does not use it."""

from __future__ import annotations

import resource
import subprocess
import sys
from itertools import cycle
from pathlib import Path
from statistics import median

from pytest_benchmark.fixture import BenchmarkFixture

from .conftest import Report

# Without Hypothesis, which is in no such project of itself: what it imports at the end of a run is most of its time.
PYTEST = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:hypothesispytest")
WITHOUT = (*PYTEST, "-p", "no:hiltest")


def processor_ms(command: tuple[str, ...], folder: Path) -> float:
    """Return the processor time of a command: what else the machine does is not in it."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


def test_a_pytest_run_with_the_plugin_and_without(benchmark: BenchmarkFixture, report: Report, tmp_path: Path) -> None:
    (tmp_path / "test_nothing.py").write_text("def test_nothing():\n    pass\n", encoding="utf-8")
    pairs: list[tuple[float, float]] = []
    orders = cycle([(PYTEST, WITHOUT), (WITHOUT, PYTEST)])

    def run_both() -> None:
        took_ms = {command: processor_ms(command, tmp_path) for command in next(orders)}
        pairs.append((took_ms[PYTEST], took_ms[WITHOUT]))

    benchmark.pedantic(run_both, rounds=20, warmup_rounds=1)
    measured = pairs[1:]  # the first pair compiled what it imported
    difference_ms = median(with_it - without for with_it, without in measured)
    report("the plugin in a pytest run that does not use it", difference_ms, "ms", "at most 25")
    report("that run, of one without the plugin", median(a / b for a, b in measured), "", "")
