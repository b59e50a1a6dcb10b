"""Blocks of the nRF51822: tasks, events, shortcuts and interrupts, by their registers."""

from __future__ import annotations

import struct

import pytest

from hiltest.boards.gdb_target import memory_description
from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.debug_access import DebugAccess
from hiltest.virtual.board.microbit_v1 import VirtualMicrobit
from hiltest.virtual.program.elf import load_image
from hiltest.world import EarthField, World
from hiltest.world.sensors import SensorSetup
from hiltest.world.sensors.mma8653 import Mma8653

CLOCK, UART, TWI, GPIOTE, TIMER0, RTC0, TEMP, RNG = (
    0x40000000 + 0x1000 * number for number in (0, 2, 3, 6, 8, 11, 12, 13)
)
NVMC, PPI, GPIO = 0x4001E000, 0x4001F000, 0x50000000
# Vector table of a program that waits in a loop: stack, reset, and further vectors that no test takes.
LOOP = struct.pack("<48I", 0x20004000, 0xC1, *[0xC1] * 46) + struct.pack("<H", 0xE7FE)


def program(*halfwords: int) -> bytes:
    """Return a program whose first instructions are given, and which then waits in a loop."""
    return LOOP[:-2] + struct.pack(f"<{len(halfwords)}H", *halfwords) + LOOP[-2:]


class Chip:
    """A chip whose registers a test accesses, as a debugger does.

    Attributes
    ----------
    board : VirtualMicrobit
    """

    def __init__(self, code: bytes = LOOP) -> None:
        part = Mma8653(SensorSetup(World(EarthField(48.5, 62.0))))
        self.board = VirtualMicrobit(load_image(code, base=0, core="cortex-m0"), i2c=[part])
        self.board.boot()

    def __setitem__(self, address: int, value: int) -> None:
        self.board.bus.write(address, 4, value)

    def __getitem__(self, address: int) -> int:
        return self.board.bus.read(address, 4)

    def wait_us(self, us: float) -> None:
        self.board.run_until(self.board.time_s + 1e-6 * us)

    def interrupts(self) -> set[int]:
        """Return the external interrupts whose lines are driven."""
        return {number for number in range(32) if self.board.processor.nvic.is_driven(number)}


@pytest.fixture
def chip() -> Chip:
    return Chip()


def test_a_timer_sets_its_event_at_the_count_and_interrupts_until_the_event_is_cleared(chip: Chip) -> None:
    chip[TIMER0 + 0x510] = 4  # 1 MHz
    chip[TIMER0 + 0x540] = 250
    chip[TIMER0 + 0x304] = 1 << 16
    chip[TIMER0] = 1
    chip.wait_us(249)
    assert (chip[TIMER0 + 0x140], chip.interrupts()) == (0, set())
    chip.wait_us(2)
    assert (chip[TIMER0 + 0x140], chip.interrupts()) == (1, {8})
    chip[TIMER0 + 0x140] = 0
    assert chip.interrupts() == set()
    chip[TIMER0 + 0x44] = 1  # capture
    assert chip[TIMER0 + 0x544] == 251


def test_a_shortcut_clears_a_timer_at_the_count_so_that_it_counts_periods_without_drift(chip: Chip) -> None:
    chip[TIMER0 + 0x510] = 0
    chip[TIMER0 + 0x508] = 3
    chip[TIMER0 + 0x540] = 16_000
    chip[TIMER0 + 0x200] = 1
    chip[TIMER0] = 1
    began = chip.board.cycles
    chip.wait_us(100_000 + 500)
    chip[TIMER0 + 0x44] = 1
    assert chip[TIMER0 + 0x544] == (chip.board.cycles - began) % 16_000


def test_a_timer_of_16_bits_wraps_and_one_that_is_stopped_keeps_its_count(chip: Chip) -> None:
    chip[TIMER0 + 0x510] = 4
    chip[TIMER0] = 1
    chip.wait_us(65_536 + 100)
    chip[TIMER0 + 0x04] = 1
    chip.wait_us(1000)
    chip[TIMER0 + 0x40] = 1
    assert chip[TIMER0 + 0x540] == pytest.approx(100, abs=1)


