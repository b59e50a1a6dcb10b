"""Results from a log: for people, as JSON (schema ``hiltest.fit-imu/1``), and as a C header."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest import __version__
from hiltest.calibration.acceptance import Acceptance, Reason, worst
from hiltest.calibration.c_source import c_constant, comment_text
from hiltest.errors import ConfigError
from hiltest.log_fitting.imu_accelerometer import AUTO, MOVING, AccelerometerResult, face_name, fit_accelerometer
from hiltest.log_fitting.imu_gyroscope import WHOLE_DEG, GyroscopeResult, TurnResult, fit_gyroscope
from hiltest.log_fitting.imu_log import ImuLog
from hiltest.log_fitting.imu_rate import SteadyRate, fit_rates, rest_rate, steady_parts
from hiltest.log_fitting.intervals import Interval, Intervals, found_intervals
from hiltest.log_fitting.sample_fit_table import reason_line

SCHEMA = "hiltest.fit-imu/1"
ACCELEROMETER_FORMULA = "gravity_g = gain * (reading - offset)"
GYROSCOPE_FORMULA = "rate_dps = matrix * (reading - bias)"

_HEADER = """\
/*
 * Calibration of an IMU by hiltest {version}, from {files}.
 * Readings and results are in the axes of the accelerometer, in the unit of the log; matrices are row by row.
 */
#ifndef HILTEST_IMU_LOG_CALIBRATION_H
#define HILTEST_IMU_LOG_CALIBRATION_H

{parts}
#endif
"""


@dataclass(frozen=True, slots=True)
class ImuFitDocument:
    """A calibration from an IMU log."""

    hiltest: str
    verdict: str
    """Version, and verdict: good, fair, poor or refused."""
    complete: bool
    """True if both sensors were calibrated."""
    files: list[str]
    """Files that were read."""
    samples: int
    """Number of samples."""
    seconds: float
    """Time from the first to the last sample."""
    rests: list[dict[str, Any]]
    """Intervals at rest."""
    accelerometer: dict[str, Any]
    """Gain, offset, and their quality."""
    gyroscope: dict[str, Any] | None
    """Bias, matrix, turns and rates; null without a gyroscope."""
    notes: list[str]
    """Further remarks."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuLogFit:
    """Calibration of an IMU from a log."""

    log: ImuLog
    intervals: Intervals
    accelerometer: AccelerometerResult
    gyroscope: GyroscopeResult | None
    """Gyroscope calibration; None without a gyroscope or a rest in the log."""
    rates: tuple[SteadyRate, ...] | None = None
    """Parts that turned at a known rate; None without a declared rate."""

    @property
    def scales(self) -> dict[str, SteadyRate]:
        """Longest part that shows the scale of each axis."""
        used = [rate for rate in self.rates or () if rate.scale is not None]
        return {rate.axis: rate for rate in sorted(used, key=lambda rate: rate.end_s - rate.start_s)}

    @property
    def complete(self) -> bool:
        """True if all sensors of the log have a calibration."""
        return self.accelerometer.fit is not None and (
            self.log.rate is None or (self.gyroscope is not None and self.gyroscope.fit is not None)
        )

    @property
    def verdict(self) -> Acceptance:
        """Verdict of the worst sensor of the log."""
        verdicts = [self.accelerometer.verdict] if len(self.log.acceleration) else []
        if self.log.rate is not None:
            verdicts.append(Acceptance.REFUSED if self.gyroscope is None else self.gyroscope.verdict)
        return worst(verdicts)


def fit_imu_log(
    log: ImuLog,
    intervals: Intervals,
    method: str = AUTO,
    *,
    turn_deg: float = WHOLE_DEG,
    bias: np.ndarray | None = None,
    rpm: float | None = None,
) -> ImuLogFit:
    """Fit the accelerometer to the rests of a log, and the gyroscope to its rests, turns and steady rates.

    Parameters
    ----------
    method
        Method for the accelerometer.
    turn_deg
        Angle of each whole turn.
    bias : shape (3,)
        Bias of the gyroscope from another log, in the unit of this one.
    rpm
        Rate of a turntable, in revolutions per minute, for the parts with steady rotation.
    """
    accelerometer = fit_accelerometer(log, intervals.rests, method)
    rests = intervals.rests if intervals.found else _rests_text(log)
    at_rest = rest_rate(log, rests) if bias is None else bias
    parts = steady_parts(log, at_rest, rpm=rpm) if rpm is not None else ()
    gyroscope = fit_gyroscope(
        log, intervals, accelerometer.fit, turn_deg=turn_deg, rests=rests, bias=bias, steady=parts
    )
    if rpm is None or gyroscope is None:
        return ImuLogFit(log, intervals, accelerometer, gyroscope)
    rates = fit_rates(log, parts, rests if bias is None else (), gyroscope.bias, rpm=rpm)
    return ImuLogFit(log, intervals, accelerometer, gyroscope, rates)


def _rests_text(log: ImuLog) -> tuple[Interval, ...]:
    try:
        return found_intervals(log).rests
    except ConfigError:
        return ()  # an annotated log may be too short to find any


