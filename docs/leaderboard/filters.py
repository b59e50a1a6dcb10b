"""Filters of packages, as `hiltest judge filters.py:NAME` calls them; docs/leaderboard.md has the rules.

`hiltest judge` gives each class one reading at a time: rates [rad/s], gravity [g], positive down, and field [uT]. It
reads a quaternion x, y, z, w from body to north, east, down. The first line of a class's docstring is the entry's name
in the table.

Packages expect the specific force, which is opposite to gravity: for a level body at rest it is (0, 0, 1) if z points
up. Many filters use the direction of the acceleration as the third axis of the earth's frame. If they get gravity
instead, that axis points down, and their frame is north, east, down.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]
STANDARD_GRAVITY = 9.80665


class _Vqf:
    """A filter of the package vqf, whose frame is east, north, up."""

    _kind = ""

    def __init__(self, rate_hz: float) -> None:
        import vqf

        self._filter = getattr(vqf, self._kind)(1.0 / rate_hz)

    def update(self, rates: Reals, gravity: Reals, field: Reals, _dt: float) -> None:
        """Give the filter a reading."""
        values = (rates, -STANDARD_GRAVITY * gravity, field)
        self._filter.update(*(np.ascontiguousarray(vector, dtype=float) for vector in values))

    def quaternion(self) -> Reals:
        """Return the attitude."""
        return _ned_from_enu(self._filter.getQuat9D())


class Vqf(_Vqf):
    """vqf VQF"""

    _kind = "VQF"


class BasicVqf(_Vqf):
    """vqf BasicVQF"""

    _kind = "BasicVQF"


class ImuFusion:
    """imufusion Ahrs"""

    def __init__(self, rate_hz: float) -> None:
        import imufusion

        self._filter = imufusion.Ahrs()
        self._filter.set_settings(imufusion.AhrsSettings(sample_rate=rate_hz, convention=imufusion.CONVENTION_NED))

    def update(self, rates: Reals, gravity: Reals, field: Reals, _dt: float) -> None:
        """Give the filter a reading; the package wants deg/s."""
        self._filter.update(np.degrees(rates), gravity, field)

    def quaternion(self) -> Reals:
        """Return the attitude."""
        return _scalar_last(self._filter.get_quaternion())


class _Ahrs:
    """A filter of the package ahrs, whose methods take and return the attitude, scalar first.

    The package begins recordings in a way of its own, so the first readings are given to it as a recording.
    """

    _kind, _update, _first_readings = "", "updateMARG", 1

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._attitude = rate_hz, None

    def _inputs(self, rates: Reals, gravity: Reals, field: Reals) -> tuple[Reals, Reals, Reals]:
        """Return what the filter takes for gyroscope, accelerometer and magnetometer."""
        return rates, gravity, field

    def _parameters(self, gravity: Reals, field: Reals) -> dict[str, Any]:
        """Return facts that the filter asks for."""
        return {}

    def update(self, rates: Reals, gravity: Reals, field: Reals, _dt: float) -> None:
        """Give the filter a reading."""
        values = [np.array(vector, dtype=float) for vector in (rates, gravity, field)]
        gyr, acc, mag = self._inputs(*values)
        if self._attitude is not None:
            self._attitude = np.asarray(getattr(self._filter, self._update)(self._attitude, gyr, acc, mag))
            return
        import ahrs.filters

        first = {
            name: np.tile(vector, (self._first_readings, 1))
            for name, vector in zip(("gyr", "acc", "mag"), (gyr, acc, mag), strict=True)
        }
        parameters = self._parameters(*values[1:])
        self._filter = getattr(ahrs.filters, self._kind)(**first, frequency=self._rate_hz, **parameters)
        self._attitude = self._filter.Q[-1]

    def quaternion(self) -> Reals:
        """Return the attitude."""
        return _scalar_last(self._attitude)


class AhrsMadgwick(_Ahrs):
    """ahrs Madgwick"""

    _kind = "Madgwick"


class AhrsMahony(_Ahrs):
    """ahrs Mahony"""

    _kind = "Mahony"

    def _inputs(self, rates: Reals, gravity: Reals, field: Reals) -> tuple[Reals, Reals, Reals]:
        return rates, -gravity, field

    def quaternion(self) -> Reals:
        """Return the attitude; the filter's frame is east, north, up."""
        return _ned_from_enu(self._attitude)


class AhrsEkf(_Ahrs):
    """ahrs EKF"""

    _kind, _update = "EKF", "update"

    def _parameters(self, gravity: Reals, field: Reals) -> dict[str, Any]:
        return {"magnetic_ref": _dip_deg(gravity, field)}


class AhrsUkf(_Ahrs):
    """ahrs UKF"""

    _kind, _update = "UKF", "update"

    def _inputs(self, rates: Reals, gravity: Reals, field: Reals) -> tuple[Reals, Reals, Reals]:
        if self._attitude is not None:
            self._filter.m_ref = self._reference
        else:
            self._reference = _reference(gravity, field)  # otherwise that of Munich
        return rates, gravity / np.linalg.norm(gravity), field / np.linalg.norm(field)


