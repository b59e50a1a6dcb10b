"""The attitude filter in float64: gyroscope, slow corrections of the tilt, and slower ones of the heading.

Frames: the body frame is the sensors', right-handed. The earth frame is NED (north, east, down). Attitudes are unit
quaternions x, y, z, w that convert body components to earth components, as in `hiltest.orientation.quaternions`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.orientation.quaternions import Quaternion
from hiltest.orientation.tilt_heading import DegenerateFieldError
from hiltest.orientation.triad import LARGEST_NORM, SMALLEST_NORM, triad

Reals = NDArray[np.float64]

# Half of the longest rotation in one step: beyond half a turn a rate no longer tells the direction.
_LONGEST_HALF_RAD = 0.5 * math.pi
# Longest time that one correction stands for; after a gap the sensors show one moment of it.
_LONGEST_CORRECTION_S = 1.0


@dataclass(frozen=True, slots=True)
class AttitudeFilterSettings:
    """Times and limit of the filter; docs/fusion.md derives the defaults."""

    tilt_time_s: float = 3.0
    """Time constant of the tilt. An error of the rate tilts the attitude by its product with this time."""
    heading_time_s: float = 20.0
    """Time constant of the heading."""
    field_gate: float = 0.1
    """Largest distance of the field from the expected field, in parts of the latter, that corrects the heading."""
    field_time_s: float = 100.0
    """Time constant of the expected field, once the heading has its own."""


class AttitudeFilterStatus(IntEnum):
    """Result of a step; the numbers are the firmware's."""

    OK = 0
    NO_ATTITUDE = 1
    """Gravity, or before the first attitude the field, cannot be used; the attitude is as before."""
    FIELD_LEFT_OUT = 2
    """The tilt is corrected and the heading is not: the field is disturbed, vertical or has no norm."""
    BAD_STEP = 3
    """The step is not finite, backwards or more than half a turn; the state is as before."""


