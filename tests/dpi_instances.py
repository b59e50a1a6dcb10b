"""Random problems for `dpi`: pairs of a distorted magnetometer and a wrong accelerometer, in any attitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Reals = NDArray[np.float64]
Counts = NDArray[np.int16]
G_COUNTS = 8192.0


@dataclass(frozen=True, eq=False)
class DpiInstance:
    """Pairs and the truth behind them.

    Attributes
    ----------
    magnetometer, accelerometer : ndarray of int16, shape (n, 3)
        Readings [counts], body frame.
    soft_iron : ndarray, shape (3, 3)
        Takes the field to the field at the part; it also turns it.
    hard_iron_counts : ndarray, shape (3,)
    gain, offset : ndarray, shape (3, 3) and (3,)
        Of the true accelerometer calibration: ``gravity_g = gain @ (counts - offset)``.
    field_counts, dip_deg : float
    """

    magnetometer: Counts
    accelerometer: Counts
    soft_iron: Reals
    hard_iron_counts: Reals
    gain: Reals
    offset: Reals
    field_counts: float
    dip_deg: float

    @property
    def gravity_g(self) -> Reals:
        """Calibrated gravity, shape (n, 3)."""
        gravity: Reals = (self.accelerometer - self.offset) @ self.gain.T
        return gravity


def dpi_instance(
    seed: int,
    count: int = 300,
    *,
    field_ut: float = 48.5,
    dip_deg: float | None = None,
    noise_ut: float = 0.4,
    noise_mg: float = 1.26,
    largest_hard_iron_ut: float = 100.0,
    turn_deg: float = 8.0,
    stretch: float = 0.2,
    attitudes: Rotation | None = None,
    readings: int = 1,
) -> DpiInstance:
    """Draw one problem: the same seed and parameters give the same one; the dip is -80 to 80 degrees, 5 at least.

    Noise of a row is that of a mean of `readings`; rows are rounded to counts all the same.
    """
    random = np.random.Generator(np.random.Philox(seed))
    dip_deg = float(random.uniform(5.0, 80.0) * random.choice([-1, 1])) if dip_deg is None else dip_deg
    turns = attitudes or Rotation.random(count, random_state=seed)
    body_from_ned = turns.as_matrix()
    axes = Rotation.random(random_state=seed + 1).as_matrix()
    symmetric = (axes * random.uniform(1.0 - stretch, 1.0 + stretch, 3)) @ axes.T
    turned = Rotation.from_rotvec(np.radians(random.uniform(-turn_deg, turn_deg, 3))).as_matrix()
    soft_iron = turned @ symmetric
    hard_iron_ut = random.uniform(-1.0, 1.0, 3) * largest_hard_iron_ut
    dip = np.radians(dip_deg)
    field_ut_body = field_ut * body_from_ned @ [np.cos(dip), 0.0, np.sin(dip)]
    gain = (np.eye(3) + random.uniform(-0.02, 0.02, (3, 3))) / G_COUNTS
    offset = random.uniform(-0.03, 0.03, 3) * G_COUNTS
    less = np.sqrt(readings)
    sensed_ut = field_ut_body @ soft_iron.T + hard_iron_ut
    sensed_ut += noise_ut / less * random.standard_normal((count, 3))
    gravity_g = body_from_ned[:, :, 2] + noise_mg / 1000.0 / less * random.standard_normal((count, 3))
    return DpiInstance(
        np.rint(10.0 * sensed_ut).astype(np.int16),
        np.rint(gravity_g @ np.linalg.inv(gain).T + offset).astype(np.int16),
        soft_iron,
        10.0 * hard_iron_ut,
        gain,
        offset,
        10.0 * field_ut,
        dip_deg,
    )