class AhrsFourati(_Ahrs):
    """ahrs Fourati"""

    _kind, _update = "Fourati", "update"

    def _parameters(self, gravity: Reals, field: Reals) -> dict[str, Any]:
        return {"magnetic_dip": _dip_deg(gravity, field)}


class AhrsRoleq(_Ahrs):
    """ahrs ROLEQ"""

    _kind, _update, _first_readings = "ROLEQ", "update", 2  # it wants two

    def _inputs(self, rates: Reals, gravity: Reals, field: Reals) -> tuple[Reals, Reals, Reals]:
        return rates, -gravity, field

    def _parameters(self, gravity: Reals, field: Reals) -> dict[str, Any]:
        return {"magnetic_ref": _reference(gravity, field)}


class AhrsAqua(_Ahrs):
    """ahrs AQUA"""

    _kind = "AQUA"

    def quaternion(self) -> Reals:
        """Return the attitude; that of the filter is from earth to body."""
        return _scalar_last(self._attitude) * (-1.0, -1.0, -1.0, 1.0)


class AhrsTilt(_Ahrs):
    """ahrs Tilt"""

    def update(self, _rates: Reals, gravity: Reals, field: Reals, _dt: float) -> None:
        """Estimate the attitude from one reading, without the gyroscope."""
        from ahrs.filters import Tilt

        self._attitude = Tilt().estimate(np.array(gravity, dtype=float), np.array(field, dtype=float))


class _Skinematics:
    """A filter of the package scikit-kinematics, whose method changes its inputs."""

    _kind = ""

    def __init__(self, rate_hz: float) -> None:
        from skinematics import imus

        self._filter = getattr(imus, self._kind)(rate=rate_hz, Quaternion=np.array([1.0, 0.0, 0.0, 0.0]))

    def update(self, rates: Reals, gravity: Reals, field: Reals, _dt: float) -> None:
        """Give the filter a reading, with unit vectors as the package does."""
        directions = (vector / np.linalg.norm(vector) for vector in (gravity, field))
        self._filter.Update(np.array(rates, dtype=float), *directions)

    def quaternion(self) -> Reals:
        """Return the attitude."""
        return _scalar_last(self._filter.Quaternion)


class SkinematicsMadgwick(_Skinematics):
    """scikit-kinematics Madgwick"""

    _kind = "Madgwick"


class SkinematicsMahony(_Skinematics):
    """scikit-kinematics Mahony"""

    _kind = "Mahony"


class PyImuMadgwick:
    """uutzinger-pyimu Madgwick"""

    def __init__(self, rate_hz: float) -> None:
        from pyIMU.madgwick import Madgwick
        from pyIMU.quaternion import Vector3D

        self._filter, self._vector = Madgwick(dt=1.0 / rate_hz), Vector3D

    def update(self, rates: Reals, gravity: Reals, field: Reals, dt: float) -> None:
        """Give the filter a reading."""
        self._attitude = self._filter.update(
            gyr=self._vector(*rates.tolist()),
            acc=self._vector(*gravity.tolist()),
            mag=self._vector(*field.tolist()),
            dt=dt,
        )

    def quaternion(self) -> Reals:
        """Return the attitude."""
        attitude = self._attitude
        return np.array([attitude.x, attitude.y, attitude.z, attitude.w])


class ImumasterEkf:
    """imumaster EKF_AHRS"""

    def __init__(self, rate_hz: float) -> None:
        from imumaster.filters.EKF import EKF_AHRS

        self._filter = EKF_AHRS(sample_rate=rate_hz, frame="NED")

    def update(self, rates: Reals, gravity: Reals, field: Reals, _dt: float) -> None:
        """Give the filter a reading."""
        self._attitude = self._filter.ekf_update(accel=-gravity, gyro=rates, mag=field)

    def quaternion(self) -> Reals:
        """Return the attitude."""
        return _scalar_last(np.ravel(self._attitude))


def _scalar_last(quaternion: Reals | None) -> Reals:
    """Return x, y, z, w of w, x, y, z."""
    return np.roll(np.asarray(quaternion, dtype=float), -1)


def _ned_from_enu(quaternion: Reals | None) -> Reals:
    """Return x, y, z, w to north, east, down of w, x, y, z to east, north, up."""
    w, x, y, z = np.asarray(quaternion, dtype=float)
    return math.sqrt(0.5) * np.array([w + z, w - z, y - x, -x - y])


def _dip_deg(gravity: Reals, field: Reals) -> float:
    """Return the dip of the field in a reading, positive down."""
    return math.degrees(math.asin(float(gravity @ field) / float(np.linalg.norm(gravity) * np.linalg.norm(field))))


def _reference(gravity: Reals, field: Reals) -> Reals:
    """Return the direction of the field in a reading, to north, east, down."""
    dip = math.radians(_dip_deg(gravity, field))
    return np.array([math.cos(dip), 0.0, math.sin(dip)])
