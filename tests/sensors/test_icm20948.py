"""The ICM-20948, with the AK09916 behind its I2C master, by Adafruit's driver, unmodified."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world import MagneticDistortion
from hiltest.world.sensors.icm20948 import Icm20948

from .bus_master import read, write
from .driver_bus import (
    TILTED,
    DriverClock,
    DriverI2c,
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
COMPASS = np.array([1.0, -1.0, -1.0])  # axes of the AK09916 in terms of the package's
ACCELEROMETER, GYROSCOPE = 0, 1  # outputs


def make_sensor(part: Icm20948, clock: DriverClock, driver: ImportDriver):
    return driver("adafruit_icm20x").ICM20948(DriverI2c([part, *part.companions], clock))


@pytest.mark.parametrize("pose", POSES)
def test_icm20948_by_adafruit_s_driver(pose: Pose, clock: DriverClock, driver: ImportDriver) -> None:
    part = Icm20948(setup(pose))
    sensor = make_sensor(part, clock, driver)
    mean, noise = statistics(lambda: sensor.acceleration, clock, 1.0 / 53.0)
    # 230 ug and 15 mdps per root of Hz, in 265 and in 229.8 Hz; the mean of 400 readings is good to a 20th,
    # their deviation to 15 % (4 sigma).
    assert mean / G == pytest.approx(true_force_g(part), abs=0.001)
    assert noise / G == pytest.approx([230e-6 * np.sqrt(265.0)] * 3, rel=0.15)
    mean, noise = np.degrees(statistics(lambda: sensor.gyro, clock, 1.0 / 100.0))
    assert mean == pytest.approx([0.0] * 3, abs=0.06)
    assert noise == pytest.approx([0.015 * np.sqrt(229.8)] * 3, rel=0.15)
    mean, noise = statistics(lambda: sensor.magnetic, clock, 1.0 / 95.0)
    assert mean == pytest.approx(COMPASS * true_field_ut(part), abs=0.1)
    assert noise == pytest.approx([0.3] * 3, rel=0.15)
    rate_dps = turn(part, clock)
    mean, _ = np.degrees(statistics(lambda: sensor.gyro, clock, 1.0 / 100.0))
    assert mean == pytest.approx(rate_dps, abs=0.06)
    assert sensor.data_ready()
    assert not sensor.data_ready()


@pytest.mark.parametrize(("acceleration", "rate"), [(2, 250), (4, 500), (8, 1000), (16, 2000)])
def test_icm20948_has_the_driver_s_ranges(
    clock: DriverClock, driver: ImportDriver, acceleration: int, rate: int
) -> None:
    adafruit, part = driver("adafruit_icm20x"), Icm20948(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.accelerometer_range = getattr(adafruit.AccelRange, f"RANGE_{acceleration}G")
    sensor.gyro_range = getattr(adafruit.GyroRange, f"RANGE_{rate}_DPS")
    rate_dps = turn(part, clock)
    mean, _ = np.degrees(statistics(lambda: sensor.gyro, clock, 1.0 / 100.0))
    assert mean == pytest.approx(rate_dps, abs=0.06)
    mean, _ = statistics(lambda: sensor.acceleration, clock, 1.0 / 53.0)
    assert mean / G == pytest.approx(true_force_g(part), abs=0.001)


@pytest.mark.parametrize(("accelerometer_hz", "gyroscope_hz"), [(1125, 1100), (225, 220), (53, 100), (4.5, 4.4)])
def test_icm20948_has_the_driver_s_rates(
    clock: DriverClock, driver: ImportDriver, accelerometer_hz: float, gyroscope_hz: float
) -> None:
    part = Icm20948(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.accelerometer_data_rate, sensor.gyro_data_rate = accelerometer_hz, gyroscope_hz
    for output, asked_hz, got_hz in (
        (ACCELEROMETER, accelerometer_hz, sensor.accelerometer_data_rate),
        (GYROSCOPE, gyroscope_hz, sensor.gyro_data_rate),
    ):
        assert got_hz == pytest.approx(asked_hz, rel=0.02)  # half a step of the divisor 21
        assert samples_per_s(part, clock, output) == pytest.approx(got_hz, abs=1.0)


def test_icm20948_filters_noise_as_the_driver_sets(clock: DriverClock, driver: ImportDriver) -> None:
    adafruit, part = driver("adafruit_icm20x"), Icm20948(setup())
    sensor = make_sensor(part, clock, driver)
    for accelerometer, accelerometer_hz, gyroscope, gyroscope_hz in (
        ("FREQ_11_5HZ_3DB", 17.0, "FREQ_51_2HZ_3DB", 73.3),
        ("DISABLED", 1248.0, "DISABLED", 12316.0),
    ):
        sensor.accel_dlpf_cutoff = getattr(adafruit.AccelDLPFFreq, accelerometer)
        sensor.gyro_dlpf_cutoff = getattr(adafruit.GyroDLPFFreq, gyroscope)
        clock.sleep(0.5)
        _, noise = statistics(lambda: sensor.acceleration, clock, 1.0 / 53.0)
        assert noise / G == pytest.approx([230e-6 * np.sqrt(accelerometer_hz)] * 3, rel=0.15)
        _, noise = np.degrees(statistics(lambda: sensor.gyro, clock, 1.0 / 100.0))
        assert noise == pytest.approx([0.015 * np.sqrt(gyroscope_hz)] * 3, rel=0.15)


@pytest.mark.parametrize(
    ("name", "rate_hz"), [("SHUTDOWN", 0), ("RATE_10HZ", 10), ("RATE_20HZ", 20), ("RATE_50HZ", 50), ("RATE_100HZ", 100)]
)
def test_icm20948_passes_the_magnetometer_s_rate_on(
    clock: DriverClock, driver: ImportDriver, name: str, rate_hz: int
) -> None:
    adafruit, part = driver("adafruit_icm20x"), Icm20948(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.magnetometer_data_rate = getattr(adafruit.MagDataRate, name)
    assert sensor._read_mag_register(0x31) == getattr(adafruit.MagDataRate, name)
    assert samples_per_s(part.companions[0], clock) == rate_hz


def test_icm20948_measures_the_field_once(clock: DriverClock, driver: ImportDriver) -> None:
    adafruit, part = driver("adafruit_icm20x"), Icm20948(setup())
    sensor = make_sensor(part, clock, driver)
    sensor.magnetometer_data_rate = adafruit.MagDataRate.SINGLE
    assert sensor._read_mag_register(0x31) == 0  # the driver's waits are longer than the measurement
    before = sensor.magnetic
    clock.sleep(1.0)
    assert sensor.magnetic == before
    assert before == pytest.approx(COMPASS * true_field_ut(part), abs=1.5)  # 5 sigma


def test_icm20948_magnetometer_reports_its_overflow(clock: DriverClock, driver: ImportDriver) -> None:
    for x_ut, status in ((4700.0, 0), (4890.0, 8)):
        part = Icm20948(setup(distortion=MagneticDistortion(hard_iron_ut=(x_ut, 0.0, 0.0))))
        sensor = make_sensor(part, clock, driver)
        clock.sleep(0.1)
        sensor._bank = 0
        assert sensor._raw_mag_data[3] >> 8 == status  # HOFL: |x| + |y| + |z| of 4912 uT


def test_icm20948_master_reports_a_slave_that_does_not_answer(clock: DriverClock, driver: ImportDriver) -> None:
    part = Icm20948(setup())
    sensor = make_sensor(part, clock, driver)
    sensor._read_mag_register(0x01, 0x0E)
    write(part, clock.now_s, 0x7F, 0x30)
    write(part, clock.now_s, 0x13, 0x8E, 0x01, 0x80)
    write(part, clock.now_s, 0x7F, 0x00)
    assert read(part, clock.now_s, 0x17, 1) == b"\x50"
    assert read(part, clock.now_s, 0x17, 1) == b"\0"


def test_icm20948_magnetometer_is_on_the_bus_by_the_bypass_only(clock: DriverClock, driver: ImportDriver) -> None:
    part = Icm20948(setup())
    sensor, bus = make_sensor(part, clock, driver), DriverI2c([part, *part.companions], clock)
    identification = bytearray(2)
    with pytest.raises(OSError, match="0x0c"):
        bus.writeto_then_readfrom(0x0C, b"\0", identification)
    sensor._bank = 0
    sensor._i2c_master_enable = False
    sensor._bypass_i2c_master = True
    bus.writeto_then_readfrom(0x0C, b"\0", identification)
    assert identification == b"\x48\x09"
    sensor.reset()
    with pytest.raises(OSError, match="0x0c"):
        bus.writeto_then_readfrom(0x0C, b"\0", identification)


def test_icm20948_pin_pulses_or_waits_for_the_status(clock: DriverClock, driver: ImportDriver) -> None:
    part = Icm20948(setup())
    make_sensor(part, clock, driver)
    output = part.outputs[GYROSCOPE]
    write(part, clock.now_s, 0x7F, 0x00)
    write(part, clock.now_s, 0x11, 0x01)
    write(part, clock.now_s, 0x07, 0x38)  # the gyroscope alone
    sample_s = output.next_sample_s(clock.now_s + 0.1)
    assert [part.interrupt_levels(sample_s + after_s) for after_s in (1e-6, 60e-6)] == [(True,), (False,)]
    assert part.next_interrupt_s(sample_s + 1e-6) == pytest.approx(sample_s + 50e-6)
    write(part, sample_s, 0x0F, 0xA0)
    assert part.interrupt_levels(sample_s + 60e-6) == (False,)  # active low
    assert read(part, sample_s + 70e-6, 0x1A, 1) == b"\x01"
    assert part.interrupt_levels(sample_s + 80e-6) == (True,)


def test_icm20948_temperature_is_zero_at_21_degrees() -> None:
    part = Icm20948(setup(temperature_degc=31.0))
    assert read(part, 0.1, 0x39, 2) == b"\0\0"  # asleep
    write(part, 0.1, 0x06, 0x01)
    assert read(part, 0.1, 0x39, 2) == round(3338.7).to_bytes(2, "big")
