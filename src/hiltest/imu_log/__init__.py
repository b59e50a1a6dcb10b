"""Logs of a whole IMU: files, columns, units, rests and turns in them, and the calibration that they carry."""

from __future__ import annotations

from hiltest.cloud.rate_units import RateUnit
from hiltest.imu_log.intervals import Interval, Intervals, found_intervals, labelled_intervals, listed_intervals
from hiltest.imu_log.log import ImuLog, LogColumns, read_imu_log
from hiltest.imu_log.units import AccelerationUnit

__all__ = [
    "AccelerationUnit",
    "ImuLog",
    "Interval",
    "Intervals",
    "LogColumns",
    "RateUnit",
    "found_intervals",
    "labelled_intervals",
    "listed_intervals",
    "read_imu_log",
]
