"""The chip's peripherals, as the shipped firmware and small programs meet them."""

from __future__ import annotations

import math

import pytest

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.board.virtual_machine import BoardSnapshot
from hiltest.virtual.core.library import lib
from hiltest.virtual.peripherals.i2c_bus import HeldLine, I2cBus
from hiltest.virtual.peripherals.pit import PeriodicTimers
from hiltest.virtual.processor.nvic import FIRST_INTERRUPT

from .conftest import SHIPPED

I2C0 = 0x40066000
BOOT_HZ = 20_971_520  # core and bus, out of reset


class Part:
    """A part that acknowledges everything, answers 0xA5, and writes down what it saw."""

    def __init__(self, address: int) -> None:
        self.address = address
        self.seen: list[tuple[str, int, float]] = []

    def start(self, reading: bool, time_s: float) -> bool:
        self.seen.append(("read" if reading else "write", self.address, time_s))
        return True

    def write(self, value: int, time_s: float) -> bool:
        self.seen.append(("byte", value, time_s))
        return True

    def read(self, time_s: float) -> int:
        self.seen.append(("fetch", 0xA5, time_s))
        return 0xA5

    def stop(self, time_s: float) -> None:
        self.seen.append(("stop", 0, time_s))


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_of_a_part_on_the_bus_ends_the_run_once(error: type[BaseException]) -> None:
    class Failing(Part):
        def start(self, reading: bool, time_s: float) -> bool:
            raise error("of the part")

    board = VirtualK64F(SHIPPED, i2c1=[Failing(0x0E)])
    with pytest.raises(error, match="of the part"):
        board.run_until(0.2)
    assert board.time_s < 0.2
    board.run_until(0.2)  # the firmware takes it for a part that does not acknowledge, and asks no more
    assert board.time_s >= 0.2


@pytest.fixture(scope="module")
def start_up() -> BoardSnapshot:
    """A board whose firmware has started, to go back to before each test."""
    board = VirtualK64F(SHIPPED)
    board.run_until(0.2)
    return board.snapshot()


@pytest.fixture
def booted(start_up: BoardSnapshot) -> VirtualK64F:
    start_up.board.restore(start_up)
    return start_up.board


def test_start_up_reaches_the_clocks_it_promises(booted: VirtualK64F) -> None:
    assert booted.clocks.core_hz == 120e6
    assert booted.clocks.bus_hz == 60e6
    assert not booted.watchdog.enabled
    # SBR 65 and BRFA 3/32 of 120 MHz: 115 218 baud.
    assert booted.uart0.baud == pytest.approx(115_218, abs=1)


def test_the_processor_sleeps_while_nothing_is_to_do(booted: VirtualK64F) -> None:
    cycles, idle = booted.cycles, booted.processor.idle_cycles
    booted.run_until(1.2)
    assert booted.cycles - cycles == pytest.approx(120e6, rel=1e-6)
    assert booted.processor.idle_cycles - idle > 0.999 * 120e6


def test_running_until_a_time_reaches_it_whatever_the_rounding(booted: VirtualK64F) -> None:
    for step in range(1, 400):
        expected = booted.time_s + step * 1.1e-7
        booted.run_until(expected)
        assert expected <= booted.time_s < expected + 1e-6


def test_bytes_sent_before_power_on_meet_a_receiver_that_is_off() -> None:
    board = VirtualK64F(SHIPPED)
    board.uart0.host_write(_framed(bytes.fromhex("01 01 0400 efbeadde")))
    board.run_until(0.2)
    assert board.uart0.host_read(100) == b""


def test_a_wrong_line_speed_garbles_what_the_board_says(start_up: BoardSnapshot) -> None:
    answers, board = [], start_up.board
    for baud in (115_200, 57_600):
        board.restore(start_up)
        board.uart0.line_baud = baud
        body = bytes.fromhex("01 01 0400 efbeadde")
        board.uart0.host_write(_framed(body))
        board.run_until(board.time_s + 0.1)
        answers.append(board.uart0.host_read(100))
    assert answers[0].startswith(b"\x7e\x81")
    assert not answers[1].startswith(b"\x7e\x81")


def _framed(body: bytes) -> bytes:
    import zlib

    body += zlib.crc32(body).to_bytes(4, "little")
    return b"\x7e" + body.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e") + b"\x7e"


def test_a_byte_on_the_line_takes_ten_bit_times(booted: VirtualK64F) -> None:
    booted.uart0.host_write(_framed(bytes.fromhex("01 01 0400 efbeadde")))
    sent_at = booted.time_s
    booted.run_until(sent_at + 1.0, wake=lambda: booted.uart0.host_waiting >= 10)
    first_ten = booted.time_s
    booted.run_until(sent_at + 1.0, wake=lambda: booted.uart0.host_waiting >= 15)
    # Five more bytes; the processor notices an event at the end of a block, a microsecond late at most.
    assert booted.time_s - first_ten == pytest.approx(5 * 10 / 115_218, abs=1e-6)


