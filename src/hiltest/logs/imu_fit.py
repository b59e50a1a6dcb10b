"""A log and all that was made of it."""

from __future__ import annotations

from dataclasses import dataclass

from hiltest.logs.imu_accelerometer import AUTO, AccelerometerResult, fit_rests
from hiltest.logs.imu_gyroscope import WHOLE_DEG, GyroscopeResult, fit_gyroscope
from hiltest.logs.imu_log import ImuLog
from hiltest.logs.intervals import Intervals


@dataclass(frozen=True, slots=True, eq=False)
class ImuLogFit:
    """Calibration of an IMU from a log.

    Attributes
    ----------
    log : ImuLog
    intervals : Intervals
    accelerometer : AccelerometerResult
    gyroscope : GyroscopeResult or None
        None without a gyroscope in the log, or a rest.
    """

    log: ImuLog
    intervals: Intervals
    accelerometer: AccelerometerResult
    gyroscope: GyroscopeResult | None

    @property
    def complete(self) -> bool:
        """Whether all sensors of the log have a calibration."""
        return self.accelerometer.fit is not None and (
            self.log.rate is None or (self.gyroscope is not None and self.gyroscope.fit is not None)
        )


def fit_imu_log(log: ImuLog, intervals: Intervals, method: str = AUTO, *, turn_deg: float = WHOLE_DEG) -> ImuLogFit:
    """Fit the accelerometer to the rests of a log, and the gyroscope to its rests and turns."""
    accelerometer = fit_rests(log, intervals.rests, method)
    gyroscope = fit_gyroscope(log, intervals, accelerometer.fit, turn_deg=turn_deg)
    return ImuLogFit(log, intervals, accelerometer, gyroscope)
