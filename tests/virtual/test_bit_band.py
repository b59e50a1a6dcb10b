"""The bit-band aliases of SRAM_U and of the peripherals reach single bits."""

from __future__ import annotations

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, word
from .test_faults import HEAD

# As the macros of older Kinetis SDKs do it.
SOURCE = """
#include <stdint.h>
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define ALIAS(type, address, bit) \\
    (*(volatile type *)(((uint32_t)(address) & 0xF0000000u) + 0x02000000u \\
        + (((uint32_t)(address) & 0xFFFFFu) << 5) + ((bit) << 2)))
#define SCGC4 0x40048034u
#define UART0_C2 0x4006A003u
volatile uint32_t counted = 0x80000001u, read_set, read_clear, byte_written, gates, control;
volatile uint8_t bytes[4];
int main(void)
{
    ALIAS(uint32_t, &counted, 4) = 0xFFFFFFFFu;
    ALIAS(uint32_t, &counted, 0) = 0xFFFFFFFEu;
    read_set = ALIAS(uint32_t, &counted, 31);
    read_clear = ALIAS(uint8_t, &counted, 30);
    ALIAS(uint8_t, &bytes[2], 5) = 1;
    ALIAS(uint16_t, &bytes[0], 12) = 1;
    byte_written = *(volatile uint32_t *)bytes;
    ALIAS(uint32_t, SCGC4, 10) = 1;
    ALIAS(uint8_t, UART0_C2, 3) = 1;
    ALIAS(uint8_t, UART0_C2, 2) = 1;
    gates = REGISTER(SCGC4);
    control = *(volatile uint8_t *)UART0_C2;
    return 0;
}
"""


def test_bits_are_set_and_cleared_and_read_alone(build_c: Build) -> None:
    board = VirtualK64F(build_c(SOURCE))
    board.run_until(0.001)
    assert not board.faults
    assert word(board, "counted") == 0x80000010
    assert (word(board, "read_set"), word(board, "read_clear")) == (1, 0)
    assert word(board, "byte_written") == 0x00201000
    assert word(board, "gates") == 0xF0100430  # value after reset, and UART0's gate
    assert word(board, "control") == 0x0C


@pytest.mark.parametrize(
    ("alias", "cause"),
    [
        (0x42000000 + (0x6A003 << 5), "write to UART0 while its clock gate in the SIM is closed through its bit-band"),
        (0x42000000 + (0x10000 << 5), "write to 0x40010000, where the chip has no peripheral through its bit-band"),
        (0x22000000 + (0x30000 << 5), "write to unmapped address 0x20030000 through its bit-band alias 0x22600000"),
    ],
)
def test_what_a_bit_stands_for_decides_whether_it_faults(build: Build, alias: int, cause: str) -> None:
    code = f"    ldr r0, ={alias:#x}\n    movs r1, #1\n    str r1, [r0]\nend:\n    b end\n"
    board = VirtualK64F(build(HEAD.replace("culprit:", "") + code + "    .size main, . - main\n    .ltorg\n"))
    with pytest.raises(BoardFault, match=cause) as caught:
        board.run_until(0.001)
    assert caught.value.pc == (board.image.symbols["main"].address & ~1) + 6
