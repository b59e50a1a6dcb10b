"""An Allan deviation for people and programs: a table, JSON, and a page with its curves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hiltest import __version__
from hiltest.calibration.allan import FILTERED_SAMPLES, AllanCurve, AllanReading, Estimate
from hiltest.log_fitting.rate_log import RateLog
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.page import render
from hiltest.report.svg import Figure
from hiltest.run_record.files import write_asked_for
from hiltest.text import format_count

HEADER = ("column", "figure", "value", "68 % interval")
# Share of a period below which deviations are the clock's resolution.
_JITTER = 0.1
# Units of N, density, B, K and the curve, and the factor from the log's unit to them.
_IN_DEGREES = (("deg/rth", 60.0), ("mdps/rtHz", 1000.0), ("deg/h", 3600.0), ("deg/h/rth", 3600.0 * 60.0))
_IN_COUNTS = (("count/rtHz", 1.0), ("count/rtHz", 1.0), ("count", 1.0), ("count/rts", 1.0))


@dataclass(frozen=True, slots=True)
class Allan:
    """Noise of a gyroscope at rest."""

    hiltest: str
    file: str
    unit: str
    """Version, log, and dps or counts."""
    samples: int
    rows: int
    gaps: int
    """Numbers of used samples, of rows in the file, and of gaps in it."""
    start_s: float | None
    rate_hz: float | None
    jitter_s: float | None
    """First instant, rate, and deviation of the time stamps."""
    notes: tuple[str, ...]
    """Further remarks."""
    columns: list[dict[str, Any]]
    """Random walk, instability and bias of each column."""
    curve: dict[str, Any]
    """Deviation over time by column, with 95 % limits."""


@dataclass(frozen=True, slots=True)
class Number:
    """A number that is printed, drawn and in the JSON."""

    key: str
    name: str
    """Key in the JSON, and name for people."""
    found: Estimate | None
    """Estimate; None if it is hidden in the noise."""
    unit: str
    at_most: float | None = None
    """Upper bound if it is hidden, if known."""
    at_s: float | None = None
    """Averaging time that it applies to."""

    @property
    def cells(self) -> tuple[str, str, str]:
        """Name, value with its unit, and interval in words."""
        at = "" if self.at_s is None else f" at {self.at_s:.4g} s"
        if self.found is None:
            return self.name, "not seen" if self.at_most is None else f"at most {self.at_most:.4g} {self.unit}", ""
        estimate = self.found
        return self.name, f"{estimate.value:.4g} {self.unit}{at}", f"{estimate.low:.4g} to {estimate.high:.4g}"

    @property
    def content(self) -> dict[str, Any]:
        """Content for the JSON."""
        value, low, high = (
            (None, None, None) if self.found is None else (self.found.value, self.found.low, self.found.high)
        )
        more = {"at_most": self.at_most, "at_s": self.at_s}
        return {
            "value": value,
            "low": low,
            "high": high,
            "unit": self.unit,
            **{key: value for key, value in more.items() if value is not None},
        }


def numbers(log: RateLog, reading: AllanReading) -> tuple[Number, ...]:
    """Return the numbers from one curve."""
    (walk, per_walk), (density, per_density), (rate, per_rate), (rate_walk, per_rate_walk) = (
        _IN_DEGREES if log.is_in_degrees else _IN_COUNTS
    )
    at_most = None if reading.bias_instability else per_rate * reading.bias_instability_at_most
    return (
        Number("angle_random_walk", "angle random walk N", _scaled(reading.angle_random_walk, per_walk), walk),
        Number(
            "noise_density",
            "noise density, one-sided",
            _scaled(reading.angle_random_walk, math.sqrt(2.0) * per_density),
            density,
        ),
        Number("bias_instability", "bias instability B", _scaled(reading.bias_instability, per_rate), rate, at_most),
        Number("rate_random_walk", "rate random walk K", _scaled(reading.rate_random_walk, per_rate_walk), rate_walk),
        Number("lowest", "lowest", _scaled(reading.lowest, per_rate), rate, at_s=reading.lowest_at_s),
    )


def table(log: RateLog, curve: AllanCurve) -> Iterator[tuple[str, ...]]:
    """Yield a row for each number of each column, with the columns of `HEADER`."""
    for name, reading in zip(log.columns, curve.readings, strict=True):
        for number in numbers(log, reading):
            yield name, *number.cells


def headline(log: RateLog) -> str:
    """Return the heading: file, samples and rate, quality of its time stamps, and gaps."""
    n, seconds = len(log.rates), len(log.rates) / log.rate_hz
    jitter = f", jitter {1000.0 * log.jitter_s:.3g} ms" if log.jitter_s * log.rate_hz > _JITTER else ""
    part = f"{log.path}: {n} samples at {log.rate_hz:.6g} Hz{jitter}, {seconds:.0f} s"
    if log.paused_s is not None:
        part += f", {log.paused_s[-1]:.4g} s of pauses passed over"
    if not log.gaps or n == log.rows:
        return part if n == log.rows else f"{part} of {log.rows} rows, from {log.start_s:.6g} s on"
    return f"{part}; {format_count(log.gaps, 'gap')}: the longest part of {log.rows} rows, from {log.start_s:.6g} s on"


def allan_document(log: RateLog, curve: AllanCurve) -> Allan:
    """Return the document of ``hiltest fit noise``; the curve is in deg/s, or in counts as the file's unit says."""
    curves = {
        "deviation": curve.deviation,
        "low": curve.low,
        "high": curve.high,
        "degrees_of_freedom": curve.freedom,
    }
    return Allan(
        hiltest=__version__,
        file=str(log.path),
        unit="dps" if log.is_in_degrees else "counts",
        samples=len(log.rates),
        rows=log.rows,
        gaps=log.gaps,
        start_s=log.start_s,
        rate_hz=log.rate_hz,
        jitter_s=log.jitter_s,
        notes=tuple(log.notes),
        columns=[
            {"name": name, **{number.key: number.content for number in numbers(log, reading)}}
            for name, reading in zip(log.columns, curve.readings, strict=True)
        ],
        curve={
            "tau_s": curve.tau_s.tolist(),
            **{
                key: {name: values[:, axis].tolist() for axis, name in enumerate(log.columns)}
                for key, values in curves.items()
            },
        },
    )


