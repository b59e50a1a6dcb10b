"""Programs of random accesses to registers run on or end with a named fault, and none troubles the host."""

from __future__ import annotations

import random
import struct

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.part.chip import mk64f12

VIRTUAL_S = 0.002  # 42 000 cycles out of reset, more than any of these needs to go wrong
_ENTRY = 0x400
_STORE = bytes.fromhex("0160")  # str r1, [r0]
_LOAD = bytes.fromhex("0268")  # ldr r2, [r0]


def elf_of(image: bytes) -> bytes:
    """Wrap an image that is loaded at 0 in an ELF without symbols."""
    ident = b"\x7fELF\x01\x01\x01" + bytes(9)
    header = ident + struct.pack("<HHIIIIIHHHHHH", 2, 40, 1, _ENTRY | 1, 52, 0, 0x05000400, 52, 32, 1, 40, 0, 0)
    return header + struct.pack("<8I", 1, 84, 0, 0, len(image), len(image), 7, 4) + image


def _load(register: int, value: int) -> bytes:
    """Make MOVW and MOVT of a value."""
    code = b""
    for opcode, half in ((0xF240, value & 0xFFFF), (0xF2C0, value >> 16)):
        first = opcode | half >> 12 | (half >> 11 & 1) << 10
        code += struct.pack("<HH", first, (half >> 8 & 7) << 12 | register << 8 | half & 0xFF)
    return code


def _random_accesses(choose: random.Random) -> bytes:
    """Write and read registers of the part with random values; the gates of all are open."""
    code = b"".join(_load(0, 0x40048028 + 4 * index) + _load(1, 0xFFFFFFFF) + _STORE for index in range(7))
    registers = [register.address for module in mk64f12().peripherals for register in module.registers]
    for _ in range(40):
        address = choose.choice(registers) if choose.random() < 0.995 else choose.getrandbits(32)
        value = choose.choice((0, 1, 0xFF, 0xFFFFFFFF, choose.getrandbits(32)))
        code += _load(0, address) + _load(1, value) + choose.choice((_STORE, _STORE, _LOAD))
    return code + bytes.fromhex("fee7")  # b .


def program(seed: int) -> bytes:
    """Make a program; every exception begins it again."""
    choose = random.Random(seed)
    code = _random_accesses(choose)
    vectors = struct.pack("<II", 0x20002000, _ENTRY | 1) + struct.pack("<I", _ENTRY | 1) * 100
    return elf_of(vectors.ljust(_ENTRY, b"\xff") + code)


def _ending(board: VirtualK64F) -> str:
    """Run a board, and return the cause of the fault that ends it; nothing if it runs on."""
    try:
        board.run_until(VIRTUAL_S)
    except BoardFault as fault:
        return fault.cause or "a fault without a cause"
    return "" if board.time_s >= VIRTUAL_S else "it stopped by itself"


@pytest.mark.parametrize("seeds", [range(60), pytest.param(range(60, 400), marks=pytest.mark.ci)], ids=["few", "many"])
def test_each_ends_with_a_named_fault_or_runs_on(seeds: range) -> None:
    for seed in seeds:
        board = VirtualK64F(program(seed))
        assert _ending(board) not in ("a fault without a cause", "it stopped by itself"), f"program {seed}"
        assert board.position(), f"program {seed}"
        for access in board.unmodelled:
            assert str(access), f"program {seed}"
