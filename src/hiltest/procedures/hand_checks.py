"""Checks of an operator's steps against the board's own sensors, before any calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

LEAST_TURN_DEG = 10.0
"""Smallest requested turn that is checked: it moves a field of 22.8 uT by 4 uT, three times the noise of 16 readings
that counts as motion."""
# Iron of up to 20 % beside the sensor changes the length of a turn's chord by up to 1.5.
_MOST_RATIO = 1.5
# A normal distribution is beyond 3.5 robust standard deviations in 5 of 10 000 cases (Iglewicz and Hoaglin, 1993).
_STICKS_OUT = 3.5
_MAD_TO_SIGMA = 1.4826
# Four parameters per axis are fitted; with twice as many poses a single wrong one cannot bend the fit to itself.
FEWEST_POSES = 8
_MOST_FITS = 20
_LEAST_REST = 0.05  # of a pose that almost alone determines a parameter
# A side of the board is named if the direction has this component along it: at most three are.
_NAMED = 0.4
_SIDES = (("nose", "tail"), ("right side", "left side"), ("underside", "top"))


def turn_fault(asked: tuple[Reals, Reals], read: tuple[Reals, Reals], turned_deg: float) -> str:
    """Describe the turn between two poses by the field [deg], if it contradicts the scale; empty if it does not.

    Parameters
    ----------
    asked
        Known fields along the board's axes at both poses, shape (3,) each [uT].
    read
        Means of the raw magnetometer there, in any axes [uT]. Hard iron cancels in their difference.
    turned_deg
        Difference of the headings by the scale, of two poses of the same tilt.
    """
    expected, actual = (float(np.linalg.norm(after - before)) for before, after in (asked, read))
    if max(expected, actual) <= _MOST_RATIO * min(expected, actual):
        return ""
    diameter = expected / math.sin(math.radians(abs(turned_deg)) / 2.0)
    field_deg = math.degrees(2.0 * math.asin(min(1.0, actual / diameter)))
    return f"its magnetometer shows {field_deg:.0f}"


def setting_errors_deg(field: Reals, gravity: Reals, read: Reals, uncertainty_deg: float) -> dict[int, float]:
    """Return true minus set heading of the poses that stick out, by the raw magnetometer alone, the largest first.

    Parameters
    ----------
    field, gravity
        Known field and gravity along the board's axes at the poses as they were set; shape (n, 3).
    read
        Means of the raw magnetometer there; shape (n, 3), in any unit and axes.
    uncertainty_deg
        Declared uncertainty of the table, which the verdict allows for: a smaller error never sticks out.

    Returns
    -------
    dict of int to float
        Errors [deg] by the index of the pose; empty for fewer than `FEWEST_POSES`.

    Notes
    -----
    Any iron, scale or exchange of axes is ``read = M field + h``, which is fitted by least squares. A rest along the
    direction in which a turn about the vertical moves the reading is an error of the angle; firmware and calibration
    have no part in it. It is divided by its own spread, which depends on the leverage of its pose, and sticks out
    beyond 3.5 robust standard deviations (1.4826 times the median). The fit is repeated without such poses until they
    stay the same.
    """
    n = len(field)
    if n < FEWEST_POSES:
        return {}
    design, by_heading = np.column_stack([field, np.ones(n)]), -np.cross(gravity, field)
    fitted = np.ones(n, dtype=bool)
    for _ in range(_MOST_FITS):
        matrix, *_ = np.linalg.lstsq(design[fitted], read[fitted], rcond=None)
        slopes, rest = by_heading @ matrix[:3], read - design @ matrix
        errors = np.degrees(np.sum(rest * slopes, axis=1) / np.maximum(np.sum(slopes**2, axis=1), np.finfo(float).tiny))
        leverage = np.sum(design @ np.linalg.pinv(design[fitted].T @ design[fitted]) * design, axis=1)
        scaled = np.abs(errors) / np.sqrt(np.where(fitted, np.maximum(1.0 - leverage, _LEAST_REST), 1.0 + leverage))
        fits = scaled <= _STICKS_OUT * _MAD_TO_SIGMA * float(np.median(scaled))
        if np.array_equal(fits, fitted):
            break
        fitted = fits
    # A sensor that stands still has no slopes, and errors of any size.
    out = np.flatnonzero(~fits & (np.abs(errors) > uncertainty_deg) & (np.abs(errors) <= 180.0))
    return {int(index): float(errors[index]) for index in out[np.argsort(-np.abs(errors[out]))]}


def side_in_words(direction: Sequence[float]) -> str:
    """Return a direction along the board's axes as the sides that it points to: "nose and right side"."""
    sides = [names[part < 0.0] for names, part in zip(_SIDES, direction, strict=True) if abs(part) >= _NAMED]
    return " and ".join(sides)
