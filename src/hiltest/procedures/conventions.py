"""Conventions by which what firmware says is right, where it is far off by those that the rig declares."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import circular_mean_deg, heading_error_deg, wrap_180
from hiltest.device.frames import FRAMES, Frame
from hiltest.orientation import DegenerateFieldError, tilt_heading

RIGHT_WITHIN_DEG = 10.0
"""Another convention moves angles by tens of degrees, and leaves no more than this once it is the right one."""
_QUARTERS_DEG = {0.0: "north", 90.0: "east", 180.0: "south", 270.0: "west"}
# Headings that cover less than this part of what the board was turned through do not follow it.
_COVERED = 0.5
Vectors: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Gravity [g] and field [uT], in hiltest's axes by the declared frame."""


def other_way(answered_deg: Sequence[float], reference_deg: Sequence[float], declared: Frame) -> str:
    """Return which way headings grow if they are right then and not as declared; empty otherwise.

    Parameters
    ----------
    answered_deg
        Headings of the firmware, as the declared frame has them.
    reference_deg
        Of the board.
    """
    if _largest(answered_deg, reference_deg) <= RIGHT_WITHIN_DEG:
        return ""
    left_deg, zero_deg = min((_turned(answered_deg, reference_deg, zero), zero) for zero in _QUARTERS_DEG)
    if left_deg > RIGHT_WITHIN_DEG:
        return ""
    way = "counterclockwise" if declared.clockwise else "clockwise"
    key = f': write heading = "{way}" under [device]' if zero_deg == 0.0 else ""
    return f"headings are right, within {left_deg:.1f} deg, if they grow {way} from {_QUARTERS_DEG[zero_deg]}{key}"


def standing_still(answered_deg: Sequence[float], reference_deg: Sequence[float]) -> str:
    """Return what headings cover that do not follow the board; empty where they do."""
    covered_deg, turned_deg = _covered(answered_deg), _covered(reference_deg)
    if covered_deg >= _COVERED * turned_deg:
        return ""
    return f"they cover {covered_deg:.1f} deg while the board is turned through {turned_deg:.0f}"


def other_frame(vectors: Sequence[Vectors], reference_deg: Sequence[float], declared: str, way: Frame) -> str:
    """Return the frame in which the firmware's vectors are right if they are not in the declared one; or empty.

    Parameters
    ----------
    reference_deg
        Heading of the board at each.
    way
        With the way in which headings grow: of two frames with the same axes the one that has it is named.
    """
    left_deg = {name: _left(vectors, reference_deg, FRAMES[declared], frame) for name, frame in FRAMES.items()}
    if left_deg[declared] <= RIGHT_WITHIN_DEG:
        return ""
    name = min(left_deg, key=lambda each: (left_deg[each], FRAMES[each].clockwise != way.clockwise))
    if left_deg[name] > RIGHT_WITHIN_DEG:
        return ""
    return f'headings computed from its vectors are right, within {left_deg[name]:.1f} deg, with frame = "{name}"'


def other_tilt(said: Sequence[tuple[float, float]], known: Sequence[tuple[float, float]]) -> str:
    """Return how pitch and roll are to be taken to be right, if they are wrong as they are; empty otherwise.

    Parameters
    ----------
    said, known
        [deg]
    """
    def left(exchanged: bool, pitch: int, roll: int) -> float:
        taken = [(other, one) if exchanged else (one, other) for one, other in said]
        errors = [
            (wrap_180(pitch * a[0] - b[0]), wrap_180(roll * a[1] - b[1])) for a, b in zip(taken, known, strict=True)
        ]
        return float(np.abs(errors).max())

    tried = {each: left(*each) for each in product((False, True), (1, -1), (1, -1))}
    if tried[False, 1, 1] <= RIGHT_WITHIN_DEG:
        return ""
    exchanged, pitch, roll = best = min(tried, key=lambda each: tried[each])
    if tried[best] > RIGHT_WITHIN_DEG:
        return ""
    negated = [name for name, sign in (("pitch", pitch), ("roll", roll)) if sign < 0]
    how = ["pitch and roll exchanged"] * exchanged + [f"{' and '.join(negated)} negated"] * bool(negated)
    return f"right within {tried[best]:.1f} deg with {', '.join(how)}"


def _left(vectors: Sequence[Vectors], reference_deg: Sequence[float], declared: Frame, frame: Frame) -> float:
    """Return the largest error of headings computed from vectors that are taken in another frame."""
    back = np.array(declared.to_body).T
    try:
        headings = [
            tilt_heading(frame.gravity(declared.gravity_sign * back @ gravity), frame.vector(back @ field)).heading_deg
            for gravity, field in vectors
        ]
    except DegenerateFieldError:
        return 180.0
    return _largest(headings, reference_deg)


def _turned(answered_deg: Sequence[float], reference_deg: Sequence[float], zero_deg: float) -> float:
    """Return the largest error of headings that grow the other way from a quarter of the compass."""
    return _largest([zero_deg - each for each in answered_deg], reference_deg)


def _largest(answered_deg: Iterable[float], reference_deg: Iterable[float]) -> float:
    """Return the largest error, the mean error taken off where that is small itself."""
    errors = [heading_error_deg(*pair) for pair in zip(answered_deg, reference_deg, strict=True)]
    try:
        mean_deg = circular_mean_deg(errors)
    except ValueError:
        return 180.0
    if abs(wrap_180(mean_deg)) > RIGHT_WITHIN_DEG:
        return 180.0
    return max(abs(wrap_180(error)) for error in errors)


def _covered(headings_deg: Sequence[float]) -> float:
    """Return the smallest arc that holds all headings [deg]."""
    ordered = sorted(heading_deg % 360.0 for heading_deg in headings_deg)
    gaps = [after - before for before, after in zip(ordered, [*ordered[1:], ordered[0] + 360.0], strict=True)]
    return 360.0 - max(gaps)
