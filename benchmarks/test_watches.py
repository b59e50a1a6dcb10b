"""What it costs to watch functions while firmware runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.boards.bench import VirtualBench
from hiltest.rig import Rig

from .conftest import Report

START_S, SLICE_S, PAIRS = 1.0, 0.25, 60
FUNCTIONS = (
    "fRunMagCalibration",
    "fUpdateMagCalibration4Slice",
    "fUpdateMagCalibration7Slice",
    "fUpdateMagCalibration10Slice",
    "fInvertMagCal",
    "fRun_9DOF_GBY_KALMAN",
    "fRun_6DOF_GY_KALMAN",
    "fRun_6DOF_GB_BASIC",
    "fFuseSensors",
    "iUpdateMagBuffer",
    "processMagData",
    "FXOS8700_ReadAccData",
    "FXOS8700_ReadMagData",
    "FXAS21002_Read",
    "fmatrixAeqInvA",
    "fEigenCompute10",
    "fComputeEigSlice",
    "feCompassNED",
    "f3DOFTiltNED",
    "fRunAccelCalibration",
    "fQuaternionFromRotationMatrix",
    "fRotationMatrixFromQuaternion",
)


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("functions", [FUNCTIONS, ("fEigenCompute10",)], ids=["22 functions", "one, never called"])
def test_watching(
    benchmark: BenchmarkFixture,
    report: Report,
    rig: Rig,
    foreign_elf: Callable[[str], Path],
    functions: tuple[str, ...],
) -> None:
    elf = foreign_elf("nxp_sensor_fusion.elf")
    plain, watched = (VirtualBench(rig, firmware=elf).machine for _ in range(2))
    for board in (plain, watched):
        board.run_until(START_S)
    watch = watched.watch_calls(functions)
    watched_s: list[float] = []
    plain_s: list[float] = []

    def run_plain() -> None:
        # Between the others, so that both meet the same machine.
        began = time.process_time()
        plain.run_until(plain.time_s + SLICE_S)
        plain_s.append(time.process_time() - began)

    def run_watched() -> None:
        began = time.process_time()
        watched.run_until(watched.time_s + SLICE_S)
        watched_s.append(time.process_time() - began)

    benchmark.pedantic(run_watched, setup=run_plain, rounds=PAIRS)
    calls = sum(len(watch.calls(function)) for function in functions)
    ratio = median(each / beside for each, beside in zip(watched_s, plain_s, strict=True))
    report(
        f"NXP's sensor fusion, {len(functions)} watched, {calls / watch.cycles * 120e6:.0f} calls a second",
        ratio,
        "x time",
        "at most 1.03",
    )