class AttitudeFilter:
    """Attitude from rates, gravity and field.

    Parameters
    ----------
    bias_rad_s : shape (3,)
        Rate at rest, which is subtracted [rad/s].
    settings
        Times and limit.

    Notes
    -----
    The tilt's correction is a second-order Butterworth low-pass of the measured acceleration in the frame that the
    gyroscope integrates (Laidig and Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and
    magnetic disturbance rejection", Information Fusion 91, 2023, section 3). That frame is corrected until the filtered
    vector is vertical, so of the filter's state only the rate of the two horizontal components remains: with the
    horizontal acceleration ``a`` in g and ``w = sqrt(2) / tilt_time``, ``rate' = w^2 a - sqrt(2) w rate`` and the tilt
    turns at ``rate``.

    The heading follows the field's direction with a gain of ``dt / heading_time``. A field is used if its horizontal
    and vertical parts are near those expected, which follow the measured ones with a gain of ``dt / field_time``. A
    field beyond the gate counts there as one at the gate: a strong magnet moves the expected field no faster than a
    weak one, and a new place is accepted in the end.

    A young filter takes means instead, with the gain ``2 dt / (age + dt)``: they weigh each measurement by its time
    since the start, so a start in motion is forgotten. It does so until that gain falls to the final one: for
    twice the tilt's time constant, and for heading and expected field twice the heading's. While the tilt is young,
    each field is expected.
    """

    def __init__(self, bias_rad_s: ArrayLike, settings: AttitudeFilterSettings | None = None) -> None:
        self._bias = tuple(np.asarray(bias_rad_s, dtype=np.float64).tolist())
        self._settings = settings or AttitudeFilterSettings()
        self._attitude = (0.0, 0.0, 0.0, 1.0)
        self._tilt_rate = (0.0, 0.0)
        self._field = (0.0, 0.0)
        self._age_s = 0.0
        self._uncorrected_s = 0.0
        self._started = False

    @property
    def attitude(self) -> Quaternion:
        """Unit quaternion x, y, z, w from body to earth; no rotation before the first correction."""
        return np.array(self._attitude)

    def update(
        self, rate_rad_s: Sequence[float], gravity_g: Sequence[float], field: Sequence[float], dt_s: float
    ) -> AttitudeFilterStatus:
        """Turn the attitude, then correct it.

        Parameters
        ----------
        rate_rad_s : shape (3,)
            Mean rate over the step, with its bias [rad/s].
        gravity_g : shape (3,)
            Accelerometer at the end of the step [g]; (0, 0, +1) if z points down and the body rests.
        field : shape (3,)
            Calibrated magnetometer at the end of the step, in any unit.
        dt_s
            Length of the step [s].
        """
        status = self.turn(rate_rad_s, dt_s)
        return status if status is AttitudeFilterStatus.BAD_STEP else self.correct(gravity_g, field)

    def turn(self, rate_rad_s: Sequence[float], dt_s: float) -> AttitudeFilterStatus:
        """Turn the attitude by a rate for a time; parameters as of `update`.

        Notes
        -----
        ``q dq``, where dq is the rotation by ``rate dt`` about the body's axes: equations (8) to (11) and (28) of
        Mucciaccia's thesis.
        """
        half = [0.5 * dt_s * (rate - bias) for rate, bias in zip(rate_rad_s, self._bias, strict=True)]
        half_rad = math.sqrt(sum(value * value for value in half))
        # A comparison with NaN is false.
        if not (dt_s >= 0.0 and half_rad <= _LONGEST_HALF_RAD):
            return AttitudeFilterStatus.BAD_STEP
        scale = math.sin(half_rad) / half_rad if half_rad > 0.0 else 1.0
        a, b, c, d = *(scale * value for value in half), math.cos(half_rad)
        x, y, z, w = self._attitude
        self._attitude = _normalised(
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )
        self._uncorrected_s += dt_s
        return AttitudeFilterStatus.OK

    def correct(self, gravity_g: Sequence[float], field: Sequence[float]) -> AttitudeFilterStatus:
        """Correct the attitude for the time since the last correction; parameters as of `update`."""
        if not math.sqrt(sum(value * value for value in gravity_g)) < LARGEST_NORM:
            return AttitudeFilterStatus.NO_ATTITUDE
        if not self._started:
            return self._start(gravity_g, field)
        dt_s = min(self._uncorrected_s, _LONGEST_CORRECTION_S)
        self._uncorrected_s = 0.0
        if dt_s == 0.0:
            return AttitudeFilterStatus.OK
        self._age_s += dt_s
        earth = self._earth_rows()
        north, east, _ = (_dot(row, gravity_g) for row in earth)
        per_time = 2.0 / (self._age_s + dt_s)
        about_north, about_east = self._tilt_correction(north, east, dt_s, per_time)
        about_down = self._heading_correction([_dot(row, field) for row in earth], dt_s, per_time)
        self._rotate(about_north, about_east, about_down or 0.0)
        return AttitudeFilterStatus.FIELD_LEFT_OUT if about_down is None else AttitudeFilterStatus.OK

    def _start(self, gravity_g: Sequence[float], field: Sequence[float]) -> AttitudeFilterStatus:
        """Take the first attitude and the first expected field from one measurement."""
        try:
            attitude = triad(gravity_g, field)
        except DegenerateFieldError:
            return AttitudeFilterStatus.NO_ATTITUDE
        x, y, z, w = attitude.tolist()
        self._attitude = (x, y, z, w)
        north, east, down = (_dot(row, field) for row in self._earth_rows())
        self._field = (math.hypot(north, east), down)
        self._age_s = min(self._uncorrected_s, _LONGEST_CORRECTION_S)
        self._uncorrected_s = 0.0
        self._started = True
        return AttitudeFilterStatus.OK

    def _tilt_correction(self, north: float, east: float, dt_s: float, per_time: float) -> tuple[float, float]:
        """Return the rotations about north and east [rad] for a gravity that has these horizontal components."""
        if per_time > 1.0 / self._settings.tilt_time_s:
            return dt_s * per_time * east, -dt_s * per_time * north
        frequency = math.sqrt(2.0) / self._settings.tilt_time_s
        gain, loss = dt_s * frequency * frequency, dt_s * math.sqrt(2.0) * frequency
        about_north, about_east = self._tilt_rate
        about_north += gain * east - loss * about_north
        about_east -= gain * north + loss * about_east
        self._tilt_rate = (about_north, about_east)
        return dt_s * about_north, dt_s * about_east

    def _heading_correction(self, field: Sequence[float], dt_s: float, per_time: float) -> float | None:
        """Return the rotation about down [rad] for a field in the earth frame; None if the field is left out."""
        north, east, down = field
        horizontal = math.hypot(north, east)
        if not SMALLEST_NORM < math.hypot(horizontal, down) < LARGEST_NORM:
            return None
        expected_horizontal, expected_down = self._field
        gate = self._settings.field_gate * math.hypot(expected_horizontal, expected_down)
        distance = math.hypot(horizontal - expected_horizontal, down - expected_down)
        is_expected = distance <= gate or per_time > 1.0 / self._settings.tilt_time_s
        young = per_time > 1.0 / self._settings.heading_time_s
        gain = dt_s * (per_time if young else 1.0 / self._settings.field_time_s)
        if not is_expected:
            gain *= gate / distance
        self._field = (
            expected_horizontal + gain * (horizontal - expected_horizontal),
            expected_down + gain * (down - expected_down),
        )
        if not is_expected or horizontal <= SMALLEST_NORM:
            return None
        sine = east / horizontal if north > 0.0 else math.copysign(1.0, east)
        return -sine * dt_s * (per_time if young else 1.0 / self._settings.heading_time_s)

    def _earth_rows(self) -> tuple[tuple[float, float, float], ...]:
        """Return north, east and down in the body frame."""
        x, y, z, w = self._attitude
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )

    def _rotate(self, about_north: float, about_east: float, about_down: float) -> None:
        """Rotate the attitude about the earth's axes; of first order, which corrections are small enough for."""
        a, b, c = 0.5 * about_north, 0.5 * about_east, 0.5 * about_down
        x, y, z, w = self._attitude
        self._attitude = _normalised(
            x + w * a + z * b - y * c,
            y - z * a + w * b + x * c,
            z + y * a - x * b + w * c,
            w - x * a - y * b - z * c,
        )


def filter_attitudes(
    gyroscope_rad_s: ArrayLike,
    gravity_g: ArrayLike,
    field: ArrayLike,
    rate_hz: float,
    settings: AttitudeFilterSettings | None = None,
) -> Reals:
    """Return the attitudes of the filter after each of n samples.

    Parameters
    ----------
    gyroscope_rad_s : shape (n, 3)
        Rates without their bias [rad/s].
    gravity_g, field : shape (n, 3)
        As of `AttitudeFilter.update`.
    rate_hz
        Samples per second.

    Returns
    -------
    ndarray, shape (n, 4)
        Unit quaternions x, y, z, w from body to NED.
    """
    attitude_filter = AttitudeFilter((0.0, 0.0, 0.0), settings)
    columns = (np.asarray(values, dtype=np.float64).tolist() for values in (gyroscope_rad_s, gravity_g, field))
    attitudes = []
    for rate_rad_s, gravity, sample in zip(*columns, strict=True):
        attitude_filter.update(rate_rad_s, gravity, sample, 1.0 / rate_hz)
        attitudes.append(attitude_filter.attitude)
    return np.array(attitudes).reshape(-1, 4)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _normalised(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    return scale * x, scale * y, scale * z, scale * w
