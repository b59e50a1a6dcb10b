"""Recorded motion with an optical truth, from NumPy archives."""

from __future__ import annotations

import math
import stat
import zipfile
import zlib
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hiltest.budgets import MOTION, BudgetError
from hiltest.errors import ConfigError

Reals = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.80665
_LOWEST_HZ, _HIGHEST_HZ = 1.0, 100_000.0
# Quaternions of a float32 recording have a norm of 1 within this.
_NORM_TOLERANCE = 1e-3
# Largest header of an array, as numpy.load has it.
_LARGEST_HEADER = 10_000
_COLUMNS = {
    "gyroscope_rad_s": 3,
    "accelerometer_m_s2": 3,
    "magnetometer_ut": 3,
    "quaternion_enu": 4,
    "movement": 0,
}


@dataclass(frozen=True, slots=True, eq=False)
class MotionRecording:
    """Readings of an IMU and a magnetometer, with the attitude that cameras saw."""

    name: str
    rate_hz: float
    gyroscope_rad_s: Reals
    """Shape (n, 3), sensor frame."""
    acceleration_m_s2: Reals
    """Specific force, shape (n, 3), sensor frame: upwards at rest."""
    field_ut: Reals
    """Shape (n, 3), sensor frame."""
    truth: Reals
    """Unit quaternions x, y, z, w from sensor frame to NED, shape (n, 4); NaN where the cameras saw nothing."""
    movement: NDArray[np.bool_]
    """Shape (n,). True during the motion phase."""

    @property
    def gravity_g(self) -> Reals:
        """Return gravity less acceleration, shape (n, 3), sensor frame: downwards at rest."""
        return -self.acceleration_m_s2 / STANDARD_GRAVITY_M_S2

    @property
    def first_motion(self) -> int:
        """Index of the first sample of the motion phase."""
        return int(np.argmax(self.movement))

    def truth_at(self, times_s: Reals) -> Reals:
        """Return true attitudes between samples, shape (len(times_s), 4); NaN beside a sample without one.

        Parameters
        ----------
        times_s : shape (n,)
            Times since the first sample.
        """
        places = np.clip(times_s * self.rate_hz, 0.0, len(self.truth) - 1.0)
        before = np.minimum(places.astype(np.intp), len(self.truth) - 2)
        first, second = self.truth[before], self.truth[before + 1]
        share = (places - before)[:, None]
        nearer = np.where((first * second).sum(axis=1, keepdims=True) < 0.0, -second, second)
        mixed = (1.0 - share) * first + share * nearer
        attitudes: Reals = mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
        return attitudes

    def rest_bias_rad_s(self) -> Reals:
        """Return the mean rate before the motion, shape (3,).

        Raises
        ------
        ConfigError
            If the recording begins with the motion.
        """
        if self.first_motion == 0:
            raise ConfigError(f"{self.name}: no rest before the motion, so the gyroscope's bias is not known")
        bias: Reals = self.gyroscope_rad_s[: self.first_motion].mean(axis=0)
        return bias


