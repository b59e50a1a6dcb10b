"""Errors of estimated attitudes against an optical truth, as the benchmark BROAD defines them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.errors import ConfigError
from hiltest.orientation.motion_recording import MotionRecording

Reals = NDArray[np.float64]
Estimator: TypeAlias = Callable[[Reals, Reals, Reals, float], Reals]
"""Function of gyroscope [rad/s], gravity [g], field [uT] and rate [Hz]: quaternions x, y, z, w to NED, shape (n, 4)."""

# Length of the row of the first seconds: longer than the filter's tilt needs.
_FIRST_S = 5.0
# Sizes from which a motion counts as accelerated, and the field as disturbed, in parts of gravity and of the field.
_ACCELERATED, _DISTURBED = 0.1, 0.1
# Window over which disturbances are averaged, so that noise of single samples is none [s].
_WINDOW_S = 0.1


@dataclass(frozen=True, slots=True)
class AttitudeScore:
    """Root-mean-square errors over some samples [deg]."""

    total_deg: float
    """Angle of the rotation between estimate and truth."""
    heading_deg: float
    """Its part about the vertical."""
    inclination_deg: float
    """Its part about a horizontal axis."""
    samples: int
    """Number of samples that count."""


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeErrors:
    """Errors of each sample [deg], shape (n,); NaN without a truth."""

    total_deg: Reals
    heading_deg: Reals
    inclination_deg: Reals

    def score(self, mask: NDArray[np.bool_]) -> AttitudeScore | None:
        """Return the root mean squares over the samples of a mask that have a truth; None without any."""
        counted = mask & np.isfinite(self.total_deg)
        if not counted.any():
            return None
        total, heading, inclination = (
            math.sqrt(float(np.mean(errors[counted] ** 2)))
            for errors in (self.total_deg, self.heading_deg, self.inclination_deg)
        )
        return AttitudeScore(total, heading, inclination, int(counted.sum()))


def attitude_errors(estimate: ArrayLike, truth: ArrayLike) -> AttitudeErrors:
    """Return the errors of estimated attitudes.

    Parameters
    ----------
    estimate, truth : shape (n, 4)
        Quaternions x, y, z, w from body to NED, of any norm above 0 and of either sign; NaN in the truth for none.

    Raises
    ------
    ConfigError
        If an estimate is not finite or zero, or the shapes differ.

    Notes
    -----
    With the rotation between both in the earth frame, ``e = estimate truth*``, the total error is ``2 acos |w|``, the
    heading error ``2 atan |z / w|`` and the inclination error ``2 acos sqrt(w^2 + z^2)``: Laidig, Caruso, Cereatti and
    Seel, "BROAD", Data 6 (7), 2021, section 4. Nothing is aligned here, because the published truth is aligned with the
    sensors and with the magnetic north already.
    """
    estimates, truths = np.asarray(estimate, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if estimates.shape != truths.shape or estimates.ndim != 2 or estimates.shape[1] != 4:
        raise ConfigError(f"estimates have shape {estimates.shape}, and the truth has {truths.shape}")
    norms = np.linalg.norm(estimates, axis=1)
    if not (np.isfinite(norms) & (norms > 0.0)).all():
        first = int(np.argmin(np.isfinite(norms) & (norms > 0.0)))
        raise ConfigError(f"the estimate of sample {first} is no attitude: {estimates[first].tolist()}")
    (a, b, c, d), (x, y, z, w) = estimates.T, truths.T
    north = -d * x + a * w - b * z + c * y
    east = -d * y + a * z + b * w - c * x
    down = -d * z - a * y + b * x + c * w
    scalar = d * w + a * x + b * y + c * z
    # Of each half angle the arc tangent is as exact as the quaternion; near 1 an arc cosine is not.
    horizontal, vertical = np.hypot(north, east), np.hypot(down, scalar)
    return AttitudeErrors(
        np.degrees(2.0 * np.arctan2(np.hypot(horizontal, down), np.abs(scalar))),
        np.degrees(2.0 * np.arctan2(np.abs(down), np.abs(scalar))),
        np.degrees(2.0 * np.arctan2(horizontal, vertical)),
    )


def score_estimator(
    recording: MotionRecording, estimator: Estimator, *, subtract_bias: bool = True
) -> Mapping[str, AttitudeScore]:
    """Run an estimator on a recording and return its scores by phase.

    Parameters
    ----------
    recording
        Motion with its truth.
    estimator
        Function that is called once with all samples.
    subtract_bias
        Subtract the mean rate of the rest before the motion, as the fusion suite does on a board.

    Returns
    -------
    Mapping
        ``motion`` is the benchmark's score; then those of `phases`, without the phases that no sample belongs to.

    Raises
    ------
    ConfigError
        If the recording has no rest whose bias could be subtracted, or the estimates are no attitudes.
    """
    rates = recording.gyroscope_rad_s - (recording.rest_bias_rad_s() if subtract_bias else 0.0)
    errors = attitude_errors(
        estimator(rates, recording.gravity_g, recording.field_ut, recording.rate_hz), recording.truth
    )
    scores = {name: errors.score(mask) for name, mask in phases(recording).items()}
    return {name: score for name, score in scores.items() if score is not None}


def phases(recording: MotionRecording, starts_s: float = 0.0) -> Mapping[str, NDArray[np.bool_]]:
    """Return masks, shape (n,), of the phases of a recording by name.

    ``motion`` is the motion phase that the recording declares, ``first seconds`` are the five after an estimator's
    start, and ``rest`` is the time afterwards and outside of the motion. Two are parts of the motion: in
    ``translation`` the acceleration differs from gravity by more than a tenth of it, and in ``disturbed field`` the
    field differs from its median by more than a tenth of it. Both are calculated with the true attitude and averaged
    over a tenth of a second.

    Parameters
    ----------
    starts_s
        Time of the estimator's start in the recording; rest and first seconds have no earlier samples.
    """
    seconds = np.arange(len(recording.movement)) / recording.rate_hz - starts_s
    down = _to_earth(recording.truth, recording.gravity_g) - (0.0, 0.0, 1.0)
    field = _to_earth(recording.truth, recording.field_ut)
    visible = np.isfinite(field[:, 0])
    median = np.median(field[visible], axis=0)
    window = max(1, round(_WINDOW_S * recording.rate_hz))
    accelerated = _smoothed_norm(down, window) > _ACCELERATED
    disturbed = _smoothed_norm(field - median, window) > _DISTURBED * float(np.linalg.norm(median))
    return {
        "motion": recording.movement,
        "first seconds": (seconds >= 0.0) & (seconds < _FIRST_S),
        "rest": ~recording.movement & (seconds >= _FIRST_S),
        "translation": recording.movement & accelerated,
        "disturbed field": recording.movement & disturbed,
    }


def _smoothed_norm(vectors: Reals, window: int) -> Reals:
    """Return the norms of moving means; vectors of NaN count as zero."""
    weights = np.full(window, 1.0 / window)
    columns = [np.convolve(column, weights, mode="same")[: len(column)] for column in np.nan_to_num(vectors).T]
    norms: Reals = np.linalg.norm(np.stack(columns, axis=1), axis=1)
    return norms


def _to_earth(attitudes: Reals, vectors: Reals) -> Reals:
    """Return body vectors in the earth frame: ``v + 2 u x (u x v + w v)`` with the quaternion's vector u."""
    axes, scalar = attitudes[:, :3], attitudes[:, 3:]
    return vectors + 2.0 * np.cross(axes, np.cross(axes, vectors) + scalar * vectors)
