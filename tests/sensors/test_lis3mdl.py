"""The LIS3MDL by Adafruit's driver, unmodified."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.sensors.lis3mdl import Lis3mdl

from .bus_master import read, write
from .driver_bus import DriverClock, DriverI2c, ImportDriver, setup, statistics, true_field_ut


def test_lis3mdl_by_adafruit_s_driver(clock: DriverClock, driver: ImportDriver) -> None:
    adafruit, part = driver("adafruit_lis3mdl"), Lis3mdl(setup())
    sensor = adafruit.LIS3MDL(DriverI2c([part], clock))
    assert sensor.range == adafruit.Range.RANGE_4_GAUSS
    mean_ut, noise_ut = statistics(lambda: sensor.magnetic, clock, 1.0 / 155.0)
    # The mean of 400 readings is good to 0.02 uT; the data sheet gives 3.2, 3.2 and 4.1 mgauss of noise.
    assert mean_ut == pytest.approx(true_field_ut(part), abs=0.1)
    assert noise_ut == pytest.approx([0.32, 0.32, 0.41], rel=0.15)  # 4 sigma of a deviation from 400 readings
    sensor.range = adafruit.Range.RANGE_16_GAUSS
    sensor.data_rate = adafruit.Rate.RATE_1000_HZ
    mean_ut, noise_ut = statistics(lambda: sensor.magnetic, clock, 1e-3)
    assert mean_ut == pytest.approx(true_field_ut(part), abs=0.2)
    assert noise_ut == pytest.approx(np.array([0.32, 0.32, 0.41]) * np.sqrt(1000 / 155), rel=0.15)


def test_lis3mdl_measures_once_and_stays_in_power_down(clock: DriverClock, driver: ImportDriver) -> None:
    adafruit, part = driver("adafruit_lis3mdl"), Lis3mdl(setup())
    mode = adafruit.OperationMode
    sensor = adafruit.LIS3MDL(DriverI2c([part], clock), data_rate=adafruit.Rate.RATE_10_HZ, operation_mode=mode.SINGLE)
    assert (sensor.operation_mode, sensor.magnetic) == (mode.SINGLE, (0.0, 0.0, 0.0))
    clock.sleep(0.2)
    first = sensor.magnetic
    assert sensor.operation_mode == mode.POWER_DOWN
    assert first == pytest.approx(true_field_ut(part), abs=2.0)  # 5 sigma
    clock.sleep(1.0)
    assert sensor.magnetic == first
    sensor.operation_mode = mode.SINGLE
    clock.sleep(0.2)
    assert sensor.magnetic != first


@pytest.mark.parametrize("axes", [("-y", "-x", "z"), ("z", "x", "-y")])
def test_axes_of_a_part_are_those_of_its_place(clock: DriverClock, driver: ImportDriver, axes) -> None:
    adafruit, part = driver("adafruit_lis3mdl"), Lis3mdl(setup(axes=axes))
    sensor = adafruit.LIS3MDL(DriverI2c([part], clock))
    mean_ut, _ = statistics(lambda: sensor.magnetic, clock, 1.0 / 155.0)
    along = {
        axis: value
        for name, value in zip("xyz", mean_ut, strict=True)
        for axis, value in ((name, value), (f"-{name}", -value))
    }
    assert [along[axis] for axis in axes] == pytest.approx(true_field_ut(part), abs=0.1)


def test_a_sample_keeps_its_range_when_the_setting_changes(clock: DriverClock, driver: ImportDriver) -> None:
    adafruit, part = driver("adafruit_lis3mdl"), Lis3mdl(setup())
    sensor = adafruit.LIS3MDL(DriverI2c([part], clock), data_rate=adafruit.Rate.RATE_0_625_HZ)
    clock.sleep(4.0)
    sensor._range = adafruit.Range.RANGE_16_GAUSS
    field_ut = true_field_ut(part)
    assert np.array(sensor._raw_mag_data) / 68.42 == pytest.approx(field_ut, abs=2.0)  # 5 sigma
    clock.sleep(4.0)
    assert np.array(sensor._raw_mag_data) / 17.11 == pytest.approx(field_ut, abs=2.0)


def test_temperature_has_eight_counts_a_degree_and_is_off_at_first() -> None:
    part = Lis3mdl(setup(Pose(0.0), temperature_degc=31.0))
    assert read(part, 0.5, 0x2E, 2) == b"\0\0"
    write(part, 0.5, 0x20, 0x80)
    assert read(part, 0.6, 0x2E, 2) == bytes([48, 0])
