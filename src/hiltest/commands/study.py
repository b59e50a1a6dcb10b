"""``hiltest study``: repeat the experiments of the papers."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from hiltest.commands.options import documented, jobs_option, load_named_rig, parsed, setting_option
from hiltest.session.settings import DEFAULT_OUT, file_name
from hiltest.studies import NAMES

if TYPE_CHECKING:
    from hiltest.studies.study import Plan
    from hiltest.studies.study_page import StudyDocument

_EXIT_CODES = """
\b
Exit codes:
  0   finished, whether figures were reproduced or not
  1   a worker's process died
  2   interrupted; repeat the command to continue
  4   usage: an option is wrong, or the folder is in use or has another study
  20  the scheduler does not answer, has no workers, or lost them
"""
_FEWEST_POINTS = 10  # one more than the unknowns: a quadric passes exactly through nine points


def _plan_choice(
    plan: Plan,
    points: int | None,
    rig: str | None,
    noise_ut: float | None,
    coverage_percent: float,
    cycles: int | None,
) -> Plan:
    """Return a plan with the conditions of the options or, for options that are not set, of the rig."""
    from hiltest.studies.study import Conditions

    described = load_named_rig(rig)
    noise_ut = noise_ut or described.sensors.magnetometer_noise_ut
    conditions = Conditions(described.field.strength_ut, noise_ut, coverage_percent, cycles)
    return replace(plan, points=points or described.procedure.calibration_points, conditions=conditions)


class _Percentage(click.FloatRange):
    """A percentage; a share of 1 is refused with the percentage that it is."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the percentage."""
        with suppress(ValueError):
            if 0.0 < float(value) <= 1.0:
                self.fail(f"{value} is a share of 1; write {100.0 * float(value):g} for percent.", param, ctx)
        return float(super().convert(value, param, ctx))


def _is_given(option: str) -> bool:
    return click.get_current_context().get_parameter_source(option) is ParameterSource.COMMANDLINE


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.study/1")
@click.argument("name", metavar="NAME", type=click.Choice(NAMES))
@click.option(
    "--instances",
    metavar="N",
    type=click.IntRange(1, 1_000_000_000),
    help="Run this many instances of each condition, such as a noise level.  [default: as in the paper]",
)
@click.option(
    "--points",
    metavar="N",
    type=click.IntRange(_FEWEST_POINTS, 100_000),
    help="Use this many points in each instance.  [default: the study's]",
)
@setting_option("rig", help="Take field, noise and points for choose from this rig.")
@click.option(
    "--noise",
    "noise_ut",
    metavar="UT",
    type=click.FloatRange(1e-3, 50.0),
    help="Set the standard deviation of points per axis for choose.  [default: the rig's]",
)
@click.option(
    "--coverage",
    "coverage_percent",
    metavar="PERCENT",
    type=_Percentage(10.0, 100.0),
    default=50.0,
    show_default=True,
    help="Set the smallest covered share of the sphere for choose.",
)
@click.option(
    "--cycles",
    metavar="N",
    type=click.IntRange(1),
    help="Set the largest number of cycles of a calibration for choose.",
)
@setting_option("firmware", help="Run the calibrators of this ELF as methods of the study, too.")
@click.option(
    "--calibrator",
    "calibrators",
    metavar="NAME",
    multiple=True,
    help="Run this method, too: a float64 reference, a calibrator of an installed package, or FILE:FUNCTION as in "
    "hiltest judge. Can be repeated.",
)
@setting_option("seed", default="1", fallback="1", help="Set the seed; the same seed gives the same numbers.")
@jobs_option()
@click.option(
    "--out",
    metavar="DIR",
    callback=parsed(file_name),
    help=f"Write run.json and study.html to this folder.  [default: {DEFAULT_OUT}/study-NAME]",
)
def study(
    name: str,
    instances: int | None,
    points: int | None,
    rig: str | None,
    noise_ut: float | None,
    coverage_percent: float,
    cycles: int | None,
    firmware: Path | None,
    calibrators: tuple[str, ...],
    seed: int,
    jobs: int | str | None,
    out: str | None,
) -> tuple[int, StudyDocument]:
    """Repeat an experiment of a paper and compare its figures.

    \b
    budget        error against clock cycles of each calibrator on the board
    choose        the best calibrator on the board for your conditions
    compensation  offset and sensitivity errors that the direct fit removes
    constraints   effect of ellipsoid constraints on the fitted ellipsoid
    dpi           effect of gravity on heading, pitch and roll of the fits
    ellipsoids    how often the direct fit is not an ellipsoid, over noise
    estimators    direction errors after each calibrator
    float32       stability of the calibrators in float32, over hard iron
    imu           errors of an IMU that remain after its calibrations
    """
    from hiltest.commands.options import ErrorOutput
    from hiltest.judge.entries import open_calibrators
    from hiltest.processes import asked_to_end
    from hiltest.session.progress_line import ProgressLine
    from hiltest.session.settings import make_folder
    from hiltest.studies.methods import add_methods
    from hiltest.studies.study import Plan, PrintedFigure, study_of
    from hiltest.studies.study_page import PAGE_FILE, StudyDocument, method_lines, printed_rows, study_table
    from hiltest.studies.study_run import run_study

    chosen = study_of(name)
    plan = Plan(name, seed, instances or chosen.instances, points or chosen.points)
    plan = add_methods(plan, firmware, open_calibrators(calibrators))
    if name == "choose":
        plan = _plan_choice(plan, points, rig, noise_ut, coverage_percent, cycles)
    elif any(_is_given(option) for option in ("rig", "noise_ut", "coverage_percent", "cycles")):
        raise click.UsageError("--rig, --noise, --coverage and --cycles are for the study choose")
    if points is not None and not chosen.points:
        raise click.UsageError(f"the study {name} has fixed numbers of points: leave out --points")
    if plan.points > chosen.most_points:
        raise click.UsageError(
            f"the study {name} accepts at most {chosen.most_points} points, the capacity of the board"
        )
    folder = Path(out or f"{DEFAULT_OUT}/study-{name}")
    make_folder(folder)
    progress = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty(), say=lambda line: click.echo(line, err=True))
    with asked_to_end() as came:
        try:
            run = run_study(
                plan, folder, jobs=jobs or os.cpu_count() or 1, progress=progress, asked_to_end=lambda: bool(came)
            )
        except KeyboardInterrupt:
            progress.clear()
            click.echo(f"{folder} keeps the finished parts: repeat the command to continue", err=True)
            raise
    figures = []
    for figure, paper, printed, measured, answer, why in printed_rows(chosen, run):
        reproduced = {"yes": True, "no": False}.get(answer)
        figures.append(PrintedFigure(figure, paper, printed, measured, reproduced, why))
        word = {True: "reproduced", False: "not reproduced", None: "undecided"}[reproduced]
        click.echo(f"{paper}: {figure}: printed {printed}, measured {measured}: {word}: {why}")
    for line in method_lines(chosen, run, plan.methods):
        click.echo(line)
    click.echo(f"{folder}: run.json, {PAGE_FILE}")
    click.echo(run.verdict.sentence)
    return 0, StudyDocument(str(folder), figures, study_table(chosen, run), run.verdict)