def test_the_ppi_starts_the_task_of_another_block_at_an_event(chip: Chip) -> None:
    chip[TIMER0 + 0x510], chip[TIMER0 + 0x540] = 4, 100
    chip[PPI + 0x510 + 8 * 3], chip[PPI + 0x514 + 8 * 3] = TIMER0 + 0x140, TEMP
    chip[PPI + 0x504] = 1 << 3
    chip[TIMER0] = 1
    chip.wait_us(120)
    assert chip[TEMP + 0x100] == 0
    chip.wait_us(20)
    assert (chip[TEMP + 0x100], chip[TEMP + 0x508]) == (1, 100)  # 25 degC in quarters


def test_channels_of_the_ppi_that_lead_to_each_other_end(chip: Chip) -> None:
    chip[GPIO + 0x700 + 4 * 3] = 0
    chip[GPIOTE + 0x510] = 3 | 3 << 8 | 3 << 16  # channel 0: task, P0.3, toggle
    chip[GPIOTE + 0x514] = 1 | 3 << 8 | 3 << 16  # channel 1: event of both edges of P0.3
    chip[PPI + 0x510], chip[PPI + 0x514], chip[PPI + 0x504] = GPIOTE + 0x104, GPIOTE, 1
    chip[GPIOTE] = 1
    assert chip[GPIOTE + 0x104] == 1


def test_the_real_time_counter_counts_the_slow_clock_behind_its_prescaler(chip: Chip) -> None:
    chip[RTC0 + 0x508] = 32  # 32768 / 33 Hz
    chip[RTC0 + 0x540], chip[RTC0 + 0x304] = 100, 1 << 16
    chip[RTC0] = 1
    chip.wait_us(100 * 33 / 32768 * 1e6 - 500)
    assert (chip[RTC0 + 0x504], chip.interrupts()) == (99, set())
    chip.wait_us(1000)
    assert (chip[RTC0 + 0x504], chip.interrupts()) == (100, {11})


def test_the_serial_port_has_the_rate_that_firmware_sets_and_buffers_six_bytes(chip: Chip) -> None:
    uart = chip.board.uart0
    chip[UART + 0x500], chip[UART + 0x524], chip[UART], chip[UART + 0x08] = 4, 0x01D7E000, 1, 1
    assert uart.baud == pytest.approx(115_200, rel=1e-3)
    chip[UART + 0x51C] = ord("H")
    chip.wait_us(80)
    assert (uart.host_waiting, chip[UART + 0x11C]) == (0, 0)
    chip.wait_us(10)
    assert (uart.host_read(10), chip[UART + 0x11C]) == (b"H", 1)
    uart.host_write(b"1234567")
    chip.wait_us(700)
    assert (chip[UART + 0x108], chip[UART + 0x124], chip[UART + 0x480]) == (1, 1, 1)  # the seventh is an overrun
    assert bytes(chip[UART + 0x518] for _ in range(6)) == b"123456"


def test_bytes_at_another_rate_than_the_line_are_damaged(chip: Chip) -> None:
    uart = chip.board.uart0
    chip[UART + 0x500], chip[UART + 0x524], chip[UART], chip[UART + 0x08] = 4, 0x00275000, 1, 1
    uart.host_write(b"A")
    chip[UART + 0x51C] = ord("H")
    chip.wait_us(2000)
    assert (uart.host_read(10), chip[UART + 0x480]) == (b"\xff", 4)


def _select(chip: Chip, address: int) -> None:
    chip[TWI + 0x500], chip[TWI + 0x508], chip[TWI + 0x50C], chip[TWI + 0x524] = 5, 0, 30, 0x01980000
    chip[TWI + 0x588] = address


def test_the_i2c_master_reads_a_register_with_a_repeated_start_and_stops_behind_the_byte(chip: Chip) -> None:
    _select(chip, 0x1D)
    chip[TWI + 0x08], chip[TWI + 0x51C] = 1, 0x0D
    chip.wait_us(250)
    assert chip[TWI + 0x11C] == 1
    chip[TWI + 0x200], chip[TWI] = 2, 1  # BB stops
    chip.wait_us(250)
    assert (chip[TWI + 0x108], chip[TWI + 0x518], chip[TWI + 0x104]) == (1, 0x5A, 1)