def test_i2c_bytes_take_nine_clocks_and_reads_repeat_the_start() -> None:
    part = Part(0x0E)
    board = VirtualK64F(SHIPPED, i2c1=[part])
    board.run_until(0.3)
    kinds = [kind for kind, _, _ in part.seen]
    assert kinds[:5] == ["write", "byte", "read", "fetch", "stop"]
    assert part.seen[1][1] == 0x07  # MAG3110 WHO_AM_I
    addressed, byte = part.seen[0][2], part.seen[1][2]
    # START and nine clocks at 375 kHz are 26.7 us; the interrupt that sends the next byte follows within 5 us.
    assert 10 / 375e3 <= byte - addressed <= 10 / 375e3 + 5e-6


def _master(held: HeldLine) -> tuple[VirtualK64F, Part]:
    """Return a board whose I2C0 is to send START while a line is held; a clock of the wire takes 20 cycles."""
    part = Part(0x0E)
    board = VirtualK64F(SHIPPED, i2c0=[part])
    board.hold_line(0, held)
    board.bus.write(I2C0 + 2, 1, 0xB0)  # C1: enabled, master, sends
    return board, part


def _completes_after(board: VirtualK64F, cycles: int) -> bool:
    """Whether the byte under way is complete at a cycle, and not before."""
    _pass(board, cycles - 1)
    before = board.bus.read(I2C0 + 3, 1) & 0x80
    _pass(board, 1)
    return not before and bool(board.bus.read(I2C0 + 3, 1) & 0x80)


@pytest.mark.parametrize(
    ("value", "clocks", "status"), [(0x80, 1, 0xB2), (0x1C, 4, 0xB2), (0x01, 8, 0xB2), (0, 9, 0xA2)]
)
def test_against_a_held_sda_a_master_loses_arbitration_at_the_first_one(value: int, clocks: int, status: int) -> None:
    board, part = _master(HeldLine("sda", 0.0, math.inf))
    board.bus.write(I2C0 + 4, 1, value)
    assert _completes_after(board, 20 * clocks)
    assert board.bus.read(I2C0 + 3, 1) == status
    assert bool(board.bus.read(I2C0 + 2, 1) & 0x20) == (value == 0)  # still master
    assert part.seen == []


def test_a_byte_waits_until_a_held_scl_is_let_go() -> None:
    board, part = _master(HeldLine("scl", 0.0, 999.5 / BOOT_HZ))
    board.bus.write(I2C0 + 4, 1, 0x1C)
    assert [kind for kind, _, _ in part.seen] == ["write"]
    assert _completes_after(board, 1000)
    board.bus.write(I2C0 + 4, 1, 0x07)
    assert _completes_after(board, 20 * 9)


def test_what_holds_one_line_of_a_bus_leaves_the_other_alone() -> None:
    board, _ = _master(HeldLine("sda", 1.0, math.inf))
    board.hold_line(0, HeldLine("scl", 0.0, math.inf))
    board.bus.write(I2C0 + 4, 1, 0x1C)
    _pass(board, 100_000)
    assert not board.bus.read(I2C0 + 3, 1) & 0x80


def test_two_parts_of_one_address_are_refused() -> None:
    with pytest.raises(ValueError, match="same address"):
        I2cBus([Part(0x0E), Part(0x0E)])


def test_chained_timers_count_expiries() -> None:
    board, timers = _timers()
    # Out of reset core and bus run from the same 20.97 MHz: one bus clock a cycle.
    timers.write(0x100, 4, 99)  # LDVAL0: expires every 100 bus clocks
    timers.write(0x110, 4, 0xFFFFFFFF)
    timers.write(0x118, 4, 5)  # TCTRL1: chained, enabled
    timers.write(0x108, 4, 1)
    board.processor.core.cycles += 1234
    assert timers.read(0x104, 4) == 99 - 34
    assert timers.read(0x114, 4) == 0xFFFFFFFF - 12


def _timers() -> tuple[VirtualK64F, PeriodicTimers]:
    board = VirtualK64F(SHIPPED)
    timers = board.timers
    timers.write(0x0, 4, 0)  # MCR: enables the module
    return board, timers


def _pass(board: VirtualK64F, cycles: int) -> None:
    board.processor.core.cycles += cycles
    lib.machine_fire_events(board.processor.machine.handle)


def test_a_timer_that_is_polled_flags_each_expiry_until_cleared() -> None:
    board, timers = _timers()
    timers.write(0x100, 4, 99)
    timers.write(0x108, 4, 1)  # no interrupt
    observations = []
    for _ in range(5):
        _pass(board, 60)
        observations.append(timers.read(0x10C, 4))
        timers.write(0x10C, 4, 1)
    assert observations == [0, 1, 0, 1, 1]  # looked at 60, 120, 180, 240 and 300; it expires at 100, 200 and 300
    assert FIRST_INTERRUPT + 48 not in board.processor.nvic.pending


