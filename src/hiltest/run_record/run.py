"""The parts of the record of a run.

Every report is rendered from a `Run` and from nothing else.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal

from hiltest.json_files import shown
from hiltest.measurement import (
    WORST_OF,
    Better,
    Measurement,
    Outcome,
    Tolerance,
    is_compared,
    plain,
    round_significant,
    tolerance_of,
)
from hiltest.run_record.comparison import Comparison, Revision
from hiltest.run_record.outcomes import TestOutcome
from hiltest.text import format_number

SCHEMA: Literal["hiltest.run/1"] = "hiltest.run/1"

_VOLATILE_OF_A_REPLAY = ("kind", "description", "recording")
_VOLATILE_OF_A_SIDE = ("file", "saved_utc", "revision")

Cell = float | int | str | bool | None
# The worst of several attempts counts, so that a rerun cannot hide a measurement that was out of its limit.
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
    """The recording that a run was replayed from: its file, its SHA-256, and its time."""

    file: str
    sha256: str
    recorded_utc: str


@dataclass(frozen=True, slots=True)
class BoardRecord:
    """The board that answered on the link. `clock` is ``virtual`` or ``wall``.

    `compiler_flags` are those of all units of the firmware; empty if no ELF has them. `elf_build_id` is the ELF's
    GNU build-id note, which was compared with `build_id`; empty without one. `kind` is ``replay`` if answers
    came from a `recording` and no firmware ran.
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
    """The rig: name, file, SHA-256 of that file, and declared `mounting`.

    `conditions_sha256` covers everything that its numbers depend on: neither limits nor texts. Empty in older records,
    which lack it. `tolerances` has absolute and relative tolerance by measurement name. `cost_reference` is the
    calibrator that the others' cycles are multiples of; empty if the rig names none. `faults` describes intentional
    faults; empty without any.
    """

    name: str
    file: str
    sha256: str
    mounting: str
    conditions_sha256: str = ""
    tolerances: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    cost_reference: str = ""
    faults: str = ""

    def __post_init__(self) -> None:
        make_tolerances(self.tolerances)


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """The calibration file that was tested: its name, its SHA-256, and its time."""

    file: str
    sha256: str
    made_utc: str


@dataclass(frozen=True, slots=True)
class CoverageRecord:
    """Executed part of the firmware: counts and totals, and the file with the details.

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

    `trace` names the file, relative to the run's folder, with the bytes on the line before a failure.
    """

    __test__ = False  # pytest takes the class for a test class because of its name

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
    """Numbers behind a plot: one row per pose, point or size."""

    name: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows, 1):
            if len(row) != len(self.columns):
                cells = f"{len(row)} cells in {len(self.columns)} columns"
                raise ValueError(f"table {shown(self.name)}, row {number}: {cells}")
        refuse_twice(f"column of table {shown(self.name)}:", [column.name for column in self.columns])

    def column(self, name: str) -> tuple[Cell, ...]:
        """Return one column.

        Raises
        ------
        KeyError
            If no column has this name.
        """
        names = [column.name for column in self.columns]
        if name not in names:
            raise KeyError(f"table {self.name!r} has no column {name!r}, only {', '.join(names)}")
        index = names.index(name)
        return tuple(row[index] for row in self.rows)

    def column_if_any(self, name: str) -> tuple[Cell, ...]:
        """Return one column; None in every row if no column has this name, as in older records."""
        has_column = any(column.name == name for column in self.columns)
        return self.column(name) if has_column else (None,) * len(self.rows)

    def rounded(self) -> Table:
        """Return the table as it is written: floats have nine significant digits, and NaN becomes None."""
        return replace(self, rows=tuple(tuple(_round_cell(cell) for cell in row) for row in self.rows))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of a run in one word, one exit code and one sentence."""

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
    """Set of tests: ``gate`` or ``full``."""
    poses: str
    calibration: CalibrationRecord | None
    environment: Environment
    started_utc: str
    finished_utc: str
    tests: tuple[TestResult, ...]
    measurements: tuple[Measurement, ...]
    tables: tuple[Table, ...]
    volatile: tuple[str, ...] = ()
    """JSON pointers (RFC 6901) of all values that may differ between two runs of the same seed."""
    comparison: Comparison | None = None
    """Comparison with the baseline or the older firmware."""
    other_attempts: tuple[Measurement, ...] = ()
    """Measurements of the other attempts of repeated tests; the worst attempt is under `measurements`."""
    chosen: bool = False
    """True if the user chose among the tests of hiltest, so that part of the set did not run."""
    tests_left_out: int = 0
    """Number of tests of the full set that the gate set left out; 0 in older records, which lack it."""
    crash: str = ""
    """Fault, hang, reset or silence of the firmware on the virtual board, which every run of the build repeats; empty
    without one, on other boards, and in older records."""
    revision: Revision | None = None
    """Sources that the run was made for, according to label and job."""
    tolerances: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Absolute and relative tolerance that was in force for each compared measurement; empty in older records,
    which lack it."""
    coverage: CoverageRecord | None = None
    """Coverage of the firmware, if it was requested."""
    suites: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each file of tests and each conftest.py, by name; empty in older records, which lack it."""

    def __post_init__(self) -> None:
        refuse_twice("measurement", [measurement.name for measurement in self.measurements])
        refuse_twice("table", [table.name for table in self.tables])
        make_tolerances(self.tolerances)

    def measurement(self, name: str) -> Measurement | None:
        """Return the measurement of this name; None if it was not made."""
        return next((measurement for measurement in self.measurements if measurement.name == name), None)

    def table(self, name: str) -> Table | None:
        """Return the table of this name; None without one."""
        return next((table for table in self.tables if table.name == name), None)

    def add_derived_fields(self) -> Run:
        """Return the run with the fields that follow from the others: notes, volatile places, tolerances in force."""
        run = replace(self, measurements=mark_worst(self.measurements, self.other_attempts))
        return replace(run, volatile=volatile_places(run), tolerances=tolerances_in_force(run))


@dataclass(slots=True)
class Findings:
    """All findings of a run so far; `finish` makes a `Run` of them."""

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
    tests_left_out: int = 0
    crash: str = ""
    revision: Revision | None = None
    coverage: CoverageRecord | None = None
    suites: Mapping[str, str] = field(default_factory=dict)

    def take(self, measurement: Measurement) -> None:
        """Add a measurement; of several attempts the worst counts."""
        stored = self.measurements.setdefault(measurement.name, measurement)
        # The same measurement may come twice: see `carry_over` of the session.
        if measurement != stored and measurement not in self.other_attempts:
            self.measurements[measurement.name], other = worst_first(stored, measurement)
            self.other_attempts.append(other)

    def finish(self, verdict: Verdict, finished_utc: str) -> Run:
        """Return the record, with measurements and tables sorted by name, and with volatile places."""
        run = Run(
            schema=SCHEMA,
            verdict=verdict,
            board=self.board,
            rig=self.rig,
            seed=self.seed,
            suite=self.suite,
            poses=self.poses,
            calibration=self.calibration,
            environment=self.environment,
            started_utc=self.started_utc,
            finished_utc=finished_utc,
            tests=tuple(self.tests),
            measurements=tuple(self.measurements[name].rounded() for name in sorted(self.measurements)),
            tables=tuple(self.tables[name].rounded() for name in sorted(self.tables)),
            comparison=self.comparison,
            other_attempts=tuple(other_attempt.rounded() for other_attempt in self.other_attempts),
            chosen=self.chosen,
            tests_left_out=self.tests_left_out,
            crash=self.crash,
            revision=self.revision,
            coverage=self.coverage,
            suites=self.suites,
        )
        return run.add_derived_fields()


def tolerances_in_force(run: Run) -> dict[str, tuple[float, float]]:
    """Return the tolerances of all compared measurements: the rig's, or else those of their kind."""
    of_rig = make_tolerances(run.rig.tolerances if run.rig else {})
    tolerances = {
        measurement.name: tolerance_of(measurement.name, of_rig)
        for measurement in run.measurements
        if is_compared(measurement.name) and not measurement.volatile
    }
    return {name: (float(tolerance.absolute), float(tolerance.relative)) for name, tolerance in tolerances.items()}


