"""``hiltest fit imu``: calibrate accelerometer and gyroscope from the log of an IMU that was turned by hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hiltest.commands.options import RATE_UNITS, NumberRange, json_option, print_document

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hiltest.log_fitting import ImuLog, Intervals
    from hiltest.log_fitting.imu_fit import ImuLogFit

_EXIT_CODES = """
\b
Exit codes:
  0   the accelerometer is calibrated, and at least the gyroscope's bias;
      with --rate-rpm: the scale of an axis of the gyroscope
  1   not calibrated: the log is not sufficient
  2   interrupted
  4   usage: an option or a file is wrong
"""
_FILE = click.Path(dir_okay=False, path_type=Path)


@dataclass(frozen=True, slots=True)
class _Options:
    """Arguments and options with the names that click passes."""

    log: Path
    gyroscope_log: Path | None
    accelerometer_columns: str | None
    gyroscope_columns: str | None
    accelerometer_unit: str | None
    gyroscope_unit: str | None
    rate: float | None
    time: str | None
    intervals: str | None
    method: str
    turn_deg: float
    rate_rpm: float | None
    bias_from: Path | None
    as_json: bool
    export_json: Path | None
    export_header: Path | None


@click.command(epilog=_EXIT_CODES)
@click.argument("log", metavar="LOG", type=_FILE)
@click.option(
    "--gyroscope-log",
    metavar="FILE",
    type=_FILE,
    help="Read the gyroscope from this log; other times than those of LOG are joined.",
)
@click.option(
    "--accelerometer-columns",
    metavar="A,B,C",
    help="Read the accelerometer from these columns: names, or numbers from 1.  [default: acc..., a...]",
)
@click.option(
    "--gyroscope-columns", metavar="A,B,C", help="Read the gyroscope from these columns.  [default: gyr..., g...]"
)
@click.option(
    "--accelerometer-unit",
    type=click.Choice(["g", "mg", "m/s2", "counts"]),
    help="Set the unit of accelerations; zero and scale of counts are unknown.  [default: the header's, else counts]",
)
@click.option(
    "--gyroscope-unit",
    type=click.Choice(RATE_UNITS),
    help="Set the unit of rates; the scale of counts is unknown.  [default: the header's, else counts]",
)
@click.option(
    "--rate",
    metavar="HZ",
    type=NumberRange(1.0, 100_000.0),
    help="Set the sample rate.  [default: from the column of time]",
)
@click.option("--time", metavar="COLUMN", help="Read the time from this column.  [default: time, t, timestamp]")
@click.option(
    "--intervals",
    metavar="FILE|COLUMN",
    help="Take rests and turns from a JSON list, or a column of labels.  [default: detect them]",
)
@click.option(
    "--method",
    type=click.Choice(["auto", "six-position", "ellipsoid", "moving"]),
    default="auto",
    show_default=True,
    help="Calibrate the accelerometer from rests on six faces or in nine poses, or from motion.",
)
@click.option(
    "--turn",
    "turn_deg",
    metavar="DEG",
    type=NumberRange(90.0, 36_000.0),
    default=360.0,
    show_default=True,
    help="Set the angle of each turn.",
)
@click.option(
    "--rate-rpm",
    metavar="RPM",
    type=NumberRange(0.1, 10_000.0),
    help="Compute the scale of each axis that turned steadily at this rate of a turntable (33.333, 45).",
)
@click.option(
    "--bias-from",
    metavar="FILE",
    type=_FILE,
    help="Take the bias from this log of the gyroscope at rest.  [default: from the rests in LOG]",
)
@json_option("hiltest.fit-imu/1")
@click.option("--export-json", metavar="FILE", type=_FILE, help="Write the same JSON to this file.")
@click.option("--export-header", metavar="FILE", type=_FILE, help="Write the calibration as a C header.")
def fit_imu(**arguments: Any) -> int:
    """Calibrate accelerometer and gyroscope from a log.

    LOG is a text table, optionally compressed (.gz), with commas, semicolons, tabs or blanks between cells, with or
    without a header. Rests, six faces and whole turns about the vertical are detected.
    """
    from hiltest.log_fitting import AccelerationUnit, LogColumns, read_imu_log
    from hiltest.log_fitting.imu_fit import SCHEMA, fit_imu_log, imu_fit_document, print_fit
    from hiltest.measurement.units import RATE_WORDS
    from hiltest.report.console import standard_output

    options = _Options(**arguments)
    listed = options.intervals if options.intervals and Path(options.intervals).suffix == ".json" else None
    labels = None if listed else options.intervals
    read = read_imu_log(
        options.log,
        options.gyroscope_log,
        rate_hz=options.rate,
        columns=LogColumns(options.accelerometer_columns, options.gyroscope_columns, options.time, labels),
        acceleration_unit=AccelerationUnit(options.accelerometer_unit) if options.accelerometer_unit else None,
        rate_unit=RATE_WORDS[options.gyroscope_unit] if options.gyroscope_unit else None,
        gyroscope_alone=options.rate_rpm is not None,
    )
    bias = _bias(read, options.bias_from, options) if options.bias_from else None
    fitted = fit_imu_log(
        read,
        _intervals(read, listed, bias, turns=options.rate_rpm is not None),
        options.method,
        turn_deg=options.turn_deg,
        bias=bias,
        rpm=options.rate_rpm,
    )
    if not options.as_json:
        print_fit(fitted, standard_output())
    code = _export(fitted, options)
    if options.as_json:  # the document is last, since an error prints a document of its own
        print_document(SCHEMA, imu_fit_document(fitted))
    return code


def _export(fitted: ImuLogFit, options: _Options) -> int:
    from hiltest.log_fitting.imu_fit import SCHEMA, imu_fit_document, to_header
    from hiltest.run_record.files import write_asked_for, write_document

    if not (fitted.accelerometer.fit is not None if options.rate_rpm is None else fitted.scales):
        if options.export_json or options.export_header:
            click.echo("refused: the calibration was not exported", err=True)
        return 1
    if options.export_json is not None:
        write_document(options.export_json, imu_fit_document(fitted), SCHEMA)
    if options.export_header is not None:
        write_asked_for(options.export_header, to_header(fitted))
    return 0


def _bias(log: ImuLog, path: Path, options: _Options) -> NDArray[np.float64]:
    from hiltest.log_fitting.rate_log import rest_bias
    from hiltest.measurement.units import RATE_WORDS

    return rest_bias(
        path,
        log.rate_unit,
        columns=options.gyroscope_columns,
        time=options.time,
        rate_hz=options.rate,
        written=RATE_WORDS[options.gyroscope_unit] if options.gyroscope_unit else None,
    )


def _intervals(log: ImuLog, listed: str | None, bias: NDArray[np.float64] | None, *, turns: bool) -> Intervals:
    from hiltest.log_fitting import found_intervals, labelled_intervals, listed_intervals
    from hiltest.log_fitting.imu_rate import rest_rate

    if listed is not None:
        return listed_intervals(log, Path(listed))
    if log.labels is not None:
        return labelled_intervals(log)
    return found_intervals(log, rest_rate=rest_rate(log) if turns and bias is None else bias)
