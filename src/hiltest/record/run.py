"""The record of a run: its parts.

Every report is rendered from a `Run` and from nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal

from hiltest.measurement import (
    WORST_OF_SEVERAL,
    Better,
    Measurement,
    Outcome,
    Tolerance,
    is_compared,
    plain,
    round_significant,
    tolerance_of,
)
from hiltest.record.comparison import Comparison, Revision
from hiltest.record.outcomes import TestOutcome

SCHEMA: Literal["hiltest.run/1"] = "hiltest.run/1"

_VOLATILE_OF_A_REPLAY = ("kind", "description", "recording")
_VOLATILE_OF_A_SIDE = ("file", "saved_utc", "revision")

Cell = float | int | str | bool | None
# The worst of several attempts counts: no rerun makes a pass of a measurement that was out of its limit.
_WORST_FIRST = (Outcome.FAIL, Outcome.CANNOT_TELL, Outcome.UNSET, Outcome.NOT_OFFERED)


@dataclass(frozen=True, slots=True)
class SensorRecord:
    """One sensor as the firmware reported it."""

    name: str
    kind: str
    bus: int
    address: int
    present: bool
    selected: bool


@dataclass(frozen=True, slots=True)
class RecordingRecord:
    """The recording that a run was replayed from: its file, its SHA-256, and when it was made."""

    file: str
    sha256: str
    recorded_utc: str


@dataclass(frozen=True, slots=True)
class BoardRecord:
    """The board that answered on the link. `clock` is ``virtual`` or ``wall``.

    `compiler_flags` are those of all units of the firmware; empty where no ELF has them. `elf_build_id` is the ELF's
    GNU build-id note, with which `build_id` was compared; empty without one. `kind` is ``replay`` where answers
    came from a `recording`, and no firmware ran.
    """

    kind: str
    description: str
    firmware: str
    version: str
    protocol_version: int
    build_id: str
    unique_id: str
    firmware_sha256: str | None
    compiler: str
    placement: str
    core_clock_hz: int
    cycle_model: str
    clock: str
    calibrators: tuple[str, ...]
    sensors: tuple[SensorRecord, ...]
    compiler_flags: str = ""
    elf_build_id: str = ""
    recording: RecordingRecord | None = None


@dataclass(frozen=True, slots=True)
class RigRecord:
    """The rig: name, file and SHA-256 of that file; `mounting` as it declares it.

    `conditions_sha256` is of what its numbers rest on: no limits, no texts. Empty in records from before it was kept.
    `tolerances` has absolute and relative by measurement name. `cost_reference` is the calibrator whose cycles the
    others' are given as a multiple of; empty where the rig names none. `faults` are those that were made on
    purpose, in words; empty without.
    """

    name: str
    file: str
    sha256: str
    mounting: str
    conditions_sha256: str = ""
    tolerances: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    cost_reference: str = ""
    faults: str = ""


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """The calibration file that was tested: its name, its SHA-256, and when it was made."""

    file: str
    sha256: str
    made_utc: str


@dataclass(frozen=True, slots=True)
class CoverageRecord:
    """What of the firmware was executed: how many of how many, and the file that has it in full.

    `branches` counts conditional branches, and those of them that went both ways.
    """

    file: str
    lines: tuple[int, int]
    functions: tuple[int, int]
    branches: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Environment:
    """The host, and the versions that the numbers depend on."""

    host: str
    platform: str
    python: str
    versions: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class TestResult:
    """One finished test.

    `trace` names the file, relative to the run's folder, that shows what went over the line before it failed.
    """

    __test__ = False  # not a test class, whatever pytest makes of the name

    id: str
    outcome: TestOutcome
    duration_s: float
    reason: str = ""
    trace: str = ""


@dataclass(frozen=True, slots=True)
class Column:
    """Heading of a table column; the unit is empty for words and plain counts."""

    name: str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Numbers behind a plot: what was seen at each pose, point or size."""

    name: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def column(self, name: str) -> tuple[Cell, ...]:
        """Return one column.

        Raises
        ------
        KeyError
            If there is none of this name.
        """
        names = [column.name for column in self.columns]
        if name not in names:
            raise KeyError(f"table {self.name!r} has no column {name!r}, only {', '.join(names)}")
        index = names.index(name)
        return tuple(row[index] for row in self.rows)

    def column_if_any(self, name: str) -> tuple[Cell, ...]:
        """Return one column; None in every row when there is none of this name, as in older records."""
        has_column = any(column.name == name for column in self.columns)
        return self.column(name) if has_column else (None,) * len(self.rows)

    def rounded(self) -> Table:
        """Return the table as it is written: floats to nine significant digits, none of them NaN."""
        return replace(self, rows=tuple(tuple(_cell(cell) for cell in row) for row in self.rows))


@dataclass(frozen=True, slots=True)
class Verdict:
    """The end of a run in one word, one exit code and one sentence."""

    outcome: str
    exit_code: int
    sentence: str
    complete: bool


