"""``hiltest compare``: what got better and what got worse between runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.errors import ConfigError

if TYPE_CHECKING:
    from hiltest.comparison.evidence import Evidence
    from hiltest.comparison.model import Comparison

_EXIT_CODES = """
\b
Exit codes:
  0   nothing got worse
  2   interrupted
  4   usage: there is no NEW, or it cannot be read
  21  regression: something got worse, beyond its tolerance
  22  not evaluated: BASE is missing or cannot be compared with, or a measurement is gone
"""
_OK, _REGRESSION, _NOT_EVALUATED = 0, 21, 22
# The first of these that any NEW has is the command's.
_WORST_FIRST = (_NOT_EVALUATED, _REGRESSION, _OK)


@click.command(epilog=_EXIT_CODES)
@click.option("--json", "as_json", is_flag=True, help="Print JSON (hiltest.comparison/1) and nothing else.")
@click.argument("base", type=click.Path(path_type=Path))
@click.argument("new", nargs=-1, required=True, type=click.Path(path_type=Path))
def compare(base: Path, new: tuple[Path, ...], as_json: bool) -> int:
    """Compare each NEW with BASE, seed by seed.

    Each is a run.json, the folder of a run, the folder of a campaign (hiltest run --seeds), or a baseline file.
    """
    from hiltest.report.comparison_text import json_text, print_comparison
    from hiltest.report.evidence import read_evidence

    evidence = [read_evidence(each) for each in new]
    comparisons = _compared(base, evidence)
    if as_json:
        click.echo(json_text(comparisons), nl=False)
    else:
        from hiltest.report.console import standard_output

        for each in comparisons:
            print_comparison(standard_output(), each)
    codes = {exit_code(each) for each in comparisons}
    return next(code for code in _WORST_FIRST if code in codes)


def exit_code(comparison: Comparison) -> int:
    """Return the exit code of one comparison."""
    if not comparison.evaluated:
        return _NOT_EVALUATED
    return _REGRESSION if comparison.regression else _OK


def _compared(base: Path, evidence: list[Evidence]) -> list[Comparison]:
    """Compare with the base; one that cannot be read is no usage error, but a gate that is not evaluated."""
    from hiltest.comparison.compare import compare as compare_sides
    from hiltest.comparison.compare import not_compared
    from hiltest.report.evidence import read_evidence

    try:
        before = read_evidence(base)
    except ConfigError as error:
        return [not_compared(str(base), str(error), each) for each in evidence]
    return [compare_sides(before, each) for each in evidence]
