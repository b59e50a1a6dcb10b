"""The LSM9DS1's two dies by Adafruit's driver, unmodified."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.sensors.lsm9ds1_ag import Lsm9ds1Ag

from .bus_master import read, write
from .driver_bus import (
    TILTED,
    ChipSelect,
    DriverClock,
    DriverI2c,
    DriverSpi,
    ImportDriver,
    samples_per_s,
    setup,
    statistics,
    true_field_ut,
    true_force_g,
    turn,
)

G = 9.80665
POSES = [TILTED, Pose(310.0, -35.0, 150.0)]
ACCELEROMETER, GYROSCOPE = 0, 1  # outputs
MIRRORED = np.array([-1.0, 1.0, 1.0])  # axes of accelerometer and gyroscope in terms of the magnetometer's


@pytest.fixture
def part() -> Lsm9ds1Ag:
    return Lsm9ds1Ag(setup(temperature_degc=31.0))


def make_sensor(part: Lsm9ds1Ag, clock: DriverClock, driver: ImportDriver):
    return driver("adafruit_lsm9ds1").LSM9DS1_I2C(DriverI2c([part, *part.companions], clock))


def test_lsm9ds1_by_adafruit_s_driver_over_spi(clock: DriverClock, driver: ImportDriver) -> None:
    part = Lsm9ds1Ag(setup())
    spi = DriverSpi({"CS_AG": part, "CS_M": part.companions[0]}, clock)
    sensor = driver("adafruit_lsm9ds1").LSM9DS1_SPI(spi, ChipSelect(spi, "CS_AG"), ChipSelect(spi, "CS_M"))
    clock.sleep(0.5)
    mean, _ = statistics(lambda: tuple(sensor.acceleration), clock, 1.0 / 952.0)
    assert mean / G == pytest.approx(MIRRORED * true_force_g(part), abs=0.0005)
    mean, _ = statistics(lambda: tuple(sensor.magnetic), clock, 1.0 / 10.0)
    assert 100.0 * mean == pytest.approx(true_field_ut(part), abs=0.25)
    sensor.mag_gain = driver("adafruit_lsm9ds1").MAGGAIN_16GAUSS
    clock.sleep(0.2)
    assert part.companions[0].field("full scale") == 3


@pytest.mark.parametrize("pose", POSES)
def test_lsm9ds1_by_adafruit_s_driver(pose: Pose, clock: DriverClock, driver: ImportDriver) -> None:
    part = Lsm9ds1Ag(setup(pose))
    sensor = make_sensor(part, clock, driver)
    clock.sleep(0.5)
    mean, noise = statistics(lambda: tuple(sensor.acceleration), clock, 1.0 / 952.0)
    # 90 ug and 5 mdps per root of Hz, in 408 and in 100 Hz; the mean of 400 readings is good to a 20th,
    # their deviation to 15 % (4 sigma).
    assert mean / G == pytest.approx(MIRRORED * true_force_g(part), abs=0.0005)
    assert noise / G == pytest.approx(
        [90e-6 * np.sqrt(408.0)] * 3, rel=0.15
    )  # 4 sigma of a deviation from 400 readings
    mean, noise = np.degrees(statistics(lambda: tuple(sensor.gyro), clock, 1.0 / 952.0))
    assert mean == pytest.approx([0.0] * 3, abs=0.015)
    assert noise == pytest.approx([5e-3 * np.sqrt(100.0)] * 3, rel=0.15)
    mean, noise = statistics(lambda: tuple(sensor.magnetic), clock, 1.0 / 10.0)
    assert 100.0 * mean == pytest.approx(true_field_ut(part), abs=0.25)  # the driver gives gauss
    assert 100.0 * noise == pytest.approx(np.array([0.32, 0.32, 0.41]) * np.sqrt(1000.0 / 155.0), rel=0.15)
    rate_dps = turn(part, clock)
    mean, _ = np.degrees(statistics(lambda: tuple(sensor.gyro), clock, 1.0 / 952.0))
    assert mean == pytest.approx(MIRRORED * rate_dps, abs=0.02)


@pytest.mark.parametrize(("acceleration", "rate", "field"), [(2, 245, 4), (4, 500, 8), (8, 2000, 12), (16, 245, 16)])
def test_lsm9ds1_has_the_driver_s_ranges(
    part, clock: DriverClock, driver: ImportDriver, acceleration: int, rate: int, field: int
) -> None:
    adafruit, sensor = driver("adafruit_lsm9ds1"), make_sensor(part, clock, driver)
    sensor.accel_range = getattr(adafruit, f"ACCELRANGE_{acceleration}G")
    sensor.gyro_scale = getattr(adafruit, f"GYROSCALE_{rate}DPS")
    sensor.mag_gain = getattr(adafruit, f"MAGGAIN_{field}GAUSS")
    clock.sleep(0.5)
    mean, _ = statistics(lambda: tuple(sensor.acceleration), clock, 1.0 / 952.0)
    assert mean / G == pytest.approx(MIRRORED * true_force_g(part), abs=0.0006)
    mean, _ = statistics(lambda: tuple(sensor.magnetic), clock, 1.0 / 10.0)
    assert 100.0 * mean == pytest.approx(true_field_ut(part), abs=0.25)
    rate_dps = turn(part, clock)
    mean, _ = np.degrees(statistics(lambda: tuple(sensor.gyro), clock, 1.0 / 952.0))
    assert mean == pytest.approx(MIRRORED * rate_dps, abs=0.035)  # half a count at 2000 dps


@pytest.mark.parametrize(
    ("code", "rate_hz", "alone_hz"),
    [(0, 0, 0), (1, 14.9, 10), (2, 59.5, 50), (3, 119, 119), (4, 238, 238), (5, 476, 476), (6, 952, 952)],
)
def test_lsm9ds1_accelerometer_follows_the_gyroscope_s_rate(
    part, clock: DriverClock, code: int, rate_hz: float, alone_hz: float
) -> None:
    write(part, 0.1, 0x20, code << 5)
    assert samples_per_s(part, clock, ACCELEROMETER) == pytest.approx(alone_hz, abs=0.5)
    write(part, clock.now_s, 0x10, code << 5)
    for output in (ACCELEROMETER, GYROSCOPE):
        assert samples_per_s(part, clock, output) == pytest.approx(rate_hz, abs=0.5)


def test_lsm9ds1_magnetometer_subtracts_its_user_offset(part, clock: DriverClock, driver: ImportDriver) -> None:
    sensor = make_sensor(part, clock, driver)
    clock.sleep(1.0)
    before = np.array(sensor.read_mag_raw())
    write(part.companions[0], clock.now_s, 0x85, 0xE8, 0x03, 0x18, 0xFC, 0x00, 0x00)
    clock.sleep(1.0)
    assert np.array(sensor.read_mag_raw()) - before == pytest.approx([-1000.0, 1000.0, 0.0], abs=500.0)  # 6 sigma


def test_lsm9ds1_temperature_has_sixteen_counts_a_degree(part, clock: DriverClock, driver: ImportDriver) -> None:
    sensor = make_sensor(part, clock, driver)
    clock.sleep(0.1)
    # The data sheet's word is right-justified; the driver drops its four lowest bits, so that it sees whole degrees.
    assert read(part, clock.now_s, 0x15, 2) == (6 * 16).to_bytes(2, "little")
    assert sensor.read_temp_raw() == 6


def test_lsm9ds1_burst_goes_round_the_outputs_of_the_active_sensors(part) -> None:
    write(part, 0.1, 0x20, 0xC0)
    alone = read(part, 0.2, 0x28, 12)
    assert alone[:6] == alone[6:]
    write(part, 0.2, 0x10, 0xC0)
    both = read(part, 0.3, 0x18, 24)
    assert both[:12] == both[12:]
    assert both[6:12] == read(part, 0.3, 0x28, 6)


def test_lsm9ds1_raises_its_pins_until_the_data_are_read(part) -> None:
    write(part, 0.1, 0x0C, 0x01, 0x02)
    write(part, 0.1, 0x10, 0x20)
    assert part.interrupt_levels(0.3) == (True, True)
    assert read(part, 0.3, 0x17, 1) == read(part, 0.3, 0x27, 1) == b"\x03"
    read(part, 0.3, 0x28, 6)
    assert part.interrupt_levels(0.3) == (False, True)
    write(part, 0.3, 0x22, 0x24)
    assert part.interrupt_levels(0.3) == (True, False)
