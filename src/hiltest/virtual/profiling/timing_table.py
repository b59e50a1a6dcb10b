"""Tables of timing profiles, for a terminal, and their JSON document."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest.virtual.model.profile_file import MEMORY_ROWS, MEMORY_RULES, ROWS, RULES
from hiltest.virtual.model.timing import CostRow, TimingProfile
from hiltest.virtual.silicon.measured_profile import PLACES, MeasuredProfile
from hiltest.virtual.silicon.rule_candidates import Judgement


@dataclass(frozen=True, slots=True)
class TimedRow:
    """Cycles of a row of a timing profile."""

    row: str
    cycles: int
    band: tuple[int, int]
    """Cycles, and their range."""
    prices: str
    """Instructions that the row prices."""
    source: str


@dataclass(frozen=True, slots=True)
class MemoryRow:
    """A memory row of a timing profile."""

    row: str
    value: int
    band: tuple[int, int]
    """Value, and its range."""
    says: str
    """Meaning of the value."""
    source: str


@dataclass(frozen=True, slots=True)
class PublishedError:
    """Interval of true counts relative to those of the model."""

    code: str
    """Memory of the code: ``sram``, ``sram_u`` (from 0x20000000) or ``flash``."""
    permille: tuple[int, int]
    source: str


@dataclass(frozen=True, slots=True)
class Timing:
    """A timing profile."""

    name: str
    digest: str
    file: str
    """Name, digest and file of the profile."""
    rows: list[TimedRow]
    memory: list[MemoryRow]
    errors: list[PublishedError]
    """Errors of its counts, from published counts of similar code; empty if the ranges of rows are the only doubt."""


def print_table(console: Console, profile: TimingProfile, file: Path) -> None:
    """Print the rows of a profile, with uncertain rows in bold type."""
    rows = profile.rows | profile.memory
    uncertain = sum(1 for row in rows.values() if row.band[0] < row.band[1])
    head = f"[bold]{escape(profile.name)}[/bold], digest {profile.digest[:16]}, {escape(str(file))}"
    console.print(head, soft_wrap=True)
    console.print(f"{len(rows)} rows, {uncertain} of them uncertain", soft_wrap=True)
    console.print(_table("cycles", profile.rows, ROWS | RULES))
    if profile.memory:
        console.print(_table("value", profile.memory, MEMORY_ROWS | MEMORY_RULES))
    for place, error in profile.errors.items():
        low, high = (f"{permille / 10:+g} %" for permille in error.permille)
        console.print(escape(f"code in {place}: true counts are {low} to {high} off ({error.source})"), soft_wrap=True)


def print_measured(console: Console, measured: MeasuredProfile) -> None:
    """Print the measured rows with those of the base, and the measurements that contradict the model's rules."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("row", no_wrap=True)
    for name in ("measured", measured.base.name, "range"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    for name, row in measured.rows.items():
        before = measured.base.rows[name]
        inside = before.band[0] <= row.band[0] and row.band[1] <= before.band[1]
        deviation = "outside its range" if not inside else "another value" if row.value != before.value else ""
        low, high = row.band
        shown = str(row.value) if low == high else f"{low} to {high}"
        table.add_row(name, shown, str(before.value), _band(before), deviation, style="bold" if deviation else None)
    console.print(table)
    for remark in measured.remarks:
        console.print(escape(remark), style="yellow", soft_wrap=True)


def print_judgements(console: Console, judgements: Iterable[Judgement]) -> None:
    """Print the predictions of the candidates for each rule, and the candidates that match the measurement."""
    console.print("Rules of fetching and addresses: measured clocks of half a sequence, and the", soft_wrap=True)
    console.print("clocks that each candidate predicts; > marks the matching candidates.", soft_wrap=True)
    for judgement in judgements:
        question = judgement.question
        console.print(f"\n{question.sequence}: {judgement.clocks} clocks", highlight=False, soft_wrap=True)
        console.print(f"    {question.about}", highlight=False, soft_wrap=True)
        for candidate, clocks in zip(question.candidates, judgement.predicted, strict=True):
            mark = ">" if candidate in judgement.survivors else " "
            console.print(f"  {mark} {clocks:4} {candidate.says}", highlight=False, soft_wrap=True)
        if judgement.decided is None:
            reason = "no candidate matches" if not judgement.survivors else "this core does not distinguish them"
            console.print(f"    {reason}", style="yellow", soft_wrap=True)
    console.print()


def print_places(console: Console, raw: Mapping[str, Mapping[str, int]]) -> None:
    """Print the sequences whose cost in flash differs from that in SRAM.

    Parameters
    ----------
    raw
        Clocks of half of each sequence, by place.
    """
    differing = [name for name in raw["sram"] if len({clocks[name] for clocks in raw.values()}) > 1]
    if not differing:
        console.print("Code in flash takes the same clocks, with and without cache and prefetch.", soft_wrap=True)
        return
    console.print("Clocks of half a sequence in SRAM, and in flash with parts of its controller off:", soft_wrap=True)
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("sequence", no_wrap=True)
    for shown in PLACES.values():
        table.add_column(shown, justify="right", no_wrap=True)
    for name in differing:
        table.add_row(name, *(str(raw[place][name]) for place in PLACES))
    console.print(table)


def _table(value: str, rows: Mapping[str, CostRow], meanings: Mapping[str, str]) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("row", no_wrap=True)
    for name in (value, "range"):
        table.add_column(name, justify="right", no_wrap=True)
    for name in ("meaning", "source"):
        table.add_column(name, overflow="fold")
    for name, row in rows.items():
        style = "bold" if row.band[0] < row.band[1] else None
        table.add_row(name, str(row.value), _band(row), escape(meanings[name]), escape(row.source), style=style)
    return table


def timing_document(profile: TimingProfile, file: Path) -> Timing:
    """Return the document of a profile."""
    prices = ROWS | RULES
    rows = [TimedRow(name, row.value, row.band, prices[name], row.source) for name, row in profile.rows.items()]
    meanings = MEMORY_ROWS | MEMORY_RULES
    memory = [MemoryRow(name, row.value, row.band, meanings[name], row.source) for name, row in profile.memory.items()]
    errors = [PublishedError(place, error.permille, error.source) for place, error in profile.errors.items()]
    return Timing(profile.name, profile.digest, str(file), rows, memory, errors)


def _band(row: CostRow) -> str:
    low, high = row.band
    return "" if low == high else f"{low} to {high}"
