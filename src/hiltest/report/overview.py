"""Contents of the HTML and the Markdown report, as plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import compress, groupby

from hiltest.measurement import Measurement, Outcome, Section
from hiltest.report.terminal import shown_limit, shown_value
from hiltest.run_record.run import BoardRecord, Run
from hiltest.text import format_number, short_test_id
from hiltest.verdict.calibrators import (
    AS_READ,
    FROM_FLASH,
    UNCALIBRATED,
    WITH_WAITS,
    WITHOUT_WAITS,
    WORSE_THAN_NONE,
    CalibratorCost,
    calibrator_costs,
    heading_as_read,
    is_worse_than_none,
)
from hiltest.verdict.exposed_causes import hidden_causes
from hiltest.verdict.summary import MAY_EXCEED
from hiltest.verdict.wording import revision

# Heading of a column of the accuracy-and-cost table, and the measurement in it.
_ACCURACY = (("worst heading [deg]", "heading.{}.max"),)
_MORE = (
    ("rms [deg]", "heading.{}.rms"),
    ("bias [deg]", "heading.{}.bias"),
    ("worst, centred [deg]", "heading.{}.max_centred"),
    ("residual [%]", "fit.{}.residual"),
    ("residual rotation [deg]", "fit.{}.rotation_left"),
)
_CYCLES = "cycles"
HEADINGS = (
    *(heading for heading, _ in _ACCURACY),
    _CYCLES,
    WITH_WAITS,
    *(heading for heading, _ in _MORE),
    "per point",
    "fixed",
    "stack [B]",
)
_TONES = {Outcome.PASS: "pass", Outcome.FAIL: "fail", Outcome.UNSET: "unset", Outcome.CANNOT_TELL: "unset"}


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell of the accuracy-and-cost table; `tone` is a class of the style sheet, `note` explains the text."""

    text: str
    limit: str = ""
    tone: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True)
class CalibratorRow:
    """One calibrator."""

    name: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class AccuracyAndCost:
    """Accuracy and cost of each calibrator; `flash_model` is the cycle model of execution from flash."""

    headings: tuple[str, ...]
    rows: tuple[CalibratorRow, ...]
    flash_model: str


@dataclass(frozen=True, slots=True)
class Group:
    """Measurements of one section."""

    name: str
    measurements: tuple[Measurement, ...]

    @property
    def checked(self) -> int:
        """Number of measurements with a limit."""
        return sum(measurement.limit is not None for measurement in self.measurements)

    @property
    def failures(self) -> int:
        """Number of measurements that fail the run."""
        return sum(measurement.gates for measurement in self.measurements)


def accuracy_and_cost(run: Run) -> AccuracyAndCost:
    """Return the table: calibrators by cost, then streaming ones, then the heading as read, without calibration.

    Empty columns are omitted.
    """
    rows = [CalibratorRow(cost.name, _cells(run, cost)) for cost in calibrator_costs(run)]
    if run.measurement(f"heading.{UNCALIBRATED}.max"):
        rows.append(CalibratorRow(AS_READ, _cells(run, CalibratorCost(UNCALIBRATED, None))))
    has_text = [any(row.cells[place].text for row in rows) for place in range(len(HEADINGS))]
    headings = tuple(compress(HEADINGS, has_text))
    waited = [
        measurement
        for row in rows
        if (measurement := run.measurement(FROM_FLASH.format(row.name))) and measurement.value is not None
    ]
    if WITH_WAITS in headings:
        headings = tuple(WITHOUT_WAITS if heading == _CYCLES else heading for heading in headings)
    return AccuracyAndCost(
        headings,
        tuple(replace(row, cells=tuple(compress(row.cells, has_text))) for row in rows),
        waited[0].cycle_model if waited else "",
    )


def groups(run: Run) -> list[Group]:
    """Return all measurements by the section of their kind."""
    order = list(Section)
    measurements = sorted(run.measurements, key=lambda measurement: order.index(measurement.section))
    by_section = groupby(measurements, key=lambda measurement: measurement.section)
    return [Group(str(section), tuple(group)) for section, group in by_section]


