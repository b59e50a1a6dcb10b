"""CRC: checksums of 16 or 32 bits over the written data, with any polynomial."""

from __future__ import annotations

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY

_DATA, _GPOLY, _CTRL = 0x0, 0x4, 0x8
_TOT, _TOTR = 30, 28  # two-bit fields, whose bit 1 selects a transposition, see `_transpose`
_FXOR, _WAS, _TCRC = 1 << 26, 1 << 25, 1 << 24
_WRITABLE = 0xF7000000
_RESET = (0xFFFFFFFF, 0x00001021, 0)  # DATA, GPOLY, CTRL
_MIRRORED = tuple(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def _transpose(data: bytes, how: int) -> bytes:
    """Transpose data according to field TOT or TOTR: 1 for bits in each byte, 2 for bits and bytes, 3 for bytes."""
    if how in (1, 2):
        data = bytes(_MIRRORED[byte] for byte in data)
    return data[::-1] if how & 2 else data


class CheckValue(Restorable):
    """The CRC module.

    A byte, halfword or word that is written to DATA is transposed by TOT, and enters the checksum with its highest
    byte first. A seed (WAS) is stored as written. The checksum is available at once.
    """

    steady = ALL_STEADY  # only a write changes anything

    def __init__(self, module: ChipPeripheral) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        self.reset()

    def reset(self) -> None:
        self._check, self._polynomial, self._control = _RESET

    def read(self, offset: int, size: int) -> int:
        register = offset & ~3
        value = {_DATA: self._result(), _GPOLY: self._polynomial, _CTRL: self._control}.get(register, 0)
        return value >> 8 * (offset & 3)

    def _result(self) -> int:
        value = self._check
        if not self._control & _TCRC:
            value &= 0xFFFF
        if self._control & _FXOR:
            value ^= 0xFFFFFFFF if self._control & _TCRC else 0xFFFF
        return int.from_bytes(_transpose(value.to_bytes(4, "little"), self._control >> _TOTR & 3), "little")

    def write(self, offset: int, size: int, value: int) -> None:
        register = offset & ~3
        if register == _GPOLY:
            self._polynomial = _replace_bytes(self._polynomial, offset, size, value)
        elif register == _CTRL:
            self._control = _replace_bytes(self._control, offset, size, value) & _WRITABLE
        elif register == _DATA and self._control & _WAS:
            self._check = _replace_bytes(self._check, offset, size, value)
        elif register == _DATA:
            for byte in _transpose(value.to_bytes(size, "big"), self._control >> _TOT & 3):
                self._feed(byte)

    def _feed(self, byte: int) -> None:
        bits = 32 if self._control & _TCRC else 16
        top, mask = 1 << bits - 1, (1 << bits) - 1
        check = self._check & mask ^ byte << bits - 8
        for _ in range(8):
            check = (check << 1 ^ (self._polynomial if check & top else 0)) & mask
        self._check = check


def _replace_bytes(word: int, offset: int, size: int, value: int) -> int:
    """Return a register with the bytes of an access replaced."""
    shift, mask = 8 * (offset & 3), (1 << 8 * size) - 1
    return word & ~(mask << shift) | value << shift
