"""``hiltest study``: the experiments of the papers."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from hiltest.commands.options import checked, jobs_option
from hiltest.settings import DEFAULT_OUT, file_name, seed
from hiltest.studies import NAMES

_EXIT_CODES = """
\b
Exit codes:
  0   finished, whatever was reproduced
  1   a worker's process died
  2   interrupted; the same command goes on from what is done
  4   usage: an option is wrong, or the folder is in use or of another study
  20  the scheduler does not answer, has no workers, or lost them
"""
_FEWEST_POINTS = 10  # one more than unknowns: through nine a quadric goes without noise


@click.command(epilog=_EXIT_CODES)
@click.argument("name", type=click.Choice(NAMES))
@click.option("--instances", metavar="N", type=click.IntRange(1, 1_000_000_000),
              help="Instances of each condition, such as a noise level.  [default: as in the paper]")
@click.option("--points", metavar="N", type=click.IntRange(_FEWEST_POINTS, 100_000),
              help="Points of each instance.  [default: the study's]")
@click.option("--seed", "seed_text", metavar="S", default="1", show_default=True, callback=checked(seed),
              help="Seed: the same gives the same numbers, whatever the jobs.")
@jobs_option()
@click.option("--out", metavar="DIR", callback=checked(file_name),
              help=f"Folder for run.json and study.html.  [default: {DEFAULT_OUT}/study-NAME]")
def study(
    name: str, instances: int | None, points: int | None, seed_text: str, jobs: int | str | None, out: str | None
) -> int:
    """Run an experiment of a paper again, and compare.

    \b
    compensation  how much offset and sensitivity error the direct fit takes out
    constraints   whether fits kept to ellipsoids leave better ellipsoids
    dpi           what gravity adds to ellipsoid fits, in heading, pitch and roll
    ellipsoids    how often the direct fit is no ellipsoid, as noise grows
    estimators    how far directions err after each calibrator
    """
    from hiltest.commands.options import ErrorOutput, asked_to_end
    from hiltest.progress_line import ProgressLine
    from hiltest.settings import make_folder
    from hiltest.studies.page import PAGE_FILE, printed_rows
    from hiltest.studies.run import run_study
    from hiltest.studies.study import Plan, study_of

    chosen = study_of(name)
    plan = Plan(name, seed(seed_text), instances or chosen.instances, points or chosen.points)
    folder = Path(out or f"{DEFAULT_OUT}/study-{name}")
    make_folder(folder)
    progress = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty(), say=lambda line: click.echo(line, err=True))
    with asked_to_end() as came:
        try:
            run = run_study(plan, folder, jobs=jobs or os.cpu_count() or 1, progress=progress,
                            asked_to_end=lambda: bool(came))  # fmt: skip
        except KeyboardInterrupt:
            progress.clear()
            click.echo(f"what is done is kept in {folder}: the same command goes on from there", err=True)
            raise
    for figure, paper, printed, measured, reproduced, why in printed_rows(chosen, run):
        word = "reproduced" if reproduced == "yes" else "not reproduced"
        click.echo(f"{paper}: {figure}: printed {printed}, measured {measured}: {word}: {why}")
    click.echo(f"{folder}: run.json, {PAGE_FILE}")
    click.echo(run.verdict.sentence)
    return 0
