"""The picture of a fit: readings before and after on the sphere, the hole, the change, and the heading error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.acceptance import Acceptance
from hiltest.calibration.robust import Mask
from hiltest.calibration.solid_angle import Hole
from hiltest.log_fitting.fit_result import SampleFit
from hiltest.log_fitting.fit_sentence import (
    HEADINGS_DEG,
    calibrated_heading_error_deg,
    dip_deg,
    error_words,
    heading_errors_as_read_deg,
)
from hiltest.report.marks import KeyEntry, Mark
from hiltest.report.svg import Figure, Point

Array = NDArray[np.float64]

LEFT_OUT = "series-3 hollow"
_SIZE = 360.0
# Distance in half ranges beyond which readings are drawn about their own middle.
_FAR = 6.0
# Angle between the view and the middle of the hole, so that both the hole and the sphere's edge are visible.
_ASIDE_DEG = 35.0
# Smallest hole that is drawn: the radius that counts as uncovered.
_DRAWN_HOLE_DEG = 20.0
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 73)


def picture(fit: SampleFit, points: Array, later: Mask, left_out: Array) -> list[Figure]:
    """Return the panels as read, with the calibration if there is one, and the heading error unless it is refused.

    Parameters
    ----------
    points : shape (n, 3)
        Readings that are drawn, in the unit of the samples.
    later : shape (n,)
        Mask of the readings after a change of the field.
    left_out : shape (k, 3)
        Readings that the fit omitted; drawn if they are near the others.
    """
    best, view = fit.best, _view(fit)
    low, high = points.min(axis=0), points.max(axis=0)
    half = float((high - low).max()) / 2.0 or 1.0
    radius, middle = best.radius or half, (low + high) / 2.0
    is_near = best.radius is not None and max(radius, float(np.abs(middle).max())) < _FAR * half
    origin = np.zeros(3) if is_near else middle
    scale = radius if is_near else half
    before = _sphere("as read", (points - origin) / scale, later, (left_out - origin) / scale, view, ideal=is_near)
    if best.hard_iron is None or best.soft_iron is None:
        return [before]
    if is_near:
        centre: Point = tuple((np.array(best.hard_iron) / scale @ view.T)[:2].tolist())
        before.line([(0.0, 0.0), centre], "over")
        before.marks([centre], "series-3 filled", Mark.DIAMOND, radius=5.0)
        before.key.append(KeyEntry("hard iron", "over", Mark.DIAMOND, "series-3 filled"))
    soft_iron = np.array(best.soft_iron).T / radius
    refused = best.verdict is Acceptance.REFUSED
    title = f"with {best.name}{', refused' if refused else ''}"
    cross = (left_out - best.hard_iron) @ soft_iron
    after = _sphere(title, (points - best.hard_iron) @ soft_iron, later, cross, view)
    if fit.hole is not None and fit.hole.radius_deg > _DRAWN_HOLE_DEG:
        after.line(_edge(fit.hole, view), "series-1 thick")
        after.key.append(KeyEntry(f"largest hole, {fit.hole.radius_deg:.0f}° about {fit.hole.axes}", "series-1 thick"))
    errors_deg = heading_errors_as_read_deg(fit)
    return [before, after] if refused or errors_deg is None else [before, after, _headings(fit, errors_deg)]


def _view(fit: SampleFit) -> Array:
    """Return the axes right, up and towards the viewer, as rows: along the axis of a turn, or aside of the hole."""
    if fit.best.turn is not None:
        return np.roll(np.eye(3), "xyz".index(fit.best.turn.axis) - 2, axis=1)
    towards = np.array((1.0, 1.0, 1.0) if fit.hole is None else fit.hole.direction)
    towards = towards / np.linalg.norm(towards)
    across = np.cross(np.eye(3)[int(np.argmin(np.abs(towards)))], towards)
    across = across / np.linalg.norm(across)
    aside = np.radians(_ASIDE_DEG)
    towards, right = (
        np.cos(aside) * towards + np.sin(aside) * across,
        np.cos(aside) * across - np.sin(aside) * towards,
    )
    return np.array([right, np.cross(towards, right), towards])


def _edge(hole: Hole, view: Array) -> list[Point]:
    middle, radius = np.array(hole.direction), np.radians(hole.radius_deg)
    first = np.cross(middle, np.eye(3)[int(np.argmin(np.abs(middle)))])
    first = first / np.linalg.norm(first)
    turn = np.outer(np.cos(_CIRCLE), first) + np.outer(np.sin(_CIRCLE), np.cross(middle, first))
    return _pairs((np.cos(radius) * middle + np.sin(radius) * turn) @ view.T)


def _sphere(title: str, points: Array, later: Mask, left_out: Array, view: Array, *, ideal: bool = True) -> Figure:
    """Draw points in radii, with the sphere that they should be on if it is near; those behind it are pale."""
    seen = points @ view.T
    reach = 1.08 * max(1.0, float(np.abs(seen[:, :2]).max(initial=0.0)))
    figure = Figure(
        title=title,
        description=f"{len(points)} readings{', and the sphere that they should be on' if ideal else ''}",
        x_label="",
        y_label="",
        x_range=(-reach, reach),
        y_range=(-reach, reach),
        width=_SIZE,
        equal_axes=True,
    )
    for axis in range(3 if ideal else 0):
        turn = np.roll(np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE), 0.0 * _CIRCLE]), axis, axis=1) @ view.T
        figure.line(_pairs(turn), "thesis")
    if ideal:
        figure.circle((0.0, 0.0), 1.0, "unit")
        figure.key.append(KeyEntry("sphere of the field", "unit"))
    front = seen[:, 2] >= 0.0
    for style, chosen in (("samples far", ~front), ("samples", front)):
        figure.dots(_pairs(seen[chosen & ~later]), style)
        if later.any():
            figure.dots(_pairs(seen[chosen & later]), f"{style} later")
    if later.any():
        figure.key.append(KeyEntry("after the change", "", Mark.DOT, "series-3 filled"))
    crosses = (left_out @ view.T)[:, :2]
    if (inside := (np.abs(crosses) <= reach).all(axis=1)).any():
        figure.series("left out", _pairs(crosses[inside]), mark=Mark.CROSS, mark_style=LEFT_OUT)
    return figure


def _headings(fit: SampleFit, errors_deg: Array) -> Figure:
    after_deg = calibrated_heading_error_deg(fit) or 0.0
    reach = 1.15 * max(float(np.abs(errors_deg).max()), after_deg, 1.0)
    figure = Figure(
        title=f"heading error, level, at a dip of {dip_deg(fit):.0f}°",
        description="Error over the heading as read, and its range with the calibration",
        x_label="heading [deg]",
        y_label="error [deg]",
        x_range=(0.0, 360.0),
        y_range=(-reach, reach),
        x_ticks=(0, 90, 180, 270, 360),
        width=_SIZE,
        height=_SIZE - 20.0,
    )
    figure.band(-2.0 * after_deg, 2.0 * after_deg, "allowed")
    figure.level(0.0, "better")
    figure.line(_pairs(np.column_stack([HEADINGS_DEG, errors_deg])), "over")
    figure.key += [
        KeyEntry("as read", "over"),
        KeyEntry(f"with the calibration: ±{2.0 * after_deg:.2g}° (95 %, {error_words(fit)})", "better"),
    ]
    return figure


def _pairs(points: Array) -> list[Point]:
    return [(x, y) for x, y in points[:, :2].tolist()]
