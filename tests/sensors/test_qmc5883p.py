"""The QMC5883P by Adafruit's driver, unmodified."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.world import MagneticDistortion
from hiltest.world.sensors.qmc5883p import Qmc5883p

from .driver_bus import DriverClock, DriverI2c, ImportDriver, setup, statistics, true_field_ut


def test_qmc5883p_by_adafruit_s_driver(clock: DriverClock, driver: ImportDriver) -> None:
    adafruit, part = driver("adafruit_qmc5883p"), Qmc5883p(setup())
    sensor = adafruit.QMC5883P(DriverI2c([part], clock))
    mean, noise = statistics(lambda: sensor.magnetic, clock, 1e-3)
    assert 100 * mean == pytest.approx(true_field_ut(part), abs=0.1)  # the driver gives gauss
    assert 100 * noise == pytest.approx([0.2] * 3, rel=0.15)  # oversampling 4 and a filter of 2
    sensor.oversample_ratio = adafruit.OSR_1
    sensor.downsample_ratio = adafruit.DSR_1
    sensor.data_rate = adafruit.ODR_200HZ
    sensor.range = adafruit.RANGE_2G
    mean, noise = statistics(lambda: sensor.magnetic, clock, 1e-3)
    assert 100 * mean == pytest.approx(true_field_ut(part), abs=0.2)
    assert 100 * noise == pytest.approx([0.2 * np.sqrt(8)] * 3, rel=0.15)
    assert not sensor.overflow
    assert sensor.self_test()
    sensor.soft_reset()
    assert (sensor.mode, sensor.range) == (adafruit.MODE_SUSPEND, adafruit.RANGE_30G)


def test_qmc5883p_reports_a_field_beyond_its_range(clock: DriverClock, driver: ImportDriver) -> None:
    strong = MagneticDistortion(hard_iron_ut=(0.0, 500.0, 0.0))
    adafruit, part = driver("adafruit_qmc5883p"), Qmc5883p(setup(distortion=strong))
    sensor = adafruit.QMC5883P(DriverI2c([part], clock))
    clock.sleep(0.1)
    assert (sensor.data_ready, sensor.data_ready, sensor.overflow) == (True, False, False)
    sensor.range = adafruit.RANGE_2G
    clock.sleep(0.1)
    assert sensor.overflow
    assert max(sensor.magnetic_raw) == 32_767
