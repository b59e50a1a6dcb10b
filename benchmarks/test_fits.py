"""Direct fits a second: one after the other, many at once in numpy, and the kernel in C, on the same points."""

from __future__ import annotations

import time

import pytest

from hiltest.calibration import fit_direct
from hiltest.calibration.direct_batch import fit_quadrics
from hiltest.studies.instances import Model, kernel

from .conftest import Report

POINTS, INSTANCES, SINGLE, ROUNDS = 100, 2048, 128, 20


def test_fits_per_second(report: Report) -> None:
    in_c, reason = kernel()
    if in_c is None:
        pytest.skip(reason)
    points = in_c.points_ut(Model(1, POINTS, 2.5), 0, INSTANCES)
    ways = {
        "single": (lambda: [fit_direct(point) for point in points[:SINGLE]], SINGLE),
        "batch": (lambda: fit_quadrics(points), INSTANCES),
        "kernel": (lambda: in_c.fit_quadrics(points), INSTANCES),
    }
    fastest = dict.fromkeys(ways, 0.0)
    for _ in range(ROUNDS):  # in turns, so that all meet the same machine
        for name, (fit, fits) in ways.items():
            began = time.process_time()
            fit()
            fastest[name] = max(fastest[name], fits / (time.process_time() - began))
    what = f"direct, {POINTS} points"
    report(f"{what}: one after the other", fastest["single"], "fits/s", "")
    report(f"{what}: many at once in numpy, of that", fastest["batch"] / fastest["single"], "x", "at least 16")
    report(f"{what}: the kernel in C, of numpy", fastest["kernel"] / fastest["batch"], "x", "at least 8")
