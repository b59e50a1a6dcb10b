"""Scale and axes of a gyroscope from whole turns about known axes: the float64 reference of ``gyroscope_turns_fit``.

A board that turns about an axis which does not move has turned, when it is at rest again, by the integral
of its rate: a vector along the axis that is the same in the body frame all the way. With ``counts =
response @ rate + bias`` the integral of the counts without their bias is ``response @ turned``, whatever the course
of the rate, and the calibration is the inverse: ``rate_dps = matrix @ (counts - bias)``.

Model: Puc, Podobnik, Munih 2018 (ERK), equations 3 and 6. That paper leaves the matrix at a constant for want of a
reference rate; whole turns of a table are a reference for its integral, which is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

#: Sensitivity of the FXAS21002C at 2000 deg/s full scale, data sheet.
NOMINAL_DPS_PER_COUNT = 0.0625
SMALLEST_TURN_DEG = 90.0
#: Least determinant relative to the cube of the longest row: 1 for three turns at right angles, 0.001 if the third is 5
#: degrees out of the plane of the others.
LEAST_DETERMINANT = 1e-3
MAX_TURNS = 8


class TurnsStatus(IntEnum):
    """Status of a fit of turns, with the firmware's numbers."""

    OK = 0
    TOO_FEW = 1
    TOO_SMALL = 2
    NOT_SPANNING = 3
    SINGULAR = 4


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeFit:
    """Gyroscope calibration: ``rate_dps = matrix @ (counts - bias)``, body frame."""

    matrix: Reals
    """Shape (3, 3) [deg/s/count]"""
    bias: Reals
    """Shape (3,) [counts]"""

    def rate_dps(self, counts: Reals) -> Reals:
        """Return the rates of readings, shape (3,) or (n, 3) [deg/s]."""
        return (np.asarray(counts, dtype=np.float64) - self.bias) @ self.matrix.T

    @property
    def response(self) -> Reals:
        """Counts per rate, the inverse of the matrix [count/(deg/s)]."""
        return np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeTurn:
    """One turn: rotation of the table, and gyroscope samples from before until after it."""

    turned_deg: Reals
    """Shape (3,). Rotation about the body axes: all of it about one fixed axis."""
    total: NDArray[np.int64] | Reals
    """Shape (3,). Sum of all samples [counts], exact for integers."""
    n: int
    """Number of samples."""
    duration_s: float
    """Time from the first sample to the last, by the board's clock."""
    bias_before: Reals
    bias_after: Reals
    """Shape (3,). Means of the rests around the turn [counts]."""
    share: float = 0.5
    """Position of the turn's middle between the middles of the two rests, 0 to 1."""

    @property
    def bias(self) -> Reals:
        """Bias in the middle of the turn [counts]."""
        return self.bias_before + self.share * (self.bias_after - self.bias_before)

    @property
    def integral(self) -> Reals:
        """Integral of the counts over the turn [count s]: zero without samples or time."""
        period_s = self.duration_s / (self.n - 1) if self.n >= 2 else 0.0
        return period_s * (self.total - self.n * self.bias)

    @property
    def direction(self) -> Reals:
        """Unit vector about which the table turned, body frame."""
        return self.turned_deg / np.linalg.norm(self.turned_deg)

    @property
    def response(self) -> Reals:
        """Counts of one deg/s about `direction`, shape (3,)."""
        return self.integral / float(np.linalg.norm(self.turned_deg))


@dataclass(frozen=True, slots=True, eq=False)
class TurnsFit:
    """Result of a fit of turns."""

    status: TurnsStatus
    at_fault: int | None
    """Index of the turn that is too small."""
    matrix: Reals
    """Shape (3, 3) [deg/s/count]; zero unless the status is OK."""
    residual_deg: float
    """rms of ``matrix @ integral - turned_deg`` over all turns; three turns are met exactly."""


def fit_turns(turns: Sequence[GyroscopeTurn]) -> TurnsFit:
    """Fit the matrix to whole turns by linear least squares.

    Parameters
    ----------
    turns
        At least three turns, about axes that span; each at least a quarter turn.

    Returns
    -------
    TurnsFit
        Fit, whose status has the reason if the turns do not determine the nine unknowns.

    Notes
    -----
    ``response = (sum s t') (sum t t')^-1`` minimises the sum of ``|s - response t|^2``: the table's turns t are the
    reference, the integrals s have the noise.
    """
    nothing = np.zeros((3, 3))
    if not 3 <= len(turns) <= MAX_TURNS:
        return TurnsFit(TurnsStatus.TOO_FEW, None, nothing, 0.0)
    for index, turn in enumerate(turns):
        if not np.linalg.norm(turn.turned_deg) >= SMALLEST_TURN_DEG or turn.n < 2:
            return TurnsFit(TurnsStatus.TOO_SMALL, index, nothing, 0.0)
    turned = np.array([turn.turned_deg for turn in turns])
    integrals = np.array([turn.integral for turn in turns])
    moments = turned.T @ turned
    if not _spans(moments):
        return TurnsFit(TurnsStatus.NOT_SPANNING, None, nothing, 0.0)
    response = np.linalg.solve(moments, turned.T @ integrals).T
    if not _spans(response):
        return TurnsFit(TurnsStatus.SINGULAR, None, nothing, 0.0)
    matrix = np.linalg.inv(response)
    residuals = integrals @ matrix.T - turned
    return TurnsFit(TurnsStatus.OK, None, matrix, float(np.sqrt((residuals**2).sum(axis=1).mean())))


def _spans(matrix: Reals) -> bool:
    longest = float(np.linalg.norm(matrix, axis=1).max())
    return bool(abs(np.linalg.det(matrix)) > LEAST_DETERMINANT * longest**3)


def scale_error_percent(response: Reals, true_response: Reals) -> float:
    """Return the error of a response's length to a rate about one axis, against the true one, shapes (3,) [%]."""
    return 100.0 * float(np.linalg.norm(response) / np.linalg.norm(true_response) - 1.0)


def misalignment_deg(response: Reals, true_response: Reals) -> float:
    """Return the angle between a response to a rate about one axis and the true one, both shape (3,) [deg].

    It uses sine and cosine, because the cosine alone loses half of the digits of an angle of a hundredth of a degree.
    """
    across = np.linalg.norm(np.cross(response, true_response))
    return float(np.degrees(np.arctan2(across, response @ true_response)))
