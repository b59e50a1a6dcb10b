"""A calibrator of the shipped firmware, run again and again without leaving the emulator."""

from __future__ import annotations

import struct

import numpy as np

from hiltest.boards import default_firmware
from hiltest.virtual.accounting import AccountingFactory, BlockAccounting, CodeHook
from hiltest.virtual.cpu import RETURN_ADDRESS
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.schedule import Event

_POINTS, _ARGUMENT, _FIT, _CODE, _STACK = 0x20020000, 0x20028000, 0x20028100, 0x20029000, 0x20030000
_N = 100
_XPSR = 1 << 24  # Thumb
_FOREVER = 10**12
# push {r4-r7, lr}; again: mov r0, r5; mov r1, r6; blx r7; subs r4, #1; bne again; pop {r4-r7, pc}
_LOOP = struct.pack("<7H", 0xB5F0, 0x4628, 0x4631, 0x47B8, 0x3C01, 0xD1FA, 0xBDF0)


class Uncounted(BlockAccounting):
    """Counts nothing: the emulator is given no hook."""

    def hook(self, outside: int, abort: object) -> CodeHook:
        """Return none."""
        return CodeHook(None, None)


class KernelLoop:
    """A board that is ready to run one calibrator over the same 100 points many times.

    Parameters
    ----------
    kernel : str
        Name of the calibrator's function.
    rounds : int
        How often a run calls it.
    accounting : AccountingFactory
        What counts.
    """

    def __init__(self, kernel: str, rounds: int, accounting: AccountingFactory) -> None:
        self._board = VirtualK64F(default_firmware(), accounting=accounting)
        self._rounds = rounds
        self._entry = self._board.image.symbols[kernel].address | 1
        memory = self._board.processor.memory
        for segment in self._board.image.segments:
            memory.write(segment.run_address, segment.data + bytes(segment.run_size - len(segment.data)))
        points = _cloud()
        memory.write(_POINTS, points.tobytes())
        low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        memory.write(_ARGUMENT, struct.pack("<IH3h3h2x", _POINTS, _N, *low, *high))
        memory.write(_CODE, _LOOP)
        self._board.processor.fpu_enabled = True

    def run(self) -> int:
        """Run all rounds; the virtual cycles that they took, 0 where nothing counts."""
        processor = self._board.processor
        processor.registers.primask.set(1)
        processor.registers.xpsr.set(_XPSR)
        variables = [self._rounds, _ARGUMENT, _FIT, self._entry]  # r4 to r7
        processor.registers.general.write(
            [*[0] * 4, *variables, *[0] * 5, _STACK, RETURN_ADDRESS | 1, _CODE | 1, _XPSR]
        )
        before = processor.cycles
        if not processor.run(Event(before + _FOREVER)):
            raise AssertionError("the loop did not come to its end")
        return processor.cycles - before


def _cloud() -> np.ndarray:
    generator = np.random.default_rng(1)
    directions = generator.normal(size=(_N, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.round(485 * directions * (1.03, 0.99, 0.98) + (120, -80, 40)).astype("<i2")
