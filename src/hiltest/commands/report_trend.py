"""``hiltest report trend``: each measurement over the runs of a folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import json_option, print_document
from hiltest.errors import ConfigError

if TYPE_CHECKING:
    from hiltest.report.trend import Skipped

_EXIT_CODES = """
\b
Exit codes:
  0   shown, whatever the numbers are
  2   interrupted
  4   usage: the folder is missing or has no run, or the page cannot be
      written
"""
_NAMED_AT_MOST = 20


@click.command(epilog=_EXIT_CODES)
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--html",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the plots to this page.  [default: trend.html in DIR; with --json none]",
)
@click.option("--all", "every", is_flag=True, help="Show also measurements without a limit or a change point.")
@json_option("hiltest.trend/1")
def report_trend(folder: Path, html: Path | None, every: bool, as_json: bool) -> None:
    """Plot each measurement over all runs in a folder.

    DIR and its subfolders are searched for runs, campaigns and baselines. A change point is a run in which a
    measurement moved by more than its tolerance; only runs with the same rig, cycle model and seeds are compared. Other
    files are listed and skipped.
    """
    from hiltest.report.trend import read_folder, trend_of
    from hiltest.report.trend.outputs import print_trend, trend_document, trend_page
    from hiltest.run_record.files import write_asked_for

    entries, skipped = read_folder(folder)
    if not entries:
        raise ConfigError("\n".join([f"{folder} has no run", *map(_skipped_line, skipped[:_NAMED_AT_MOST])]))
    trend_of_folder = trend_of(entries)
    if not as_json:
        from hiltest.report.console import standard_output

        print_trend(trend_of_folder, standard_output(), every=every)
        _print_skipped(skipped)
    if html is not None or not as_json:
        page = html or folder / "trend.html"
        write_asked_for(page, trend_page(trend_of_folder, skipped))
        click.echo(f"{page}", err=as_json)
    if as_json:  # the document is last, since an error prints a document of its own
        print_document("hiltest.trend/1", trend_document(trend_of_folder, skipped))


def _print_skipped(skipped: list[Skipped]) -> None:
    for entry in skipped[:_NAMED_AT_MOST]:
        click.echo(_skipped_line(entry), err=True)
    if len(skipped) > _NAMED_AT_MOST:
        click.echo(f"and {len(skipped) - _NAMED_AT_MOST} more, which the page lists", err=True)


def _skipped_line(skipped: Skipped) -> str:
    return f"skipped {skipped.file}: {skipped.reason}"
