"""An Allan deviation for people and programs: a table, JSON, and a page with its curve."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hiltest import __version__
from hiltest.calibration.allan import FLICKER, AllanCurve, AllanReading
from hiltest.logs.rate_log import RateLog
from hiltest.record.files import write_asked_for
from hiltest.report.marks import KeyEntry, series
from hiltest.report.page import render
from hiltest.report.svg import Figure

SCHEMA = "hiltest.allan/1"
# From the floor of a curve to the instability of a bias.
_FLOOR = math.sqrt(FLICKER)


def table(log: RateLog, curve: AllanCurve) -> Iterator[tuple[str, str, str, str]]:
    """Yield a header and a row for each column: name, angle random walk, bias instability, lowest point."""
    unit = "deg/s" if log.in_degrees else "count"
    yield "column", "angle random walk", "bias instability", "lowest"
    for name, reading in zip(log.columns, curve.readings, strict=True):
        yield name, _walk(reading, log), _instability(reading, log), (
            f"{reading.lowest:.3g} {unit} at {reading.lowest_at_s:.3g} s"
        )


def headline(log: RateLog) -> str:
    """Return the heading: file, samples and rate."""
    n, seconds = len(log.rates), len(log.rates) / log.rate_hz
    gaps = "" if not log.gaps else f"; {log.gaps} gaps: the longest part of {log.rows} rows"
    return f"{log.path}: {n} samples at {log.rate_hz:.6g} Hz, {seconds:.0f} s{gaps}"


def to_json(log: RateLog, curve: AllanCurve) -> str:
    """Return the text of ``hiltest allan --json``; angles are in degrees, or in counts as the file's unit says."""
    content = {
        "schema": SCHEMA, "hiltest": __version__, "file": str(log.path), "unit": "dps" if log.in_degrees else "counts",
        "samples": len(log.rates), "rows": log.rows, "gaps": log.gaps, "rate_hz": log.rate_hz,
        "notes": list(log.notes),
        "columns": [
            _column(name, reading, log) for name, reading in zip(log.columns, curve.readings, strict=True)
        ],
        "curve": {
            "tau_s": curve.tau_s.tolist(), "relative_uncertainty": curve.relative_uncertainty.tolist(),
            "deviation": {name: curve.deviation[:, axis].tolist() for axis, name in enumerate(log.columns)},
        },
    }  # fmt: skip
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_page(log: RateLog, curve: AllanCurve, path: Path) -> None:
    """Write a page with the curve so that a reader sees the whole file or none."""
    header, *rows = table(log, curve)
    page = render(
        "allan.html.j2", package="hiltest.logs", headline=headline(log), notes=log.notes, header=header, rows=rows,
        figure=figure(log, curve), version=__version__,
    )  # fmt: skip
    write_asked_for(path, page)


def figure(log: RateLog, curve: AllanCurve) -> Figure:
    """Draw the deviations, and lines for the noise figures, on logarithmic axes."""
    unit = "deg/s" if log.in_degrees else "count"
    _, *rows = table(log, curve)
    drawn = Figure(
        title="Allan deviation over averaging time",
        description="; ".join(f"{name}: {walk}, {instability}" for name, walk, instability, _ in rows),
        x_label="averaging time [s]", y_label=f"Allan deviation [{unit}]",
        x_range=(float(curve.tau_s[0]), float(curve.tau_s[-1])),
        y_range=(float(curve.deviation.min()) / 1.5, float(curve.deviation.max()) * 1.5),
        width=640.0, height=400.0, log_x=True, log_y=True,
    )  # fmt: skip
    low, high = drawn.y_range
    for reading in curve.readings:
        deviation = np.clip(reading.deviation(curve.tau_s), low, high)
        drawn.line(zip(curve.tau_s.tolist(), deviation.tolist(), strict=True), "thesis")
    for axis, name in enumerate(log.columns):
        style, mark = series(axis)
        points = list(zip(curve.tau_s.tolist(), curve.deviation[:, axis].tolist(), strict=True))
        drawn.series(name, points, style, mark, radius=2.5)
    drawn.key.append(KeyEntry("what was read off", "thesis"))
    return drawn


def _column(name: str, reading: AllanReading, log: RateLog) -> dict[str, Any]:
    found: dict[str, Any] = {
        "name": name, "angle_random_walk_per_rthz": reading.angle_random_walk,
        "noise_density_one_sided_per_rthz": math.sqrt(2.0) * reading.angle_random_walk,
        "bias_instability": reading.bias_instability, "bias_instability_at_most": reading.lowest / _FLOOR,
        "rate_random_walk_per_rts": reading.rate_random_walk, "lowest": reading.lowest,
        "lowest_at_s": reading.lowest_at_s,
    }  # fmt: skip
    if log.in_degrees:
        found["angle_random_walk_deg_per_rth"] = 60.0 * reading.angle_random_walk
        instability = reading.bias_instability
        found["bias_instability_deg_per_h"] = None if instability is None else 3600.0 * instability
    return found


def _walk(reading: AllanReading, log: RateLog) -> str:
    if not log.in_degrees:
        return f"{reading.angle_random_walk:.4g} count/rtHz"
    return f"{60.0 * reading.angle_random_walk:.4g} deg/rth"


def _instability(reading: AllanReading, log: RateLog) -> str:
    value = reading.bias_instability
    shown = reading.lowest / _FLOOR if value is None else value
    text = f"{3600.0 * shown:.3g} deg/h" if log.in_degrees else f"{shown:.3g} count"
    return f"at most {text}" if value is None else text
