"""Several boards in one report: one column per board, and the spread between them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest import __version__
from hiltest.measurement import KINDS, UNDECIDED, Outcome, identify
from hiltest.report.markdown_text import folded, plain_text, table
from hiltest.report.page import badge_of, render
from hiltest.run_record.exit_codes import outcome_of
from hiltest.run_record.files import REPORT_FILE
from hiltest.run_record.run import Verdict
from hiltest.text import number
from hiltest.verdict.calibrators import UNCALIBRATED

# Measurements on the terminal: accuracy and cost of each calibrator.
_APART = ("spread", "deviation", "Cpk")
_SIGNS = {"": "", "bad": " ✗", "warn": " ?"}
_HEADLINES = (KINDS["heading.{calibrator}.max"], KINDS["cycles.{calibrator}.total"])


@dataclass(frozen=True, slots=True)
class BoardLine:
    """Result of one board's run."""

    name: str
    """Name of its rig, or its serial number."""
    folder: str
    """Folder of its record, relative to the page."""
    exit_code: int
    sentence: str
    """Sentence of its verdict, or its last output if it has none."""
    firmware: str = ""
    """Firmware; empty if no board answered."""

    @property
    def outcome(self) -> str:
        """Outcome of the run by its exit code."""
        return outcome_of(self.exit_code)


@dataclass(frozen=True, slots=True)
class Apart:
    """One measurement on every board that has it."""

    name: str
    unit: str
    values: Mapping[str, float | int | None]
    """Values by board."""
    outcomes: Mapping[str, Outcome]
    """Outcomes by board."""
    spread: float | int | None
    """Largest minus smallest value; None if fewer than two boards have a number, or if they are not comparable."""

    mean: float | None = None
    deviation: float | None = None
    """Mean and sample standard deviation over the boards; None where the spread is."""
    cpk: float | None = None
    """Distance of the mean from the nearer limit, in three standard deviations; None if the limits differ or lack."""

    @property
    def has_limit(self) -> bool:
        """True if a board has a limit for it."""
        return any(outcome not in (Outcome.INFORMATION, Outcome.NOT_OFFERED) for outcome in self.outcomes.values())

    def tone(self, board: str) -> str:
        """Return the class of its cell in the style sheet; empty without an objection."""
        outcome = self.outcomes.get(board)
        return "bad" if outcome is Outcome.FAIL else "warn" if outcome in UNDECIDED else ""

    def cell(self, board: str) -> str:
        """Return its value on a board as text, with a sign if it is beyond its limit, or if that is not known."""
        if board not in self.values:
            return ""
        return number(self.values[board], self.unit) + _SIGNS[self.tone(board)]

    @property
    def apart(self) -> tuple[str, str, str]:
        """Spread, standard deviation and Cpk as texts."""
        spread, deviation = (
            "" if value is None else number(value, self.unit) for value in (self.spread, self.deviation)
        )
        return spread, deviation, "" if self.cpk is None else f"{self.cpk:.2f}"


def boards_html(verdict: Verdict, boards: Sequence[BoardLine], apart: Sequence[Apart]) -> str:
    """Return the page as HTML."""
    held = [row for row in apart if row.has_limit]
    others = [row for row in apart if not row.has_limit]
    return render(
        "boards.html.j2",
        verdict=verdict,
        boards=boards,
        held=held,
        others=others,
        columns=_APART,
        report=REPORT_FILE,
        badge_of=badge_of,
        version=__version__,
    )


def boards_markdown(verdict: Verdict, boards: Sequence[BoardLine], apart: Sequence[Apart]) -> str:
    """Return the page as Markdown."""
    return "\n".join(_lines(verdict, boards, apart)) + "\n"


def boards_table(boards: Sequence[BoardLine], apart: Sequence[Apart]) -> str:
    """Return the measurements as CSV, one in each row, with the boards behind the statistics."""
    names = [board.name for board in boards]
    file = io.StringIO()
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(["measurement", "unit", "spread", "mean", "deviation", "cpk", *names])
    rows.writerow(["verdict", "", "", "", "", "", *(board.outcome for board in boards)])
    rows.writerow(["exit code", "", "", "", "", "", *(board.exit_code for board in boards)])
    for row in apart:
        statistics = row.spread, row.mean, row.deviation, row.cpk
        rows.writerow([row.name, row.unit, *statistics, *map(row.values.get, names)])
    return file.getvalue()


def _lines(verdict: Verdict, boards: Sequence[BoardLine], apart: Sequence[Apart]) -> Iterator[str]:
    names = [board.name for board in boards]
    yield from (f"# {plain_text(verdict.outcome.upper())}", "", plain_text(verdict.sentence), "")
    ends = ([board.name, str(board.exit_code), board.sentence] for board in boards)
    yield from table(["board", "exit code", "verdict"], ends)
    held, others = ([row for row in apart if row.has_limit is has_limit] for has_limit in (True, False))
    yield from ("", *_measurements(names, held))
    yield from folded("Measurements without a limit", _measurements(names, others))


def _measurements(names: Sequence[str], apart: Sequence[Apart]) -> Iterator[str]:
    rows = ([row.name, *map(row.cell, names), *row.apart, row.unit] for row in apart)
    yield from table(["measurement", *map(plain_text, names), *_APART, "unit"], rows)


def print_boards(console: Console, names: Sequence[str], apart: Sequence[Apart]) -> None:
    """Print the worst heading and the cycles of each calibrator, one column per board."""
    shown = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    shown.add_column("")
    for name in (*names, "spread"):
        shown.add_column(escape(name), justify="right")
    shown.add_column("")
    for row in apart:
        named = identify(row.name)
        if named.kind in _HEADLINES and named.subject != UNCALIBRATED:
            cells = [row.cell(name) for name in names]
            shown.add_row(*map(escape, (row.name, *cells, row.apart[0], row.unit)))
    console.print(shown)