def tally(run: Run) -> str:
    """Return how many tests ran and how many measurements are within their limits."""
    outcomes = Counter(test.outcome for test in run.tests)
    limits = [measurement for measurement in run.measurements if measurement.limit is not None]
    held = sum(limit.outcome is Outcome.PASS for limit in limits)
    parts = [", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "no test ran"]
    parts.append(f"{held} of {len(limits)} within their limits" if limits else "no limit was checked")
    parts.append(f"{len(run.measurements) - len(limits)} more measurements without a limit")
    return f"{'Tests: ' if outcomes else ''}{parts[0]} · {' · '.join(parts[1:])}"


def tone(measurement: Measurement) -> str:
    """Return the class of the style sheet for an outcome."""
    return _TONES.get(measurement.outcome, "")


def origin(measurement: Measurement) -> str:
    """Return the test that measured it and, for cycles, the cycle model and the uncertainty range."""
    where = f"{short_test_id(measurement.test)} {measurement.cycle_model}".strip()
    return f"{where}; {measurement.band.explained(of=measurement.value)}" if measurement.band else where


def board_line(run: Run) -> str:
    """Return the board, its firmware and the rig in one line."""
    parts = []
    if run.board:
        parts += [run.board.description, _firmware(run.board)]
    else:
        parts.append("no board answered")
    if run.rig:
        parts.append(f"rig {run.rig.name}")
    parts.append(_memory(run))
    return " · ".join([*filter(None, [*parts, revision(run.revision)]), run.started_utc])


def _memory(run: Run) -> str:
    """Return the firmware's use of the part's memories, as far as it was measured."""
    names = (("flash", "flash"), ("RAM", "ram"), ("stack", "stack_most"))
    measured = ((called, run.measurement(f"firmware.{name}")) for called, name in names)
    return ", ".join(
        f"{called} {shown_value(measurement)} B"
        for called, measurement in measured
        if measurement and measurement.value is not None
    )


def _firmware(board: BoardRecord) -> str:
    build = f"build {board.build_id}" if board.build_id else ""
    return " ".join(filter(None, (board.firmware, board.version, build)))


def provenance(run: Run) -> Iterator[tuple[str, str]]:
    """Yield name and text of everything that the numbers depend on, as far as it is known."""
    yield from ((name, text) for name, text in _provenance(run) if text)


def _provenance(run: Run) -> Iterator[tuple[str, str]]:
    if run.revision:
        yield from (("label", run.revision.label), ("commit", run.revision.commit), ("branch", run.revision.branch))
    if run.board:
        board = run.board
        yield "board", board.description
        yield "unique id", board.unique_id
        protocol = f", protocol {board.protocol_version}" if board.protocol_version else ""
        yield "firmware", _firmware(board) + protocol
        yield "build id in the ELF", board.elf_build_id or "not offered"
        yield "firmware SHA-256", board.firmware_sha256 or "not offered by this board"
        yield "compiler", board.compiler
        yield "placement", board.placement
        yield "core clock", f"{board.core_clock_hz / 1e6:g} MHz"
        yield "cycle model", board.cycle_model
        yield "time", f"{board.clock} clock"
        observes = board.kind == "virtual"
        yield (
            "checked from",
            "the delivered samples on" if observes else "the firmware's answers on: samples are not observed",
        )
        yield "calibrators", ", ".join(board.calibrators)
        yield (
            "sensors",
            "; ".join(
                f"{sensor.name} ({sensor.kind}, bus {sensor.bus}, 0x{sensor.address:02X}, "
                f"{'selected' if sensor.selected else 'present' if sensor.present else 'absent'})"
                for sensor in board.sensors
            ),
        )
    if run.rig:
        yield "rig", f"{run.rig.name} ({run.rig.file})"
        yield "rig SHA-256", run.rig.sha256
        yield "mounting yaw", run.rig.mounting
        yield "injected faults", run.rig.faults
    yield "seed", "none" if run.seed is None else str(run.seed)
    yield "suite", run.suite
    yield "poses", run.poses
    yield "bugs that these poses do not show", hidden_causes(run)
    if run.calibration:
        yield "calibration file", f"{run.calibration.file}, made {run.calibration.made_utc}"
        yield "calibration SHA-256", run.calibration.sha256
    yield "host", f"{run.environment.host}, {run.environment.platform}"
    versions = ", ".join(f"{name} {number}" for name, number in run.environment.versions.items())
    yield "versions", f"Python {run.environment.python}, {versions}"
    yield "started, finished", f"{run.started_utc}, {run.finished_utc}"


def _cells(run: Run, cost: CalibratorCost) -> tuple[Cell, ...]:
    accuracy, more = (
        [_cell(run, pattern.format(cost.name)) for _, pattern in columns] for columns in (_ACCURACY, _MORE)
    )
    if is_worse_than_none(run.measurement(f"heading.{cost.name}.max"), heading_as_read(run.measurements)):
        accuracy = [replace(cell, note=WORSE_THAN_NONE) for cell in accuracy]
    total, *parts = _stream_cells(run, cost) if cost.is_streaming else _batch_cells(run, cost.name)
    stack = _cell(run, f"firmware.{cost.name}.stack")
    return (*accuracy, total, _cell(run, FROM_FLASH.format(cost.name)), *more, *parts, stack)


def _batch_cells(run: Run, name: str) -> list[Cell]:
    total, *parts = (_cell(run, f"cycles.{name}.{quantity}") for quantity in ("total", "per_point", "fixed"))
    worst = run.measurement(f"cycles.{name}.worst_found")
    if worst is not None and worst.value is not None:
        total = replace(total, note=", ".join(filter(None, (total.note, f"worst found {format_number(worst.value)}"))))
    return [total, *parts]


def _stream_cells(run: Run, cost: CalibratorCost) -> list[Cell]:
    """Return the cells of a streaming calibrator: its fixed part is the final fit, its points have mean and maximum."""
    whole = run.measurement(f"stream.{cost.name}.total")
    band = f", {whole.band}" if whole and whole.band else ""
    total = Cell("" if cost.cycles is None else format_number(cost.cycles), note=f"{cost.points} points{band}")
    most = run.measurement(f"stream.{cost.name}.cycles_max")
    note = "" if most is None or most.value is None else f"max {format_number(most.value)}"
    per_point = replace(_cell(run, f"stream.{cost.name}.cycles_mean"), note=note)
    return [total, per_point, _cell(run, f"stream.{cost.name}.fit_cycles")]


def _cell(run: Run, name: str) -> Cell:
    measurement = run.measurement(name)
    if measurement is None:
        return Cell("")
    band = str(measurement.band) if measurement.band else ""
    band += f": {MAY_EXCEED}" if measurement.may_exceed_limit else ""
    return Cell(shown_value(measurement), limit=shown_limit(measurement), tone=tone(measurement), note=band)
