"""Render a campaign as Markdown: one page for all its seeds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from hiltest.report.markdown import comparison_lines
from hiltest.report.markdown_text import folded, plain_text, table
from hiltest.run_record.comparison import Comparison
from hiltest.run_record.run import Verdict
from hiltest.text import format_number
from hiltest.verdict.wording import counted_by


@dataclass(frozen=True, slots=True)
class SeedLine:
    """Result of one seed's run, in words."""

    seed: int
    exit_code: int
    sentence: str


@dataclass(frozen=True, slots=True)
class Spread:
    """One measurement over the seeds on which it has a number."""

    name: str
    unit: str
    n: int
    min: float
    median: float
    max: float
    failed_seeds: tuple[int, ...]


def campaign_markdown(
    verdict: Verdict,
    seeds: Sequence[SeedLine],
    spreads: Sequence[Spread],
    comparison: Comparison | None,
    cycle_models: Iterable[str] = (),
) -> str:
    """Return the page: verdict, changes, failed seeds and the limits that they missed; the rest is folded.

    Parameters
    ----------
    cycle_models
        Cycle models of the counts among the spreads.
    """
    return "\n".join(_lines(verdict, seeds, spreads, comparison, counted_by(cycle_models))) + "\n"


def _lines(
    verdict: Verdict, seeds: Sequence[SeedLine], spreads: Sequence[Spread], comparison: Comparison | None, remark: str
) -> Iterator[str]:
    yield from (f"# {plain_text(verdict.outcome.upper())}", "", plain_text(verdict.sentence))
    if remark:
        yield from ("", plain_text(remark))
    if comparison is not None:
        yield from comparison_lines(comparison)
    red = [seed for seed in seeds if seed.exit_code]
    if red:
        yield from ("", "## Seeds that did not pass", "", *_seeds(red))
    missed = [spread for spread in spreads if spread.failed_seeds]
    if missed:
        yield from ("", "## Failed limits", "", *_spreads(missed))
    yield from folded("Every measurement over the seeds", _spreads(spreads))
    yield from folded("Every seed", _seeds(seeds))


def _seeds(seeds: Sequence[SeedLine]) -> Iterator[str]:
    rows = ([str(seed.seed), str(seed.exit_code), seed.sentence] for seed in seeds)
    yield from table(["seed", "exit code", "verdict"], rows)


def _spreads(spreads: Sequence[Spread]) -> Iterator[str]:
    rows = (
        [
            spread.name,
            str(spread.n),
            *map(format_number, (spread.min, spread.median, spread.max)),
            spread.unit,
            ", ".join(map(str, spread.failed_seeds)),
        ]
        for spread in spreads
    )
    yield from table(["measurement", "seeds", "smallest", "median", "largest", "unit", "failed on seeds"], rows)