def make_tolerances(content: Mapping[str, tuple[float, float]]) -> dict[str, Tolerance]:
    """Return tolerances of a record by measurement.

    Raises
    ------
    ValueError
        If a number is no tolerance; the message has the name.
    """
    tolerances = {}
    for name, values in content.items():
        try:
            tolerances[name] = Tolerance(*values)
        except ValueError as error:
            raise ValueError(f"tolerances.{name}: {error}") from error
    return tolerances


def refuse_twice(kind: str, names: Iterable[object]) -> None:
    """Refuse names, or other keys, that are not unique.

    Raises
    ------
    ValueError
        If one appears twice; the message has its kind and the first of them.
    """
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f"{kind} {shown(name)} appears twice")


def utc_now() -> str:
    """Return the time as ISO 8601 in UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def volatile_places(run: Run) -> tuple[str, ...]:
    """Return JSON pointers of all values that may differ between two runs of a seed, or a run and its replay."""
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


def _round_cell(cell: Cell) -> Cell:
    if isinstance(cell, str | bool):
        return cell
    # JSON has no NaN; an empty cell of a table is null.
    return None if cell is None or not math.isfinite(cell) else round_significant(plain(cell))


def worst_first(earlier: Measurement, later: Measurement) -> tuple[Measurement, Measurement]:
    """Return the measurements of two attempts under one name; the first one counts.

    The order is: out of its limit, too near to tell, not evaluated, not offered, with a number. The worse of two
    numbers comes first; if none is worse, the earlier one.
    """
    worst, rest = sorted((earlier, later), key=_rank)
    return worst, rest


def mark_worst(measurements: Iterable[Measurement], others: Sequence[Measurement]) -> tuple[Measurement, ...]:
    """Return the measurements with a note if `others` has their name: the number of attempts and their spread."""
    by_name: dict[str, list[Measurement]] = {}
    for attempt in others:
        by_name.setdefault(attempt.name, []).append(attempt)
    return tuple(
        _mark_worst(measurement, by_name[measurement.name]) if measurement.name in by_name else measurement
        for measurement in measurements
    )


def _mark_worst(measurement: Measurement, others: Sequence[Measurement]) -> Measurement:
    values = sorted(attempt.value for attempt in (measurement, *others) if attempt.value is not None)
    spread = f", {format_number(values[0])} to {format_number(values[-1])}" if values else ""
    remark = f"{WORST_OF}{len(others) + 1} attempts{spread}"
    return replace(measurement, note="; ".join(filter(None, (measurement.note, remark))))


def _rank(measurement: Measurement) -> tuple[int, float]:
    outcome, value = measurement.outcome, measurement.value
    kind = _WORST_FIRST.index(outcome) if outcome in _WORST_FIRST else len(_WORST_FIRST)
    if value is None or measurement.better is Better.NEITHER:
        return kind, 0.0
    return kind, -measurement.better.cost(float(value))
