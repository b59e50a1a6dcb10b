"""Samples that no intact sensor returns: at the end of its range, or the same one repeatedly.

A calibration or heading from them says nothing about the firmware's arithmetic, so they are refused before any
computation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.errors import SensorFaultError
from hiltest.link.gyroscope import GyroscopeRestReply, IntegrateGyroscopeReply
from hiltest.link.poses import AddPoseReply
from hiltest.link.replies import AverageReply, SensorKind, Statistic
from hiltest.rig import COUNTS_PER_UT
from hiltest.rig.parts import PARTS

SAME_SAMPLES = 8
"""Number of consecutive samples that cannot be equal on all axes: with noise of one count rms, less than any modelled
sensor has, the probability is 10^-11."""
_SPREADS = 3.0  # standard deviations between a mean and the end of the range at which samples may have been clipped
_SHOCKS = 0.02  # share of a tumble's samples of gravity that a knock, which says nothing of the field, may take
_WORDS_END = 32_764  # of accelerometer and gyroscope: 4 g left-justified to 16 bits, 2048 deg/s
_RANGES_UT = {
    name: part.magnetometer_range_ut
    for part in PARTS.values()
    for kind, name in part.sensors.items()
    if kind == "magnetometer" and part.magnetometer_range_ut is not None
}


class SampleChecks:
    """Checks of a board's sensor readings.

    Parameters
    ----------
    sensor_name
        Returns the name of the selected sensor of a kind.
    is_noise_free
        Returns whether a sensor of a kind is simulated without noise, so that equal samples are normal.
    """

    def __init__(self, sensor_name: Callable[[SensorKind], str], is_noise_free: Callable[[SensorKind], bool]) -> None:
        self._name, self._is_noise_free = sensor_name, is_noise_free

    def reply(self, reply: object) -> None:
        """Check a reply that has samples.

        Raises
        ------
        SensorFaultError
        """
        if isinstance(reply, AddPoseReply):
            reply = reply.average
        if isinstance(reply, AverageReply):
            self._mean(SensorKind.MAGNETOMETER, reply.n, reply.magnetometer)
            self._mean(SensorKind.ACCELEROMETER, reply.n, reply.accelerometer)
        elif isinstance(reply, GyroscopeRestReply):
            self._mean(SensorKind.GYROSCOPE, reply.n, reply.rate)
        elif isinstance(reply, IntegrateGyroscopeReply) and np.array_equal(reply.lowest, reply.highest):
            self._refuse_same(SensorKind.GYROSCOPE, reply.n)

    def tumble(self, magnetometer: NDArray[np.int16], accelerometer: NDArray[np.int16]) -> None:
        """Check points in the order of their time, shape (n, 3) [counts].

        Raises
        ------
        SensorFaultError
        """
        self.samples(SensorKind.MAGNETOMETER, magnetometer)
        self.samples(SensorKind.ACCELEROMETER, accelerometer, knocked=int(_SHOCKS * len(accelerometer)))

    def samples(self, kind: SensorKind, counts: NDArray[np.int16], *, knocked: int = 0) -> None:
        """Check samples of one sensor in the order of their time, shape (n, 3) [counts].

        Parameters
        ----------
        knocked
            Number of samples that may be at the end of the range.

        Raises
        ------
        SensorFaultError
        """
        at_end = np.abs(counts.astype(int)) >= self._end(kind)
        if np.count_nonzero(at_end.any(axis=1)) > knocked:
            axis = int(at_end.sum(axis=0).argmax())
            self._refuse_end(kind, axis, f"in {at_end[:, axis].sum()} of {len(counts)} samples")
        self._refuse_same(kind, longest_run(counts.tolist()))

    def _mean(self, kind: SensorKind, n: int, statistic: Statistic) -> None:
        spread = np.zeros(3) if statistic.spread is None else statistic.spread
        reaches = np.abs(statistic.mean) + _SPREADS * spread >= self._end(kind) - 0.5
        if reaches.any():
            self._refuse_end(kind, int(reaches.argmax()), f"in {n} samples")
        if statistic.spread is not None and not statistic.spread.any():
            self._refuse_same(kind, n)

    def _end(self, kind: SensorKind) -> float:
        range_ut = _RANGES_UT.get(self._name(kind)) if kind is SensorKind.MAGNETOMETER else None
        return _WORDS_END if range_ut is None else COUNTS_PER_UT * range_ut

    def _refuse_end(self, kind: SensorKind, axis: int, where: str) -> None:
        near = "a magnet or a current" if kind is SensorKind.MAGNETOMETER else "vibration or motion of the board"
        raise SensorFaultError(
            f"{self._name(kind)}: its {'xyz'[axis]} axis is at the end of its range {where}. Look for {near}; "
            "otherwise the part is defective, or the firmware reads it incorrectly"
        )

    def _refuse_same(self, kind: SensorKind, samples: int) -> None:
        if samples >= SAME_SAMPLES and not self._is_noise_free(kind):
            raise SensorFaultError(
                f"{self._name(kind)}: {samples} consecutive samples are identical on all axes. The part hangs, or "
                "the firmware reads no new samples: switch the board off and on"
            )


def longest_run(rows: Sequence[ArrayLike]) -> int:
    """Return the length of the longest run of equal rows."""
    return max((len(list(equal)) for _, equal in groupby(rows)), default=0)
