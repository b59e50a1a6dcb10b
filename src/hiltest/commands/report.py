"""``hiltest report``: write the reports of a record again."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import documented
from hiltest.errors import ConfigError

if TYPE_CHECKING:
    from hiltest.report.render import Reported
    from hiltest.run_record.reader import RecordFile

_EXIT_CODES = """
\b
Exit codes:
  0   written, whatever the verdict
  2   interrupted
  4   usage: the record is missing or unreadable, or the folder is read-only
"""
# A run can begin or finish while this command reads its folder.
_TRIES = 3


@click.command(epilog=_EXIT_CODES)
@click.argument("record", metavar="DIR|FILE", type=click.Path(path_type=Path))
@documented("hiltest.report/1")
@click.option(
    "--out",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Write run.json and the reports to this folder.  [default: the record's]",
)
def report(record: Path, out: Path | None) -> tuple[int, Reported]:
    """Write the reports of a run again and print its verdict.

    DIR is the folder of a run, FILE a run.json. If the run was cut short or is still running, the reports say so and
    show the finished tests.
    """
    from hiltest.report.render import Reported
    from hiltest.run_record.reader import read_record

    folder = record if record.is_dir() else record.parent
    if out is None or out.resolve() == folder.resolve():
        stored = _rewrite_reports(record, folder)
    else:
        stored = read_record(record)
        _copy_record(stored, out)
    click.echo(f"{out or folder}: report.html, report.md")
    click.echo(stored.run.verdict.sentence)
    return 0, Reported(str(out or folder), ["report.html", "report.md"], stored.run.verdict)


def _rewrite_reports(record: Path, folder: Path) -> RecordFile:
    """Write the reports beside the record, and again if a run began or finished there meanwhile."""
    from hiltest.run_record.reader import read_record

    for _ in range(_TRIES):
        before = _state(folder)
        stored = read_record(record)
        _render(stored, folder)
        if _state(folder) == before:
            break
    return stored


def _copy_record(stored: RecordFile, out: Path) -> None:
    """Write the whole record into a folder of its own, and replace an earlier record there."""
    from hiltest.run_record.files import RUN_FILE, write_atomically
    from hiltest.run_record.journal import Journal
    from hiltest.run_record.run_json import content_to_json
    from hiltest.session.settings import make_folder

    make_folder(out)
    claim = Journal(out)
    try:
        claim.begin()
        write_atomically(out / RUN_FILE, content_to_json(stored.file.content))
        _render(stored, out)
        claim.finish()
    finally:
        claim.release()


def _render(stored: RecordFile, folder: Path) -> None:
    import numpy as np

    from hiltest.report.render import write_reports

    try:
        with np.errstate(all="ignore"):  # numbers that are not finite cause no warnings; they are drawn at some place
            write_reports(stored.run, folder)
    except OSError as error:
        raise ConfigError(f"cannot write to {folder}: {error.strerror}; name another folder with --out") from error
    except (LookupError, TypeError, ValueError, ArithmeticError) as error:
        # The plots read tables by column: a file may be a valid record, and have tables with other contents.
        raise ConfigError(f"{stored.file.path}: cannot be drawn: {type(error).__name__}: {error}") from error


def _state(folder: Path) -> tuple[int | None, bool | None]:
    """Return the finished record in a folder, and whether a run goes on there; None for a missing file."""
    from hiltest.run_record.files import RUN_FILE
    from hiltest.run_record.journal import JOURNAL_FILE, is_going_on

    record: int | None = None
    going_on: bool | None = None
    with suppress(FileNotFoundError):
        record = (folder / RUN_FILE).stat().st_ino
    with suppress(FileNotFoundError):
        going_on = is_going_on(folder / JOURNAL_FILE)
    return record, going_on
