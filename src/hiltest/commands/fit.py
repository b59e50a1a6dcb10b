"""``hiltest fit``: run calibrators on recorded samples, and rate each result."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from hiltest.commands.options import ErrorOutput, json_option, setting_option

if TYPE_CHECKING:
    from hiltest.calibration.own import FileCalibrator
    from hiltest.log_fitting import FieldUnit, Samples
    from hiltest.log_fitting.fit_result import SampleFit

_EXIT_CODES = """
\b
Exit codes:
  0   the best verdict is at least poor, or the one of --at-least
  1   the best verdict is worse
  2   interrupted
  4   usage: an option, the log or a firmware file is wrong
  20  the firmware on the virtual board faults or hangs
  23  wrong firmware, or another protocol version
"""
# Shapes that the calibrators fit.
_ELLIPSOIDS = ("auto", "ellipsoid")
_DEFAULT_CALIBRATORS = ("board",)
_STANDARD_INPUT = Path("/dev/stdin")
_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command(epilog=_EXIT_CODES)
@click.argument("log", metavar="LOG", type=click.Path(path_type=Path))
@click.option(
    "--columns",
    metavar="A,B,C",
    help="Read x, y, z, or x, y of two axes, from these columns: names or numbers from 1; a minus negates one.  "
    "[default: the magnetometer's]",
)
@click.option(
    "--accelerometer-columns",
    metavar="A,B,C",
    help="Read the accelerometer from these columns, for gravity.  [default: acc..., a...]",
)
@click.option("--accelerometer-log", metavar="FILE", type=_FILE, help="Read the accelerometer from this log, by time.")
@click.option(
    "--unit",
    type=click.Choice(["uT", "nT", "mT", "T", "gauss", "mG", "counts"]),
    help="Set the unit of the samples; the scale of counts is unknown.  [default: the header's, else counts]",
)
@click.option(
    "--calibrator",
    "calibrators",
    metavar="NAME",
    multiple=True,
    default=_DEFAULT_CALIBRATORS,
    show_default=True,
    help="Run this calibrator, of the firmware, an installed package, or FILE:FUNCTION as in hiltest judge. board: all "
    "of the firmware. all: also float64 references from the literature. Can be repeated.",
)
@click.option(
    "--shape",
    type=click.Choice([*_ELLIPSOIDS, "sphere", "ridge", "circle", "ellipse"]),
    default="auto",
    show_default=True,
    help="Fit this shape. auto: the calibrators' ellipsoid, or the shape that the samples allow. ridge: part of a "
    "sphere. circle, ellipse: a turn in a plane, for headings only.",
)
@click.option(
    "--field",
    "field_ut",
    metavar="UT",
    type=click.FloatRange(1.0, 1e5),
    help="Set the known strength of the field; for circle and ellipse, of its part in the plane.",
)
@click.option(
    "--with",
    "followed",
    metavar="COLUMN",
    multiple=True,
    help="Fit hard iron that follows this column too: a current, throttle or temperature; by name or number from 1.",
)
@click.option(
    "--at",
    metavar="LATITUDE,LONGITUDE,DATE",
    help="Compare strength and dip with the World Magnetic Model; the date as YYYY-MM-DD.",
)
@click.option(
    "--from",
    "first",
    metavar="T",
    type=float,
    help="Begin at this time: seconds after the first reading, or a reading's number if no column has times.",
)
@click.option("--to", "last", metavar="T", type=float, help="End before this time.")
@click.option("--steady", is_flag=True, help="Use the longest part with a constant field.")
@click.option(
    "--robust",
    type=click.Choice(["tukey", "none"]),
    default="tukey",
    show_default=True,
    help="Weight the samples. tukey: omit repeats and outliers of the ellipsoid. none: use all samples.",
)
@click.option(
    "--on",
    type=click.Choice(["virtual", "host"]),
    default="virtual",
    show_default=True,
    help="Run the firmware's calibrators and count cycles (virtual), or their float64 references (host).",
)
@setting_option("firmware")
@json_option("hiltest.fit/1; without a magnetometer hiltest.fit-imu/1 or hiltest.allan/1")
@click.option("--export-json", metavar="FILE", type=_FILE, help="Write the best calibration as JSON.")
@click.option("--export-header", metavar="FILE", type=_FILE, help="Write the best calibration as a C header.")
@click.option(
    "--export-ardupilot", metavar="FILE", type=_FILE, help="Write the best calibration as parameters of ArduPilot."
)
@click.option("--force", is_flag=True, help="Export even a refused calibration, which is marked as refused.")
@click.option("--html", metavar="FILE", type=_FILE, help="Write a page with the samples before and after.")
@click.option(
    "--at-least",
    type=click.Choice(["good", "fair", "poor"]),
    default="poor",
    show_default=True,
    help="Require this verdict of the best calibration for exit code 0.",
)
def fit(
    log: Path,
    columns: str | None,
    accelerometer_columns: str | None,
    accelerometer_log: Path | None,
    unit: str | None,
    calibrators: tuple[str, ...],
    shape: str,
    field_ut: float | None,
    followed: tuple[str, ...],
    at: str | None,
    first: float | None,
    last: float | None,
    steady: bool,
    robust: str,
    on: str,
    firmware: Path | None,
    as_json: bool,
    export_json: Path | None,
    export_header: Path | None,
    export_ardupilot: Path | None,
    force: bool,
    html: Path | None,
    at_least: str,
) -> int:
    """Fit a calibration to the log of a magnetometer, and rate it.

    LOG is a table with or without a header, a capture of a serial monitor or for MotionCal, lines of JSON, or packets
    of NXP's Sensor Fusion; - is standard input. A refused calibration is not exported without --force.

    If LOG is a folder, print one row per log: the fit by the float64 references and the agreement between its parts.

    A log without a magnetometer goes to hiltest fit imu if it has an accelerometer, and to hiltest fit noise if it has
    only a gyroscope.
    """
    from hiltest.interfaces.sensor_files.columns import NoMagnetometerError
    from hiltest.log_fitting import FieldUnit
    from hiltest.log_fitting.signed_columns import read_signed_samples

    if log.is_dir():
        return _fit_folder(log, columns, FieldUnit(unit) if unit else None, robust=robust != "none", at_least=at_least)
    path = _STANDARD_INPUT if str(log) == "-" else log
    own_columns = accelerometer_columns if accelerometer_log is None else None
    try:
        read = read_signed_samples(
            path, columns=columns, unit=FieldUnit(unit) if unit else None, accelerometer_columns=own_columns
        )
    except NoMagnetometerError as error:
        if not error.sensors or path == _STANDARD_INPUT:
            raise
        return _fit_without_magnetometer(log, error.sensors)
    if accelerometer_log is not None:
        from hiltest.log_fitting.samples import join_accelerometer

        read = join_accelerometer(read, accelerometer_log, accelerometer_columns)
    if steady or first is not None or last is not None:
        read = _part(read, first, last, steady=steady)
    following = None
    if followed:
        from hiltest.log_fitting.followed_columns import following_sentences, subtract_followed

        read, following = subtract_followed(read, followed, robust=robust != "none")
    fitted = _fit(read, calibrators, shape, on, firmware, robust=robust != "none", field_ut=field_ut)
    extra = [] if following is None else following_sentences(following, fitted.unit)
    extra += [] if at is None else [_compare_with_model(fitted, at)]
    fitted = replace(fitted, following=following, notes=(*extra, *fitted.notes))
    if not as_json:
        _show(fitted, as_json=False)
    _export(fitted, export_json, export_header, export_ardupilot, force=force)
    if html is not None:
        from hiltest.log_fitting.sample_fit_page import write_page

        write_page(fitted, read, html)
    if as_json:  # the document is last, since an error prints a document of its own
        _show(fitted, as_json=True)
    return int(_is_worse(fitted, at_least))


def _is_worse(fitted: SampleFit, at_least: str) -> bool:
    from hiltest.calibration.acceptance import Acceptance

    order = list(Acceptance)
    return order.index(fitted.best.verdict) > order.index(Acceptance(at_least))


def _fit_without_magnetometer(log: Path, sensors: Collection[str]) -> int:
    """Fit the log of other sensors by their own command, with the options that both commands have."""
    from hiltest.commands.fit_imu import fit_imu
    from hiltest.commands.fit_noise import fit_noise

    name, command = ("imu", fit_imu) if "accelerometer" in sensors else ("noise", fit_noise)
    context = click.get_current_context()
    options = _given_options(context) - {"log"}
    for option in options - {parameter.name for parameter in command.params}:
        raise click.UsageError(
            f"{_flag(context, option)} is for a magnetometer, which {log} does not have; hiltest fit {name} fits it"
        )
    click.echo(f"{log} has no magnetometer, so this is hiltest fit {name}.", err=True)
    return int(context.invoke(command, log=log, **{option: context.params[option] for option in options}) or 0)


def _given_options(context: click.Context) -> set[str]:
    """Return the names of the parameters that the command line has."""
    return {name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}


def _flag(context: click.Context, name: str) -> str:
    return next(parameter.opts[0] for parameter in context.command.params if parameter.name == name)


def _fit_folder(folder: Path, columns: str | None, unit: FieldUnit | None, *, robust: bool, at_least: str) -> int:
    context = click.get_current_context()
    for name in _given_options(context) - {"log", "columns", "unit", "robust", "at_least"}:
        raise click.UsageError(f"{_flag(context, name)} is for a single log, and {folder} is a folder: leave it out")
    from hiltest.errors import ConfigError
    from hiltest.log_fitting.log_folder import fit_folder
    from hiltest.log_fitting.log_folder_table import print_folder
    from hiltest.report.console import standard_output
    from hiltest.session.progress_line import ProgressLine

    progress = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty())
    logs = list(fit_folder(folder, columns=columns, unit=unit, robust=robust, progress=progress))
    progress.clear()
    print_folder(logs, standard_output())
    fits = [log.fit for log in logs if log.fit is not None]
    if not fits:
        raise ConfigError(f"{folder} has no log of a magnetometer; hiltest fit FILE prints the reason for a file")
    return int(any(_is_worse(fit, at_least) for fit in fits))


def _part(samples: Samples, first: float | None, last: float | None, *, steady: bool) -> Samples:
    from hiltest.log_fitting import span

    if steady:
        if first is not None or last is not None:
            raise click.UsageError("--steady selects the part: leave out --from and --to")
        first, last = span.steady(samples)
        click.echo(f"steady from {first:g} to {'the end' if last == math.inf else format(last, 'g')}", err=True)
    return span.between(samples, first, last)


def _fit(
    samples: Samples,
    calibrators: Sequence[str],
    shape: str,
    on: str,
    firmware: Path | None,
    *,
    robust: bool,
    field_ut: float | None,
) -> SampleFit:
    from hiltest.log_fitting.sample_fit import fit_by_shape, fit_on_board, fit_on_host

    if shape not in _ELLIPSOIDS:
        if tuple(calibrators) != _DEFAULT_CALIBRATORS or firmware is not None:
            raise click.UsageError(
                f"--shape {shape} is not fitted by calibrators: leave out --calibrator and --firmware"
            )
        from hiltest.calibration.shapes import Shape

        return fit_by_shape(samples, Shape(shape), robust=robust, field_ut=field_ut)
    named = [name for name in calibrators if name not in ("board", "all")]
    if named and len(samples.columns) < samples.points.shape[1]:
        raise click.UsageError(
            f"--calibrator {named[0]} needs three axes, and {samples.path} has only {' and '.join(samples.columns)}: "
            "leave it out to fit the turn, or name three columns with --columns"
        )
    any_shape = shape == "auto"
    from hiltest.calibration import REFERENCES
    from hiltest.calibration.own import check_own_name, own_calibrator

    selected: list[str | FileCalibrator] = [*calibrators]
    if any(":" in name or Path(name).is_file() for name in named):
        from hiltest.judge.entries import open_calibrators  # takes a second

        selected = [*open_calibrators(calibrators)]
    for name in named:
        check_own_name(name, REFERENCES)
    on_board = [one for one in selected if isinstance(one, str) and own_calibrator(one) is None]
    if on == "host" or (firmware is None and not on_board):
        if firmware is not None:
            raise click.UsageError("--firmware is for the virtual board: leave out --on host")
        return fit_on_host(samples, *selected, robust=robust, any_shape=any_shape, field_ut=field_ut)
    from hiltest.boards import open_board
    from hiltest.rig.bench_files import DEFAULT_RIG, shipped
    from hiltest.rig.rig_file import load_rig

    # The packaged rig is used even if this folder has another: recorded samples do not depend on its world.
    rig = load_rig(shipped() / "rigs" / DEFAULT_RIG)
    with open_board(rig, firmware=firmware) as board:
        return fit_on_board(board, samples, *selected, robust=robust, any_shape=any_shape, field_ut=field_ut)


def _show(fitted: SampleFit, *, as_json: bool) -> None:
    if as_json:
        from hiltest.log_fitting.sample_fit_exports import to_json

        click.echo(to_json(fitted), nl=False)
        return
    from hiltest.log_fitting.sample_fit_table import print_fit
    from hiltest.report.console import standard_output

    print_fit(fitted, standard_output())


def _compare_with_model(fitted: SampleFit, place: str) -> str:
    """Return the best calibration's strength and dip beside those of the World Magnetic Model."""
    from hiltest.doctor.field_checks import field_at
    from hiltest.measurement.units import MICROTESLA, FieldUnit

    try:
        latitude, longitude, day = place.split(",")
        model = field_at(float(latitude), float(longitude), 0.0, date.fromisoformat(day.strip()))
        if not (abs(float(latitude)) <= 90.0 and abs(float(longitude)) <= 360.0):
            raise ValueError("no place on the earth")
    except ValueError as error:
        raise click.UsageError(
            f"--at {place}: write latitude, longitude, date, such as 48.1,11.6,2026-05-01"
        ) from error
    if isinstance(model, str):
        raise click.UsageError(f"--at {place}: {model}")
    best, unit = fitted.best, MICROTESLA[FieldUnit(fitted.unit)]
    strength, dip = "an unknown strength", "an unknown dip, because gravity was not used"
    if best.radius is not None and unit is not None:
        strength = f"{best.radius * unit:.2f} uT, {best.radius * unit / model.strength_ut:.3f} of it"
    if best.gravity is not None and best.gravity.dip_deg is not None:
        dip = f"a dip of {best.gravity.dip_deg:.1f} deg"
    return (
        f"{model.model} has {model.strength_ut:.2f} uT and a dip of {abs(model.dip_deg):.1f} deg there; the log has "
        f"{strength}, and {dip}."
    )


def _export(
    fitted: SampleFit, as_json: Path | None, as_header: Path | None, as_ardupilot: Path | None, *, force: bool
) -> None:
    if as_json is None and as_header is None and as_ardupilot is None:
        return
    from hiltest.calibration.acceptance import Acceptance
    from hiltest.log_fitting.sample_fit_exports import export_ardupilot, export_header, export_json

    if fitted.best.verdict is Acceptance.REFUSED:
        if fitted.best.hard_iron is None:
            click.echo("refused: no calibration exists to export", err=True)
            return
        if not force:
            click.echo("refused: the calibration was not exported; --force exports it anyway", err=True)
            return
        click.echo("refused: exported anyway, and marked as refused", err=True)
    for path, export in ((as_json, export_json), (as_header, export_header), (as_ardupilot, export_ardupilot)):
        if path is not None:
            export(fitted, path)
