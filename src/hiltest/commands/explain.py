"""``hiltest explain``: cause and evidence of a verdict, and the source lines that cost more."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import documented, setting_option

if TYPE_CHECKING:
    from hiltest.campaigns.explanation import Explanation

_EXIT_CODES = """
\b
Exit codes:
  0   explained, whatever the verdict
  2   interrupted
  4   usage: a record or an ELF is missing, or the ELF is not that of the run
  20  a calibrator faulted or hung
"""
_SHOWN = 12


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.explanation/1")
@click.argument("run", type=click.Path(path_type=Path))
@setting_option("baseline", help="Compare with this baseline, or record of a run.", fallback="the run's own base")
@setting_option("firmware", help="Show the lines of this ELF, which the run executed.")
@click.option(
    "--against",
    metavar="ELF",
    type=click.Path(path_type=Path),
    help="Compare its lines with those of this ELF, which the base executed.  [default: the packaged one]",
)
def explain(run: Path, baseline: Path | None, firmware: Path | None, against: Path | None) -> tuple[int, Explanation]:
    """Explain a run by cause, evidence and source lines.

    RUN is the folder of a run, or a run.json. If the cycles of a calibrator changed, its function is called in both
    ELFs; functions that the rig counts run in both, in a tumble of 20 s. The source lines are listed that cost more or
    less.
    """
    from hiltest.campaigns import explanation
    from hiltest.verdict.wording import entry

    document = explanation.explain(run, baseline, firmware, against)
    click.echo(document.sentence)
    for title, texts in (("Likely cause", document.causes), ("Next", document.next_steps)):
        for text in texts:
            click.echo(f"{title}: {text}")
    for change in document.changes[:_SHOWN]:
        click.echo(f"  {change.change:<9}  {entry(change)}")
    for function in document.functions:
        click.echo(f"{function.function}: {function.base_cycles} -> {function.cycles} cycles ({function.cycle_model})")
        for line in function.lines[:_SHOWN]:
            click.echo(f"  {line.delta:+9d}  {line.location}  ({line.base_cycles} -> {line.cycles} cycles)")
    if document.remark:
        click.echo(f"No source lines: {document.remark}.")
    return 0, document
