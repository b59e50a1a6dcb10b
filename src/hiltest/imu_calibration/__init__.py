"""The calibration of a whole IMU as a file: its contents, the board that it is of, and the same numbers for C."""

from __future__ import annotations

from hiltest.imu_calibration.contents import (
    AccelerometerPart,
    FigureOfMerit,
    GyroscopePart,
    ImuCalibration,
    MadeOn,
    MagnetometerPart,
)

__all__ = ["AccelerometerPart", "FigureOfMerit", "GyroscopePart", "ImuCalibration", "MadeOn", "MagnetometerPart"]