def write_page(log: RateLog, curve: AllanCurve, path: Path) -> None:
    """Write a page with the curves so that a reader sees the whole file or none."""
    page = render(
        "allan.html.j2",
        package="hiltest.log_fitting",
        headline=headline(log),
        notes=log.notes,
        header=HEADER,
        rows=list(table(log, curve)),
        figures=[figure(log, curve, axis) for axis in range(len(log.columns))],
        version=__version__,
    )
    write_asked_for(path, page)


def figure(log: RateLog, curve: AllanCurve, axis: int) -> Figure:
    """Draw the deviations of one column with their intervals and the fitted slopes, on logarithmic axes."""
    read = numbers(log, curve.readings[axis])
    walk, _, instability, rate_walk, lowest = read
    per_unit = 3600.0 if log.is_in_degrees else 1.0
    tau_s, deviation, low, high = (
        curve.tau_s,
        *(per_unit * bound[:, axis] for bound in (curve.deviation, curve.low, curve.high)),
    )
    drawn = Figure(
        title=f"Allan deviation of {log.columns[axis]}",
        description="; ".join(": ".join(number.cells[:2]) for number in read),
        x_label="averaging time [s]",
        y_label=f"Allan deviation [{lowest.unit}]",
        x_range=(float(tau_s[0]), float(tau_s[-1])),
        y_range=(float(low.min()) / 1.5, float(high.max()) * 1.5),
        width=560.0,
        height=400.0,
        log_x=True,
        log_y=True,
    )
    terms = per_unit * curve.readings[axis].terms(tau_s)
    slopes = ((walk, "-1/2", "series-1"), (instability, "0", "series-2"), (rate_walk, "+1/2", "series-3"))
    for (number, slope, style), term in zip(slopes, terms.T, strict=True):
        within = (term > drawn.y_range[0]) & (term < drawn.y_range[1])
        if within.any():
            drawn.line(zip(tau_s[within].tolist(), term[within].tolist(), strict=True), style)
            drawn.key.append(KeyEntry(f"{number.name}: slope {slope}, {number.cells[1]}", style))
    drawn.line(zip(tau_s.tolist(), np.linalg.norm(terms, axis=1).clip(*drawn.y_range).tolist(), strict=True), "thesis")
    drawn.key.append(KeyEntry("their sum", "thesis"))
    drawn.bars(zip(tau_s.tolist(), low.tolist(), high.tolist(), strict=True), "series-0")
    fitted = np.round(tau_s * log.rate_hz) >= FILTERED_SAMPLES
    for name, which, style in (
        ("deviation, with its 68 % interval", fitted, "series-0 filled"),
        (f"below {FILTERED_SAMPLES} samples, where the output filter acts: not fitted", ~fitted, "series-0 hollow"),
    ):
        points = list(zip(tau_s[which].tolist(), deviation[which].tolist(), strict=True))
        drawn.series(name, points, mark=Mark.DOT, mark_style=style, radius=2.5)
    at = int(np.argmin(deviation))
    drawn.marks([(float(tau_s[at]), float(deviation[at]))], "neutral", Mark.DIAMOND, radius=5.0)
    drawn.key.append(KeyEntry(f"lowest: {lowest.cells[1]}", mark=Mark.DIAMOND, mark_style="neutral"))
    return drawn


def _scaled(estimate: Estimate | None, factor: float) -> Estimate | None:
    return None if estimate is None else estimate.scaled(factor)
