"""Recorded files: readings of magnetometers and IMUs, what is fitted to them, Allan deviation, and their pages."""

from __future__ import annotations

from hiltest.logs.columns import Unit
from hiltest.logs.counts import CountScale, thinned
from hiltest.logs.imu_log import ImuLog, LogColumns, read_imu_log
from hiltest.logs.intervals import Interval, Intervals, found_intervals, labelled_intervals, listed_intervals
from hiltest.logs.samples import Cloud, read_cloud
from hiltest.logs.units import AccelerationUnit, RateUnit

__all__ = [
    "AccelerationUnit",
    "Cloud",
    "CountScale",
    "ImuLog",
    "Interval",
    "Intervals",
    "LogColumns",
    "RateUnit",
    "Unit",
    "found_intervals",
    "labelled_intervals",
    "listed_intervals",
    "read_cloud",
    "read_imu_log",
    "thinned",
]
