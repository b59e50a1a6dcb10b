"""The I3G4250D over SPI, as the sample compass on the STM32F411 Discovery reads it."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.world.sensors.i3g4250d import I3g4250d

from .bus_master import read, write
from .driver_bus import ChipSelect, DriverClock, DriverSpi, samples_per_s, setup, statistics, turn

READ, NEXT = 0x80, 0x40
OUT_X_L, CTRL_REG1, CTRL_REG4 = 0x28, 0x20, 0x23


class Spi:
    """Transfers to the part on a bus, one chip select each."""

    def __init__(self, part: I3g4250d, clock: DriverClock) -> None:
        self.spi = DriverSpi({"CS": part}, clock)
        self.select = ChipSelect(self.spi, "CS")

    def transfer(self, first: int, *data: int, count: int = 0) -> bytes:
        answer = bytearray(count)
        self.select.value = False
        self.spi.write(bytes([first, *data]))
        self.spi.readinto(answer)
        self.select.value = True
        return bytes(answer)

    def rate_dps(self, step_mdps: float) -> np.ndarray:
        return np.frombuffer(self.transfer(READ | NEXT | OUT_X_L, count=6), "<i2") * step_mdps * 1e-3


@pytest.fixture
def part() -> I3g4250d:
    return I3g4250d(setup(temperature_degc=31.0))


@pytest.fixture
def spi(part: I3g4250d, clock: DriverClock) -> Spi:
    return Spi(part, clock)


def test_it_answers_its_identity_and_sleeps_at_first(part: I3g4250d, spi: Spi, clock: DriverClock) -> None:
    assert spi.transfer(READ | 0x0F, count=1) == b"\xd3"
    assert spi.transfer(READ | CTRL_REG1, count=1) == b"\x07"
    clock.sleep(1.0)
    assert spi.transfer(READ | NEXT | 0x26, count=8) == bytes(8)


@pytest.mark.parametrize(("code", "step_mdps"), [(0, 8.75), (1, 17.5), (2, 70.0), (3, 70.0)])
def test_a_turn_is_read_at_every_full_scale(
    part: I3g4250d, spi: Spi, clock: DriverClock, code: int, step_mdps: float
) -> None:
    spi.transfer(NEXT | CTRL_REG1, 0x0F, 0x00, 0x00, code << 4, 0x02)
    rate_dps = turn(part, clock)
    mean_dps, noise_dps = statistics(lambda: tuple(spi.rate_dps(step_mdps)), clock, 1.0 / 105.0)
    # 30 mdps per root of Hz in 12.5 Hz are 0.106 dps; the mean of 400 readings is good to a 20th of that, and its
    # deviation to 15 % (4 sigma).
    assert mean_dps == pytest.approx(rate_dps, abs=0.025)
    assert noise_dps == pytest.approx([0.106] * 3, rel=0.15)


@pytest.mark.parametrize(("code", "rate_hz", "bandwidth_hz"), [(0, 105, 32), (1, 208, 54), (2, 420, 78), (3, 840, 93)])
def test_rates_and_the_bandwidth_of_the_first_filter(
    part: I3g4250d, spi: Spi, clock: DriverClock, code: int, rate_hz: int, bandwidth_hz: float
) -> None:
    spi.transfer(CTRL_REG1, code << 6 | 0x0F)
    assert samples_per_s(part, clock) == pytest.approx(rate_hz, abs=1)
    _, noise_dps = statistics(lambda: tuple(spi.rate_dps(8.75)), clock, 1.0 / rate_hz)
    assert noise_dps == pytest.approx([0.03 * np.sqrt(bandwidth_hz)] * 3, rel=0.15)


def test_the_pin_is_high_from_a_sample_until_it_is_read(part: I3g4250d, spi: Spi, clock: DriverClock) -> None:
    spi.transfer(NEXT | CTRL_REG1, 0x0F, 0x00, 0x28)
    assert part.interrupt_levels(clock.now_s) == (True, False)  # INT1 is active low and has no source
    clock.sleep(0.015)
    assert part.interrupt_levels(clock.now_s) == (True, True)
    spi.rate_dps(8.75)
    assert part.interrupt_levels(clock.now_s) == (True, False)


def test_the_temperature_falls_by_a_count_a_degree(part: I3g4250d) -> None:
    write(part, 0.1, CTRL_REG1, 0x0F)
    assert read(part, 0.3, 0x26, 1) == (-6 & 0xFF).to_bytes(1)


def test_the_pointer_moves_if_it_is_asked_to(part: I3g4250d, spi: Spi) -> None:
    assert read(part, 0.5, 0x0F, 2) == b"\xd3\xd3"
    spi.transfer(CTRL_REG4, 0x10)
    assert spi.transfer(READ | NEXT | 0x22, count=2) == b"\x00\x10"
    assert spi.transfer(READ | CTRL_REG4, count=2) == b"\x10\x10"
