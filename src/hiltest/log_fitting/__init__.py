"""Recorded files: samples of magnetometers and IMUs, fits, Allan deviation, and their pages."""

from __future__ import annotations

from hiltest.log_fitting.counts import CountScale, evenly_on_sphere
from hiltest.log_fitting.imu_log import ImuLog, LogColumns, read_imu_log
from hiltest.log_fitting.intervals import Interval, Intervals, found_intervals, labelled_intervals, listed_intervals
from hiltest.log_fitting.samples import Samples, read_samples
from hiltest.measurement.units import AccelerationUnit, FieldUnit, RateUnit

__all__ = [
    "AccelerationUnit",
    "CountScale",
    "FieldUnit",
    "ImuLog",
    "Interval",
    "Intervals",
    "LogColumns",
    "RateUnit",
    "Samples",
    "evenly_on_sphere",
    "found_intervals",
    "labelled_intervals",
    "listed_intervals",
    "read_imu_log",
    "read_samples",
]
