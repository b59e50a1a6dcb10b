"""``hiltest compare``: what got better and what got worse between runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.errors import ConfigError

if TYPE_CHECKING:
    from hiltest.record.comparison import Comparison
    from hiltest.verdict.evidence import Evidence

_EXIT_CODES = """
\b
Exit codes:
  0   may be merged: nothing got worse
  1   not to be merged: NEW fails by itself, a limit or a test of its own
  2   interrupted
  4   usage: there is no NEW, or it cannot be read
  21  not to be merged: something got worse, beyond its tolerance
  22  cannot say: BASE is missing or cannot be compared with, a measurement is
      gone, or a limit was not evaluated
"""


@click.command(epilog=_EXIT_CODES)
@click.option("--json", "as_json", is_flag=True, help="Print JSON (hiltest.comparison/1) and nothing else.")
@click.argument("base", type=click.Path(path_type=Path))
@click.argument("new", nargs=-1, required=True, type=click.Path(path_type=Path))
def compare(base: Path, new: tuple[Path, ...], as_json: bool) -> int:
    """Say what got better and what got worse between runs.

    Each is a run.json, the folder of a run, the folder of a campaign (hiltest run --seeds), or a baseline file.
    """
    from hiltest.record.exit_codes import ExitCode, comparison_code
    from hiltest.report.comparison_text import json_text, print_comparison, say_how_to_keep
    from hiltest.verdict.evidence_reader import read_evidence

    evidence = [read_evidence(each) for each in new]
    comparisons = _compared(base, evidence)
    if as_json:
        click.echo(json_text(comparisons), nl=False)
    else:
        from hiltest.report.console import standard_output

        for each in comparisons:
            print_comparison(standard_output(), each)
            say_how_to_keep(standard_output(), each, each.new.file)
    codes = {comparison_code(each) for each in comparisons}
    return next(code for code in ExitCode if code in codes)  # they stand in the order in which they win


def _compared(base: Path, evidence: list[Evidence]) -> list[Comparison]:
    """Compare with the base; a base that cannot be read is a gate that is not evaluated, and no usage error."""
    from hiltest.verdict.compare import compare as compare_sides
    from hiltest.verdict.compare import not_compared
    from hiltest.verdict.evidence_reader import read_evidence

    try:
        before = read_evidence(base)
    except ConfigError as error:
        return [not_compared(str(base), str(error), each) for each in evidence]
    return [compare_sides(before, each) for each in evidence]
