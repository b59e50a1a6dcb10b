"""The LSM6DS3TR-C by Adafruit's driver, unmodified."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.sensors.lsm6ds3trc import Lsm6ds3trc

from .bus_master import read, write
from .driver_bus import (
    TILTED,
    DriverClock,
    DriverI2c,
    ImportDriver,
    samples_per_s,
    setup,
    statistics,
    true_force_g,
    turn,
)

G = 9.80665
pytestmark = pytest.mark.usefixtures("adafruit")
POSES = [TILTED, Pose(310.0, -35.0, 150.0)]
ACCELEROMETER, GYROSCOPE = 0, 1  # outputs


@pytest.fixture
def adafruit(driver: ImportDriver) -> ModuleType:
    """Module of the family, in which the classes of its parts sleep."""
    return driver("adafruit_lsm6ds")


def make_sensor(part: Lsm6ds3trc, clock: DriverClock, driver: ImportDriver, name: str = "LSM6DS3TRC"):
    return getattr(driver(f"adafruit_lsm6ds.{name.lower()}"), name)(DriverI2c([part], clock))


@pytest.mark.parametrize("name", ["LSM6DS3", "LSM6DS3TRC"])
@pytest.mark.parametrize("pose", POSES)
def test_lsm6ds3trc_by_adafruit_s_driver(pose: Pose, name: str, clock: DriverClock, driver: ImportDriver) -> None:
    part = Lsm6ds3trc(setup(pose, temperature_degc=31.5))
    sensor = make_sensor(part, clock, driver, name)
    mean, noise = statistics(lambda: sensor.acceleration, clock, 1.0 / 104.0)
    # 90 ug and 5 mdps per root of Hz, in half the data rate and in 33 Hz; the mean of 400 readings is good to a 20th.
    assert mean / G == pytest.approx(true_force_g(part), abs=0.0005)
    assert noise / G == pytest.approx([90e-6 * np.sqrt(52.0)] * 3, rel=0.15)  # 4 sigma of a deviation from 400 readings
    mean, noise = np.degrees(statistics(lambda: sensor.gyro, clock, 1.0 / 104.0))
    assert mean == pytest.approx([0.0] * 3, abs=0.01)
    assert noise == pytest.approx([5e-3 * np.sqrt(33.0)] * 3, rel=0.15)
    rate_dps = turn(part, clock)
    mean, _ = np.degrees(statistics(lambda: sensor.gyro, clock, 1.0 / 104.0))
    assert mean == pytest.approx(rate_dps, abs=0.02)
    assert sensor.temperature == pytest.approx(31.5, abs=0.01)


@pytest.mark.parametrize(("name", "density_ug"), [("2G", 90), ("4G", 90), ("8G", 90), ("16G", 130)])
def test_lsm6ds3trc_has_the_driver_s_ranges_of_acceleration(
    adafruit: ModuleType, clock: DriverClock, driver: ImportDriver, name: str, density_ug: float
) -> None:
    part = Lsm6ds3trc(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.accelerometer_range = getattr(adafruit.AccelRange, f"RANGE_{name}")
    sensor.accelerometer_data_rate = adafruit.Rate.RATE_833_HZ
    clock.sleep(0.1)
    mean, noise = statistics(lambda: sensor.acceleration, clock, 1.0 / 833.0)
    assert mean / G == pytest.approx(true_force_g(part), abs=0.001)
    assert noise / G == pytest.approx([density_ug * 1e-6 * np.sqrt(833.0 / 2.0)] * 3, rel=0.15)


@pytest.mark.parametrize("name", ["125", "250", "500", "1000", "2000"])
def test_lsm6ds3trc_has_the_driver_s_ranges_of_rate(
    adafruit: ModuleType, clock: DriverClock, driver: ImportDriver, name: str
) -> None:
    part = Lsm6ds3trc(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.gyro_range = getattr(adafruit.GyroRange, f"RANGE_{name}_DPS")
    assert sensor.gyro_range == getattr(adafruit.GyroRange, f"RANGE_{name}_DPS")
    rate_dps = turn(part, clock)
    mean, _ = np.degrees(statistics(lambda: sensor.gyro, clock, 1.0 / 104.0))
    assert mean == pytest.approx(rate_dps, abs=0.02)


@pytest.mark.parametrize(
    ("code", "rate_hz"),
    [(0, 0), (1, 12.5), (2, 26), (3, 52), (4, 104), (5, 208), (6, 416), (7, 833), (8, 1666), (9, 3332), (10, 6664)],
)
def test_lsm6ds3trc_has_the_driver_s_rates(clock: DriverClock, driver: ImportDriver, code: int, rate_hz: float) -> None:
    part = Lsm6ds3trc(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.accelerometer_data_rate = sensor.gyro_data_rate = code
    for output in (ACCELEROMETER, GYROSCOPE):
        assert samples_per_s(part, clock, output) == pytest.approx(rate_hz, abs=0.5)


def test_lsm6ds3trc_is_slow_in_low_power_mode_only(
    adafruit: ModuleType, clock: DriverClock, driver: ImportDriver
) -> None:
    part = Lsm6ds3trc(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.accelerometer_data_rate = adafruit.Rate.RATE_1_6_HZ
    assert part.outputs[ACCELEROMETER].rate_hz == 12.5
    write(part, clock.now_s, 0x15, 0x10)
    assert part.outputs[ACCELEROMETER].rate_hz == 1.6
    sensor.accelerometer_data_rate = adafruit.Rate.RATE_104_HZ
    clock.sleep(0.1)
    _, noise = statistics(lambda: sensor.acceleration, clock, 1.0 / 104.0)
    assert noise / G == pytest.approx([0.0020] * 3, rel=0.15)  # normal mode at 4 g


def test_lsm6ds3trc_filters_noise(adafruit: ModuleType, clock: DriverClock, driver: ImportDriver) -> None:
    part = Lsm6ds3trc(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.accelerometer_range = adafruit.AccelRange.RANGE_2G
    sensor.high_pass_filter = adafruit.AccelHPF.HPF_DIV9
    write(part, clock.now_s, 0x17, 0xC0)
    clock.sleep(0.1)
    _, noise = statistics(lambda: sensor.acceleration, clock, 1.0 / 104.0)
    assert noise / G == pytest.approx([90e-6 * np.sqrt(104.0 / 9.0)] * 3, rel=0.15)


def test_lsm6ds3trc_adds_self_test_and_user_offsets(clock: DriverClock, driver: ImportDriver) -> None:
    part = Lsm6ds3trc(setup(Pose(0.0)))
    sensor = make_sensor(part, clock, driver)
    for mode, sign in ((0x05, 1.0), (0x0E, -1.0)):
        write(part, clock.now_s, 0x14, mode)
        clock.sleep(0.1)
        assert np.array(sensor.acceleration) / G == pytest.approx([sign * 0.895] * 2 + [sign * 0.895 - 1.0], abs=0.01)
        assert np.degrees(sensor.gyro) == pytest.approx([sign * 50.0] * 3, abs=0.2)
    write(part, clock.now_s, 0x14, 0)
    write(part, clock.now_s, 0x73, 64, 0x80, 64)
    clock.sleep(0.1)
    assert np.array(sensor.acceleration) / G == pytest.approx([0.0625, -0.125, -1.0625], abs=0.005)


def test_lsm6ds3trc_raises_its_pins_until_the_data_are_read(clock: DriverClock, driver: ImportDriver) -> None:
    part = Lsm6ds3trc(setup())
    sensor = make_sensor(part, clock, driver)
    write(part, clock.now_s, 0x0D, 0x01, 0x02)
    clock.now_s = np.ceil(clock.now_s * 104.0) / 104.0 + 0.1e-3  # after a sample: the reads below take 2 ms of 9.6
    assert part.interrupt_levels(clock.now_s) == (True, True)
    assert read(part, clock.now_s, 0x1E, 1) == b"\x03"
    _ = sensor.acceleration
    assert part.interrupt_levels(clock.now_s) == (False, True)
    write(part, clock.now_s, 0x12, 0x24)
    assert part.interrupt_levels(clock.now_s) == (True, False)
    _ = sensor.gyro
    assert part.interrupt_levels(clock.now_s) == (True, True)


def test_lsm6ds3trc_pointer_stays_if_it_is_asked_to() -> None:
    part = Lsm6ds3trc(setup())
    assert read(part, 0.1, 0x0F, 4) == b"\x6a\0\0\x04"
    write(part, 0.1, 0x12, 0x00)
    assert read(part, 0.1, 0x0F, 4) == b"\x6a" * 4