def read_motion_recording(path: str | PathLike[str]) -> MotionRecording:
    """Read a recording in the layout of the BROAD archives.

    The file is a NumPy archive (.npz) of the arrays gyroscope_rad_s, accelerometer_m_s2 and magnetometer_ut, shape
    (n, 3), quaternion_enu, shape (n, 4), scalar first, from sensor frame to east-north-up, movement, shape (n,), and
    the number sampling_rate_hz. BROAD is Laidig, Caruso, Cereatti and Seel, Data 6 (7), 2021, doi 10.3390/data6070072.

    Raises
    ------
    ConfigError
        If the file cannot be read, or an array is missing, too large, of another shape or kind, or not finite.
    """
    name = Path(path).name
    try:
        status = Path(path).stat()
        if not stat.S_ISREG(status.st_mode):  # a device or a pipe may never end
            raise ConfigError(f"{name}: not a regular file; name a NumPy archive (.npz)")
        MOTION.check(size=status.st_size)
        with zipfile.ZipFile(path) as archive:
            rate_hz = float(_read_array(archive, name, "sampling_rate_hz", (), "f"))
            arrays: dict[str, NDArray[np.generic]] = {}
            for member, columns in _COLUMNS.items():
                shape = (-1, columns) if columns else (-1,)
                arrays[member] = _read_array(archive, name, member, shape, "f" if columns else "b")
    except BudgetError as error:
        raise ConfigError(f"{name}: {error}; cut the recording") from error
    except (OSError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise ConfigError(f"{name}: not a readable NumPy archive ({error})") from error
    return _checked(name, rate_hz, arrays)


def _read_array(
    archive: zipfile.ZipFile, name: str, member: str, shape: tuple[int, ...], kind: str
) -> NDArray[np.generic]:
    """Return one array of an archive; -1 in the shape is any length up to the limit."""
    try:
        entry = archive.getinfo(f"{member}.npy")
    except KeyError:
        raise ConfigError(f"{name}: the array {member} is missing") from None
    with archive.open(entry) as stream:
        try:
            version = np.lib.format.read_magic(stream)
            if version != (1, 0):
                raise ValueError(f"version {version[0]}.{version[1]} of the header")
            actual, by_columns, dtype = np.lib.format.read_array_header_1_0(stream, max_header_size=_LARGEST_HEADER)
        except (ValueError, SyntaxError, TypeError, KeyError, RecursionError, MemoryError) as error:
            raise ConfigError(f"{name}: {member} is not a NumPy array ({error})") from error
        rows_known = len(actual) == len(shape) and actual[1:] == shape[1:]
        if not rows_known or dtype.kind != kind or by_columns:
            expected = "(n" + "".join(f", {size}" for size in shape[1:]) + ")" if shape else "()"
            raise ConfigError(
                f"{name}: {member} has shape {actual} and type {dtype}; expected rows of shape {expected} and "
                f"{'floating-point numbers' if kind == 'f' else 'truth values'}"
            )
        if actual and not 1 <= actual[0] <= MOTION.items:
            raise ConfigError(f"{name}: {member} has {actual[0]} rows; expected 1 to {MOTION.items}")
        size = math.prod(actual) * dtype.itemsize
        data = stream.read(size + 1)
    if len(data) != size:
        raise ConfigError(f"{name}: {member} has not the {size} bytes that its header announces")
    return np.frombuffer(data, dtype=dtype).reshape(actual)


def _checked(name: str, rate_hz: float, arrays: dict[str, NDArray[np.generic]]) -> MotionRecording:
    if not _LOWEST_HZ <= rate_hz <= _HIGHEST_HZ:
        raise ConfigError(f"{name}: sampling_rate_hz is {rate_hz:g}; expected {_LOWEST_HZ:g} to {_HIGHEST_HZ:g}")
    counts = {member: len(array) for member, array in arrays.items()}
    if len(set(counts.values())) > 1:
        lengths = ", ".join(f"{member} {count}" for member, count in counts.items())
        raise ConfigError(f"{name}: the arrays have different lengths: {lengths}")
    movement = arrays.pop("movement").astype(bool)
    if not movement.any():
        raise ConfigError(f"{name}: movement is False everywhere, so no error counts")
    reals = {member: array.astype(np.float64) for member, array in arrays.items()}
    quaternions = reals.pop("quaternion_enu")
    for member, values in reals.items():
        if not np.isfinite(values).all():
            raise ConfigError(f"{name}: {member} has values that are not finite")
    visible = np.asarray(np.isfinite(quaternions).all(axis=1))
    if not visible[movement].any():
        raise ConfigError(f"{name}: quaternion_enu has no attitude during the motion")
    norms = np.linalg.norm(quaternions[visible], axis=1)
    if np.abs(norms - 1.0).max() > _NORM_TOLERANCE:
        raise ConfigError(f"{name}: quaternion_enu has rows whose norm is not 1")
    truth = np.full(quaternions.shape, np.nan)
    truth[visible] = _ned_from_enu(quaternions[visible] / norms[:, None])
    return MotionRecording(
        name, rate_hz, reals["gyroscope_rad_s"], reals["accelerometer_m_s2"], reals["magnetometer_ut"], truth, movement
    )


def _ned_from_enu(scalar_first: Reals) -> Reals:
    """Return attitudes to NED, scalar last, of attitudes to ENU, scalar first.

    East and north are exchanged and up is reversed: half a turn about the axis between north and east.
    """
    w, x, y, z = scalar_first.T
    return math.sqrt(0.5) * np.stack([w + z, w - z, y - x, -x - y], axis=1)