def test_the_i2c_master_waits_between_bytes_while_it_is_suspended(chip: Chip) -> None:
    _select(chip, 0x1D)
    chip[TWI + 0x08], chip[TWI + 0x51C] = 1, 0x0C
    chip.wait_us(250)
    chip[TWI + 0x200], chip[TWI] = 1, 1  # BB suspends
    chip.wait_us(1000)
    first = chip[TWI + 0x518]
    chip[TWI + 0x108] = 0
    chip.wait_us(1000)
    assert (first, chip[TWI + 0x108]) == (0, 0)
    chip[TWI + 0x200], chip[TWI + 0x20] = 2, 1  # the next byte is the last
    chip.wait_us(250)
    assert (chip[TWI + 0x518], chip[TWI + 0x104]) == (0x5A, 1)


def test_an_address_that_no_part_has_and_pins_without_a_bus_are_errors_of_the_i2c_master(chip: Chip) -> None:
    _select(chip, 0x1E)
    chip[TWI + 0x08] = 1
    chip.wait_us(200)
    assert (chip[TWI + 0x124], chip[TWI + 0x4C4]) == (1, 2)
    chip[TWI + 0x4C4] = 2
    _select(chip, 0x1D)
    chip[TWI + 0x508] = 1
    chip[TWI + 0x08] = 1
    chip.wait_us(200)
    assert chip[TWI + 0x4C4] == 2


def test_a_pressed_button_is_sensed_as_the_event_of_the_port(chip: Chip) -> None:
    chip[GPIO + 0x700 + 4 * 17] = 3 << 16  # input, sense low
    chip[GPIOTE + 0x304] = 1 << 31
    assert chip.interrupts() == set()
    chip.board.press("button A")
    assert (chip[GPIOTE + 0x17C], chip.interrupts(), chip[GPIO + 0x510] >> 17 & 1) == (1, {6}, 0)
    with pytest.raises(ConfigError, match="button B"):
        chip.board.press("SW2")


def test_gpiote_toggles_a_pin_by_a_task_and_reports_an_edge(chip: Chip) -> None:
    chip[GPIOTE + 0x510] = 3 | 3 << 8 | 3 << 16  # channel 0: task, P0.3, toggle
    chip[GPIO + 0x700 + 4 * 3] = 0
    assert not chip.board.level("P0.3")
    chip[GPIOTE] = 1
    assert chip.board.level("P0.3")
    chip[GPIOTE + 0x514] = 1 | 1 << 8 | 1 << 16  # channel 1: event of a rising edge of P0.1
    chip.board.drive("P0.1", True)
    assert chip[GPIOTE + 0x104] == 1


def test_registers_that_set_and_clear_bits_change_no_others(chip: Chip) -> None:
    chip[TEMP + 0x304], chip[TEMP + 0x304], chip[TEMP + 0x308] = 0x1, 0x8, 0x1
    chip[TIMER0 + 0x304], chip[TIMER0 + 0x304], chip[TIMER0 + 0x308] = 1 << 16, 1 << 19, 1 << 16
    assert (chip[TEMP + 0x300], chip[TIMER0 + 0x300]) == (0x8, 1 << 19)
    chip[GPIO + 0x518], chip[GPIO + 0x51C] = 0b1110, 0b0100
    chip[GPIO + 0x508], chip[GPIO + 0x50C] = 0b0111, 0b0001
    assert (chip[GPIO + 0x514], chip[GPIO + 0x504], chip[GPIO + 0x700 + 4 * 3] & 1) == (0b1010, 0b0110, 1)
    assert [chip.board.level(f"P0.{pin}") for pin in range(4)] == [True, True, False, False]  # SCL is pulled up


def test_a_lit_led_is_seen_for_20_ms(chip: Chip) -> None:
    chip[GPIO + 0x518] = 0xFFF0  # rows and columns are outputs
    chip[GPIO + 0x504] = 1 << 13 | 0x1FF0 & ~(1 << 4)
    assert chip.board.display_rows() == ("#....", ".....", ".....", ".....", ".....")
    chip[GPIO + 0x504] = 1 << 15 | 0x1FF0 & ~(1 << 8)
    assert chip.board.display_rows() == ("#....", ".#...", ".....", ".....", ".....")
    chip.wait_us(20_001)
    assert chip.board.display_rows() == (".....", ".#...", ".....", ".....", ".....")


