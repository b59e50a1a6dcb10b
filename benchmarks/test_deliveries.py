"""Cost of recording the samples that sensors deliver, and of checking the firmware's answers against them."""

from __future__ import annotations

import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.boards import open_board
from hiltest.boards.delivered_samples import DeliveredSamples
from hiltest.procedures import (
    UNCALIBRATED,
    UNCALIBRATED_SLOT,
    collect_tumble,
    measure_cycles,
    measure_known_angles,
    open_turntable,
    run_calibrators,
)
from hiltest.rig import Rig
from hiltest.world.sensors.sampling import SampledOutput

from .conftest import Report

ROUNDS = 8


def main_job(rig: Rig) -> float:
    """Tumble the board, run every calibrator, and measure all known angles; return the processor time [s]."""
    began_s = time.process_time()
    with open_board(rig) as board:
        table = open_turntable(board, uncertainty_deg=0.1, prompt=input, tumble_s=rig.turntable.tumble_s)
        tumble = collect_tumble(board, table, points=rig.procedure.tumble_points)
        n = rig.procedure.calibration_points
        measure_cycles(board, board.identity.calibrators, n=n)
        runs = run_calibrators(board, tumble, calibrators=board.identity.calibrators, n=n)
        slots = {UNCALIBRATED: UNCALIBRATED_SLOT} | {name: run.slot for name, run in runs.items() if run.usable}
        poses = rig.procedure.known_angle_poses("all")
        measure_known_angles(board, table, poses=poses, slots=slots, mounting_yaw_deg=1.7)
    return time.process_time() - began_s


def test_recording_delivered_samples(
    benchmark: BenchmarkFixture, report: Report, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked_s, recorded_s, plain_s = list[float](), list[float](), list[float]()

    def run_others() -> None:
        # Between the rounds, so that all meet the same machine.
        with monkeypatch.context() as patch:
            patch.setattr(DeliveredSamples, "check", lambda *_: None)
            recorded_s.append(main_job(rig))
            patch.setattr(SampledOutput, "deliver", lambda *_: None)
            plain_s.append(main_job(rig))

    benchmark.pedantic(lambda: checked_s.append(main_job(rig)), setup=run_others, rounds=ROUNDS, warmup_rounds=1)
    plain = min(plain_s)
    report("the main job with its delivered samples recorded", min(recorded_s) / plain, "x time", "at most 1.05")
    report("the main job with these samples recorded and checked", min(checked_s) / plain, "x time", "")
