"""Logs of an IMU that somebody laid down on its faces and turned, with the truth behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

RATE_HZ = 100.0
FACES = tuple(sign * row for row in np.eye(3) for sign in (1.0, -1.0))


@dataclass(frozen=True)
class Sensor:
    """``reading = response @ truth + bias + noise``."""

    response: Reals
    bias: Reals
    noise: float

    def reading(self, truth: Reals, random: np.random.Generator) -> Reals:
        return truth @ self.response.T + self.bias + self.noise * random.standard_normal(truth.shape)


ACCELEROMETER = Sensor(
    np.array([[1.02, 0.006, -0.004], [0.002, 0.985, 0.008], [-0.005, 0.003, 1.01]]),
    np.array([0.03, -0.02, 0.015]),
    0.0015,
)
GYROSCOPE = Sensor(
    np.array([[1.03, 0.01, -0.006], [0.004, 0.97, 0.012], [-0.008, 0.005, 1.015]]), np.array([0.6, -0.4, 0.9]), 0.05
)


@dataclass
class Recording:
    """Grows by what is done with the sensor."""

    up: Reals = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    gravity: list[Reals] = field(default_factory=list)
    rate: list[Reals] = field(default_factory=list)

    @property
    def samples(self) -> int:
        return sum(map(len, self.gravity))

    def rest(self, seconds: float = 3.0) -> Recording:
        count = round(seconds * RATE_HZ)
        return self._add(np.tile(self.up, (count, 1)), np.zeros((count, 3)))

    def lay(self, up: Sequence[float] | Reals, seconds: float = 1.0) -> Recording:
        """Turn over until `up` is up."""
        end = np.array(up) / np.linalg.norm(up)
        axis = np.cross(end, self.up)
        if np.linalg.norm(axis) < 1e-9:
            axis = np.cross(self.up, np.roll(np.abs(self.up), 1) + np.array([0.0, 0.1, 0.2]))
        axis = axis / np.linalg.norm(axis)
        angle = np.arctan2(np.linalg.norm(np.cross(self.up, end)), self.up @ end)
        share, speed = self._course(seconds)
        turned = [_rotated(self.up, axis, -angle * item) for item in share]
        self._add(np.array(turned), np.degrees(angle) * speed[:, None] * axis)
        self.up = end
        return self

    def turn(self, degrees: float, seconds: float = 5.0, *, about: Reals | None = None) -> Recording:
        """Turn about the vertical, or another axis of the body while gravity stays (which no hand can)."""
        _, speed = self._course(seconds)
        axis = self.up if about is None else about
        return self._add(np.tile(self.up, (len(speed), 1)), degrees * speed[:, None] * axis)

    def readings(
        self, accelerometer: Sensor = ACCELEROMETER, gyroscope: Sensor = GYROSCOPE, *, seed: int = 1
    ) -> tuple[Reals, Reals]:
        random = np.random.default_rng(seed)
        return (
            accelerometer.reading(np.concatenate(self.gravity), random),
            gyroscope.reading(np.concatenate(self.rate), random),
        )

    def _add(self, gravity: Reals, rate: Reals) -> Recording:
        self.gravity.append(gravity)
        self.rate.append(rate)
        return self

    @staticmethod
    def _course(seconds: float) -> tuple[Reals, Reals]:
        """Return the part of a move that is done at each sample, and its speed, which sums to one over the samples."""
        u = (np.arange(round(seconds * RATE_HZ)) + 0.5) / round(seconds * RATE_HZ)
        speed = 6.0 * u * (1.0 - u)
        return u * u * (3.0 - 2.0 * u), speed * RATE_HZ / speed.sum()


def six_faces_and_turns() -> Recording:
    """What the page tells to do."""
    done = Recording()
    for face in FACES:
        done.lay(face).rest()
    for face in np.eye(3):
        done.lay(face).rest().turn(360.0).rest()
    return done.turn(-360.0).rest()


def many_poses(count: int = 24, *, seed: int = 2) -> Recording:
    done = Recording()
    for up in np.random.default_rng(seed).normal(size=(count, 3)):
        done.lay(up).rest(2.0)
    return done


def write(path: Path, acceleration: Reals, rate: Reals | None = None, *, units: tuple[str, str] = ("g", "dps")) -> Path:
    """Write a log with time and units in the header."""
    columns = [np.arange(len(acceleration)) / RATE_HZ, *acceleration.T, *([] if rate is None else rate.T)]
    names = ["time_s", *(f"acc_{axis}_{units[0]}" for axis in "xyz")]
    names += [] if rate is None else [f"gyr_{axis}_{units[1]}" for axis in "xyz"]
    np.savetxt(path, np.column_stack(columns), fmt="%.9g", delimiter=",", header=",".join(names), comments="")
    return path


def _rotated(vector: Reals, axis: Reals, angle: float) -> Reals:
    rotated: Reals = (
        vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1.0 - np.cos(angle))
    )
    return rotated
