"""How long a large run's page takes: 1 000 measurements, each of them worse than its baseline."""

from __future__ import annotations

import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.measurement import EXACT, Better, Limit, check
from hiltest.report.render import html_report
from hiltest.run_record.comparison import Change, Comparison, Difference, Side
from hiltest.run_record.run import Column, Environment, Findings, Run, Table, Verdict

from .conftest import Report

MEASUREMENTS = 1000
POSES = 60
CALIBRATORS = ("direct", "corrected", "iterative", "dpi")


def large_run() -> Run:
    found = Findings(Environment("bench", "Linux", "3.11", {}), "gate", "all", "2026-01-02T03:04:05Z")
    measurements = [
        check(f"family_{k % 25}.thing_{k}.quantity", 1.2345, unit="deg", limit=Limit(max=2), test="test_it.py::test_it")
        for k in range(MEASUREMENTS - len(CALIBRATORS))
    ] + [check(f"heading.{name}.max", 0.9, unit="deg", limit=Limit(max=1.8)) for name in CALIBRATORS]
    found.measurements.update((measurement.name, measurement) for measurement in measurements)
    columns = (Column("heading", "deg"), Column("level"), *(Column(f"error.{name}", "deg") for name in CALIBRATORS))
    rows = tuple((6.0 * pose, pose % 5 == 0, *(0.01 * pose for _ in CALIBRATORS)) for pose in range(POSES))
    found.tables["heading.poses"] = Table("heading.poses", columns, rows)
    side = Side("base.json", "", "firmware", "1", "0", "gcc", "m", "rig", (1,), "")
    found.comparison = Comparison(
        side,
        side,
        tuple(
            Difference(
                each.name,
                "deg",
                Change.WORSE,
                Better.LOWER,
                1.0,
                1.2345,
                0.2345,
                None,
                1,
                EXACT,
                each.limit,
                "pass",
                "",
            )
            for each in measurements
        ),
        (),
        "All of them got worse.",
    )
    return found.finish(Verdict("regression", 21, "All of them got worse.", True), "2026-01-02T03:05:00Z")


@pytest.mark.benchmark(timer=time.process_time)
def test_page_of_a_thousand_measurements(benchmark: BenchmarkFixture, report: Report) -> None:
    run = large_run()
    page = benchmark.pedantic(html_report, args=(run,), rounds=5, warmup_rounds=1)
    report("page of 1 000 measurements", benchmark.stats.stats.median, "s", "at most 3")
    report("its size", len(page.encode()) / 1e6, "MB", "at most 3")
