"""The CRC module against a plain reference, bit by bit."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.peripherals.crc import CheckValue

from .conftest import Build, word

DATA, GPOLY, CTRL = 0, 4, 8
(MODULE,) = (peripheral for peripheral in mk64f12().peripherals if peripheral.name == "CRC")


def mirrored(value: int, bits: int) -> int:
    return int(f"{value:0{bits}b}"[::-1], 2)


def reference(data: bytes, *, bits: int, polynomial: int, seed: int, reflects: bool, inverts: bool) -> int:
    """Divide message by polynomial, one bit at a time, least significant bits first where it reflects."""
    check = seed
    for byte in data:
        for index in range(8):
            bit = byte >> (index if reflects else 7 - index) & 1
            top = check >> bits - 1 & 1
            check = check << 1 & (1 << bits) - 1
            if bit ^ top:
                check ^= polynomial & (1 << bits) - 1
    check ^= (1 << bits) - 1 if inverts else 0
    return mirrored(check, bits) if reflects else check


@given(
    st.binary(max_size=40),
    st.sampled_from([16, 32]),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.booleans(),
    st.lists(st.sampled_from([1, 2, 4]), min_size=1),
)
def test_the_check_value_is_the_reference_whatever_the_width_of_the_writes(
    data: bytes, bits: int, polynomial: int, seed: int, reflects: bool, inverts: bool, widths: list[int]
) -> None:
    seed &= (1 << bits) - 1
    module = CheckValue(MODULE)
    # As memory holds it, the byte at the lowest address is the lowest one of a word, and goes first: TOT turns it up.
    control = (2 if reflects else 3) << 30 | (2 if reflects else 0) << 28 | inverts << 26 | (bits == 32) << 24
    module.write(CTRL, 4, control | 1 << 25)
    module.write(GPOLY, 4, polynomial)
    module.write(DATA, 4, seed)
    module.write(CTRL, 4, control)
    remainder, turn = data, 0
    while remainder:
        width = widths[turn % len(widths)]
        width = width if width <= len(remainder) else 1
        module.write(DATA, width, int.from_bytes(remainder[:width], "little"))
        remainder, turn = remainder[width:], turn + 1
    result = module.read(DATA, 4) if bits == 32 else module.read(2 if reflects else 0, 2) & 0xFFFF
    assert result == reference(data, bits=bits, polynomial=polynomial, seed=seed, reflects=reflects, inverts=inverts)


SOURCE = """
static const char text[] = "123456789";
unsigned before, crc32, ccitt, kermit, by_words;
static void begin(unsigned control, unsigned polynomial, unsigned seed) {
    WORD(0x40032008) = control | 1u << 25; WORD(0x40032004) = polynomial; WORD(0x40032000) = seed;
    WORD(0x40032008) = control;
}
static void feed(void) { for (int i = 0; i < 9; i++) BYTE(0x40032000 + i % 4) = text[i]; }
int main(void) {
    WORD(0x4004803C) |= 1u << 18;
    before = WORD(0x40032004);
    begin(0xA5000000u, 0x04C11DB7u, ~0u); feed(); crc32 = WORD(0x40032000);
    begin(0, 0x1021, 0xFFFF); feed(); ccitt = HALF(0x40032000);
    begin(0xA0000000u, 0x1021, 0); feed(); kermit = HALF(0x40032002);
    begin(0xE5000000u, 0x04C11DB7u, ~0u);
    WORD(0x40032000) = 0x34333231; HALF(0x40032000) = 0x3635; HALF(0x40032002) = 0x3837; BYTE(0x40032003) = 0x39;
    by_words = WORD(0x40032000);
    return 0;
}
"""


def test_firmware_finds_the_check_values_of_the_catalogue(build_c: Build) -> None:
    board = VirtualK64F(build_c(SOURCE))
    board.run_until(0.01)
    assert word(board, "before") == 0x1021
    assert word(board, "crc32") == 0xCBF43926  # CRC-32
    assert word(board, "ccitt") == 0x29B1  # CRC-16/CCITT-FALSE
    assert word(board, "kermit") == 0x2189  # CRC-16/KERMIT
    # CRC-32/BZIP2, read with its bits and bytes turned round.
    assert word(board, "by_words") == mirrored(0xFC891918, 32)
    assert board.unmodelled == ()
