"""What the HTML and the Markdown report both show, as plain data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

from hiltest.measurement import Measurement, Outcome
from hiltest.report.record import Run
from hiltest.report.terminal import shown_limit, shown_value
from hiltest.report.verdict import UNCALIBRATED, calibrator_results, grouped, without_folders

# Heading of a column of the accuracy-and-cost table, and the measurement in it.
_COLUMNS = (
    ("worst heading", "heading.{}.max"),
    ("cycles", "cycles.{}.total"),
    ("rms", "heading.{}.rms"),
    ("bias", "heading.{}.bias"),
    ("worst, centred", "heading.{}.max_centred"),
    ("residual", "fit.{}.residual"),
    ("rotation left", "fit.{}.rotation_left"),
    ("per point", "cycles.{}.per_point"),
    ("fixed", "cycles.{}.fixed"),
)
_TONES = {Outcome.PASS: "pass", Outcome.FAIL: "fail", Outcome.UNSET: "unset"}


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell of the accuracy-and-cost table; `tone` is a class of the style sheet."""

    text: str
    limit: str = ""
    tone: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """One calibrator."""

    name: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class AccuracyAndCost:
    """The table this product exists for: what each calibrator reaches and what it costs."""

    headings: tuple[str, ...]
    rows: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class Group:
    """Measurements whose names begin with the same word."""

    name: str
    measurements: tuple[Measurement, ...]


def accuracy_and_cost(run: Run) -> AccuracyAndCost:
    """Return the table of all calibrators, cheapest first, without calibration last."""
    names = [each.name for each in calibrator_results(run.measurements)]
    if run.measurement(f"heading.{UNCALIBRATED}.max"):
        names.append(UNCALIBRATED)
    rows = tuple(Row(name, tuple(_cell(run, pattern.format(name)) for _, pattern in _COLUMNS)) for name in names)
    return AccuracyAndCost(tuple(heading for heading, _ in _COLUMNS), rows)


def groups(run: Run) -> list[Group]:
    """Return all measurements by the first word of their names."""
    by_word = groupby(run.measurements, key=lambda each: each.name.split(".")[0])
    return [Group(name, tuple(measurements)) for name, measurements in by_word]


def tone(measurement: Measurement) -> str:
    """Return the class of the style sheet for an outcome."""
    return _TONES.get(measurement.outcome, "")


def origin(measurement: Measurement) -> str:
    """Return which test measured it and, for cycles, what counted."""
    return f"{without_folders(measurement.test)} {measurement.cycle_model}".strip()


def board_line(run: Run) -> str:
    """Return the board, its firmware and the rig in one line."""
    parts = []
    if run.board:
        parts += [run.board.description, f"{run.board.firmware} {run.board.version} build {run.board.build_id}"]
    else:
        parts.append("no board answered")
    if run.rig:
        parts.append(f"rig {run.rig.name}")
    return " · ".join([*parts, run.started_utc])


def provenance(run: Run) -> Iterator[tuple[str, str]]:
    """Yield name and text of everything that the numbers rest on."""
    if run.board:
        board = run.board
        yield "board", board.description
        yield "unique id", board.unique_id
        yield "firmware", f"{board.firmware} {board.version}, build {board.build_id}, protocol {board.protocol_version}"
        yield "firmware SHA-256", board.firmware_sha256 or "not offered by this board"
        yield "compiler", board.compiler
        yield "placement", board.placement
        yield "core clock", f"{board.core_clock_hz / 1e6:g} MHz"
        yield "cycle model", board.cycle_model
        yield "time", f"{board.clock} clock"
        yield "calibrators", ", ".join(board.calibrators)
        yield "sensors", "; ".join(
            f"{each.name} ({each.kind}, bus {each.bus}, 0x{each.address:02X}, "
            f"{'selected' if each.selected else 'present' if each.present else 'absent'})" for each in board.sensors
        )
    if run.rig:
        yield "rig", f"{run.rig.name} ({run.rig.file})"
        yield "rig SHA-256", run.rig.sha256
        yield "mounting yaw", run.rig.mounting
    yield "seed", "none" if run.seed is None else str(run.seed)
    yield "suite", run.suite
    yield "poses", run.poses
    if run.calibration:
        yield "calibration file", f"{run.calibration.file}, made {run.calibration.made_utc}"
        yield "calibration SHA-256", run.calibration.sha256
    yield "host", f"{run.environment.host}, {run.environment.platform}"
    versions = ", ".join(f"{name} {number}" for name, number in run.environment.versions.items())
    yield "versions", f"Python {run.environment.python}, {versions}"
    yield "started, finished", f"{run.started_utc}, {run.finished_utc}"


def _cell(run: Run, name: str) -> Cell:
    measurement = run.measurement(name)
    if measurement is None:
        return Cell("")
    return Cell(_comparable(measurement), limit=shown_limit(measurement), tone=tone(measurement))


def _comparable(measurement: Measurement) -> str:
    """Return a value with fixed decimals, so that a column can be compared at a glance."""
    if measurement.value is None:
        return shown_value(measurement)
    if measurement.unit in ("deg", "%"):
        return f"{measurement.value:.2f} {measurement.unit}"
    return grouped(measurement.value) if abs(measurement.value) >= 1000 else f"{measurement.value:.1f}"
