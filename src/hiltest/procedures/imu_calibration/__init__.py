"""The calibration of a complete IMU as a file: its contents, the check of its board, and a C header."""

from __future__ import annotations

from hiltest.procedures.imu_calibration.contents import (
    AccelerometerPart,
    FigureOfMerit,
    GyroscopePart,
    ImuCalibration,
    MadeOn,
    MagnetometerPart,
)

__all__ = ["AccelerometerPart", "FigureOfMerit", "GyroscopePart", "ImuCalibration", "MadeOn", "MagnetometerPart"]
