"""Records of runs, written by hand."""

from __future__ import annotations

from hiltest.measurement import Measurement
from hiltest.run_record.comparison import Revision
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import BoardRecord, Environment, Findings, RigRecord, Run, SensorRecord, TestResult
from hiltest.verdict.verdict import decide

from .entries import MODEL


def finished_run(
    day: int,
    *measurements: Measurement,
    build: str = "0123456789abcdef",
    seed: int = 1,
    model: str = MODEL,
    firmware: str = "hiltest-frdm-k64f",
    hour: int = 0,
    revision: Revision | None = None,
) -> Run:
    """Return a run of a day in January."""
    board = BoardRecord(
        kind="virtual",
        description="virtual FRDM-K64F",
        firmware=firmware,
        version="0.1.0",
        protocol_version=4,
        build_id=build,
        unique_id="00" * 16,
        firmware_sha256="ab" * 32,
        compiler="GCC 12.2.1",
        placement="sram",
        core_clock_hz=120_000_000,
        cycle_model=model,
        clock="virtual",
        calibrators=("direct",),
        sensors=(SensorRecord("MAG3110", "magnetometer", 1, 0x0E, present=True, selected=True),),
    )
    findings = Findings(
        Environment("bench", "Linux", "3.11.2", {"hiltest": "0.1.0"}),
        "gate",
        "all",
        f"2026-01-{day:02d}T{hour:02d}:00:00Z",
        seed=seed,
        board=board,
        revision=revision,
        rig=RigRecord("virtual-k64f", "virtual-k64f.toml", "cd" * 32, "1.7 ± 0.2 deg", "ef" * 32),
    )
    findings.tests.append(TestResult("t.py::t", TestOutcome.PASSED, 1.0))
    findings.measurements.update((measurement.name, measurement) for measurement in measurements)
    return findings.finish(decide(findings, pytest_exit=0), f"2026-01-{day:02d}T23:00:00Z")
