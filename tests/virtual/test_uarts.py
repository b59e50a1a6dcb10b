"""UART0 to UART5, each with its clock, its FIFO and a far end of its own."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.errors import BenchError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.core.library import lib
from hiltest.virtual.peripherals.uart import Uart

from .conftest import SHIPPED, Build, word

# Out of reset the core and UART0 and UART1 run at 20.97 MHz; the bus, and with it the others, at half of that.
HEAD = """
static const unsigned at[6] = {0x4006A000, 0x4006B000, 0x4006C000, 0x4006D000, 0x400EA000, 0x400EB000};
volatile unsigned sizes[6], levels[6], overruns, done;
static void begin(int fifos) {
    stop_watchdog();
    WORD(0x40048044) = 0x01110000;
    WORD(0x40048034) |= 0xFu << 10; WORD(0x40048028) |= 3u << 10;
    for (int n = 0; n < 6; n++) {
        BYTE(at[n]) = 0; BYTE(at[n] + 1) = n < 2 ? 11 : 5; BYTE(at[n] + 10) = n < 2 ? 12 : 22; // 115 200 baud
        if (fifos) BYTE(at[n] + 16) = 0x88;
        sizes[n] = BYTE(at[n] + 16);
        BYTE(at[n] + 3) = 0x0C;
    }
}
"""
ECHO = (
    HEAD
    + """
int main(void) {
    begin(0);
    for (;;) {
        for (int n = 0; n < 6; n++) {
            if (BYTE(at[n] + 4) & 0x20) { BYTE(at[n] + 7) = BYTE(at[n] + 7) + n; }
        }
    }
}
"""
)
WAITING = (
    HEAD
    + """
int main(void) {
    begin(1);
    for (;;) {
        for (int n = 0; n < 6; n++) {
            levels[n] = BYTE(at[n] + 22);
            overruns |= (BYTE(at[n] + 4) >> 3 & 1u) << n;
        }
    }
}
"""
)


def words(board: VirtualK64F, name: str) -> tuple[int, ...]:
    return board.processor.memory.read_words(board.image.symbols[name].address, 6)


def test_each_uart_speaks_to_its_own_far_end(build_c: Build) -> None:
    board = VirtualK64F(build_c(ECHO))
    board.run_until(0.001)
    assert (board.clocks.core_hz, board.clocks.bus_hz) == (640 * 32768, 320 * 32768)
    assert [uart.baud for uart in board.uarts] == pytest.approx([115_200] * 6, rel=1e-3)
    for number, uart in enumerate(board.uarts):
        uart.host_write(b"%dabc" % number)
    board.run_until(0.003)
    assert [uart.host_read(100) for uart in board.uarts] == [
        bytes(byte + number for byte in b"%dabc" % number) for number in range(6)
    ]
    assert board.unmodelled == ()


def test_the_first_two_hold_eight_bytes_and_the_others_one(build_c: Build) -> None:
    board = VirtualK64F(build_c(WAITING))
    board.run_until(0.001)
    assert words(board, "sizes") == (0xAA, 0xAA, 0x88, 0x88, 0x88, 0x88)
    for uart in board.uarts:
        uart.host_write(b"12345678")
    board.run_until(0.003)
    assert words(board, "levels") == (8, 8, 1, 1, 1, 1)
    assert word(board, "overruns") == 0b111100


C2, S1, D, PFIFO, CFIFO, SFIFO = 3, 4, 7, 0x10, 0x11, 0x12
IDLE, OVERRUN = 0x10, 0x08


def quiet_board() -> tuple[VirtualK64F, Uart]:
    """A board that stands still at its reset, and its UART1 at 115 200 baud with both directions on."""
    board = VirtualK64F(SHIPPED)
    board.processor.core.cycles += 1000
    uart = board.uarts[1]
    uart.clocked = True
    for offset, value in ((0, 0), (1, 11), (10, 12), (C2, 0x0C)):
        uart.write(offset, 1, value)
    return board, uart


def pass_bytes(board: VirtualK64F, count: float) -> None:
    board.processor.core.cycles += round(count * 10 * board.clocks.core_hz / 115_200)
    lib.machine_fire_events(board.processor.machine.handle)


def test_reading_status_and_then_data_clears_the_flags_that_it_showed() -> None:
    board, uart = quiet_board()
    uart.host_write(b"abc")
    pass_bytes(board, 2.1)
    assert uart.read(S1, 1) & (IDLE | OVERRUN) == OVERRUN
    pass_bytes(board, 2)
    assert uart.read(D, 1) == ord("a")
    assert uart.read(S1, 1) & (IDLE | OVERRUN) == IDLE  # it came after the reading of S1
    assert uart.read(SFIFO, 1) == 0xC4  # both are empty; of three bytes two had no room
    assert (uart.read(D, 1), uart.read(S1, 1) & IDLE) == (0, 0)
    assert uart.read(SFIFO, 1) == 0xC5  # nothing was there to read
    uart.write(SFIFO, 1, 0x01)
    assert uart.read(SFIFO, 1) == 0xC4


def test_a_byte_on_the_line_is_sent_whatever_is_flushed_and_lost_at_a_reset() -> None:
    board, uart = quiet_board()
    uart.write(PFIFO, 1, 0x88)
    for byte in b"0123456789":
        uart.write(D, 1, byte)
    assert uart.read(SFIFO, 1) == 0x42  # one is on the line and eight wait
    pass_bytes(board, 2.5)
    uart.write(CFIFO, 1, 0x80)
    pass_bytes(board, 5)
    assert uart.host_read(100) == b"012"
    uart.write(D, 1, ord("x"))
    uart.reset()
    pass_bytes(board, 5)
    assert uart.host_waiting == 0


RATES = st.tuples(st.sampled_from([640, 732, 2197, 2929]), st.integers(1, 16))
SPELLS = st.lists(st.tuples(RATES, st.integers(1, 10**12)), min_size=1, max_size=3)


def test_a_byte_arrives_at_its_picosecond_after_days_at_any_clocks() -> None:
    board, uart = quiet_board()
    processor, time, start = board.processor, board.clocks.time, board.snapshot()

    @given(SPELLS, st.integers(300, 3_000_000))
    def arrives(spells: list[tuple[tuple[int, int], int]], baud: int) -> None:
        board.restore(start)
        for (factor, divider), cycles in spells:
            time.run_at(time.hz, Fraction(factor * 32_768, divider), processor.cycles)
            processor.core.cycles += cycles
        uart.line_baud = baud
        uart.host_write(b"a")
        arrival = time.cycle_of(time.now() + round(10**13 / baud))
        assert lib.machine_next_event(processor.machine.handle) == arrival

    arrives()


def test_the_line_to_the_board_takes_16_mib_at_most() -> None:
    _, uart = quiet_board()
    uart.host_write(bytes(1 << 24))
    with pytest.raises(BenchError, match="UART1 of the virtual board cannot accept 1 more bytes"):
        uart.host_write(b"a")
