"""``hiltest allan``: gyroscope noise from a long log."""

from __future__ import annotations

import math
from pathlib import Path

import click

from hiltest.commands.options import RATE_UNITS, NumberRange, json_option, print_document

_EXIT_CODES = """
\b
Exit codes:
  0   printed
  1   the log cannot support it: too short, moved, or a column that does not change
  2   interrupted
  4   usage: an option, or a row of the file is wrong
"""
_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command(epilog=_EXIT_CODES)
@click.argument("log", metavar="FILE.csv", type=_FILE)
@click.option(
    "--columns",
    metavar="A,B,C",
    help="Columns of the rates, one to three: names or numbers from 1.  [default: the gyroscope's]",
)
@click.option("--unit", type=click.Choice(RATE_UNITS), help="Unit of the rates.  [default: the header's]")
@click.option(
    "--time",
    metavar="COLUMN",
    help="Column of the time, in the unit its name ends with, else s.  [default: the one called time]",
)
@click.option(
    "--rate", "rate_hz", metavar="HZ", type=NumberRange(1e-3, 1e6), help="Rate of sampling, for a file without time."
)
@click.option(
    "--from",
    "first",
    metavar="S",
    type=NumberRange(0.0),
    default=0.0,
    help="First instant to take, in seconds after the first row.",
)
@click.option(
    "--to", "last", metavar="S", type=NumberRange(0.0), default=math.inf, help="First instant not to take, likewise."
)
@json_option("hiltest.allan/1")
@click.option("--html", metavar="FILE", type=_FILE, help="Write a page with the curve.")
def allan(
    log: Path,
    columns: str | None,
    unit: str | None,
    time: str | None,
    rate_hz: float | None,
    first: float,
    last: float,
    as_json: bool,
    html: Path | None,
) -> None:
    """Print random walk and bias instability of a gyroscope at rest.

    FILE.csv is what `hiltest log` writes, or any text table with a row a sample. Of a log with gaps the longest part
    is used.
    """
    from hiltest.calibration.allan import allan_curve
    from hiltest.log_fitting.allan_page import HEADER, allan_document, headline, table, write_page
    from hiltest.log_fitting.rate_log import check_rest, read_rate_log
    from hiltest.measurement.units import RATE_WORDS

    read = read_rate_log(
        log,
        columns=columns,
        unit=RATE_WORDS[unit] if unit else None,
        time=time,
        rate_hz=rate_hz,
        first_s=first,
        last_s=last,
    )
    check_rest(read)
    curve = allan_curve(read.rates, rate_hz=read.rate_hz)
    if not as_json:
        click.echo(headline(read))
        rows = [HEADER, *table(read, curve)]
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        for row in rows:
            click.echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        for note in read.notes:
            click.echo(note)
    if html is not None:
        write_page(read, curve, html)
    if as_json:  # the document is last, since an error prints a document of its own
        print_document("hiltest.allan/1", allan_document(read, curve))
