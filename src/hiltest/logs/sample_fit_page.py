"""Page of a fit of recorded samples: one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest import __version__
from hiltest.calibration.acceptance import Acceptance
from hiltest.logs.sample_fit import CalibratorFit, SampleFit
from hiltest.logs.sample_fit_table import figure_rows, reason_line
from hiltest.record.files import write_asked_for
from hiltest.report.figures.samples import coverage_map
from hiltest.report.page import render
from hiltest.report.svg import Figure

Array = NDArray[np.float64]

_TONES = {Acceptance.GOOD: "good", Acceptance.POOR: "warn", Acceptance.REFUSED: "bad"}
# More dots than this hide each other, and make the file large.
_DRAWN = 2000
_SIZE = 300.0
# Readings further out than so many half ranges are drawn about their own middle.
_FAR = 6.0


def fit_page(fit: SampleFit, points: Array) -> str:
    """Return the page of a fit of recorded samples.

    Parameters
    ----------
    fit : SampleFit
    points : ndarray, shape (n, 3)
        The samples, in their unit.
    """
    return render(
        "sample_fit.html.j2", package="hiltest.logs", reason=reason_line,
        fit=fit, tone=_TONES[fit.best.verdict], rows=figure_rows(fit), samples=_samples(fit, points),
        maps=_maps(fit, points), version=__version__,
    )


def write_page(fit: SampleFit, points: Array, path: Path) -> None:
    """Write the page so that a reader sees the whole file or none."""
    write_asked_for(path, fit_page(fit, points))


def _samples(fit: SampleFit, points: Array) -> list[Figure]:
    corrected = _corrected(fit.best, _drawn(points))
    after = [] if corrected is None else [_after(corrected, fit.best.name, axes) for axes in ("xy", "xz")]
    return [_before(_drawn(points), fit.unit), *after]


def _maps(fit: SampleFit, points: Array) -> list[Figure]:
    corrected = _corrected(fit.best, points)
    if corrected is None:
        return []
    return [coverage_map(corrected, _drawn(corrected)), _lengths(_drawn(corrected), len(points))]


def _drawn(points: Array) -> Array:
    """Return every so many of the points, few enough to draw."""
    return points[:: -(-len(points) // _DRAWN)]


def _corrected(best: CalibratorFit, points: Array) -> Array | None:
    """Return the corrected points in units of the radius, None without a calibration."""
    if best.soft_iron is None or best.hard_iron is None or best.radius is None:
        return None
    corrected: Array = (points - best.hard_iron) @ np.array(best.soft_iron).T / best.radius
    return corrected


def _before(points: Array, unit: str) -> Figure:
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    middle, half = (low + high) / 2.0, float((high - low).max()) / 2.0 or 1.0
    furthest = float(np.abs(points[:, :2]).max())
    if 0.0 < furthest < _FAR * half:
        middle, half = np.zeros(2), furthest
    (x, y), reach = middle, 1.15 * half
    figure = Figure(
        title="before", description=f"{len(points)} points seen along z, as they were read",
        x_label=f"x [{unit}]", y_label=f"y [{unit}]", x_range=(x - reach, x + reach), y_range=(y - reach, y + reach),
        width=_SIZE, equal_axes=True,
    )  # fmt: skip
    if not middle.any():
        figure.level(0, "zero")
        figure.line([(0, -reach), (0, reach)], "zero")
    figure.dots(_pairs(points[:, 0], points[:, 1]), "samples")
    return figure


def _after(points: Array, name: str, axes: str) -> Figure:
    across, up = ("xyz".index(axis) for axis in axes)
    reach = 1.15 * max(1.0, float(np.abs(points).max()))
    figure = Figure(
        title=f"after {name}", description=f"{len(points)} corrected points in {axes}, with the unit circle",
        x_label=f"{axes[0]} [radius]", y_label=f"{axes[1]} [radius]", x_range=(-reach, reach),
        y_range=(-reach, reach), width=_SIZE, equal_axes=True,
    )  # fmt: skip
    figure.dots(_pairs(points[:, across], points[:, up]), "samples")
    figure.circle((0, 0), 1.0, "unit")
    return figure


def _lengths(shown: Array, count: int) -> Figure:
    """Draw the corrected lengths in the order of the file: a disturbance shows as a step."""
    lengths = 100.0 * (np.linalg.norm(shown, axis=1) - 1.0)
    reach = 1.15 * max(2.0, float(np.abs(lengths).max()))
    figure = Figure(
        title="length of the corrected readings", description="Difference from the radius in the order of the file",
        x_label="reading", y_label="off the radius [%]", x_range=(0, max(1, count)), y_range=(-reach, reach),
    )  # fmt: skip
    figure.level(0, "zero")
    figure.dots(_pairs(np.linspace(0, count, len(lengths), endpoint=False), lengths), "samples")
    return figure


def _pairs(x: Array, y: Array) -> list[tuple[float, float]]:
    return list(zip(x.tolist(), y.tolist(), strict=True))
