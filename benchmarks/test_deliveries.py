"""Cost of recording the samples that sensors deliver, and of checking the firmware's answers against them."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

from pytest_benchmark.fixture import BenchmarkFixture

from .conftest import Report

ROUNDS = 12
RUN = "from hiltest.commands.cli import main; main(['run'])"
WITHOUT = """
from hiltest.boards.delivered_samples import DeliveredSamples
from hiltest.world.sensors.sampling import SampledOutput

DeliveredSamples.check = SampledOutput.deliver = lambda *_: None
"""


def run_main_job(folder: Path, before: str = "") -> float:
    """Run the default rig; return the processor time [s]."""
    began = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", before + RUN], cwd=folder, check=True, capture_output=True, timeout=120)
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return ended.ru_utime - began.ru_utime


def test_recording_delivered_samples(benchmark: BenchmarkFixture, report: Report, tmp_path: Path) -> None:
    checked_s, plain_s = list[float](), list[float]()

    def run_without() -> None:
        # Between the rounds, so that both meet the same machine.
        plain_s.append(run_main_job(tmp_path, WITHOUT))

    benchmark.pedantic(
        lambda: checked_s.append(run_main_job(tmp_path)), setup=run_without, rounds=ROUNDS, warmup_rounds=1
    )
    report("the main job with delivered samples recorded and checked", min(checked_s) / min(plain_s), "x time", "1.05")
