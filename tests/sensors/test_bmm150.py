"""The BMM150 by the driver `bmm150` from PyPI, which compensates the raw words in floating-point numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.world import MagneticDistortion
from hiltest.world.sensors.bmm150 import Bmm150

from .bus_master import read, write
from .driver_bus import TILTED, DriverClock, DriverI2c, ImportDriver, setup, statistics, true_field_ut

ADDRESS = 0x13
CHIP_ID, RHALL, POWER, MODE, PINS, XYZ1_HIGH = 0x40, 0x48, 0x4B, 0x4C, 0x4E, 0x6D
STEPS_UT = np.array([0.363, 0.373, 0.336])  # of the raw words at 25 degC, by the trim: their rounding is noise as well
OVERFLOW = -32_768
FIRST_SAMPLE_S = 0.2  # after the last change of the settings, at the least rate of the presets


class DriverSmbus:
    """The methods of `smbus2.SMBus` that the driver calls."""

    def __init__(self, i2c: DriverI2c) -> None:
        self.i2c = i2c

    def read_i2c_block_data(self, address: int, register: int, count: int) -> list[int]:
        data = bytearray(count)
        self.i2c.writeto_then_readfrom(address, bytes([register]), data)
        return list(data)

    def read_byte_data(self, address: int, register: int) -> int:
        return self.read_i2c_block_data(address, register, 1)[0]

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        self.i2c.writeto(address, bytes([register, value]))


def make_sensor(part: Bmm150, clock: DriverClock, driver: ImportDriver, monkeypatch: pytest.MonkeyPatch, **options):
    """The driver, with one value put right: version 0.2.2 loses the upper byte of the trim value dig_xyz1 (it takes
    ``byte & 0x7F << 8``, in which the shift is first)."""
    bosch = driver("bmm150")
    monkeypatch.setattr("smbus2.SMBus", lambda _number: DriverSmbus(DriverI2c([part], clock)))
    sensor = bosch.BMM150(**options)
    sensor.trim_data.dig_xyz1 |= sensor.i2c_bus.read_byte_data(ADDRESS, XYZ1_HIGH) << 8
    clock.sleep(FIRST_SAMPLE_S)
    return sensor


@pytest.mark.parametrize(
    ("preset", "rate_hz", "noise_ut"),
    # Table of the presets; its figures are rounded, and those of the model follow from the repetitions.
    [
        ("LOWPOWER", 10.0, (1.0, 1.0, 1.4)),
        ("REGULAR", 10.0, (0.58, 0.58, 0.63)),
        ("ENHANCED", 10.0, (0.45, 0.45, 0.47)),
        ("HIGHACCURACY", 20.0, (0.25, 0.25, 0.27)),
    ],
)
@pytest.mark.parametrize("pose", [Pose(0.0), TILTED])
def test_bmm150_by_its_driver_in_all_presets(
    clock: DriverClock, driver: ImportDriver, monkeypatch: pytest.MonkeyPatch, pose, preset, rate_hz, noise_ut
) -> None:
    part = Bmm150(setup(pose, address=ADDRESS))
    sensor = make_sensor(part, clock, driver, monkeypatch, presetmode=driver("bmm150").PresetMode[preset])
    assert part.outputs[0].rate_hz == rate_hz
    mean_ut, deviation_ut = statistics(sensor.read_mag_data, clock, 1.0 / rate_hz)
    assert mean_ut == pytest.approx(true_field_ut(part), abs=0.3)  # 4 sigma of the mean of 400 readings
    assert deviation_ut == pytest.approx(np.hypot(noise_ut, STEPS_UT / math.sqrt(12)), rel=0.15)


@pytest.mark.parametrize("degc", [-20.0, 60.0])
def test_bmm150_s_words_drift_with_temperature_and_their_compensation_does_not(
    clock: DriverClock, driver: ImportDriver, monkeypatch: pytest.MonkeyPatch, degc: float
) -> None:
    part, at_25 = (Bmm150(setup(address=ADDRESS, temperature_degc=value)) for value in (degc, 25.0))
    raw = []
    for model in (part, at_25):
        sensor = make_sensor(model, clock, driver, monkeypatch, presetmode=driver("bmm150").PresetMode.HIGHACCURACY)
        mean_ut, _ = statistics(sensor.read_mag_data, clock, 0.05)
        assert mean_ut == pytest.approx(true_field_ut(model), abs=0.06)
        raw.append(statistics(sensor.read_raw_mag_data, clock, 0.05)[0])
    assert raw[0][3] - raw[1][3] == 10 * (degc - 25.0)
    assert abs(raw[0][2] / raw[1][2] - 1.0) > 0.02  # a firmware without compensation is wrong by so much


def test_bmm150_measures_once_in_forced_mode(
    clock: DriverClock, driver: ImportDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = Bmm150(setup(address=ADDRESS))
    sensor = make_sensor(part, clock, driver, monkeypatch)
    forced = driver("bmm150.bmm150_defs").PowerMode.FORCED
    before = sensor.read_mag_data()
    sensor.set_op_mode(forced)
    began_s = clock.now_s
    while not read(part, clock.now_s, RHALL, 1)[0] & 1:
        clock.sleep(1e-4)
    # 3 repetitions of each axis, by the formula of the fastest rate; the grid of the samples adds up to as much again.
    assert 2.9e-3 <= clock.now_s - began_s <= 6.0e-3
    assert sensor.read_mag_data() != before
    assert read(part, clock.now_s, MODE, 1)[0] & 0x06 == 0x06  # sleep mode
    assert not read(part, clock.now_s, RHALL, 1)[0] & 1


def test_bmm150_reads_zero_and_ignores_settings_in_suspend_mode(
    clock: DriverClock, driver: ImportDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = Bmm150(setup(address=ADDRESS))
    assert read(part, 0.1, CHIP_ID, 1) == b"\0"
    write(part, 0.1, PINS, 0x80)
    write(part, 0.1, POWER, 1)
    assert read(part, 0.2, CHIP_ID, 1) == b"\x32"
    assert read(part, 0.2, MODE, 1) == b"\x06"
    assert read(part, 0.2, PINS, 1) == b"\x07"
    sensor = make_sensor(part, clock, driver, monkeypatch)
    sensor.set_op_mode(driver("bmm150.bmm150_defs").PowerMode.SUSPEND)
    assert part.outputs[0].next_sample_s(clock.now_s) == math.inf
    sensor.soft_reset()
    assert read(part, clock.now_s, CHIP_ID, 1) == b"\x32"


def test_bmm150_s_data_ready_pin_follows_its_samples(
    clock: DriverClock, driver: ImportDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = Bmm150(setup(address=ADDRESS))
    sensor = make_sensor(part, clock, driver, monkeypatch)
    assert part.interrupt_levels(clock.now_s) == (False, False)
    write(part, clock.now_s, PINS, 0x87)
    assert part.interrupt_levels(clock.now_s) == (False, True)
    sensor.read_mag_data()
    assert part.interrupt_levels(clock.now_s) == (False, False)
    write(part, clock.now_s, PINS, 0x83)  # active low
    assert part.interrupt_levels(clock.now_s) == (False, True)


def test_bmm150_reports_a_field_beyond_its_words(
    clock: DriverClock, driver: ImportDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    strong = MagneticDistortion(hard_iron_ut=(2000.0, -2000.0, 2000.0))
    part = Bmm150(setup(Pose(0.0), address=ADDRESS, distortion=strong))
    sensor = make_sensor(part, clock, driver, monkeypatch)
    x_ut, y_ut, z_ut = sensor.read_mag_data()
    assert (x_ut, y_ut) == (OVERFLOW, OVERFLOW)
    assert z_ut == pytest.approx(2000.0 + true_field_ut(part)[2], abs=7.0)  # 5 sigma
