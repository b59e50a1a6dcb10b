"""The LSM303AGR's two dies by Adafruit's drivers, unmodified."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world.sensors.lsm303agr_a import Lsm303agrA

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
)

STEP_UT = 0.15
G = 9.80665
POSES = [TILTED, Pose(310.0, -35.0, 150.0)]


@pytest.fixture(params=POSES)
def part(request) -> Lsm303agrA:
    return Lsm303agrA(setup(request.param))


def bus(part: Lsm303agrA, clock: DriverClock) -> DriverI2c:
    return DriverI2c([part, *part.companions], clock)


def test_lsm303agr_magnetometer_by_adafruit_s_driver(part, clock: DriverClock, driver: ImportDriver) -> None:
    adafruit = driver("adafruit_lsm303agr_mag")
    sensor = adafruit.LSM303AGR_Mag(bus(part, clock))
    assert sensor.data_rate == adafruit.DataRate.Rate_10_HZ
    sensor.data_rate = adafruit.DataRate.Rate_100_HZ
    clock.sleep(0.1)
    mean_ut, noise_ut = statistics(lambda: sensor.magnetic, clock, 1.0 / 100.0)
    # The mean of 400 readings is good to 0.02 uT; without the filter the noise is the root of 2 times 0.3 uT.
    assert mean_ut == pytest.approx(true_field_ut(part), abs=0.1)
    assert noise_ut == pytest.approx([0.3 * np.sqrt(2.0)] * 3, rel=0.15)
    sensor.x_offset, sensor.y_offset, sensor.z_offset = 15.0, -30.0, 45.0
    clock.sleep(0.1)
    mean_ut, _ = statistics(lambda: sensor.magnetic, clock, 1.0 / 100.0)
    assert mean_ut == pytest.approx(true_field_ut(part) - [15.0, -30.0, 45.0], abs=0.1)


@pytest.mark.parametrize(("code", "rate_hz"), [(0, 10), (1, 20), (2, 50), (3, 100)])
def test_lsm303agr_magnetometer_has_the_driver_s_rates(
    clock: DriverClock, driver: ImportDriver, code: int, rate_hz: int
) -> None:
    part = Lsm303agrA(setup())
    sensor = driver("adafruit_lsm303agr_mag").LSM303AGR_Mag(bus(part, clock))
    sensor.data_rate = code
    assert samples_per_s(part.companions[0], clock) == rate_hz


def test_lsm303agr_latches_a_field_beyond_the_threshold(clock: DriverClock, driver: ImportDriver) -> None:
    part = Lsm303agrA(setup(Pose(0.0)))  # 22.8, 0 and 42.8 uT
    (magnetometer,) = part.companions
    sensor = driver("adafruit_lsm303agr_mag").LSM303AGR_Mag(bus(part, clock))
    sensor.interrupt_threshold = 30.0
    assert sensor.interrupt_threshold == pytest.approx(30.0, abs=STEP_UT)
    sensor.interrupt_enabled = True
    clock.sleep(0.3)
    assert magnetometer.interrupt_levels(clock.now_s) == (True,)
    x_high, *_, triggered = sensor.faults
    assert (x_high, triggered) == (False, True)
    assert sensor._int_source == 0x21  # z alone; it stays above the threshold
    sensor.interrupt_threshold = 10.0
    clock.sleep(0.3)
    assert sensor._int_source == 0xA1
    sensor.z_offset = 100.0
    sensor._int_iron_off = True
    clock.sleep(0.3)
    assert sensor._int_source == 0x85
    sensor.interrupt_threshold = 200.0
    sensor._int_source  # noqa: B018 - reading ends the latch
    assert sensor._int_source == 0
    assert magnetometer.interrupt_levels(clock.now_s) == (False,)


def test_lsm303agr_measures_the_field_once(part) -> None:
    (magnetometer,) = part.companions
    write(magnetometer, 0.1, 0x60, 0x01)
    assert read(magnetometer, 0.15, 0x67, 1) == b"\0"
    assert read(magnetometer, 0.35, 0x60, 1) == b"\x03"
    assert read(magnetometer, 0.35, 0x67, 1) == b"\x0f"


@pytest.mark.parametrize("mode", ["NORMAL", "HIGH_RESOLUTION", "LOW_POWER"])
@pytest.mark.parametrize("code", range(4))
def test_lsm303agr_accelerometer_by_adafruit_s_driver(
    part, clock: DriverClock, driver: ImportDriver, mode: str, code: int
) -> None:
    adafruit = driver("adafruit_lsm303_accel")
    sensor = adafruit.LSM303_Accel(bus(part, clock))
    sensor.data_rate = adafruit.Rate.RATE_400_HZ
    sensor.mode = getattr(adafruit.Mode, f"MODE_{mode}")
    sensor.range = code
    assert (sensor.range, sensor.tapped) == (code, False)
    clock.sleep(0.1)  # the first sample at high resolution takes seven periods
    mean, noise = statistics(lambda: sensor.acceleration, clock, 1.0 / 400.0)
    step_g = sensor._lsb_shift()[0] / 1000.0
    # Noise below a step does not average out its rounding.
    assert mean / G == pytest.approx(true_force_g(part), abs=max(0.001, 0.5 * step_g))
    if step_g < 0.003:
        assert noise / G == pytest.approx([np.hypot(0.003, step_g / np.sqrt(12.0))] * 3, rel=0.15)


@pytest.mark.parametrize(
    ("mode", "code", "rate_hz"),
    [(0, 2, 10), (0, 3, 25), (0, 4, 50), (0, 5, 100), (1, 6, 200), (1, 7, 400), (1, 9, 1344), (2, 8, 1620), (2, 0, 0)],
)
def test_lsm303agr_accelerometer_has_the_driver_s_rates(
    clock: DriverClock, driver: ImportDriver, mode: int, code: int, rate_hz: int
) -> None:
    part = Lsm303agrA(setup())
    sensor = driver("adafruit_lsm303_accel").LSM303_Accel(bus(part, clock))
    sensor.mode, sensor.data_rate = mode, code
    assert samples_per_s(part, clock) == rate_hz


def test_lsm303agr_temperature_has_four_counts_a_degree_and_is_off_at_first() -> None:
    part = Lsm303agrA(setup(temperature_degc=31.0))
    assert read(part, 0.5, 0x8C, 2) == b"\0\0"
    write(part, 0.5, 0x1F, 0xC0)
    assert read(part, 0.6, 0x8C, 2) == (24 << 6).to_bytes(2, "little")


def test_lsm303agr_pointer_moves_if_it_is_asked_to(part) -> None:
    assert read(part, 0.5, 0x20, 2) == b"\x07\x07"
    assert read(part, 0.5, 0xA0, 2) == b"\x07\x00"