def test_an_led_is_lit_by_the_direction_of_its_pins(chip: Chip) -> None:
    chip[GPIO + 0x504] = 1 << 13
    chip[GPIO + 0x518] = 1 << 13
    assert chip.board.display_rows()[0] == "....."
    chip[GPIO + 0x518] = 1 << 4  # the column is low before and after
    assert chip.board.display_rows()[0] == "#...."


def test_an_oscillator_that_is_stopped_while_it_starts_does_not_run(chip: Chip) -> None:
    chip[CLOCK], chip[CLOCK + 4] = 1, 1
    chip.wait_us(5000)
    assert (chip[CLOCK + 0x100], chip[CLOCK + 0x40C]) == (0, 0)


#: Store 0x0F0F0F0F at 0x3F000: ldr r0, r1 from literals, str.
STORE = program(0x4802, 0x4903, 0x6008, 0xE7FE, 0x46C0, 0x46C0, 0x0F0F, 0x0F0F, 0xF000, 0x0003)


def test_a_store_programs_flash_while_nvmc_enables_it_and_only_clears_bits() -> None:
    chip = Chip(STORE)
    chip[NVMC + 0x504] = 1
    chip.board.processor.memory.write(0x3F000, b"\xf0\xff\xff\xff")
    chip.wait_us(100)
    assert chip.board.processor.memory.read(0x3F000, 4) == b"\x00\x0f\x0f\x0f"
    chip[NVMC + 0x504] = 2
    chip[NVMC + 0x508] = 0x3F000
    assert chip.board.processor.memory.read(0x3F000, 4) == b"\xff\xff\xff\xff"


def test_a_store_to_flash_that_nvmc_does_not_enable_is_a_fault() -> None:
    with pytest.raises(BoardFault, match=r"NVMC\.CONFIG does not enable writes"):
        Chip(STORE).wait_us(100)


def test_random_numbers_follow_from_the_seed(chip: Chip) -> None:
    def numbers(seed: int) -> list[int]:
        other = Chip()
        other.board.seed = seed
        other[RNG] = 1
        values = []
        for _ in range(5):
            other.wait_us(167)
            values.append(other[RNG + 0x508])
        return values

    assert numbers(1) == numbers(1) != numbers(2)


def test_a_snapshot_restores_timers_and_their_events(chip: Chip) -> None:
    chip[TIMER0 + 0x510], chip[TIMER0 + 0x540] = 4, 500
    chip[TIMER0] = 1
    chip.wait_us(100)
    before = chip.board.snapshot()
    for _ in range(2):
        chip.wait_us(300)
        assert chip[TIMER0 + 0x140] == 0
        chip.wait_us(200)
        assert chip[TIMER0 + 0x140] == 1
        chip.board.restore(before)


def test_an_access_to_a_block_without_a_model_is_named(chip: Chip) -> None:
    chip[0x40001000 + 0x508] = 7
    assert [str(access) for access in chip.board.unmodelled] == [
        "RADIO_FREQUENCY at 0x40001508 is not modelled; write of 0x00000007 from 0x000000c0 was stored"
    ]


def test_the_cortex_m0_has_no_instructions_of_a_larger_core() -> None:
    chip = Chip(program(0xF3AF, 0x8000))  # NOP.W
    with pytest.raises(BoardFault, match="undefined"):
        chip.wait_us(10)


def test_a_debugger_reads_and_writes_pins_flash_and_facts_of_the_chip(chip: Chip) -> None:
    access = DebugAccess(chip.board)
    access.write(GPIO + 0x518, (1 << 3).to_bytes(4, "little"))
    assert access.read(GPIO + 0x514, 4) == (1 << 3).to_bytes(4, "little")
    assert access.read(0x10000010, 4) == (1024).to_bytes(4, "little"), "size of a page"
    assert access.register(15) == (0xC0).to_bytes(4, "little")
    described = memory_description(chip.board.memory, chip.board.bus.regions())
    assert '<memory type="ram" start="0x50000000" length="0x1000"/>' in described
