"""A calibration with other numbers in every place."""

from __future__ import annotations

import pytest

from hiltest.procedures.imu_calibration.contents import (
    ACCELEROMETER_UNITS,
    FRAME,
    GYROSCOPE_UNITS,
    MAGNETOMETER_UNITS,
    SCHEMA,
    AccelerometerPart,
    FigureOfMerit,
    GyroscopePart,
    ImuCalibration,
    MadeOn,
    MagnetometerPart,
)


@pytest.fixture
def calibration() -> ImuCalibration:
    return some_calibration()


def some_calibration() -> ImuCalibration:
    """Return a calibration of all three sensors."""
    return ImuCalibration(
        schema=SCHEMA,
        hiltest="0.1.0",
        made_utc="2026-02-03T04:05:06Z",
        frame=FRAME,
        temperature_degc=21.0,
        made_on=MadeOn("real", "hiltest-frdm-k64f", "0.1.0", "0123456789abcdef", "ab" * 16, "frdm-k64f", None),
        accelerometer=AccelerometerPart(
            sensor="FXOS8700CQ accelerometer",
            method="six-position",
            n=6,
            formula="gravity_g = gain * (counts - offset)",
            gain=((1.22e-4, 1e-7, -2e-7), (3e-7, 1.23e-4, 4e-7), (-5e-7, 6e-7, 1.21e-4)),
            offset=(12.5, -7.25, 3.125),
            units=ACCELEROMETER_UNITS,
            figures=(FigureOfMerit("residual", 1.5, "mg"),),
        ),
        gyroscope=GyroscopePart(
            sensor="FXAS21002C",
            method="rest",
            n=400,
            formula="rate_dps = matrix * (counts - bias)",
            matrix=((0.0625, 1e-5, 2e-5), (3e-5, 0.0626, 4e-5), (5e-5, 6e-5, 0.0624)),
            bias=(23.8, -33.6, 19.1),
            units=GYROSCOPE_UNITS,
            figures=(),
        ),
        magnetometer=MagnetometerPart(
            sensor="MAG3110",
            method="direct",
            n=300,
            formula="unit_field = soft_iron * (counts - hard_iron)",
            soft_iron=((2.01e-3, -2e-5, 1e-5), (-2e-5, 2.1e-3, -2.1e-5), (1e-5, -2.1e-5, 2.05e-3)),
            hard_iron=(24.0, -21.6, 39.9),
            hard_iron_ut=(2.4, -2.16, 3.99),
            units=MAGNETOMETER_UNITS,
            figures=(FigureOfMerit("residual", 0.84, "%"), FigureOfMerit("coverage of the sphere", 91.0, "%")),
        ),
    )