def test_a_chained_timer_interrupts_when_the_chain_has_run_down() -> None:
    board, timers = _timers()
    timers.write(0x100, 4, 99)
    timers.write(0x110, 4, 4)
    timers.write(0x118, 4, 7)  # chained, interrupt, enabled: waits for the one before
    timers.write(0x108, 4, 1)
    _pass(board, 499)
    assert FIRST_INTERRUPT + 49 not in board.processor.nvic.pending
    _pass(board, 1)
    assert FIRST_INTERRUPT + 49 in board.processor.nvic.pending
    assert timers.read(0x11C, 4) == 1


def test_an_expiry_that_a_write_to_another_timer_finds_interrupts_too() -> None:
    board, timers = _timers()
    timers.write(0x100, 4, 99)
    timers.write(0x108, 4, 3)
    board.processor.core.cycles += 105  # within an instruction of the firmware: events come behind it
    timers.write(0x110, 4, 7)
    _pass(board, 1)
    assert FIRST_INTERRUPT + 48 in board.processor.nvic.pending


def test_a_new_load_value_counts_from_the_next_expiry() -> None:
    board, timers = _timers()
    timers.write(0x100, 4, 99)
    timers.write(0x108, 4, 1)
    _pass(board, 50)
    timers.write(0x100, 4, 9)
    assert timers.read(0x104, 4) == 49
    _pass(board, 50 + 3)
    assert timers.read(0x104, 4) == 9 - 3


def test_a_chained_timer_keeps_its_count_when_the_one_before_stops() -> None:
    board, timers = _timers()
    timers.write(0x100, 4, 99)
    timers.write(0x110, 4, 1000)
    timers.write(0x118, 4, 5)
    timers.write(0x108, 4, 1)
    _pass(board, 250)
    timers.write(0x108, 4, 0)
    _pass(board, 250)
    assert timers.read(0x114, 4) == 1000 - 2


def test_timers_stand_still_while_their_module_is_disabled() -> None:
    board, timers = _timers()
    timers.write(0x100, 4, 99)
    timers.write(0x108, 4, 3)
    _pass(board, 60)
    timers.write(0x0, 4, 2)
    _pass(board, 1000)
    timers.write(0x0, 4, 0)
    _pass(board, 39)
    assert not timers.read(0x10C, 4)
    _pass(board, 1)
    assert timers.read(0x10C, 4)


def test_a_chain_that_outlasts_any_time_never_interrupts() -> None:
    board, timers = _timers()
    for channel in range(4):
        timers.write(0x100 + 16 * channel, 4, 0xFFFFFFFF)
        timers.write(0x108 + 16 * channel, 4, 7 if channel else 1)
    assert board.processor.waiting.next_cycle == math.inf
    timers.write(0x110, 4, 0)
    timers.write(0x118, 4, 0)
    timers.write(0x118, 4, 7)  # it begins anew, and expires with the one before
    assert board.processor.waiting.next_cycle == board.cycles + (1 << 32)


def test_bytes_of_systick_and_its_neighbours_are_those_of_their_words() -> None:
    bus = VirtualK64F(SHIPPED).bus
    bus.write(0xE000E014, 4, 0x123456)
    assert [bus.read(0xE000E014 + byte, 1) for byte in range(4)] == [0x56, 0x34, 0x12, 0]
    assert bus.read(0xE000E01C, 4) == 0xC0000000  # CALIB
    bus.write(0xE000E400 + 21, 1, 0x7F)  # the priority of interrupt 21
    assert bus.read(0xE000E414, 4) == 0x7000
    bus.write(0xE000E102, 1, 0x20)  # enables interrupt 21
    assert bus.read(0xE000E180, 4) == 1 << 21


def test_systick_counts_down_and_flags_its_expiry() -> None:
    board = VirtualK64F(SHIPPED)
    bus = board.bus
    bus.write(0xE000E014, 4, 999)
    bus.write(0xE000E018, 4, 0)
    bus.write(0xE000E010, 4, 5)
    _pass(board, 400)
    assert bus.read(0xE000E018, 4) == 1000 - 400 - 1
    assert not bus.read(0xE000E010, 4) >> 16 & 1
    _pass(board, 700)
    assert bus.read(0xE000E010, 4) >> 16 & 1
    assert not bus.read(0xE000E010, 4) >> 16 & 1  # reading clears it


def test_a_firmware_reset_starts_again_and_time_goes_on(booted: VirtualK64F) -> None:
    before = booted.cycles
    booted.uart0.host_write(_framed(bytes.fromhex("11 07 0000")))
    booted.run_until(booted.time_s + 0.3)
    assert booted.uart0.host_read(100).startswith(b"\x7e\x91\x07")
    booted.uart0.host_write(_framed(bytes.fromhex("01 01 0400 efbeadde")))
    booted.run_until(booted.time_s + 0.2)
    assert booted.uart0.host_read(100).startswith(b"\x7e\x81\x01")
    assert booted.cycles > before