def print_fit(fit: ImuLogFit, console: Console) -> None:
    """Print the rests and turns of the log, the calibration of each sensor, and each refusal with its reason."""
    log, rests = fit.log, fit.intervals.rests
    length_s = log.time_s[-1] - log.time_s[0]
    console.print(
        escape(
            f"{', '.join(log.files)}: {len(log.time_s)} samples, {length_s:.1f} s; {len(rests)} rests, "
            f"{'found' if fit.intervals.found else 'annotated'}"
        ),
        soft_wrap=True,
    )
    if len(log.acceleration):
        _print_accelerometer(fit.accelerometer, log.acceleration_unit, console)
    else:
        console.print("no accelerometer in the log")
    if fit.gyroscope is not None:
        _print_gyroscope(fit.gyroscope, log.rate_unit, console)
        for rate in fit.rates or ():
            console.print(escape(f"  {_rate_sentence(rate, log.rate_unit)}"), soft_wrap=True)
        if fit.rates == ():
            console.print(
                "  no scale: the log has no steady revolution and a rest. Log a rest and at least ten seconds of "
                "turning, or use --bias-from",
                style="yellow",
                soft_wrap=True,
            )
    else:
        console.print(
            "no gyroscope in the log" if log.rate is None else "gyroscope: refused, no rest for its bias",
            soft_wrap=True,
        )
    for note in log.notes:
        console.print(escape(note), style="dim", soft_wrap=True)


def _print_accelerometer(result: AccelerometerResult, unit: str, console: Console) -> None:
    faces = " ".join(face_name(face) for face in result.faces) or "none"
    left_out = f", {result.left_out} readings left out" if result.method == MOVING else ""
    summary = f"{result.rests} rests, faces {faces}{left_out}"
    console.print(escape(f"accelerometer, {result.method}: {result.verdict}; {summary}"), soft_wrap=True)
    if result.fit is None:
        console.print(escape(f"  refused: {result.refused}"), style="bold red", soft_wrap=True)
        _print_reasons(result.reasons, console)
        return
    grid = _grid(
        (f"gain [{_per_reading('g', unit)}]", _matrix(result.fit.gain)),
        (f"offset [{unit}]", _triple(result.fit.offset)),
        ("spread of norms, before [%]", f"{result.spread_before_percent:.3f}"),
        ("spread of norms, after [%]", f"{result.spread_after_percent:.4f}"),
        *(
            [("residual [mg]", f"{result.residual_mg:.3f}")]
            if result.faces_askew_deg is None
            else [
                ("faces askew, rms [deg]", f"{result.faces_askew_deg:.2f}"),
                ("cross-axis elements, assumed rms [%]", f"{result.cross_axis_percent:.2f}"),
            ]
        ),
        (
            "error of gravity's direction [deg]",
            "-" if result.direction_error_deg is None else f"{result.direction_error_deg:.2f}",
        ),
    )
    console.print(grid)
    _print_reasons(result.reasons, console)


def _print_gyroscope(result: GyroscopeResult, unit: str, console: Console) -> None:
    used = sum(not turn.refused for turn in result.turns)
    verdict = f"{result.verdict}; " if result.fit is not None else ""
    console.print(escape(f"gyroscope: {verdict}{result.n} samples at rest, {used} turns"), soft_wrap=True)
    rows = [(f"bias [{unit}]", _triple(result.bias)), (f"spread of the rests [{unit}]", f"{result.bias_spread:.3g}")]
    if result.fit is not None:
        rows.insert(0, (f"matrix [{_per_reading('deg/s', unit)}]", _matrix(result.fit.matrix)))
    console.print(_grid(*rows))
    for turn in result.turns:
        console.print(escape(f"  {_turn_sentence(turn, unit)}"), soft_wrap=True)
    _print_reasons(result.reasons, console)
    if result.fit is None:
        console.print(escape(f"  no matrix: {result.refused}"), style="yellow", soft_wrap=True)


def _print_reasons(reasons: tuple[Reason, ...], console: Console) -> None:
    for reason in reasons:
        console.print(escape(f"  {reason_line(reason)}"), soft_wrap=True)


def _turn_sentence(turn: TurnResult, unit: str) -> str:
    """Return one turn as a sentence."""
    name = f" {turn.name}" if turn.name else ""
    integral = "counts s" if unit == "counts" else "deg"
    when = f"{turn.start_s:.1f} to {turn.end_s:.1f} s"
    words = f"turn{name}, {when}: {_triple(turn.integral)} {integral}"
    if turn.refused:
        return f"{words}, refused: {turn.refused}"
    return f"{words}, taken for {turn.turned_deg:+.0f} deg; {turn.left_deg:.3f} deg left"


def _rate_sentence(rate: SteadyRate, unit: str) -> str:
    """Return one steady rate as a sentence."""
    words = (
        f"rate, {rate.start_s:.1f} to {rate.end_s:.1f} s: {_triple(rate.reading)} {unit}, "
        f"{rate.askew_deg:.1f} deg off {rate.axis}"
    )
    if rate.scale is None:
        return f"{words}, refused: {rate.refused}"
    per = _per_reading("deg/s", unit).removeprefix("1")
    return f"{words}; scale of {rate.axis}: {rate.scale:.6g} +- {rate.uncertainty:.1g} {per}".rstrip()


