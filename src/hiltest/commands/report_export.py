"""``hiltest report export``: write a run's numbers for other tools."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from hiltest.commands.options import documented
from hiltest.errors import ConfigError

_EXIT_CODES = """
\b
Exit codes:
  0   written, whatever the verdict of the run
  2   interrupted
  4   usage: the record is missing, has no number for this format, or the
      file cannot be written
"""


@dataclass(frozen=True, slots=True)
class ExportedNumbers:
    """Numbers for another tool."""

    format: str
    """Requested format."""
    numbers: int
    """Number of exported numbers."""
    file: str | None
    """File that was written; null if none was requested."""
    content: dict[str, Any] | list[Any]
    """Content for the other tool."""


@click.command(epilog=_EXIT_CODES)
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@documented("hiltest.export/1")
@click.option(
    "--format",
    "form",
    required=True,
    type=click.Choice(["bencher", "github-action-benchmark"]),
    help="Write Bencher Metric Format, or the list for custom tools of github-action-benchmark.",
)
@click.option(
    "--better",
    type=click.Choice(["smaller", "larger"]),
    help="Select the numbers for customSmallerIsBetter or customBiggerIsBetter of github-action-benchmark."
    "  [default: smaller]",
)
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write to this file.  [default: standard output]",
)
def report_export(run: Path, form: str, better: str | None, out: Path | None) -> tuple[int, ExportedNumbers]:
    """Write the numbers of a run as JSON for dashboards.

    RUN is a run.json, its folder, the folder of a campaign or a baseline. Measurements that should be near zero are
    exported as magnitudes; measurements without a better direction, such as a worst sector, are omitted. Several
    seeds are exported as mean, smallest and largest value.
    """
    from hiltest.json_files import json_text
    from hiltest.report.exports import bencher_metrics, exported, github_action_entries
    from hiltest.run_record.files import write_document
    from hiltest.verdict.evidence_reader import read_evidence

    if form == "bencher" and better is not None:
        raise click.UsageError(
            "--better is for github-action-benchmark, since a file for Bencher has both: leave it out"
        )
    evidence = read_evidence(run)
    for fault in evidence.faults:
        click.echo(fault, err=True)
    numbers = exported(evidence.measurements)
    selected = [number for number in numbers if form == "bencher" or number.larger_is_better == (better == "larger")]
    if not selected:
        direction = f" that is better when {better or 'smaller'}" if form != "bencher" else " with a better direction"
        raise ConfigError(f"{run}: the run has no number{direction}")
    if len(selected) < len(numbers):
        other = "smaller" if better == "larger" else "larger"
        click.echo(
            f"{len(numbers) - len(selected)} numbers are better when {other}: --better {other} exports them", err=True
        )
    content = bencher_metrics(selected) if form == "bencher" else github_action_entries(selected)
    if out is None:
        click.echo(json_text(content))
    else:
        write_document(out, content)
        click.echo(f"{out}: {len(selected)} numbers", err=True)
    file = None if out is None else str(out)
    return 0, ExportedNumbers(form, len(selected), file, content)
