"""Statistics of heading errors: safe against wrapping, and without removal of outliers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.orientation.angles import circular_mean_deg, wrap_180, wrap_360

SECTOR_DEG = 30.0


@dataclass(frozen=True, slots=True)
class Sector:
    """A range of headings, `start_deg` included and `end_deg` not, and the largest error in it [deg]."""

    start_deg: float
    end_deg: float
    max_deg: float


@dataclass(frozen=True, slots=True)
class HeadingSummary:
    """Statistics of heading errors."""

    n: int
    max_deg: float
    rms_deg: float
    """Largest absolute error, and root mean square."""
    bias_deg: float | None
    """Circular mean of the errors, in (-180, 180]; None if it is undefined."""
    max_centred_deg: float | None
    """Largest absolute error minus the bias; None without a bias."""
    worst_sector: Sector
    """Sector of reference headings with the largest error."""
    worst_heading_deg: float
    """Reference heading of the largest error."""
    tilt_sensitivity_deg: float | None
    """rms over tilted poses minus rms over level ones; None if either are missing."""


def summarise(
    error_deg: ArrayLike, reference_deg: ArrayLike, *, level: Sequence[bool] | NDArray[np.bool_] | None = None
) -> HeadingSummary:
    """Summarise heading errors.

    Parameters
    ----------
    error_deg : shape (n,)
        Answer minus reference; whole turns are removed.
    reference_deg : shape (n,)
        Known headings.
    level : shape (n,)
        Mask of level poses, for `tilt_sensitivity_deg`.

    Raises
    ------
    ValueError
        When there are no errors, or the lengths differ.
    """
    errors = [wrap_180(float(value)) for value in np.asarray(error_deg, dtype=np.float64)]
    references = [wrap_360(float(value)) for value in np.asarray(reference_deg, dtype=np.float64)]
    if not errors or len(errors) != len(references):
        raise ValueError(f"{len(errors)} errors for {len(references)} reference headings; give equally many, and some")
    worst = max(range(len(errors)), key=lambda index: abs(errors[index]))
    start_deg = SECTOR_DEG * math.floor(references[worst] / SECTOR_DEG)
    bias_deg = _bias_deg(errors)
    return HeadingSummary(
        n=len(errors),
        max_deg=abs(errors[worst]),
        rms_deg=rms(errors),
        bias_deg=bias_deg,
        max_centred_deg=None if bias_deg is None else max(abs(wrap_180(error - bias_deg)) for error in errors),
        worst_sector=Sector(start_deg, start_deg + SECTOR_DEG, abs(errors[worst])),
        worst_heading_deg=references[worst],
        tilt_sensitivity_deg=None if level is None else _tilt_sensitivity_deg(errors, level),
    )


def rms(values: Sequence[float]) -> float:
    """Return the root mean square, summed exactly so that the order of values does not matter."""
    return math.sqrt(math.fsum(value * value for value in values) / len(values))


def _bias_deg(errors: Sequence[float]) -> float | None:
    try:
        return wrap_180(circular_mean_deg(errors))
    except ValueError:  # a constant heading errs equally in all directions
        return None


def _tilt_sensitivity_deg(errors: Sequence[float], level: Sequence[bool] | NDArray[np.bool_]) -> float | None:
    flat = [error for error, is_level in zip(errors, level, strict=True) if is_level]
    tilted = [error for error, is_level in zip(errors, level, strict=True) if not is_level]
    return rms(tilted) - rms(flat) if flat and tilted else None
