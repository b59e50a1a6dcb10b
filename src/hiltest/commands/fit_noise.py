"""``hiltest fit noise``: gyroscope noise from a long log."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import click

from hiltest.commands.options import RATE_UNITS, NumberRange, json_option, print_document

_EXIT_CODES = """
\b
Exit codes:
  0   printed
  1   the log is not sufficient: too short, moved, or a constant column
  2   interrupted
  4   usage: an option, or a row of the file is wrong
"""
_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command(epilog=_EXIT_CODES)
@click.argument("log", metavar="FILE.csv", type=_FILE)
@click.option(
    "--columns",
    metavar="A,B,C",
    help="Read one to three rates from these columns: names or numbers from 1.  [default: the gyroscope's]",
)
@click.option("--unit", type=click.Choice(RATE_UNITS), help="Set the unit of the rates.  [default: the header's]")
@click.option(
    "--time",
    metavar="COLUMN",
    help="Read the time from this column, in the unit at the end of its name, else s.  [default: time]",
)
@click.option(
    "--rate", "rate_hz", metavar="HZ", type=NumberRange(1e-3, 1e6), help="Set the sample rate of a file without time."
)
@click.option(
    "--from",
    "first",
    metavar="S",
    type=NumberRange(0.0),
    default=0.0,
    help="Begin at this time, in seconds after the first row.",
)
@click.option(
    "--noise",
    "noise_mdps",
    metavar="MDPS",
    type=NumberRange(1e-6),
    help="Accept at most this noise density [mdps/rtHz], as in the data sheet, of a sensor at rest.  [default: 100]",
)
@click.option("--to", "last", metavar="S", type=NumberRange(0.0), default=math.inf, help="End before this time.")
@json_option("hiltest.allan/1")
@click.option("--html", metavar="FILE", type=_FILE, help="Write a page with the curve.")
def fit_noise(
    log: Path,
    columns: str | None,
    unit: str | None,
    time: str | None,
    rate_hz: float | None,
    first: float,
    last: float,
    noise_mdps: float | None,
    as_json: bool,
    html: Path | None,
) -> None:
    """Compute random walk and bias instability of a gyroscope.

    FILE.csv is a log of a gyroscope at rest, written by hiltest log, or any text log. Pauses of less than 1 % of the
    log are passed over if they are less than 10 % together; otherwise the longest part between gaps is used.
    """
    from hiltest.calibration.allan import allan_curve
    from hiltest.log_fitting.allan_page import HEADER, allan_document, headline, table, write_page
    from hiltest.log_fitting.rate_log import LARGEST_NOISE_MDPS, check_rest, read_rate_log
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
    check_rest(read, noise_mdps=noise_mdps or LARGEST_NOISE_MDPS)
    if not read.is_in_degrees:
        unchecked = "The scale of counts is unknown, so a motion from beginning to end is not detected."
        read = replace(read, notes=(*read.notes, unchecked))
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
