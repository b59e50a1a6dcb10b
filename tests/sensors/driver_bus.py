"""The bus objects that public drivers expect, in front of the parts of this project, with a virtual clock."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType

import numpy as np
import pytest

from hiltest.orientation.angles import Pose
from hiltest.virtual.peripherals.i2c_bus import I2cBus, I2cDevice
from hiltest.virtual.peripherals.spi_bus import SpiBus, SpiDevice
from hiltest.world import EarthField, Temperature, World
from hiltest.world.sensors import SensorSetup, TableSensor

FIELD = EarthField(48.5, 62.0)
TILTED = Pose(heading_deg=120.0, pitch_deg=25.0, roll_deg=-40.0)
READINGS = 400
ImportDriver = Callable[[str], ModuleType]
BIT_S = 2.5e-6  # fast mode, 400 kHz


class DriverClock:
    """The time of drivers and parts: it moves by the bits on the bus, and when a driver sleeps."""

    def __init__(self, start_s: float = 0.1) -> None:
        self.now_s = start_s

    def sleep(self, duration_s: float) -> None:
        self.now_s += max(duration_s, BIT_S)

    def byte_s(self) -> float:
        self.now_s += 9 * BIT_S
        return self.now_s


class DriverI2c:
    """The methods of `busio.I2C` that drivers call."""

    def __init__(self, parts: Sequence[I2cDevice], clock: DriverClock) -> None:
        self.bus = I2cBus(parts)
        self.clock = clock

    def try_lock(self) -> bool:
        return True

    def unlock(self) -> None:
        pass

    def writeto(self, address: int, buffer: bytes, *, start: int = 0, end: int | None = None) -> None:
        self._write(address, bytes(buffer)[start:end])
        self.bus.stop(self.clock.byte_s())

    def readfrom_into(self, address: int, buffer: bytearray, *, start: int = 0, end: int | None = None) -> None:
        self._address(address << 1 | 1)
        for index in range(*slice(start, end).indices(len(buffer))):
            buffer[index] = self.bus.read(self.clock.byte_s())
        self.bus.stop(self.clock.byte_s())

    def writeto_then_readfrom(
        self,
        address: int,
        out_buffer: bytes,
        in_buffer: bytearray,
        *,
        out_start: int = 0,
        out_end: int | None = None,
        in_start: int = 0,
        in_end: int | None = None,
    ) -> None:
        self._write(address, bytes(out_buffer)[out_start:out_end])
        self.readfrom_into(address, in_buffer, start=in_start, end=in_end)

    def _write(self, address: int, data: bytes) -> None:
        self._address(address << 1)
        for value in data:
            if not self.bus.write(value, self.clock.byte_s()):
                raise OSError(f"part 0x{address:02x} did not acknowledge 0x{value:02x}")

    def _address(self, byte: int) -> None:
        if not self.bus.address(byte, self.clock.byte_s()):
            raise OSError(f"no part acknowledges address 0x{byte >> 1:02x}")


class DriverSpi:
    """The methods of `busio.SPI` that drivers call."""

    def __init__(self, parts: Mapping[str, SpiDevice], clock: DriverClock) -> None:
        self.bus = SpiBus(parts)
        self.clock = clock

    def try_lock(self) -> bool:
        return True

    def unlock(self) -> None:
        pass

    def configure(self, **settings: int) -> None:
        assert settings["phase"] == settings["polarity"] == 1, "the parts of ST take bits at the rising edge"

    def write(self, buffer: bytes, *, start: int = 0, end: int | None = None) -> None:
        for value in bytes(buffer)[start:end]:
            self.bus.exchange(value, self.clock.byte_s())

    def readinto(self, buffer: bytearray, *, start: int = 0, end: int | None = None) -> None:
        for index in range(*slice(start, end).indices(len(buffer))):
            buffer[index] = self.bus.exchange(0, self.clock.byte_s())


class ChipSelect:
    """The attributes of `digitalio.DigitalInOut` that drivers set."""

    def __init__(self, spi: DriverSpi, pin: str) -> None:
        self._spi, self._pin = spi, pin

    def switch_to_output(self, value: bool) -> None:
        self.value = value

    @property
    def value(self) -> bool:
        return self._level

    @value.setter
    def value(self, high: bool) -> None:
        self._level = high
        self._spi.bus.set_select(self._pin, high, self._spi.clock.now_s)


def import_driver(
    name: str, clock: DriverClock, monkeypatch: pytest.MonkeyPatch, require_module: Callable[[str], None]
) -> ModuleType:
    """Import a driver, which then sleeps by the virtual clock."""
    require_module(name)
    monkeypatch.setattr(time, "sleep", clock.sleep)
    module = importlib.import_module(name)
    if hasattr(module, "sleep"):
        monkeypatch.setattr(module, "sleep", clock.sleep)
    return module


def setup(pose: Pose = TILTED, *, temperature_degc: float = 25.0, **truth) -> SensorSetup:
    return SensorSetup(World(FIELD, pose=pose, temperature=Temperature(temperature_degc)), seed=3, **truth)


def true_field_ut(part: TableSensor) -> np.ndarray:
    return np.array(part.setup.world.state_at(0.0).field_body_ut)


def statistics(read: Callable[[], tuple[float, float, float]], clock: DriverClock, period_s: float):
    """Mean and standard deviation of one reading per period."""
    readings = []
    for _ in range(READINGS):
        clock.sleep(period_s)
        readings.append(read())
    return np.mean(readings, axis=0), np.std(readings, axis=0)


def true_force_g(part: TableSensor) -> np.ndarray:
    """Force that holds the board, in g, which an accelerometer measures: up."""
    return -np.array(part.setup.world.state_at(0.0).gravity_body_g)


def samples_per_s(part: TableSensor, clock: DriverClock, output: int = 0) -> int:
    """Number of samples within a second, after a second to start."""
    clock.sleep(1.0)
    return part.outputs[output].latest(clock.now_s + 1.0) - part.outputs[output].latest(clock.now_s)


def turn(part: TableSensor, clock: DriverClock) -> np.ndarray:
    """Begin a long turn about the vertical at 30 deg/s; return the rate along the board's axes."""
    part.setup.world.turn_round(3600.0, rate_dps=30.0, time_s=clock.now_s)
    clock.sleep(1.0)
    return np.array(part.setup.world.state_at(clock.now_s).rate_body_dps)
