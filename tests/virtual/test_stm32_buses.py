"""Buses, pins' interrupts, DMA and flash of the STM32F411, by their registers."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.board.described_machine import DescribedMachine
from hiltest.virtual.core.machine import RefusedAccess
from hiltest.virtual.part.machine_file import load_machine
from hiltest.virtual.peripherals.i2c_bus import HeldLine
from hiltest.virtual.program.elf import load_image
from hiltest.world import EarthField, World
from hiltest.world.sensors import SensorSetup
from hiltest.world.sensors.lis3mdl import Lis3mdl
from hiltest.world.sensors.lsm303agr_m import Lsm303agrM

FLASH, SRAM = 0x08000000, 0x20000000
RCC, I2C1 = 0x40023800, 0x40005400
# Vector table of a program that waits in a loop: stack, reset, and further vectors that no test takes.
LOOP = struct.pack("<102I", SRAM + 0x20000, *[FLASH + 0x199] * 101) + struct.pack("<H", 0xE7FE)
CR1, CR2, DR, SR1, SR2, CCR = (I2C1 + offset for offset in (0x00, 0x04, 0x10, 0x14, 0x18, 0x1C))
PE, START, STOP, ACK, POS = 1, 1 << 8, 1 << 9, 1 << 10, 1 << 11
SB, ADDR, BTF, RXNE, TXE, ARLO, AF = 1, 2, 4, 1 << 6, 1 << 7, 1 << 9, 1 << 10
EVENT, ERROR = 31, 32
MAGNETOMETER, OFFSETS, IDENTITY = 0x1E, 0x45, 0x4F


class Chip:
    """A chip whose registers a test accesses, as a debugger does; its core runs at 16 MHz.

    Attributes
    ----------
    board : DescribedMachine
    """

    def __init__(self) -> None:
        self.part = Lsm303agrM(SensorSetup(World(EarthField(48.5, 62.0))))
        self.far = Lis3mdl(SensorSetup(World(EarthField(48.5, 62.0))))
        self.board = DescribedMachine(
            "stm32f411-disco", load_image(LOOP, base=FLASH), i2c={"i2c1": [self.part]}, spi={"spi1": {"PE3": self.far}}
        )
        self.board.boot()
        self.board.run_until(0.02)  # the part boots
        for gates, bits in ((0x30, 0x60009F), (0x40, 0x220001), (0x44, 0x5000)):
            self[RCC + gates] = bits

    def __setitem__(self, address: int, value: int) -> None:
        self.board.bus.write(address, 4, value)

    def __getitem__(self, address: int) -> int:
        return self.board.bus.read(address, 4)

    def wait_us(self, us: float) -> None:
        self.board.run_until(self.board.time_s + 1e-6 * us)

    def interrupts(self) -> set[int]:
        """Return the external interrupts whose lines are driven."""
        return {number for number in range(86) if self.board.processor.nvic.is_driven(number)}

    def unmodelled(self) -> str:
        return "\n".join(map(str, self.board.unmodelled))


@pytest.fixture
def chip() -> Iterator[Chip]:
    return Chip()


class Master:
    """I2C1 at 100 kHz, as a driver uses it that polls flags."""

    def __init__(self, chip: Chip) -> None:
        self.chip = chip
        chip[CCR] = 80
        chip[CR1] = PE

    def wait(self, flags: int) -> None:
        """Wait until a flag is set, at most 1 ms."""
        for _ in range(100):
            if self.chip[SR1] & flags:
                return
            self.chip.wait_us(10)
        raise AssertionError(f"SR1 is {self.chip[SR1]:#x}, without {flags:#x}")

    def address(self, byte: int, control: int = 0) -> None:
        self.chip[CR1] = PE | START | control
        self.wait(SB)
        self.chip[DR] = byte
        self.wait(ADDR | AF)

    def write(self, *values: int, stops: bool = True) -> None:
        self.address(MAGNETOMETER << 1)
        assert self.chip[SR2] == 7  # busy master that transmits
        for value in values:
            self.wait(TXE)
            self.chip[DR] = value
        self.wait(BTF)
        if stops:
            self.stop()

    def stop(self) -> None:
        self.chip[CR1] |= STOP
        self.chip.wait_us(20)

    def read_one(self) -> bytes:
        chip = self.chip
        self.address(MAGNETOMETER << 1 | 1)
        assert chip[SR2] == 3  # busy master that receives
        chip[CR1] |= STOP
        self.wait(RXNE)
        return bytes([chip[DR]])

    def read_two(self, *, before_address: bool) -> bytes:
        """Read two bytes with POS, whose ACK is cleared before or after ADDR is."""
        chip = self.chip
        self.address(MAGNETOMETER << 1 | 1, ACK | POS)
        if before_address:
            chip[CR1] = PE | POS
        assert chip[SR2] == 3
        chip[CR1] = PE | POS
        self.wait(BTF)
        chip[CR1] |= STOP
        return bytes([chip[DR], chip[DR]])

    def read_many(self, count: int) -> bytes:
        chip = self.chip
        self.address(MAGNETOMETER << 1 | 1, ACK)
        assert chip[SR2] == 3
        values = []
        while count - len(values) > 3:
            self.wait(RXNE)
            values.append(chip[DR])
        self.wait(BTF)
        chip[CR1] &= ~ACK
        values.append(chip[DR])
        chip[CR1] |= STOP
        values.append(chip[DR])
        self.wait(RXNE)
        return bytes([*values, chip[DR]])


READS: dict[int, Callable[[Master], bytes]] = {
    1: Master.read_one,
    2: lambda master: master.read_two(before_address=False),
    -2: lambda master: master.read_two(before_address=True),
    3: lambda master: master.read_many(3),
    6: lambda master: master.read_many(6),
}


@pytest.mark.parametrize("count", READS)
def test_bytes_that_were_written_to_a_sensor_are_read_back_by_the_procedure_for_their_number(
    chip: Chip, count: int
) -> None:
    master = Master(chip)
    offsets = bytes(range(0x11, 0x17))
    master.write(OFFSETS | 0x80, *offsets)
    assert chip[SR2] == 0
    master.write(OFFSETS | 0x80, stops=False)
    assert READS[count](master) == offsets[: abs(count)]
    chip.wait_us(20)
    assert (chip[SR1], chip[SR2], chip[CR1] & STOP) == (0, 0, 0)
    assert READS[1](master) != b""  # the bus is free: the part gave up SDA after the byte without acknowledge


def test_an_address_that_no_part_has_is_not_acknowledged_and_the_error_interrupts(chip: Chip) -> None:
    master = Master(chip)
    chip[CR2] = 1 << 8
    master.address(0x42)
    assert (chip[SR1], chip[SR2] & 3, chip.interrupts()) == (AF, 3, {ERROR})
    chip[SR1] = 0
    assert chip.interrupts() == set()
    master.stop()
    assert chip[SR2] == 0


def test_events_interrupt_and_those_of_buffers_only_with_their_own_enable(chip: Chip) -> None:
    master = Master(chip)
    chip[CR2] = 1 << 9
    master.address(MAGNETOMETER << 1)
    assert chip.interrupts() == {EVENT}
    assert chip[SR2] & 2
    assert (chip[SR1], chip.interrupts()) == (TXE, set())
    chip[CR2] |= 1 << 10
    assert chip.interrupts() == {EVENT}


@pytest.mark.parametrize(("ccr", "us"), [(80, 90), (0x8000 | 40, 67.5), (0xC000 | 5, 70.3)])
def test_a_byte_takes_nine_clocks_of_the_configured_rate(chip: Chip, ccr: int, us: float) -> None:
    master = Master(chip)
    chip[CCR] = ccr
    master.address(MAGNETOMETER << 1)
    assert chip[SR2] == 7
    chip[DR] = IDENTITY
    chip.wait_us(us - 1)
    assert not chip[SR1] & BTF
    chip.wait_us(2)
    assert chip[SR1] & BTF


def test_a_held_data_line_is_busy_and_takes_the_arbitration(chip: Chip) -> None:
    master = Master(chip)
    master.address(MAGNETOMETER << 1)
    assert chip[SR2] == 7
    chip.board.hold_line(1, HeldLine("sda", chip.board.time_s, chip.board.time_s + 0.01))
    chip[DR] = IDENTITY
    master.wait(ARLO)
    assert chip[SR2] == 2  # busy, and no longer master
    chip.wait_us(10_000)
    assert chip[SR2] == 0
    chip[SR1] = 0
    master.write(IDENTITY, stops=False)
    assert master.read_one() == b"\x40"


def test_a_held_clock_delays_a_byte(chip: Chip) -> None:
    master = Master(chip)
    master.address(MAGNETOMETER << 1)
    assert chip[SR2] == 7
    chip.board.hold_line(1, HeldLine("scl", chip.board.time_s, chip.board.time_s + 0.001))
    chip[DR] = IDENTITY
    chip.wait_us(990)
    assert not chip[SR1] & BTF
    chip.wait_us(20)
    assert chip[SR1] & BTF


def test_modes_of_i2c_without_a_model_are_named(chip: Chip) -> None:
    chip[CR1] = 2
    chip[CR2] = 1 << 11
    chip[I2C1 + 8] = 0x42
    assert [line.split(" ")[0] for line in chip.unmodelled().splitlines()] == ["I2C1_CR1", "I2C1_CR2", "I2C1_OAR1"]


def test_a_bus_that_the_chip_does_not_have_is_refused() -> None:
    part = Lsm303agrM(SensorSetup(World(EarthField(48.5, 62.0))))
    with pytest.raises(ConfigError, match=r"has no bus i2c0; known: i2c1, i2c2, i2c3, spi1"):
        DescribedMachine("stm32f411-disco", load_image(LOOP, base=FLASH), i2c={"i2c0": [part]})


# -- SPI -----------------------------------------------------------------------------------------------------------

SPI1, GPIOE = 0x40013000, 0x40021000
SPI_CR1, SPI_CR2, SPI_SR, SPI_DR = (SPI1 + 4 * word for word in range(4))
MASTER = 1 << 9 | 1 << 8 | 1 << 2  # SSM, SSI, MSTR: the fastest clock
ENABLED, SPI_RXNE, SPI_TXE, MODF, OVR, BSY = 1 << 6, 1, 2, 1 << 5, 1 << 6, 1 << 7


def select(chip: Chip, is_selected: bool) -> None:
    """Drive the chip select PE3 low or high."""
    chip[GPIOE] = chip[GPIOE] & ~0xC0 | 0x40
    chip[GPIOE + 0x18] = 1 << (19 if is_selected else 3)


def exchange(chip: Chip, frame: int, us: float = 2) -> int:
    chip[SPI_DR] = frame
    chip.wait_us(us)
    return chip[SPI_DR]


def test_a_selected_part_answers_with_its_identity(chip: Chip) -> None:
    chip[SPI_CR1] = MASTER | ENABLED
    assert [exchange(chip, value) for value in (0x8F, 0)] == [0xFF, 0xFF]  # nobody is selected
    select(chip, True)
    assert [exchange(chip, value) for value in (0x8F, 0)][1] == 0x3D
    select(chip, False)
    select(chip, True)
    chip[SPI_CR1] = MASTER | 1 << 11
    chip[SPI_CR1] |= ENABLED
    assert exchange(chip, 0x8F00) & 0xFF == 0x3D


@pytest.mark.parametrize(("rate", "us"), [(0, 1.0), (3, 8.0), (7, 128.0)])
def test_a_frame_takes_its_bits_and_is_busy_meanwhile(chip: Chip, rate: int, us: float) -> None:
    chip[SPI_CR1] = MASTER | rate << 3 | ENABLED
    chip[SPI_DR] = 0
    assert chip[SPI_SR] == SPI_TXE | BSY
    chip[SPI_DR] = 0
    assert chip[SPI_SR] == BSY
    chip.wait_us(us + 0.2)
    assert chip[SPI_SR] == SPI_TXE | BSY | SPI_RXNE
    chip.wait_us(us)
    assert chip[SPI_SR] == SPI_TXE | SPI_RXNE | OVR
    assert (chip[SPI_DR], chip[SPI_SR]) == (0xFF, SPI_TXE | OVR)  # DR and then SR clear the overrun
    assert chip[SPI_SR] == SPI_TXE


def test_a_master_whose_select_is_low_has_a_mode_fault(chip: Chip) -> None:
    chip[SPI_CR2] = 1 << 5
    chip[SPI_CR1] = 1 << 9 | 1 << 2
    assert (chip[SPI_CR1], chip.interrupts()) == (1 << 9, {35})
    assert chip[SPI_SR] & MODF
    chip[SPI_CR1] = MASTER
    assert (chip[SPI_SR], chip.interrupts()) == (SPI_TXE, set())


def test_dma_exchanges_the_bytes_of_an_spi_transfer(chip: Chip) -> None:
    dma2, receive, send = 0x40026400, 0x10, 0x10 + 3 * 0x18
    chip.board.processor.memory.write(SRAM, bytes([0x8F, 0, 0, 0, 9, 9]))
    chip[SPI_CR1] = MASTER | ENABLED
    select(chip, True)
    for stream, control, memory in ((receive, 1 << 10 | 1, SRAM + 4), (send, 1 << 10 | 1 << 6 | 1, SRAM)):
        chip[dma2 + stream + 4] = 2
        chip[dma2 + stream + 8] = SPI_DR
        chip[dma2 + stream + 12] = memory
        chip[dma2 + stream] = 3 << 25 | control
    chip[SPI_CR2] = 3
    chip.wait_us(10)
    assert chip.board.processor.memory.read(SRAM + 4, 2)[1] == 0x3D
    assert chip[dma2] == 1 << 5 | 1 << 4 | 1 << 27 | 1 << 26  # both streams are half and completely done


# -- DMA, pins, flash ------------------------------------------------------------------------------------------------

DMA1, STREAM2 = 0x40026000, 0x10 + 2 * 0x18


def test_a_copy_in_memory_takes_time_and_then_has_all_words(chip: Chip) -> None:
    words = list(range(0x1000, 0x1010))
    chip.board.processor.memory.write_words(SRAM, words)
    for offset, value in ((8, SRAM), (12, SRAM + 0x100), (4, len(words))):
        chip[DMA1 + STREAM2 + offset] = value
    chip[DMA1 + STREAM2] = 2 << 13 | 2 << 11 | 3 << 9 | 2 << 6 | 1 << 4 | 1
    assert chip.board.processor.memory.read_words(SRAM + 0x100, 1) == (0,)
    chip.wait_us(5)
    assert chip.board.processor.memory.read_words(SRAM + 0x100, 16) == tuple(words)
    assert (chip[DMA1] >> 16, chip.interrupts()) == (0x30, {13})


def test_a_transfer_from_where_nothing_is_ends_with_its_error(chip: Chip) -> None:
    for offset, value in ((8, 0x10000000), (12, SRAM), (4, 1)):
        chip[DMA1 + STREAM2 + offset] = value
    chip[DMA1 + STREAM2] = 2 << 6 | 1 << 2 | 1
    chip.wait_us(5)
    assert (chip[DMA1] >> 16, chip[DMA1 + STREAM2] & 1, chip.interrupts()) == (1 << 3, 0, {13})


EXTI, SYSCFG = 0x40013C00, 0x40013800


@pytest.mark.parametrize(("pin", "line", "interrupt"), [("PE2", 2, 8), ("PE5", 5, 23), ("PD15", 15, 40)])
def test_the_selected_edge_of_the_selected_pin_interrupts_until_it_is_cleared(
    chip: Chip, pin: str, line: int, interrupt: int
) -> None:
    port = ord(pin[1]) - ord("A")
    chip[SYSCFG + 8 + line // 4 * 4] = port << line % 4 * 4
    chip[EXTI + 0x08] = chip[EXTI] = 1 << line
    chip.board.drive(f"P{'BA'[port != 0]}{line}", True)  # the same number, another port
    assert chip.interrupts() == set()
    chip.board.drive(pin, True)
    assert (chip[EXTI + 0x14], chip.interrupts()) == (1 << line, {interrupt})
    chip[EXTI + 0x14] = 1 << line
    chip.board.drive(pin, False)
    assert (chip[EXTI + 0x14], chip.interrupts()) == (0, set())


def test_the_data_ready_pin_of_a_sensor_interrupts_at_each_sample(chip: Chip) -> None:
    chip.board.connect_interrupts("i2c1", chip.part, {"INT_MAG": "PE2"})
    chip[SYSCFG + 8] = 4 << 8
    chip[EXTI + 0x08] = chip[EXTI] = 1 << 2
    Master(chip).write(0x60 | 0x80, 0, 0, 1)  # 10 samples a second, and their signal on the pin
    chip.wait_us(200_000)
    assert chip.interrupts() == {8}


def test_a_store_of_another_size_than_that_of_the_controller_is_an_error_of_parallelism(chip: Chip) -> None:
    flash, program = 0x40023C00, chip.board.bus.store_in_flash
    assert program is not None
    for offset, value in ((4, 0x45670123), (4, 0xCDEF89AB), (0x10, 1 | 1 << 8)):
        chip[flash + offset] = value
    program(FLASH + 0x60000, 4, 0)
    assert chip[flash + 0x0C] == 1 << 6
    program(FLASH + 0x60002, 2, 0xABCD)
    assert chip.board.processor.memory.read_words(FLASH + 0x60000, 1) == (0xABCDFFFF,)


def test_a_machine_that_is_like_another_one_has_its_blocks_and_its_own(tmp_path: Path) -> None:
    stack_in_ccm = struct.pack("<I", 0x10010000) + LOOP[4:]
    board = DescribedMachine("stm32f407-disco", load_image(stack_in_ccm, base=FLASH))
    board.run_until(0.001)
    board.bus.write(RCC + 0x40, 4, 1 << 19)
    board.bus.write(0x40004C0C, 4, 1 << 13)
    assert board.bus.read(0x40004C0C, 4) == 1 << 13  # UART4, which only this one has
    assert board.bus.read(I2C1 + 0x20, 4) == 0  # I2C1 of the other one, without its clock
    with pytest.raises(RefusedAccess, match="where the chip has no peripheral"):
        board.bus.read(0x40013400, 4)  # SPI4, which only the other one has
    file = tmp_path / "mine.toml"
    file.write_text('like = "stm32f999"')
    with pytest.raises(ConfigError, match="like: no machine 'stm32f999' comes with hiltest; known: stm32f407-disco"):
        load_machine(str(file))
