"""How fast a log of a magnetometer is read."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.interfaces.sensor_files.parsed_lines import Lines
from hiltest.log_fitting import read_samples

from .conftest import Report

ROWS = 100_000


@pytest.mark.benchmark(timer=time.process_time)
def test_reading_a_plain_table(benchmark: BenchmarkFixture, report: Report, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    points = 40.0 * np.random.default_rng(1).normal(size=(ROWS, 3))
    np.savetxt(path, points, "%.4f", ",", header="mx,my,mz", comments="")

    read = benchmark.pedantic(read_samples, args=(path,), rounds=10, warmup_rounds=1)
    before = time.process_time()
    by_numpy = np.loadtxt(path, delimiter=",", skiprows=1)
    numpy_s = time.process_time() - before
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Lines, "ahead", lambda _: b"")
        before = time.process_time()
        read_samples(path)
        line_by_line_s = time.process_time() - before
    assert (read.points == by_numpy).all()
    took_s = benchmark.stats.stats.min
    report("logs: reading a plain table, of numpy.loadtxt's time", took_s / numpy_s, "", "at most 2")
    report("logs: reading a plain table, of the time line by line", took_s / line_by_line_s, "", "at most 0.2")
