"""Page of a fit of recorded samples: one self-contained HTML file."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hiltest import __version__
from hiltest.calibration.acceptance import Acceptance
from hiltest.calibration.direction_error import BLOCKS
from hiltest.calibration.robust import Mask
from hiltest.log_fitting.fit_result import CalibratorFit, SampleFit
from hiltest.log_fitting.fit_sentence import headline
from hiltest.log_fitting.sample_fit_picture import LEFT_OUT, picture
from hiltest.log_fitting.sample_fit_table import figure_tables, told_reasons
from hiltest.log_fitting.samples import Samples
from hiltest.log_fitting.span import FieldChange, instants
from hiltest.report.figures.samples import coverage_map
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.page import render
from hiltest.report.svg import Figure
from hiltest.run_record.files import write_asked_for

Array = NDArray[np.float64]
_Rows = TypeVar("_Rows", Array, NDArray[np.intp])

_TONES = {Acceptance.GOOD: "good", Acceptance.FAIR: "warn", Acceptance.POOR: "warn", Acceptance.REFUSED: "bad"}
# Maximum number of dots: more would overlap, and make the file large.
_DRAWN = 2000
_WIDE = 920.0


def fit_page(fit: SampleFit, samples: Samples) -> str:
    """Return the page of a fit of samples."""
    return render(
        "sample_fit.html.j2",
        package="hiltest.log_fitting",
        told=[*told_reasons(fit), *fit.notes],
        fit=fit,
        tone=_TONES[fit.best.verdict],
        headline=headline(fit),
        first=_draw_first(fit, samples),
        tables=figure_tables(fit),
        pictures=_draw_rows(fit, samples),
        version=__version__,
    )


def write_page(fit: SampleFit, samples: Samples, path: Path) -> None:
    """Write the page so that a reader sees the whole file or none."""
    write_asked_for(path, fit_page(fit, samples))


def _draw_first(fit: SampleFit, samples: Samples) -> list[Figure]:
    dropped = _dropped_mask(fit, samples)
    drawn = _thin_out(np.flatnonzero(~dropped))
    later = np.zeros(len(samples.points), dtype=bool) if fit.change is None else instants(samples)[0] >= fit.change.at
    return picture(fit, samples.points[drawn], later[drawn], _thin_out(samples.points[dropped]))


def _draw_rows(fit: SampleFit, samples: Samples) -> list[list[Figure]]:
    """Return rows of figures: the residuals in time, and the coverage of the sphere."""
    dropped = _dropped_mask(fit, samples)
    corrected = _corrected_points(fit.best, samples.points)
    if corrected is None:
        return []
    rows = [[_draw_lengths(corrected, dropped, samples, fit.change)]]
    # A turn in a plane does not cover an area of the sphere.
    if fit.best.turn is None:
        rows.append([coverage_map(corrected[~dropped], _thin_out(corrected[~dropped]), fit.hole)])
    return rows


def _dropped_mask(fit: SampleFit, samples: Samples) -> Mask:
    """Return a mask of the samples that the fit omitted."""
    lines = np.arange(1, len(samples.points) + 1) if samples.lines is None else samples.lines
    dropped = np.zeros(len(lines), dtype=bool)
    for first, last in fit.dropped:
        dropped[np.searchsorted(lines, first) : np.searchsorted(lines, last, side="right")] = True
    return dropped


def _thin_out(points: _Rows) -> _Rows:
    """Return a subset of the rows, few enough to draw."""
    return points[:: max(1, -(-len(points) // _DRAWN))]


def _corrected_points(best: CalibratorFit, points: Array) -> Array | None:
    """Return the corrected points in units of the radius; None without a calibration."""
    if best.soft_iron is None or best.hard_iron is None or best.radius is None:
        return None
    corrected: Array = (points - best.hard_iron) @ np.array(best.soft_iron).T / best.radius
    return corrected


def _draw_lengths(corrected: Array, dropped: Mask, samples: Samples, change: FieldChange | None) -> Figure:
    """Draw the corrected lengths in time, or in the order of the file: a disturbance shows as a step."""
    lengths = 100.0 * (np.linalg.norm(corrected, axis=1) - 1.0)
    at, unit = instants(samples)
    timed = unit == "s"
    reach = 1.15 * max(2.0, float(np.abs(lengths[~dropped]).max()))
    figure = Figure(
        title="length of the corrected readings",
        description="Difference from the radius" + (" in time" if timed else " in the order of the file"),
        x_label="time [s]" if timed else "reading",
        y_label="off the radius [%]",
        x_range=(samples.start, float(at[-1])),
        y_range=(-reach, reach),
        width=_WIDE,
    )
    figure.level(0, "zero")
    both = np.column_stack([at, lengths])
    figure.dots(_pairs(*_thin_out(both[~dropped]).T), "samples")
    for start, end in pairwise(np.arange(BLOCKS + 1) * (len(at) - 1) // BLOCKS):
        used_lengths = lengths[start : end + 1][~dropped[start : end + 1]]
        if len(used_lengths):
            figure.line(
                [(float(at[start]), float(used_lengths.mean())), (float(at[end]), float(used_lengths.mean()))], "end"
            )
    figure.key.append(KeyEntry(f"means of the {BLOCKS} blocks of the direction error", "end"))
    if dropped.any():
        # Clipped to the edge of the figure.
        out = np.clip(_thin_out(both[dropped]), (-np.inf, -reach), (np.inf, reach))
        figure.series("left out", _pairs(*out.T), mark=Mark.CROSS, mark_style=LEFT_OUT)
    if change is not None:
        figure.upright(change.at, "the field changed", "limit")
    return figure


def _pairs(x: Array, y: Array) -> list[tuple[float, float]]:
    return list(zip(x.tolist(), y.tolist(), strict=True))