def imu_fit_document(fit: ImuLogFit) -> ImuFitDocument:
    """Return the document of ``hiltest fit imu``."""
    log, accelerometer, gyroscope = fit.log, fit.accelerometer, fit.gyroscope
    return ImuFitDocument(
        hiltest=__version__,
        verdict=fit.verdict,
        complete=fit.complete,
        files=list(log.files),
        samples=len(log.time_s),
        seconds=float(log.time_s[-1] - log.time_s[0]),
        rests=[{"name": rest.name, "start": rest.start, "end": rest.end} for rest in fit.intervals.rests],
        accelerometer={
            "unit": log.acceleration_unit,
            "formula": ACCELEROMETER_FORMULA,
            "method": accelerometer.method,
            "n": accelerometer.rests,
            "faces": [face_name(face) for face in accelerometer.faces],
            "gain": None if accelerometer.fit is None else accelerometer.fit.gain.tolist(),
            "offset": None if accelerometer.fit is None else accelerometer.fit.offset.tolist(),
            "spread_before_percent": accelerometer.spread_before_percent,
            "spread_after_percent": accelerometer.spread_after_percent,
            "residual_mg": accelerometer.residual_mg,
            "faces_askew_deg": accelerometer.faces_askew_deg,
            "cross_axis_percent": accelerometer.cross_axis_percent,
            "direction_error_deg": accelerometer.direction_error_deg,
            "left_out": accelerometer.left_out,
            "verdict": accelerometer.verdict,
            "reasons": [asdict(reason) for reason in accelerometer.reasons],
            "refused": accelerometer.refused,
        },
        gyroscope=None
        if gyroscope is None
        else {
            "unit": log.rate_unit,
            "formula": GYROSCOPE_FORMULA,
            "n": gyroscope.n,
            "bias": gyroscope.bias.tolist(),
            "bias_spread": gyroscope.bias_spread,
            "matrix": None if gyroscope.fit is None else gyroscope.fit.matrix.tolist(),
            "verdict": gyroscope.verdict,
            "reasons": [asdict(reason) for reason in gyroscope.reasons],
            "refused": gyroscope.refused,
            "turns": [
                {
                    "name": turn.name,
                    "start_s": turn.start_s,
                    "end_s": turn.end_s,
                    "bias": list(turn.bias),
                    "integral": list(turn.integral),
                    "turned_deg": turn.turned_deg,
                    "left_deg": turn.left_deg,
                    "refused": turn.refused,
                }
                for turn in gyroscope.turns
            ],
            "rates": [asdict(rate) for rate in fit.rates or ()],
        },
        notes=list(log.notes),
    )


def to_header(fit: ImuLogFit) -> str:
    """Return the calibrations as a C header: C11, float, no code."""
    parts = []
    if fit.accelerometer.fit is not None:
        unit, gravity_fit = fit.log.acceleration_unit, fit.accelerometer.fit
        parts += [
            f"/* {ACCELEROMETER_FORMULA} */",
            c_constant("accelerometer_gain", gravity_fit.gain, _per_reading("g", unit)),
            c_constant("accelerometer_offset", gravity_fit.offset, unit),
            "",
        ]
    if fit.gyroscope is not None:
        gyroscope, rate_unit = fit.gyroscope, fit.log.rate_unit
        formula = GYROSCOPE_FORMULA if gyroscope.fit is not None else "reading - bias"
        parts += [f"/* {formula} */", c_constant("gyroscope_bias", gyroscope.bias, rate_unit)]
        if gyroscope.fit is not None:
            parts.append(c_constant("gyroscope_matrix", gyroscope.fit.matrix, _per_reading("deg/s", rate_unit)))
        parts += [
            c_constant(f"gyroscope_scale_{axis}", rate.scale, _per_reading("deg/s", rate_unit))
            for axis, rate in sorted(fit.scales.items())
            if rate.scale is not None
        ]
        parts.append("")
    files = ", ".join(comment_text(Path(file).name) for file in fit.log.files)
    return _HEADER.format(version=comment_text(__version__), files=files, parts="\n".join(parts))


def _per_reading(numerator: str, unit: str) -> str:
    """Return the unit of a gain: the numerator per reading."""
    if unit == numerator:
        return "1"
    if unit == "counts":
        return f"{numerator}/count"
    return f"({numerator})/({unit})" if "/" in unit else f"{numerator}/{unit}"


def _grid(*rows: tuple[str, str]) -> Table:
    grid = Table(box=SIMPLE_HEAD, pad_edge=False, show_header=False)
    for row in rows:
        grid.add_row(*map(escape, row))
    return grid


def _matrix(values: np.ndarray) -> str:
    return "\n".join(_triple(row) for row in values)


def _triple(values: np.ndarray | tuple[float, float, float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
