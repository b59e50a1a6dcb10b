"""Heading errors at planned poses, predicted from those measured so far, as the errors of residual iron.

A calibration that leaves soft iron dS and hard iron dh errs by ``d heading/d field . (dS field + dh)``: linear in
twelve parameters. Bayes' rule for normal distributions gives their distribution after each pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from scipy.special import chdtri, ndtri

from hiltest.calibration.fit import Array
from hiltest.calibration.heading_bound import heading_derivatives

RISK = 0.03
"""Chance that a value is above its interval, and that it is below it, after any one pose."""
FEWEST_POSES = 6
# Residual iron before the first pose, rms of each element relative to the field: 10 % and 2.4 uT of 48.5 exceed each
# calibration that could meet a limit of some degrees.
_SOFT_IRON, _HARD_IRON = 0.1, 0.05
# Larger rests than in one honest board of a thousand are no iron: another model would predict other poses.
_MISFIT = 1e-3
_DRAWS, _SEED = 1000, 1  # 30 of them are above the interval
STATISTICS = ("max", "max_centred", "rms", "bias")
"""Statistics of heading errors over all poses, as in the names of measurements."""


class ResidualIron:
    """Planned poses of a board with unknown residual iron.

    Parameters
    ----------
    field, gravity : shape (n, 3)
        Known vectors along the board's axes, in any unit.
    sigma_deg : shape (n,)
        Standard deviation of a measured error, independent from pose to pose: noise, and setting of the angle.
    """

    def __init__(self, field: Array, gravity: Array, sigma_deg: Array) -> None:
        unit = field / np.linalg.norm(field, axis=1)[:, None]
        slopes = np.degrees(heading_derivatives(unit, gravity))
        self._rows = np.hstack([(slopes[:, :, None] * unit[:, None, :]).reshape(-1, 9), slopes])
        self._sigma_deg = sigma_deg
        self._prior = np.diag(1.0 / np.repeat([_SOFT_IRON, _HARD_IRON], [9, 3]) ** 2)
        self._draws = np.random.default_rng(_SEED).standard_normal((12, _DRAWS))

    @cached_property
    def order(self) -> list[int]:
        """Indices of the poses: each next one adds most information (greedy D-optimal design)."""
        order: list[int] = []
        information = self._prior
        for _ in self._sigma_deg:
            gains = np.sum(self._rows @ np.linalg.inv(information) * self._rows, axis=1) / self._sigma_deg**2
            gains[order] = -1.0
            order.append(int(gains.argmax()))
            row = self._rows[order[-1]]
            information = information + np.outer(row, row) / self._sigma_deg[order[-1]] ** 2
        return order

    def intervals(self, errors_deg: Mapping[int, float]) -> dict[str, tuple[float, float]]:
        """Return middle and half width [deg] of the interval of each statistic over all planned poses.

        Parameters
        ----------
        errors_deg
            Measured heading errors by the index of the pose.

        Returns
        -------
        dict of str to (float, float)
            By the names of `STATISTICS`; empty for fewer than `FEWEST_POSES`, and for errors that no iron makes.
        """
        if len(errors_deg) < FEWEST_POSES:
            return {}
        taken, errors = list(errors_deg), np.array(list(errors_deg.values()))
        rows, sigma = self._rows[taken], self._sigma_deg[taken]
        weighted = rows.T / sigma**2
        covariance = np.linalg.inv(self._prior + weighted @ rows)
        mean = covariance @ (weighted @ errors)
        if np.sum(((errors - rows @ mean) / sigma) ** 2) > chdtri(len(errors), _MISFIT):
            return {}
        return _intervals(self._rows @ mean, self._rows @ np.linalg.cholesky(covariance), self._draws)


def _intervals(errors: Array, spread: Array, draws: Array) -> dict[str, tuple[float, float]]:
    """Return the intervals of all statistics of errors with a covariance ``spread spread'``.

    The largest error is at least its lower bound at any one pose, and the rms its lower bound along the mean errors: a
    wide distribution at poses without a measurement is no evidence of an error there. The upper ends are quantiles.
    """
    bias, about, about_spread = errors.mean(), errors - errors.mean(), spread - spread.mean(axis=0)
    predicted = errors[:, None] + spread @ draws
    rms, along = np.sqrt(np.mean(errors**2)), np.linalg.norm(errors @ spread) / np.linalg.norm(errors)
    low = {
        "max": _largest_low(errors, spread),
        "max_centred": _largest_low(about, about_spread),
        "rms": rms + ndtri(RISK) * along / np.sqrt(len(errors)),
        "bias": bias + ndtri(RISK) * np.linalg.norm(spread.mean(axis=0)),
    }
    high = {
        "max": np.quantile(np.abs(predicted).max(axis=0), 1.0 - RISK),
        "max_centred": np.quantile(np.abs(predicted - predicted.mean(axis=0)).max(axis=0), 1.0 - RISK),
        "rms": np.quantile(np.sqrt(np.mean(predicted**2, axis=0)), 1.0 - RISK),
        "bias": 2.0 * bias - low["bias"],
    }
    return {name: (float(high[name] + low[name]) / 2.0, float(high[name] - low[name]) / 2.0) for name in STATISTICS}


def _largest_low(errors: Array, spread: Array) -> float:
    # The poses share twelve parameters, so that at most so many chances add (Bonferroni).
    return float((np.abs(errors) + ndtri(RISK / 12) * np.linalg.norm(spread, axis=1)).max())
