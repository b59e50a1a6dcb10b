"""``hiltest judge``: judge any calibrator against the bound and against the clock."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hiltest.commands.options import documented, parsed
from hiltest.session.settings import DEFAULT_OUT, file_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from hiltest.judge.judgement import JudgeDocument
    from hiltest.judge.worlds import World
    from hiltest.orientation.motion_recording import MotionRecording
    from hiltest.session.progress_line import ProgressLine

_EXIT_CODES = """
\b
FILE is one of:
  mine.c, mine.cpp     a source, compiled for the Cortex-M4 and for this host
  mine.elf             any program for a Cortex-M4; --function names its function
  libmine.so           a shared library of this host
  mine.py:calibrate    a Python function: samples in, (hard_iron, soft_iron) out
  mine.py:Filter       a Python class with update and quaternion, or heading

\b
Exit codes:
  0   judged, and every --limit holds
  1   a --limit does not hold, or no answer in any world is accepted
  2   interrupted
  4   usage: an option or the file is wrong, or a host function fails
  20  the function faults or hangs on the virtual core
  21  regression: more error, more cycles or more refusals than --against
  22  a --limit names a value that was not measured
"""


@click.command(epilog=_EXIT_CODES)
@documented("hiltest.judge/1")
@click.argument("file", required=False)
@click.option("--function", metavar="NAME", help="Judge this function of the file.  [default: calibrate]")
@click.option(
    "--signature",
    metavar="FILE.toml",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Use this table to call functions with another signature.",
)
@click.option(
    "--part", metavar="NAME|FILE", help="Compile a source for this chip, or count an ELF with its memories and timing."
)
@click.option("--against", metavar="FILE", help="Compare with this calibrator, in the same worlds.")
@click.option(
    "--limit",
    "limits",
    metavar="NAME=MOST",
    multiple=True,
    help="Fail if a value is larger, such as bound.p99=1.5 or cycles=20000. Can be repeated.",
)
@click.option("--alone", is_flag=True, help="Show the judged calibrators only, without those of hiltest.")
@click.option(
    "--recording",
    "recordings",
    metavar="FILE.npz",
    type=click.Path(path_type=Path, dir_okay=False),
    multiple=True,
    help="Judge a filter on this recorded motion with a true attitude. Can be repeated.",
)
@click.option(
    "--init",
    metavar="FILE.c",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write a calibrator to begin with, and hiltest_judge.h beside it, and do nothing else.",
)
@click.option(
    "--out",
    metavar="DIR",
    callback=parsed(file_name),
    help=f"Write judge.json and judge.html to this folder.  [default: {DEFAULT_OUT}/judge]",
)
def judge(
    file: str | None,
    function: str | None,
    signature: Path | None,
    part: str | None,
    against: str | None,
    limits: tuple[str, ...],
    alone: bool,
    recordings: tuple[Path, ...],
    init: Path | None,
    out: str | None,
) -> tuple[int, JudgeDocument]:
    """Judge a calibrator or a filter by its errors and cycles.

    A calibrator calibrates in 600 simulated worlds whose truth is known. A filter follows a simulated or a recorded
    motion.
    """
    from hiltest import __version__
    from hiltest.commands.options import ErrorOutput
    from hiltest.judge.build import HEADER
    from hiltest.judge.entries import is_filter, is_python, open_entry, open_filter, open_foreign
    from hiltest.judge.judgement import JudgeDocument, document
    from hiltest.judge.judgement import judge as judge_entry
    from hiltest.judge.own_calibrators import own_calibrators
    from hiltest.judge.signature_table import read_signature_table
    from hiltest.judge.worlds import FAMILIES, WORLDS
    from hiltest.session.progress_line import ProgressLine
    from hiltest.session.settings import make_folder

    if init is not None:
        _write_template(init)
        sentence = f"{init} and {HEADER} are written; judge it with: hiltest judge {init}"
        click.echo(sentence)
        return 0, JudgeDocument(__version__, sentence, 0, (), (), None)
    if file is None:
        raise click.UsageError("name a FILE, or --init FILE.c to begin with one")
    if signature is not None and function is not None:
        raise click.UsageError(f"--function: the functions are those of {signature}; leave one option out")
    largest = dict(map(_limit, limits))
    if signature is not None and is_python(file):
        raise click.UsageError(f"{file}: --signature is for C and C++; in Python, write a function of the contract")
    table = None if signature is None else read_signature_table(signature)
    judges_filter = table[0].is_filter if table else bool(recordings) or is_filter(file, function)
    if recordings and not judges_filter:
        raise click.UsageError(f"--recording: {signature} describes a calibrator; leave one option out")

    def opened(named: str) -> Any:
        if table is not None and not is_python(named):
            return open_foreign(named, table, part)
        return open_filter(named) if judges_filter else open_entry(named, function, part)

    folder = Path(out or f"{DEFAULT_OUT}/judge")
    make_folder(folder)
    progress = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty(), say=lambda line: click.echo(line, err=True))
    files = {"judged": file} | ({} if against is None else {"against": against})
    if judges_filter:
        return _written(_judge_filters(files, opened, recordings, largest, alone, progress), folder)
    with ExitStack() as stack:
        entries = [(stack.enter_context(opened(named)), role) for role, named in files.items()]
        entries += [] if alone else [(entry, "hiltest") for entry in own_calibrators()]
        total, done = len(entries) * WORLDS * len(FAMILIES), count()
        judged = []
        for entry, role in entries:
            progress_of = partial(_show_world, progress, done, total, entry.name)
            judged.append(judge_entry(entry, role, progress_of))
    progress.clear()
    other = judged[1] if against is not None else None
    return _written(document(judged[0], judged[len(files) :], largest, other), folder)


def _judge_filters(
    files: Mapping[str, str],
    opened: Callable[[str], Any],
    recordings: Sequence[Path],
    limits: Mapping[str, float],
    alone: bool,
    progress: ProgressLine,
) -> JudgeDocument:
    from hiltest.judge.filter_scores import judge_filter
    from hiltest.judge.filters import OwnFilter
    from hiltest.judge.judgement import filter_document
    from hiltest.judge.motions import simulated_motion
    from hiltest.orientation.motion_recording import read_motion_recording

    motions = [read_motion_recording(file) for file in recordings] or [simulated_motion()]
    with ExitStack() as stack:
        filters = [(stack.enter_context(opened(named)), role) for role, named in files.items()]
        filters += [] if alone else [(OwnFilter(), "hiltest")]
        total, done, results = len(filters) * len(motions), count(), []
        for filter_, role in filters:
            progress_of = partial(_show_motion, progress, done, total, filter_.name)
            results.append(judge_filter(filter_, role, motions, progress_of))
    progress.clear()
    return filter_document(results, limits)


def _written(result: JudgeDocument, folder: Path) -> tuple[int, JudgeDocument]:
    from hiltest.judge.judge_tables import JSON_FILE, PAGE_FILE, page, print_tables
    from hiltest.report.console import standard_output
    from hiltest.run_record.files import write_asked_for, write_document

    write_document(folder / JSON_FILE, result, "hiltest.judge/1")
    write_asked_for(folder / PAGE_FILE, page(result))
    print_tables(standard_output(), result)
    click.echo(f"{folder}: {JSON_FILE}, {PAGE_FILE}")
    click.echo(result.sentence)
    return result.exit_code, result


def _write_template(file: Path) -> None:
    from hiltest.judge.build import HEADER, header_folder

    if file.exists():
        raise click.UsageError(f"{file} exists and is not overwritten; name another file")
    for source, target in (("template.c", file), (HEADER, file.with_name(HEADER))):
        target.write_text((header_folder() / source).read_text(encoding="utf-8"), encoding="utf-8")


def _limit(text: str) -> tuple[str, float]:
    name, equals, most = text.partition("=")
    try:
        value = float(most)
    except ValueError:
        value = math.nan
    if not equals or not math.isfinite(value):
        raise click.UsageError(f"--limit {text}: write NAME=MOST, such as bound.p99=1.5")
    return name.strip(), value


def _show_world(progress: ProgressLine, done: Iterator[int], total: int, name: str, _world: World) -> None:
    progress("judging", next(done), total, name)


def _show_motion(progress: ProgressLine, done: Iterator[int], total: int, name: str, motion: MotionRecording) -> None:
    progress("judging", next(done), total, f"{name}, {motion.name}")
