"""Readings of a magnetometer and an accelerometer that look about together, with the truth behind them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hiltest.calibration import FitStatus, MagnetometerFit
from hiltest.calibration.axes import Axes
from hiltest.calibration.quality import direction_difference_rms_deg

Reals = NDArray[np.float64]

FIELD_UT, DIP_DEG = 48.0, 65.0
ROTATION = Rotation.from_rotvec(np.radians([1.2, -1.0, 1.24]))
_SOFT_IRON = np.array([[1.05, 0.02, -0.03], [0.02, 0.96, 0.01], [-0.03, 0.01, 1.02]]) @ ROTATION.as_matrix()
_GAIN = np.array([[1.02, 0.004, 0.0], [0.004, 0.99, -0.003], [0.0, -0.003, 1.01]])
#: What a perfect calibration of the magnetometer is: it takes readings to the accelerometer's axes.
TRUTH = MagnetometerFit(
    FitStatus.ELLIPSOID, False, 0, np.linalg.inv(_SOFT_IRON) / FIELD_UT, np.array([10.0, -20.0, 30.0])
)


def still_pairs(
    seed: int, count: int, *, noise_ut: float = 0.2, noise_g: float = 0.002, moved_g: float = 0.0
) -> tuple[Reals, Reals]:
    """Return readings at attitudes all round [uT] and [g]; `moved_g` is what a hand accelerates by, rms of an axis."""
    random = np.random.default_rng(seed)
    down = np.array([0.0, 0.0, 1.0])
    dip = math.radians(DIP_DEG)
    attitudes = Rotation.random(count, random_state=seed)
    field = attitudes.apply(FIELD_UT * np.array([math.cos(dip), 0.0, math.sin(dip)]))
    gravity = attitudes.apply(down) + moved_g * random.normal(size=(count, 3))
    points = field @ _SOFT_IRON.T + TRUTH.hard_iron + noise_ut * random.normal(size=(count, 3))
    return points, gravity @ _GAIN.T + [0.02, -0.03, 0.01] + noise_g * random.normal(size=(count, 3))


def direction_error_deg(fit: MagnetometerFit) -> float:
    """Return how far corrected directions of `still_pairs` are off in the accelerometer's axes, rms."""
    return direction_difference_rms_deg(fit, TRUTH)


# How the parts of SAP6 are mounted, by its own configuration; the older instruments have turned theirs already.
_SAP6_MAGNETOMETER, _SAP6_ACCELEROMETER = Axes((0, 1, 2), (1, 1, -1)), Axes((1, 0, 2), (-1, -1, 1))


@dataclass(frozen=True)
class Shots:
    """Readings of a cave survey's instrument: eight all round, and twice eight of one direction, rolled."""

    name: str
    points: Reals
    acceleration: Reals

    @classmethod
    def read(cls, path: Path) -> Shots:
        content = json.loads(path.read_text(encoding="utf-8"))
        if "shots" in content:
            flat = (np.array(content["shots"][kind], dtype=float) for kind in ("mag", "grav"))
            points, acceleration = (item[np.isfinite(item)].reshape(-1, 3) for item in flat)
        else:
            points = np.array(content["mag"]) @ _SAP6_MAGNETOMETER.matrix.T
            acceleration = np.array(content["grav"]) @ _SAP6_ACCELEROMETER.matrix.T
        return cls(path.stem, points, acceleration)


ALIGNED = (slice(8, 16), slice(16, 24))


def repeats_within_deg(field: Reals, gravity: Reals) -> float:
    """Return how far the direction of one aim is from its mean, rms, as field and gravity have it when rolled.

    The aim is the axis of the board that keeps its direction best: nobody has measured how the laser lies.
    """
    east = np.cross(gravity, field)
    axes = [np.cross(east, gravity), east, gravity]
    world_from_body = np.stack([axis / np.linalg.norm(axis, axis=1, keepdims=True) for axis in axes], axis=1)
    mean = world_from_body.mean(axis=0)
    aim = np.linalg.eigh(mean.T @ mean)[1][:, -1]
    observed, middle = world_from_body @ aim, mean @ aim
    angles = np.arctan2(np.linalg.norm(np.cross(observed, middle), axis=1), observed @ middle)
    return math.degrees(float(np.sqrt(np.mean(angles**2))))
