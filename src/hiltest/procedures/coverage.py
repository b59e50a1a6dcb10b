"""Coverage of the sphere by magnetometer points, and the largest uncovered cap."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.fit import FitStatus
from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.sphere import fit_sphere
from hiltest.link.replies import MICROTESLA_PER_COUNT
from hiltest.procedures.hand_checks import side_in_words

# Directions 2 degrees apart, so the cap is at worst that much too small.
_DIRECTIONS = sphere_directions(5000)
# A board at rest gives a ball of noise, which a sphere fits too, but not with the field as its radius.
_RADIUS_WITHIN = 2.0


def largest_uncovered_cap(points: ArrayLike, *, field_ut: float) -> tuple[float, NDArray[np.float64] | None]:
    """Return radius [deg] and direction of the largest cap of the sphere that holds no point.

    Parameters
    ----------
    points : shape (n, 3)
        Magnetometer counts.
    field_ut
        Strength of the local field, within a factor of two.

    Returns
    -------
    float
        Radius, 0 to 180; 180 while the points do not determine the centre of the sphere.
    ndarray, shape (3,), or None
        Unit vector to its centre along the board's axes; None without a centre of the sphere.

    Notes
    -----
    Directions are seen from the centre of the sphere that fits the points best. The middle of their range would not do:
    seen from its own middle, a patch covers all directions.

    An operator can act on this cap, and a fit cannot detect it: no point determines the ellipsoid there. It does not
    depend on cells whose size would have to suit the number of points (100 random points fill 63 of 100 equal cells).
    Random points over the whole sphere leave 30 degrees at n = 100, 18 at 300; evenly spread ones 16 and 9.
    """
    counts = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    sphere = fit_sphere(counts, FitStatus.NOT_AN_ELLIPSOID)
    if not sphere.has_fit:
        return 180.0, None
    radius_ut = MICROTESLA_PER_COUNT / float(sphere.soft_iron[0, 0])
    if not field_ut / _RADIUS_WITHIN < radius_ut < field_ut * _RADIUS_WITHIN:
        return 180.0, None
    corrected = sphere.corrected(counts)
    norms = np.linalg.norm(corrected, axis=1, keepdims=True)
    directions: NDArray[np.float64] = np.divide(corrected, norms, out=np.zeros_like(corrected), where=norms > 0.0)
    nearest = (_DIRECTIONS @ directions.T).max(axis=1)
    radius_deg = math.degrees(math.acos(max(-1.0, min(1.0, float(nearest.min())))))
    return radius_deg, _DIRECTIONS[int(nearest.argmin())]


def sphere_coverage(points: ArrayLike, *, field_ut: float) -> float:
    """Return the part of the sphere's area that is outside of the largest uncovered cap, 0 to 1.

    Parameters
    ----------
    points : shape (n, 3)
        Magnetometer counts.
    field_ut
        Strength of the local field, within a factor of two.

    Notes
    -----
    ``(1 + cos cap) / 2``: points on the sphere without a cap give the share of the rest, in the sense of the thesis'
    generator and the calibrators' own coverage figures (within 0.02 for 100 points and a soft iron of 3 %). 100 random
    points over the whole sphere give 0.93. The figure is for an operator who turns a board, not for a verdict: the
    calibrators use their own pivots.
    """
    return (1.0 + math.cos(math.radians(largest_uncovered_cap(points, field_ut=field_ut)[0]))) / 2.0


def hole_in_words(points: ArrayLike, *, field_ut: float, dip_deg: float) -> str:
    """Describe the largest uncovered cap to an operator, by the sides of the board to turn into it.

    Parameters
    ----------
    dip_deg
        Inclination of the local field: it points mostly down on the northern half of the earth, and up on the southern.
    """
    radius_deg, direction = largest_uncovered_cap(points, field_ut=field_ut)
    if direction is None:
        return "the points are no sphere: the board was hardly turned"
    vertical = "down" if dip_deg >= 0.0 else "up"
    return f"a hole of {radius_deg:.0f} deg is left where its {side_in_words(direction.tolist())} points {vertical}"
