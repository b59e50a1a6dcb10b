"""Turn of a board since a known angle, from its gyroscope."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.orientation.angles import Pose, pose_from_rotation, rotation_body_from_ned, wrap_180
from hiltest.procedures.hand_checks import LEAST_TURN_DEG

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Reals = NDArray[np.float64]

# A hand changes its rate by at most 200 deg/s in 0.4 s: 10 degrees of error if the rate between is a straight line. The
# error grows with the square of the gap, and those of several gaps are independent.
_LONGEST_GAP_S, _GAP_DEG_PER_S2 = 0.4, 10.0 / 0.4**2
# Error of the scale of an uncalibrated gyroscope, and of its bias after 0.3 s at rest with 0.1 dps/sqrt(Hz), k = 2.
_SCALE, _BIAS_DPS = 0.1, 0.3


class FollowedTurn:
    """Integral of the gyroscope's rate without its bias, from the last known angle on.

    Notes
    -----
    The matrix T that turns body components at the known angle into those now obeys ``dT/dt = -[rate]x T``. Between two
    samples the rate is their mean; with a longer gap than `_LONGEST_GAP_S` the turn is unknown until the next known
    angle.
    """

    def __init__(self) -> None:
        self._turn: Rotation | None = None
        self._bias_dps = np.zeros(3)
        self._last: tuple[float, Reals] | None = None
        self._path_deg = self._time_s = self._gaps_deg2 = 0.0

    def stand(self, times_s: ArrayLike, rates_dps: ArrayLike) -> None:
        """Take the mean of samples of a board that stood, since the last that were added, as the bias from now on."""
        rates = np.asarray(rates_dps, dtype=np.float64)
        if len(rates):
            self._bias_dps = rates.mean(axis=0)
            self._last = float(np.asarray(times_s)[-1]), np.zeros(3)

    def begin(self) -> None:
        """Begin at a known angle, where the board stood last."""
        from scipy.spatial.transform import Rotation

        self._turn = None if self._last is None else Rotation.identity()
        self._path_deg = self._time_s = self._gaps_deg2 = 0.0

    def add(self, times_s: ArrayLike, rates_dps: ArrayLike) -> None:
        """Add samples: times [s], rates of shape (n, 3) [deg/s]."""
        from scipy.spatial.transform import Rotation

        times, rates = np.asarray(times_s, dtype=np.float64), np.asarray(rates_dps, dtype=np.float64) - self._bias_dps
        if self._turn is None or self._last is None or not len(rates):
            return
        steps_s = np.diff(times, prepend=self._last[0])
        if steps_s.max() > _LONGEST_GAP_S:
            self._turn = self._last = None
            return
        means = 0.5 * (rates + np.vstack([self._last[1], rates[:-1]]))
        for step_deg in means * steps_s[:, np.newaxis]:
            self._turn = Rotation.from_rotvec(-step_deg, degrees=True) * self._turn
            self._path_deg += float(np.linalg.norm(step_deg))
        self._time_s += float(steps_s.sum())
        self._gaps_deg2 += float(np.sum((_GAP_DEG_PER_S2 * steps_s**2) ** 2))
        self._last = float(times[-1]), rates[-1]

    def turned_deg(self, before: Pose) -> float | None:
        """Return the turn about the vertical since a known angle, in (-180, 180]; None if it is unknown."""
        if self._turn is None:
            return None
        now = pose_from_rotation(self._turn.as_matrix() @ rotation_body_from_ned(before))
        return wrap_180(now.heading_deg - before.heading_deg)

    def contradicts(self, before: Pose, asked_deg: float) -> bool:
        """Return whether the turn differs from that of the scale by more than the gyroscope's own error."""
        turned_deg = self.turned_deg(before)
        error_deg = math.hypot(_SCALE * self._path_deg, _BIAS_DPS * self._time_s, math.sqrt(self._gaps_deg2))
        return turned_deg is not None and abs(wrap_180(turned_deg - asked_deg)) > LEAST_TURN_DEG + error_deg
