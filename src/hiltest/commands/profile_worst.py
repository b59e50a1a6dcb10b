"""``hiltest profile worst``: search for the input with the most cycles of a function."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hiltest.commands.options import NumberRange, documented, setting_option
from hiltest.session.settings import DEFAULT_OUT, make_folder

if TYPE_CHECKING:
    from hiltest.studies.worst_case.search import Budget, Problem, SearchResult
    from hiltest.studies.worst_case.worst_input import WorstCase

_FEWEST_POINTS, _MOST_POINTS = 9, 512  # unknowns of an ellipsoid, and capacity of the firmware's buffer
_SECONDS = 60.0
_EPILOG = """
\b
Arguments as for hiltest profile; the search varies ranges of numbers:
  0..100          a whole number from 0 to 100
  -1.0..2.5       a number
  int16:50:-9..9  fifty numbers by address (int8 to uint64, float32, float64)

\b
Exit codes:
  0   searched; or replayed with the saved cycles, or on another build
  1   no call succeeded; or the same build takes other cycles than saved
  2   interrupted; the worst input so far is saved
  4   usage: an option, an argument, the ELF or a saved file is wrong
  20  the function faulted or hung
"""


# Unknown options are allowed, since a negative number is an argument of the function.
@dataclass(frozen=True, slots=True)
class Worst:
    """A search for the most cycles of a function, or a call with a saved input."""

    call: str
    """Short description of function and input."""
    cycles: int | None
    """Cycles of the worst call; null if none succeeded."""
    cycle_model: str
    """Cycle model of the counts."""
    file: str | None
    """File with the saved input."""
    calls: int | None = None
    """Number of calls of the search; null for a call with a saved input."""
    refused_cycles: int | None = None
    """Most cycles of a call that did not succeed."""
    kept_cycles: int | None = None
    """Saved cycles, for a call with a saved input."""
    same_build: bool = True
    """True if the saved cycles belong to this ELF."""


@click.command(epilog=_EPILOG, context_settings={"ignore_unknown_options": True})
@documented("hiltest.worst/1")
@setting_option("firmware", help="Take the function from this program for a Cortex-M4.")
@click.option(
    "--seconds", metavar="S", type=NumberRange(0.1, 1e6), help=f"Search for this time.  [default: {_SECONDS:g}]"
)
@click.option(
    "--calls",
    metavar="N",
    type=click.IntRange(1, 1_000_000_000),
    help="Search with this many calls, reproducibly for the same seed.",
)
@setting_option("seed", default="1", fallback="1", help="Set the seed of the search.")
@click.option(
    "--points",
    metavar="N",
    type=click.IntRange(_FEWEST_POINTS, _MOST_POINTS),
    default=100,
    show_default=True,
    help="Pass at most this many points to a calibrator.",
)
@click.option(
    "--returns", metavar="LOW..HIGH", help="Count only calls that return a value in this range.  [default: any value]"
)
@click.option(
    "--out",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help=f"Save the input to this file.  [default: {DEFAULT_OUT}/worst-FUNCTION.json]",
)
@click.option(
    "--replay",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Repeat the call of a saved file, and compare the cycles.",
)
@click.argument("function", required=False)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def profile_worst(
    function: str | None,
    arguments: tuple[str, ...],
    firmware: Path | None,
    seconds: float | None,
    calls: int | None,
    seed: int,
    points: int,
    returns: str | None,
    out: Path | None,
    replay: Path | None,
) -> tuple[int, Worst]:
    """Search for the input that takes the most cycles.

    FUNCTION is a calibrator of the firmware, which is called with sets of points, or any function, which is called with
    ARGUMENTS.
    """
    from hiltest.boards import default_firmware
    from hiltest.path_names import path_in
    from hiltest.processes import asked_to_end
    from hiltest.run_record.files import write_asked_for
    from hiltest.studies.worst_case.search import Budget
    from hiltest.studies.worst_case.worst_input import to_json

    elf = firmware or default_firmware()
    if replay is not None:
        if function is not None:
            raise click.UsageError("the file of --replay has function and input: leave out FUNCTION and ARGUMENTS")
        return _replay(replay, elf)
    if function is None:
        raise click.UsageError("name a FUNCTION, or --replay FILE")
    if seconds is not None and calls is not None:
        raise click.UsageError("--seconds and --calls exclude each other: leave one of them out")
    name = f"worst-{function}.json"
    file = out or path_in(Path(DEFAULT_OUT), name, remedy="name the file with --out")
    problem = _problem(elf, function, arguments, points, returns)
    if out is None:
        make_folder(file.parent)
    with asked_to_end() as came:
        budget = Budget(calls, None if calls else seconds or _SECONDS, lambda: bool(came))
        result, case, summary = _run_search(problem, budget, seed, elf, function)
    click.echo(summary)
    if case is None:
        return 1, Worst(function, None, "", None, result.calls, result.refused_cycles)
    write_asked_for(file, to_json(case))
    click.echo(f"saved in {file}; repeat with: hiltest profile worst --replay {file}{_option(firmware)}")
    document = Worst(case.description, case.cycles, case.cycle_model, str(file), result.calls, result.refused_cycles)
    return 2 if came else 0, document


def _option(firmware: Path | None) -> str:
    return "" if firmware is None else f" --firmware {firmware}"


def _problem(elf: Path, function: str, arguments: tuple[str, ...], points: int, returns: str | None) -> Problem[Any]:
    from hiltest.studies.board_calibrators import BoardCalibrators
    from hiltest.studies.worst_case.argument_ranges import ArgumentRanges, parse_range
    from hiltest.studies.worst_case.point_sets import PointSets

    if not arguments and function in (calibrators := BoardCalibrators(elf)).names:
        return PointSets(calibrators, function, points)
    return ArgumentRanges(elf, function, arguments, parse_range(returns) if returns else None)


def _run_search(
    problem: Problem[Any], budget: Budget, seed_number: int, elf: Path, function: str
) -> tuple[SearchResult[Any], WorstCase | None, str]:
    """Return the result, the case to save, and a summary; nothing is saved if no call succeeded."""
    from hiltest.commands.options import ErrorOutput
    from hiltest.session.progress_line import ProgressLine
    from hiltest.studies.worst_case.search import search
    from hiltest.studies.worst_case.worst_input import worst_case
    from hiltest.text import format_number

    line = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty(), say=lambda text: click.echo(text, err=True))

    def progress(calls: int, elapsed_s: float, cycles: int) -> None:
        note = f"{format_number(cycles)} cycles so far"
        if budget.calls is not None:
            line(f"{function}: call", calls, budget.calls, note)
        elif budget.seconds is not None:
            line(f"{function}: second", int(elapsed_s), math.ceil(budget.seconds), note)

    result = search(problem, seed=seed_number, budget=budget, progress=progress)
    line.clear()
    searched = f"{format_number(result.calls)} calls, {result.elapsed_s:.0f} s, seed {seed_number}"
    refused = "" if result.refused_cycles is None else f"; refused calls at most {format_number(result.refused_cycles)}"
    if not result.call.counts:
        return result, None, f"{function}: none of {searched} succeeded{refused}"
    case = worst_case(result, problem.saved_fields(result.worst_input), elf, function, seed_number)
    summary = (
        f"{case.description}: {format_number(case.cycles)} cycles at most ({case.cycle_model}; {searched}{refused})"
    )
    return result, case, summary


def _replay(file: Path, elf: Path) -> tuple[int, Worst]:
    from hiltest.studies.worst_case.worst_input import digest, load_worst_case
    from hiltest.text import format_number

    case = load_worst_case(file)
    call, cycle_model = case.replay(elf)
    now = f"{case.description}: {format_number(call.cycles)} cycles ({cycle_model})"
    if not call.counts:
        now += f"; refused, with {call.returned}"
    is_same_build = digest(elf) == case.elf_sha256
    document = Worst(
        case.description, call.cycles, cycle_model, str(file), kept_cycles=case.cycles, same_build=is_same_build
    )
    if (call.cycles, cycle_model, call.counts) == (case.cycles, case.cycle_model, True):
        click.echo(f"{now}, the saved count{'' if is_same_build else f', on another build than {case.elf}'}")
        return 0, document
    saved = f"{format_number(case.cycles)} ({case.cycle_model})"
    if is_same_build and cycle_model == case.cycle_model:
        click.echo(f"{now}; saved were {saved} of the same build, by hiltest {case.hiltest}")
        return 1, document
    why = "the same build by another cycle model" if is_same_build else f"another build, {case.elf}"
    click.echo(f"{now}; saved were {saved} of {why}")
    return 0, document