@dataclass(frozen=True, slots=True)
class Run:
    """Record of a run, as in ``run.json``."""

    schema: Literal["hiltest.run/1"]
    verdict: Verdict
    board: BoardRecord | None
    rig: RigRecord | None
    seed: int | None
    suite: Literal["gate", "full"]
    """Which set of tests it was: ``gate`` or ``full``."""
    poses: str
    calibration: CalibrationRecord | None
    environment: Environment
    started_utc: str
    finished_utc: str
    tests: tuple[TestResult, ...]
    measurements: tuple[Measurement, ...]
    tables: tuple[Table, ...]
    volatile: tuple[str, ...] = ()
    """JSON pointers (RFC 6901) of all that may differ between two runs of the same seed."""
    comparison: Comparison | None = None
    """Comparison with the baseline or the older firmware."""
    other_attempts: tuple[Measurement, ...] = ()
    """What the other attempts of tests that were run again measured; the worst stands under `measurements`."""
    chosen: bool = False
    """Whether the user chose among the tests of hiltest, so that some of the set did not run."""
    revision: Revision | None = None
    """Sources that it was made for, as the label and the job name them."""
    tolerances: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Absolute and relative, that were in force for each measurement that is compared. Empty in records from before
    they were kept."""
    coverage: CoverageRecord | None = None
    """Coverage of the firmware, where it was asked for."""

    def measurement(self, name: str) -> Measurement | None:
        """Return the measurement of this name, None when it was not made."""
        return next((measurement for measurement in self.measurements if measurement.name == name), None)

    def table(self, name: str) -> Table | None:
        """Return the table of this name, None when there is none."""
        return next((table for table in self.tables if table.name == name), None)


@dataclass(slots=True)
class Findings:
    """Everything that a run has found so far; `finish` makes the `Run` of it."""

    environment: Environment
    suite: Literal["gate", "full"]
    poses: str
    started_utc: str
    seed: int | None = None
    rig: RigRecord | None = None
    board: BoardRecord | None = None
    calibration: CalibrationRecord | None = None
    tests: list[TestResult] = field(default_factory=list)
    measurements: dict[str, Measurement] = field(default_factory=dict)
    tables: dict[str, Table] = field(default_factory=dict)
    comparison: Comparison | None = None
    other_attempts: list[Measurement] = field(default_factory=list)
    chosen: bool = False
    revision: Revision | None = None
    coverage: CoverageRecord | None = None

    def take(self, measurement: Measurement) -> None:
        """Take a measurement; of several attempts the worst counts."""
        kept = self.measurements.setdefault(measurement.name, measurement)
        # The same may come twice: see `carry_over` of the session.
        if measurement != kept and measurement not in self.other_attempts:
            self.measurements[measurement.name], other = worst_first(kept, measurement)
            self.other_attempts.append(other)

    def finish(self, verdict: Verdict, finished_utc: str) -> Run:
        """Return the record: measurements and tables sorted by name, volatile places listed."""
        several = {other_attempt.name for other_attempt in self.other_attempts}
        measurements = [self.measurements[name].rounded() for name in sorted(self.measurements)]
        run = Run(
            schema=SCHEMA, verdict=verdict, board=self.board, rig=self.rig, seed=self.seed, suite=self.suite,
            poses=self.poses, calibration=self.calibration, environment=self.environment,
            started_utc=self.started_utc, finished_utc=finished_utc, tests=tuple(self.tests),
            measurements=tuple(marked(each) if each.name in several else each for each in measurements),
            tables=tuple(self.tables[name].rounded() for name in sorted(self.tables)), comparison=self.comparison,
            other_attempts=tuple(other_attempt.rounded() for other_attempt in self.other_attempts), chosen=self.chosen,
            revision=self.revision, coverage=self.coverage,
        )
        return replace(run, volatile=volatile_places(run), tolerances=in_force(run))


def in_force(run: Run) -> dict[str, tuple[float, float]]:
    """Return the tolerances of all that is compared: the rig's, or else those of the kind."""
    of_rig = {name: Tolerance(*each) for name, each in (run.rig.tolerances if run.rig else {}).items()}
    found = {
        measurement.name: tolerance_of(measurement.name, of_rig)
        for measurement in run.measurements if is_compared(measurement.name) and not measurement.volatile
    }
    return {name: (float(each.absolute), float(each.relative)) for name, each in found.items()}


def utc_now() -> str:
    """Return the time as ISO 8601 in UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def volatile_places(run: Run) -> tuple[str, ...]:
    """Return JSON pointers of all that may differ between two runs of the same seed, or a run and its replay."""
    places = ["/started_utc", "/finished_utc"]
    places += [f"/tests/{index}/duration_s" for index in range(len(run.tests))]
    for name, measurements in (("measurements", run.measurements), ("other_attempts", run.other_attempts)):
        for index, measurement in enumerate(measurements):
            if measurement.volatile:
                places += [f"/{name}/{index}/value", f"/{name}/{index}/outcome"]
    if run.board is not None and run.board.recording is not None:
        places += [f"/board/{name}" for name in _VOLATILE_OF_A_REPLAY]
    if run.revision is not None:
        places.append("/revision")
    if run.comparison is not None:
        places += [f"/comparison/{side}/{name}" for side in ("base", "new") for name in _VOLATILE_OF_A_SIDE]
    return tuple(places)


def _cell(cell: Cell) -> Cell:
    if isinstance(cell, str | bool):
        return cell
    # JSON has no NaN; an empty cell of a table is null.
    return None if cell is None or not math.isfinite(cell) else round_significant(plain(cell))


def worst_first(kept: Measurement, other: Measurement) -> tuple[Measurement, Measurement]:
    """Return the measurements of two attempts under one name, the one that counts first.

    Out of its limit comes before near it, that before not evaluated, that before no number at all, and that before a
    number. Of two numbers the worse one comes first, and where neither is, the earlier.
    """
    worst, rest = sorted((kept, other), key=_rank)
    return worst, rest


def marked(measurement: Measurement) -> Measurement:
    """Return the measurement with a note that others of its name exist."""
    return replace(measurement, note="; ".join(filter(None, (measurement.note, WORST_OF_SEVERAL))))


def _rank(measurement: Measurement) -> tuple[int, float]:
    outcome, value = measurement.outcome, measurement.value
    kind = _WORST_FIRST.index(outcome) if outcome in _WORST_FIRST else len(_WORST_FIRST)
    if value is None or measurement.better is Better.NEITHER:
        return kind, 0.0
    return kind, -measurement.better.cost(float(value))
