"""The table of the sensors' registers says of each model what it stores, and what it carries out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.measurement.sensor_registers import Bits, Register, Setting, names_setting, registers_of
from hiltest.world import EarthField, MagneticDistortion, World
from hiltest.world.sensors import Fxas21002c, Fxos8700cq, Mag3110, RegisterDevice

from .bus_master import read, write

WORLD = partial(World, EarthField(48.5, 62.0))
DISTORTION = MagneticDistortion(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (3.0, -2.0, 5.0))
PARTS: dict[str, Callable[[], RegisterDevice]] = {
    "MAG3110": lambda: Mag3110(WORLD(), DISTORTION, seed=1),
    "FXOS8700CQ": lambda: Fxos8700cq(WORLD(), DISTORTION, seed=1),
    "FXAS21002C": lambda: Fxas21002c(WORLD(), seed=1, bias_dps=(1.0, -2.0, 3.0)),
}
# The registers with which the packaged firmware makes a part measure; the last one ends standby.
RUNNING = {
    "MAG3110": {0x11: 0xA0, 0x10: 0x01},
    "FXOS8700CQ": {0x0E: 0x01, 0x2B: 0x02, 0x5B: 0x1F, 0x5C: 0x00, 0x2A: 0x0D},
    "FXAS21002C": {0x0D: 0x00, 0x15: 0x00, 0x13: 0x0A},
}
OUTPUTS = {"MAG3110": [0x01], "FXOS8700CQ": [0x01, 0x33], "FXAS21002C": [0x01]}


def assumed() -> Iterator[tuple[str, int, Register, Bits]]:
    """Yield the bits of which a model carries out one value only."""
    for part in PARTS:
        for address, row in registers_of(part).items():
            for bits in row.bits:
                if bits.modelled is not None and address in PARTS[part]().settings():
                    yield part, address, row, bits


ASSUMED = list(assumed())


@given(st.sampled_from(sorted(PARTS)), st.integers(0, 255), st.integers(0, 255))
def test_every_register_that_firmware_can_write_is_in_the_table(part: str, address: int, value: int) -> None:
    device, rows = PARTS[part](), registers_of(part)
    before = device.settings()
    acknowledged = write(device, 0.1, address, value)
    after = device.settings()
    assert after.keys() <= rows.keys()
    assert {changed for changed in after if after[changed] != before[changed]} <= {address}
    if acknowledged and address in rows and rows[address].is_setting:
        mask = sum(bits.mask for bits in rows[address].bits)
        assert after[address] & mask == value & mask


@pytest.mark.parametrize("part", PARTS)
def test_settings_of_a_sample_are_known_after_they_are_changed_back(part: str) -> None:
    device, (*others, last) = PARTS[part](), RUNNING[part].items()
    for address, value in (*others, last):
        write(device, 0.1, address, value)
    settings = device.settings()
    assert device.sampled_settings() == settings
    for output in OUTPUTS[part]:
        read(device, 0.5, output, 6)
    write(device, 0.6, last[0], 0)
    assert device.settings() != settings
    assert device.sampled_settings() == settings


@pytest.mark.parametrize("part", PARTS)
def test_reading_the_settings_changes_nothing(part: str) -> None:
    device, other = PARTS[part](), PARTS[part]()
    for address, value in RUNNING[part].items():
        write(device, 0.1, address, value)
        write(other, 0.1, address, value)
    device.settings()
    assert read(device, 1.0, 0x00, 7) == read(other, 1.0, 0x00, 7)


@pytest.mark.parametrize(("part", "address", "row", "bits"), ASSUMED)
def test_bits_that_are_not_modelled_change_no_sample_and_are_named(
    part: str, address: int, row: Register, bits: Bits
) -> None:
    samples = []
    setting = Setting(part, row.name, 0)
    for flipped in (0, bits.mask):
        device = PARTS[part]()
        registers = {address: 0, **RUNNING[part]}
        registers[address] ^= flipped
        for register, value in registers.items():
            write(device, 0.1, register, value)
        setting = Setting(part, row.name, device.settings()[address])
        assert bool(setting.not_modelled) is bool(flipped)
        samples.append([read(device, 1.0, output, 6) for output in OUTPUTS[part]])
    assert samples[0] == samples[1]
    assert any(map(any, samples[0]))
    assert bits.meaning in setting.not_modelled
    assert Setting(part, row.name, setting.as_modelled).not_modelled == ""


def test_the_bits_of_a_function_without_a_model_can_be_fewer_than_all() -> None:
    assert Setting("FXOS8700CQ", "0x5D", 0xF8).not_modelled == ""
    assert "self-test of the magnetometer is set" in Setting("FXOS8700CQ", "0x5D", 0x04).not_modelled


def test_a_change_is_named_by_the_meaning_of_its_bits() -> None:
    change = Setting("onboard-FXOS8700CQ", "M_CTRL_REG1", 0x03).describe_change(0x1F)
    assert change == "onboard-FXOS8700CQ M_CTRL_REG1 0x03, was 0x1F: oversampling"
    both = Setting("FXAS21002C", "CTRL_REG0", 0x84).describe_change(0x00)
    assert both == "FXAS21002C CTRL_REG0 0x84, was 0x00: high-pass filter, low-pass filter"
    assert Setting("MPU6050", "0x1B", 0x08).describe_change(0x00) == "MPU6050 0x1B 0x08, was 0x00"


@pytest.mark.parametrize(
    ("text", "known"),
    [
        ("FXAS21002C CTRL_REG0 0x04", True),
        ("onboard-FXOS8700CQ CTRL_REG1 0x09", True),
        ("FXOS8700CQ 0x15 0x78", True),
        ("FXAS21002C CTRL_REG9 0x04", False),
        ("MPU6050 CTRL_REG0 0x04", False),
        ("FXAS21002C CTRL_REG0 4", False),
        ("FXAS21002C CTRL_REG0", False),
    ],
)
def test_a_setting_is_accepted_by_the_name_that_a_run_gives_it(text: str, known: bool) -> None:
    assert names_setting(text) is known
