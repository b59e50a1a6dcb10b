"""Parts that a rig names: their place, their truth, and the sentences about mistakes in them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.errors import ConfigError
from hiltest.rig import Rig, build_world, world_truth
from hiltest.rig.rig import _conditions, conditions_sha256
from hiltest.rig.rig_file import load_rig, parse_rig
from hiltest.world.sensors.faulty_part import FaultyPart
from hiltest.world.sensors.lis3mdl import Lis3mdl

from ..parts_on_buses import parts_on_buses
from ..sensors.bus_master import read, write

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "text-compass.toml"
PTC5_IS_GPIO = 0x4004B014, 4, 1 << 8  # PORTC_PCR5
LIS3MDL = """
[[sensors.parts]]
part = "lis3mdl"
"""


def rig_with(tmp_path: Path, addition: str, *changes: tuple[str, str]) -> Rig:
    text = RIG.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    file = tmp_path / "rig.toml"
    file.write_text(text + addition)
    return load_rig(file)


def refusal(tmp_path: Path, addition: str, *changes: tuple[str, str]) -> tuple[str, str]:
    """The refused line of a rig, and the sentence."""
    with pytest.raises(ConfigError) as refused:
        rig_with(tmp_path, addition, *changes)
    place = re.match(r".*rig\.toml:(\d+): (.*)", str(refused.value))
    assert place, refused.value
    return (tmp_path / "rig.toml").read_text().splitlines()[int(place[1]) - 1], place[2]


def readings_ut(part, register: int, counts_per_ut: float, start_s: float = 0.1) -> np.ndarray:
    """One reading along the axes of the part."""
    data = read(part, start_s, register, 6)
    return np.frombuffer(data, "<i2") / counts_per_ut


def test_a_part_stands_beside_those_of_the_shield_with_its_own_truth(tmp_path: Path) -> None:
    axes = 'axes = ["-y", "-x", "z"]\nmagnetometer_noise_ut = 0.0\nmagnetometer_offset_ut = [10.0, 0.0, -5.0]\n'
    rig = rig_with(tmp_path, LIS3MDL + axes)
    assert set(rig.parts) == {"mag3110", "fxos8700cq", "fxas21002c", "onboard-fxos8700cq", "lis3mdl"}
    world = build_world(rig)
    parts = {part.address: part for part in parts_on_buses(rig, world, seed=1)["i2c1"]}
    assert sorted(parts) == [0x0E, 0x1C, 0x1E, 0x20]
    write(parts[0x1C], 0.05, 0x22, 0x00)
    x, y, z = readings_ut(parts[0x1C], 0x28, 68.42, 0.3)
    assert rig.world is not None
    field_ut = np.array(rig.world.soft_iron) @ world.state_at(0.3).field_body_ut + rig.world.hard_iron_ut
    assert [-y, -x, z] == pytest.approx(field_ut + np.array([10.0, 0.0, -5.0]), abs=0.01)  # a count is 0.015 uT


def test_a_part_can_be_the_magnetometer_under_test(tmp_path: Path) -> None:
    rig = rig_with(
        tmp_path,
        LIS3MDL + "magnetometer_offset_ut = [10.0, 0.0, -5.0]\n",
        ('magnetometer = "MAG3110"', 'magnetometer = "LIS3MDL"'),
    )
    assert rig.magnetometer_part == "lis3mdl"
    truth = world_truth(rig)
    assert truth is not None
    assert truth.hard_iron_counts == pytest.approx((124.0, -22.0, -10.0))  # 10 a microtesla
    noisy = ("magnetometer_noise_ut = 0.4 ", "magnetometer_noise_ut = 0.8 ")
    _, sentence = refusal(tmp_path, LIS3MDL, ('magnetometer = "MAG3110"', 'magnetometer = "LIS3MDL"'), noisy)
    assert "declares 0.8 uT, and the world has 0.35" in sentence


def test_two_parts_of_a_kind_have_names_and_noise_of_their_own(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, LIS3MDL + LIS3MDL + 'name = "second"\naddress = 0x1E\nbus = "i2c0"\n')
    sensors = parts_on_buses(rig, build_world(rig), seed=1)
    pair = [part for bus in ("i2c1", "i2c0") for part in sensors[bus] if isinstance(part, Lis3mdl)]
    assert [part.address for part in pair] == [0x1C, 0x1E]
    for part in pair:
        write(part, 0.05, 0x22, 0x00)
    first, second = (readings_ut(part, 0x28, 68.42, 0.3) for part in pair)
    assert first == pytest.approx(second, abs=6.0)  # 5 sigma of their difference in low-power mode
    assert all(first != second)


def test_the_sensor_of_a_named_part_has_its_name_before_its_own(tmp_path: Path) -> None:
    far = (
        '\n[[sensors.parts]]\npart = "lis3mdl"\nname = "far"\nbus = "i2c0"\nmagnetometer_offset_ut = [1.0, 0.0, 0.0]\n'
    )
    for name, part in (("LIS3MDL", "lis3mdl"), ("far LIS3MDL", "far")):
        rig = rig_with(tmp_path, LIS3MDL + far, ('magnetometer = "MAG3110"', f'magnetometer = "{name}"'))
        assert rig.magnetometer_part == part


def test_faults_of_a_named_part(tmp_path: Path) -> None:
    absent = '\n[faults]\nsensor = { part = "lis3mdl", fault = "absent", after_s = 1.0, for_s = 1.0 }\n'
    rig = rig_with(tmp_path, LIS3MDL + absent)
    part = parts_on_buses(rig, build_world(rig), seed=1)["i2c1"][-1]
    assert isinstance(part, FaultyPart)
    assert [part.start(True, time_s) for time_s in (0.5, 1.5, 2.5)] == [True, False, True]
    frozen = rig_with(tmp_path, LIS3MDL + absent.replace("absent", "frozen"))
    part = parts_on_buses(frozen, build_world(frozen), seed=1)["i2c1"][-1]
    write(part, 0.05, 0x22, 0x00)
    rows = [readings_ut(part, 0x28, 68.42, time_s).tolist() for time_s in (0.8, 1.15, 1.95, 2.5)]
    assert [row == rows[1] for row in rows] == [False, True, True, False]


def test_an_interrupt_pin_is_wired_to_the_processor(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, LIS3MDL + 'interrupts = { DRDY = "PTC5" }\n')
    bench = VirtualBench(rig)
    bench.power_on()
    bench.machine.bus.write(*PTC5_IS_GPIO)
    assert not bench.machine.level("PTC5")
    bench.write_sensor(1, 0x1C, 0x22, 0x00)  # continuous, 10 Hz
    bench.machine.run_until(bench.time_s + 0.25)
    assert bench.machine.level("PTC5")


class SpiMaster:
    """SPI0 of a bench, with its chip selects 0 and 1 on PTD0 and PTD4."""

    def __init__(self, bench: VirtualBench) -> None:
        self.bench, self.registers, self.spi = bench, bench.machine.bus, 0x4002C000
        self.registers.write(0x4004803C, 4, self.registers.read(0x4004803C, 4) | 1 << 12)  # SIM_SCGC6: SPI0
        for pin in (0, 4):
            self.registers.write(0x4004C000 + 4 * pin, 4, 2 << 8)  # PORTD_PCR: SPI0_PCS0, SPI0_PCS1
        self.registers.write(self.spi, 4, 1 << 31 | 3 << 16)  # MCR: master, chip selects low when active
        self.registers.write(self.spi + 0xC, 4, 7 << 27)  # CTAR0: bytes

    def read(self, select: int, register: int) -> list[int]:
        """Both received bytes of a read of a register."""
        for command in (1 << 31 | 1 << (16 + select) | 0x80 | register, 1 << (16 + select)):  # PUSHR
            self.registers.write(self.spi + 0x34, 4, command)
        self.bench.machine.run_until(self.bench.time_s + 1e-3)
        return [self.registers.read(self.spi + 0x38, 4) for _ in range(2)]


def test_a_part_on_spi_answers_to_its_chip_select_unless_it_is_absent(tmp_path: Path) -> None:
    absent = '\n[faults]\nsensor = { part = "lis3mdl", fault = "absent", for_s = 0.5 }\n'
    rig = rig_with(tmp_path, LIS3MDL + 'bus = "spi0"\nchip_select = "PTD0"\n' + absent)
    bench = VirtualBench(rig)
    bench.power_on()
    master = SpiMaster(bench)
    assert master.read(0, 0x0F) == [0xFF, 0xFF]
    bench.machine.run_until(0.8)
    assert master.read(0, 0x0F) == [0xFF, 0x3D]


SPI = 'bus = "spi0"\nchip_select = "PTD0"\n'


@pytest.mark.parametrize(
    ("name", "keys", "identities"),
    [
        ("lsm9ds1", 'companion_chip_select = "PTD4"\n', [0x68, 0x3D]),
        ("icm20948", "", [0xEA, 0xFF]),
    ],
)
def test_a_package_on_spi_answers_to_a_chip_select_of_each_device(
    tmp_path: Path, name: str, keys: str, identities: list[int]
) -> None:
    part = f'\n[[sensors.parts]]\npart = "{name}"\n{SPI}{keys}'
    bench = VirtualBench(rig_with(tmp_path, part))
    bench.power_on()
    master, register = SpiMaster(bench), 0x0F if name == "lsm9ds1" else 0x00
    assert [master.read(select, register)[1] for select in (0, 1)] == identities


def test_a_magnetometer_behind_a_part_on_spi_is_among_the_devices_of_the_bench(tmp_path: Path) -> None:
    bench = VirtualBench(rig_with(tmp_path, f'\n[[sensors.parts]]\npart = "icm20948"\n{SPI}'))
    device = bench._named["icm20948"]
    magnetometer = device.companions[0]
    write(magnetometer, 0.05, 0x31, 0x08)
    magnetometer.is_reachable = True
    write(magnetometer, 0.05, 0x31, 0x08)
    read(magnetometer, 0.5, 0x11, 6)
    assert bench.delivered_fields()["spi0:PTD0 AK09916"][0] == 1


def test_the_further_device_of_a_package_has_an_address_of_its_own(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, '\n[[sensors.parts]]\npart = "lsm9ds1"\nbus = "i2c0"\ncompanion_address = 0x1C\n')
    assert [part.address for part in parts_on_buses(rig, build_world(rig), 1)["i2c0"]] == [0x1D, 0x6B, 0x1C]


def test_the_mag3110_of_the_shield_can_be_wired(tmp_path: Path) -> None:
    wired = '\n[[sensors.parts]]\npart = "mag3110"\ninterrupts = { INT1 = "PTC5" }\n'
    rig = rig_with(tmp_path, wired)
    assert set(rig.parts) == {"mag3110", "fxos8700cq", "fxas21002c", "onboard-fxos8700cq"}
    bench, levels = VirtualBench(rig), set()
    bench.power_on()
    bench.machine.bus.write(*PTC5_IS_GPIO)
    for _ in range(50):  # the firmware reads samples at 80 Hz soon after they are ready
        bench.machine.run_until(bench.time_s + 0.5e-3)
        levels.add(bench.machine.level("PTC5"))
    assert levels == {False, True}


def test_keys_without_a_value_are_not_in_the_digest_of_a_rig_with_parts(tmp_path: Path) -> None:
    (part,) = _conditions(rig_with(tmp_path, LIS3MDL))["sensors"]["parts"]
    assert part == {"part": "lis3mdl", "bus": "i2c1", "interrupts": {}}


def test_a_rig_without_parts_keeps_its_digest(tmp_path: Path) -> None:
    assert conditions_sha256(rig_with(tmp_path, "")) == conditions_sha256(load_rig(RIG))
    assert conditions_sha256(rig_with(tmp_path, LIS3MDL)) != conditions_sha256(load_rig(RIG))


@pytest.mark.parametrize(
    ("addition", "changes", "line", "sentence"),
    [
        ('part = "lis3mld"', (), 'part = "lis3mld"', "no part 'lis3mld'; did you mean 'lis3mdl'?"),
        ('part = "lis3mdl"\nadress = 0x1C', (), "adress = 0x1C", "unknown key 'adress'"),
        (
            'part = "lis3mdl"\ninterrupts = { RDY = "PTB9" }',
            (),
            'interrupts = { RDY = "PTB9" }',
            "lis3mdl has no pin RDY; it has INT, DRDY",
        ),
        (
            'part = "lis3mdl"\naddress = 0x1E',
            (),
            "address = 0x1E",
            "lis3mdl and fxos8700cq have the same address 0x1e on i2c1",
        ),
        (
            'part = "lsm303agr"',
            (),
            "[[sensors.parts]]",
            "lsm303agr and fxos8700cq have the same address 0x1e on i2c1",
        ),
        (
            'part = "lis3mdl"\ninterrupts = { INT = "PTF9" }',
            (),
            'interrupts = { INT = "PTF9" }',
            "names no pin of the processor: PTF9; write PTA0 to PTE31",
        ),
        ('part = "lis3mdl"\naddress = 0x20', (), "address = 0x20", "lis3mdl answers at 0x1c or 0x1e only"),
        ('part = "lis3mdl"\nbus = "spi0"', (), "[[sensors.parts]]", "chip_select: belongs to a part on an SPI bus"),
        ('part = "fxas21002c"\naxes = ["x", "y", "z"]', (), 'axes = ["x", "y", "z"]', "is a key of [world] for"),
        ('part = "mag3110"\nbus = "spi0"\nchip_select = "PTD0"', (), 'bus = "spi0"', "mag3110 has a model for I2C"),
        (
            'part = "lis3mdl"\naccelerometer_noise_mg = 5.0',
            (),
            "accelerometer_noise_mg = 5.0",
            "lis3mdl measures magnetometer only",
        ),
        ('part = "qmc5883p"\nbus = "spi0"\nchip_select = "PTD0"', (), 'bus = "spi0"', "qmc5883p has I2C only"),
        ('part = "lsm303agr"\nbus = "spi0"\nchip_select = "PTD0"', (), 'bus = "spi0"', "lsm303agr has I2C only"),
        (
            'part = "lsm9ds1"\nbus = "spi0"\nchip_select = "PTD0"',
            (),
            "[[sensors.parts]]",
            "name the chip select of the LSM9DS1_M in this package",
        ),
        (
            'part = "icm20948"\nbus = "spi0"\nchip_select = "PTD0"\ncompanion_chip_select = "PTD4"',
            (),
            'companion_chip_select = "PTD4"',
            "icm20948 has no further device on an SPI bus",
        ),
        (
            'part = "lsm9ds1"\nbus = "spi0"\nchip_select = "PTD0"\ncompanion_chip_select = "PTD0"',
            (),
            'companion_chip_select = "PTD0"',
            "is the part's own chip_select",
        ),
        (
            'part = "lsm9ds1"\ncompanion_address = 0x1D',
            (),
            "companion_address = 0x1D",
            "the further device of lsm9ds1 answers at 0x1e or 0x1c only",
        ),
        ('part = "lis3mdl"\ncompanion_address = 0x1E', (), "companion_address = 0x1E", "lis3mdl is one device"),
        (
            'part = "lis3mdl"\ninterrupts = { DRDY = "PTB9" }',
            (),
            "[[sensors.parts]]",
            "lis3mdl and fxos8700cq are both wired to PTB9: use another pin",
        ),
        ('part = "lis3mdl"\n[[sensors.parts]]\npart = "lis3mdl"', (), "[[sensors.parts]]", "is the second part"),
        (
            'part = "lis3mdl"\n\n[faults]\nsensor = { part = "qmc5883p", fault = "frozen" }',
            (),
            'sensor = { part = "qmc5883p", fault = "frozen" }',
            "is none of",
        ),
    ],
)
def test_mistakes_are_refused_with_their_line(tmp_path: Path, addition: str, changes, line: str, sentence: str) -> None:
    refused_line, refused_sentence = refusal(tmp_path, f"\n[[sensors.parts]]\n{addition}\n", *changes)
    assert refused_line == line
    assert sentence in refused_sentence


@pytest.mark.parametrize(
    ("name", "pins", "addresses"),
    [
        ("lsm303agr", 'INT_1_XL = "PTC5", INT_MAG = "PTB9"', [0x0E, 0x19, 0x1E]),
        ("lsm6ds3trc", 'INT2 = "PTC5"', [0x0E, 0x6A]),
        ("lsm9ds1", '"INT1_A/G" = "PTC5", DRDY_M = "PTB9"', [0x0E, 0x1E, 0x6B]),
        ("icm20948", 'INT1 = "PTC5"', [0x0C, 0x0E, 0x69]),
    ],
)
def test_all_devices_of_a_package_are_on_the_bus(tmp_path: Path, name: str, pins: str, addresses: list[int]) -> None:
    part = f'\n[[sensors.parts]]\npart = "{name}"\ninterrupts = {{ {pins} }}\n'
    rig = rig_with(tmp_path, part, ("[world]\n", '[world]\nfitted = ["mag3110"]\n'))
    assert sorted(device.address for device in parts_on_buses(rig, build_world(rig), seed=1)["i2c1"]) == addresses
    VirtualBench(rig)  # it connects the pins of each device


def test_parts_are_of_a_virtual_board() -> None:
    real = RIG.with_name("frdm-k64f.toml")
    with pytest.raises(ConfigError, match=r'sensors\.parts: requires a board of kind "virtual"'):
        parse_rig(real, real.read_bytes() + LIS3MDL.encode())


def test_pins_are_those_of_the_rig_s_board() -> None:
    microbit = RIG.with_name("microbit-v1.toml")
    content = microbit.read_bytes()
    parse_rig(microbit, content)
    with pytest.raises(ConfigError, match=r"interrupts: names no pin of the processor: PTB9; write P0\.0 to P0\.31"):
        parse_rig(microbit, content.replace(b'"P0.29"', b'"PTB9"'))
