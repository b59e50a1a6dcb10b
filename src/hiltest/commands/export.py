"""``hiltest export``: write a run's numbers for other tools."""

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
  4   usage: there is no record, no number for this format, or the file
      cannot be written
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
    help="bencher: Bencher Metric Format. github-action-benchmark: the list for its custom tools.",
)
@click.option(
    "--better",
    type=click.Choice(["smaller", "larger"]),
    help="For github-action-benchmark: smaller for customSmallerIsBetter, larger for customBiggerIsBetter."
    "  [default: smaller]",
)
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="File to write.  [default: standard output]",
)
def export(run: Path, form: str, better: str | None, out: Path | None) -> tuple[int, ExportedNumbers]:
    """Write the numbers of a run as JSON for dashboards.

    RUN is a run.json, its folder, the folder of a campaign or a baseline. Measurements that should be near zero are
    exported as their magnitude; those without a better direction, such as a worst sector, are left out. Several seeds
    give mean, smallest and largest.
    """
    from hiltest.json_files import json_text
    from hiltest.report.exports import bencher_metrics, exported, github_action_entries
    from hiltest.run_record.files import write_document
    from hiltest.verdict.evidence_reader import read_evidence

    if form == "bencher" and better is not None:
        raise click.UsageError("--better is for github-action-benchmark: a file for Bencher holds both")
    evidence = read_evidence(run)
    for fault in evidence.faults:
        click.echo(fault, err=True)
    numbers = exported(evidence.measurements)
    selected = [number for number in numbers if form == "bencher" or number.larger_is_better == (better == "larger")]
    if not selected:
        way = f"better when {better or 'smaller'}" if form != "bencher" else "better one way than the other"
        raise ConfigError(f"{run}: no number in it is {way}")
    if len(selected) < len(numbers):
        other = "smaller" if better == "larger" else "larger"
        click.echo(f"{len(numbers) - len(selected)} others are better when {other}: --better {other}", err=True)
    content = bencher_metrics(selected) if form == "bencher" else github_action_entries(selected)
    if out is None:
        click.echo(json_text(content))
    else:
        write_document(out, content)
        click.echo(f"{out}: {len(selected)} numbers", err=True)
    file = None if out is None else str(out)
    return 0, ExportedNumbers(form, len(selected), file, content)
