"""Detection of conventions under which firmware's values are right, if they are far off under the declared ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.interfaces.frames import FRAMES, Frame
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.orientation.angles import circular_mean_deg, heading_error_deg, wrap_180

RIGHT_WITHIN_DEG = 10.0
"""A wrong convention moves angles by tens of degrees; the right one leaves at most this error."""
# Headings that cover less than this part of the board's arc do not follow the board.
_COVERED = 0.5
Vectors: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Gravity [g] and field [uT], in hiltest's axes by the declared frame."""


def standing_still(answered_deg: Sequence[float], reference_deg: Sequence[float]) -> str:
    """Return the arc of headings that do not follow the board, in words; empty if they do."""
    covered_deg, turned_deg = _covered_arc_deg(answered_deg), _covered_arc_deg(reference_deg)
    if covered_deg >= _COVERED * turned_deg:
        return ""
    return f"they cover {covered_deg:.1f} deg while the board is turned through {turned_deg:.0f}"


def other_frame(vectors: Sequence[Vectors], reference_deg: Sequence[float], declared: str, way: Frame) -> str:
    """Return the frame in which the firmware's vectors are right; empty if the declared one is right or none is.

    Parameters
    ----------
    reference_deg
        Heading of the board for each.
    way
        Frame with the direction of headings, which selects between frames with the same axes.
    """
    left_deg = {
        name: _largest_error_in_frame(vectors, reference_deg, FRAMES[declared], frame) for name, frame in FRAMES.items()
    }
    if left_deg[declared] <= RIGHT_WITHIN_DEG:
        return ""
    name = min(left_deg, key=lambda name: (left_deg[name], FRAMES[name].clockwise != way.clockwise))
    if left_deg[name] > RIGHT_WITHIN_DEG:
        return ""
    return f'headings computed from its vectors are right, within {left_deg[name]:.1f} deg, with frame = "{name}"'


def other_tilt(answered: Sequence[tuple[float, float]], reference: Sequence[tuple[float, float]]) -> str:
    """Return the change of pitch and roll that makes them right if they are wrong as declared; otherwise empty.

    Parameters
    ----------
    answered, reference
        [deg]
    """

    def remaining_deg(exchanged: bool, pitch: int, roll: int) -> float:
        tilts = [(other, one) if exchanged else (one, other) for one, other in answered]
        errors = [
            (wrap_180(pitch * a[0] - b[0]), wrap_180(roll * a[1] - b[1])) for a, b in zip(tilts, reference, strict=True)
        ]
        return float(np.abs(errors).max())

    tried = {change: remaining_deg(*change) for change in product((False, True), (1, -1), (1, -1))}
    if tried[False, 1, 1] <= RIGHT_WITHIN_DEG:
        return ""
    exchanged, pitch, roll = best = min(tried, key=lambda change: tried[change])
    if tried[best] > RIGHT_WITHIN_DEG:
        return ""
    negated = [name for name, sign in (("pitch", pitch), ("roll", roll)) if sign < 0]
    how = ["pitch and roll exchanged"] * exchanged + [f"{' and '.join(negated)} negated"] * bool(negated)
    return f"right within {tried[best]:.1f} deg with {', '.join(how)}"


def _largest_error_in_frame(
    vectors: Sequence[Vectors], reference_deg: Sequence[float], declared: Frame, frame: Frame
) -> float:
    """Return the largest error of headings that are computed from vectors in another frame."""
    back = np.array(declared.to_body).T
    try:
        headings = [
            tilt_heading(frame.gravity(declared.gravity_sign * back @ gravity), frame.vector(back @ field)).heading_deg
            for gravity, field in vectors
        ]
    except DegenerateFieldError:
        return 180.0
    return _largest_error(headings, reference_deg)


def _largest_error(answered_deg: Iterable[float], reference_deg: Iterable[float]) -> float:
    """Return the largest error, minus the mean error if that is small."""
    errors = [heading_error_deg(*pair) for pair in zip(answered_deg, reference_deg, strict=True)]
    try:
        mean_deg = circular_mean_deg(errors)
    except ValueError:
        return 180.0
    if abs(wrap_180(mean_deg)) > RIGHT_WITHIN_DEG:
        return 180.0
    return max(abs(wrap_180(error)) for error in errors)


def _covered_arc_deg(headings_deg: Sequence[float]) -> float:
    """Return the smallest arc that holds all headings [deg]."""
    ordered = sorted(heading_deg % 360.0 for heading_deg in headings_deg)
    gaps = [after - before for before, after in zip(ordered, [*ordered[1:], ordered[0] + 360.0], strict=True)]
    return 360.0 - max(gaps)
