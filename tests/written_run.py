"""A run written by hand, with round numbers, and what it takes to change it."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hiltest.measurement import Limit, Measurement, check
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import (
    BoardRecord,
    Column,
    Environment,
    Findings,
    RigRecord,
    SensorRecord,
    Table,
    TestResult,
)

MODEL = "cortex-m4-trm/3@sram"
HEADING_TEST = "hil/suites/test_heading.py::test_heading"


def heading_measurements(
    calibrator: str,
    maximum: float,
    *,
    limit: float,
    cycles: int,
    bias: float = 0.1,
    centred: float | None = None,
    residual: float = 0.8,
    not_checked: str = "",
) -> list[Measurement]:
    """Return what the heading and cycle suites measure of one calibrator."""

    def measured(name: str, value: float, unit: str, most: Limit | None = None, **more: str) -> Measurement:
        return check(name, value, unit=unit, limit=most, test=HEADING_TEST, **more)  # type: ignore[arg-type]

    return [
        measured(f"heading.{calibrator}.max", maximum, "deg", Limit(max=limit), not_checked=not_checked),
        measured(f"heading.{calibrator}.bias", bias, "deg", Limit.within(0.7), not_checked=not_checked),
        measured(f"heading.{calibrator}.max_centred", maximum if centred is None else centred, "deg", Limit(max=limit)),
        measured(f"fit.{calibrator}.residual", residual, "%"),
        measured(f"fit.{calibrator}.residual_predicted", 0.79, "%"),
        measured(f"cycles.{calibrator}.total", cycles, "cycle", cycle_model=MODEL),
    ]


def poses_table() -> Table:
    """Return 60 poses whose error is a sine of the heading, at most 0.97 degrees."""
    rows = []
    for pitch, roll in ((0, 0), (20, 0), (-20, 0), (0, 20), (0, -20)):
        for heading in range(0, 360, 30):
            direct = 0.97 * math.sin(math.radians(heading + 2 * pitch - roll))
            rows.append((heading, pitch, roll, (pitch, roll) == (0, 0), direct, 0.9 * direct, 8 * direct))
    columns = (
        Column("heading", "deg"),
        Column("pitch", "deg"),
        Column("roll", "deg"),
        Column("level"),
        Column("error.direct", "deg"),
        Column("error.iterative", "deg"),
        Column("error.uncalibrated", "deg"),
    )
    return Table("heading.poses", columns, tuple(rows))


def points_table() -> Table:
    """Return 200 points of a sphere of 485 counts around (100, -50, 20)."""
    rows = []
    for k in range(200):
        z = 1 - (2 * k + 1) / 200
        around = math.sqrt(1 - z * z)
        angle = k * math.pi * (3 - math.sqrt(5))
        rows.append(
            (
                round(100 + 485 * around * math.cos(angle)),
                round(-50 + 485 * around * math.sin(angle)),
                round(20 + 485 * z),
            )
        )
    return Table("tumble.points", tuple(Column(axis, "count") for axis in "xyz"), tuple(rows))


def calibrations_table() -> Table:
    """Return the calibration that undoes `points_table`, for one calibrator."""
    soft_iron = [1 / 485 if row == column else 0.0 for row in "xyz" for column in "xyz"]
    names = [f"soft_iron_{row}{column}" for row in "xyz" for column in "xyz"] + [f"hard_iron_{row}" for row in "xyz"]
    return Table(
        "calibration.results",
        (Column("calibrator"), *(Column(name) for name in names)),
        (("direct", *soft_iron, 100.0, -50.0, 20.0),),
    )


def sizes_table() -> Table:
    """Return cycles that lie on 1 900 + 105 n and 3 000 + 2 000 n."""
    rows = tuple((n, 1900 + 105 * n, 3000 + 2000 * n) for n in (20, 100, 180, 300))
    columns = (Column("n"), Column("direct", "cycle"), Column("iterative", "cycle"))
    return Table("cycles.sizes", columns, rows)


def budget_table() -> Table:
    """Return three curves over 30 points and one over 100: one effort left no calibration, another but a sphere."""
    rows = (
        ("direct", 30, "points", 9, 2700, "POOR_COVERAGE", True, 2.5, 5.0),
        ("direct", 30, "points", 30, 4600, "ELLIPSOID", False, 0.7, 1.7),
        ("iterative", 30, "sweeps", 1, 25_000, "SINGULAR", False, None, None),
        ("iterative", 30, "sweeps", 5, 90_000, "ELLIPSOID", False, 0.7, 1.7),
        ("slow-stream", 30, "points so far", 30, 12_000, "TOO_FEW_POINTS", False, None, None),
        ("direct", 100, "points", 9, 2700, "ELLIPSOID", False, 2.5, 5.0),
        ("direct", 100, "points", 100, 11_000, "ELLIPSOID", False, 0.4, 0.8),
    )
    units = {
        "calibrator": "",
        "points": "",
        "kind": "",
        "effort": "",
        "cycles": "cycle",
        "fit": "",
        "sphere": "",
        "mean_error": "deg",
        "max_error": "deg",
    }
    return Table("budget.curve", tuple(Column(*unit) for unit in units.items()), rows)


def stages_table() -> Table:
    """Return what two stream calibrators know on the way; one has solvers of 4 elements and more."""
    rows = (
        ("direct-stream", 100, "POOR_COVERAGE", True, 100, 0, 0, None, 3.27, 1.12),
        ("direct-stream", 300, "ELLIPSOID", False, 300, 0, 0, None, 0.81, 0.23),
        ("slow-stream", 100, "TOO_FEW_POINTS", False, 96, 0, 0, 1000.0, None, None),
        ("slow-stream", 300, "ELLIPSOID", True, 217, 4, 3, 1.57, 2.42, 0.97),
    )
    units = {
        "calibrator": "",
        "points": "",
        "fit": "",
        "sphere": "",
        "held": "",
        "elements": "",
        "accepted": "",
        "fit_error": "%",
        "max_error": "deg",
        "mean_error": "deg",
    }
    return Table("stream.stages", tuple(Column(*unit) for unit in units.items()), rows)


@pytest.fixture
def board() -> BoardRecord:
    return BoardRecord(
        kind="virtual",
        description="virtual FRDM-K64F, seed 1",
        firmware="hiltest-frdm-k64f",
        version="0.1.0",
        protocol_version=4,
        build_id="0123456789abcdef",
        unique_id="00" * 16,
        firmware_sha256="ab" * 32,
        compiler="GCC 12.2.1",
        placement="sram",
        core_clock_hz=120_000_000,
        cycle_model=MODEL,
        clock="virtual",
        calibrators=("direct", "iterative"),
        sensors=(SensorRecord("MAG3110", "magnetometer", 1, 0x0E, present=True, selected=True),),
    )


@pytest.fixture
def findings(board: BoardRecord) -> Callable[..., Findings]:
    """Return a function that makes findings of some measurements."""

    def make(*measurements: Measurement, tests: tuple[TestResult, ...] = (), tables: bool = True) -> Findings:
        result = Findings(
            Environment("bench, 2 cores", "Linux", "3.11.2", {"hiltest": "0.1.0"}),
            "gate",
            "all",
            "2026-01-02T03:04:05Z",
            seed=1,
            board=board,
            rig=RigRecord("virtual-k64f", "virtual-k64f.toml", "cd" * 32, "1.7 ± 0.2 deg", cost_reference="direct"),
        )
        result.tests.extend(tests or [TestResult(HEADING_TEST, TestOutcome.PASSED, 1.25)])
        result.measurements.update((measurement.name, measurement) for measurement in measurements)
        if tables:
            for make_table in (
                poses_table,
                points_table,
                calibrations_table,
                sizes_table,
                budget_table,
                stages_table,
            ):
                table = make_table()
                result.tables[table.name] = table
        return result

    return make


@pytest.fixture
def good() -> list[Measurement]:
    """Measurements of a run in which everything holds."""
    return [
        *heading_measurements("direct", 0.97, limit=1.8, cycles=12_400),
        *heading_measurements("iterative", 0.95, limit=1.8, cycles=203_000),
        check("gyroscope.bias_error", 0.02, unit="dps", limit=Limit(max=0.1), test="test_gyroscope.py::test"),
        check("board.wall_seconds", 8.1, unit="s", volatile=True),
    ]


@pytest.fixture
def heading() -> Callable[..., list[Measurement]]:
    """Return the function that makes the measurements of one calibrator."""
    return heading_measurements
