"""UART0 to UART5, each with its clock, its FIFO and a far end of its own."""

from __future__ import annotations

import pytest

from hiltest.virtual.k64f import VirtualK64F

from .conftest import Build
from .test_exceptions import word

# Out of reset the core and UART0 and UART1 run at 20.97 MHz; the bus, and with it the others, at half of that.
HEAD = """
#define WORD(address) (*(volatile unsigned *)(address))
#define HALF(address) (*(volatile unsigned short *)(address))
#define BYTE(address) (*(volatile unsigned char *)(address))
static const unsigned at[6] = {0x4006A000, 0x4006B000, 0x4006C000, 0x4006D000, 0x400EA000, 0x400EB000};
volatile unsigned sizes[6], levels[6], overruns, done;
static void begin(int fifos) {
    HALF(0x4005200E) = 0xC520; HALF(0x4005200E) = 0xD928; HALF(0x40052000) = 0x01D2;
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
