"""A calibrator of the shipped firmware, run again and again without leaving the core."""

from __future__ import annotations

import struct

import numpy as np

from hiltest.boards import default_firmware
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.processor.cpu import RETURN_ADDRESS
from hiltest.virtual.processor.schedule import Event

_POINTS, _ARGUMENT, _FIT, _CODE, _STACK = 0x20020000, 0x20028000, 0x20028100, 0x20029000, 0x20030000
_N = 100
_XPSR = 1 << 24  # Thumb
_FOREVER = 10**12
# push {r4-r7, lr}; again: mov r0, r5; mov r1, r6; blx r7; subs r4, #1; bne again; pop {r4-r7, pc}
_LOOP = struct.pack("<7H", 0xB5F0, 0x4628, 0x4631, 0x47B8, 0x3C01, 0xD1FA, 0xBDF0)


class KernelLoop:
    """A board that is ready to run one calibrator over the same 100 points many times.

    Parameters
    ----------
    kernel : str
        Name of the calibrator's function.
    rounds : int
        How often a run calls it.
    profile : TimingProfile, optional
        Prices of the instructions, and waits of the memories.
    """

    def __init__(self, kernel: str, rounds: int, profile: TimingProfile | None = None) -> None:
        self._board = VirtualK64F(default_firmware(), profile=profile or DEFAULT_PROFILE)
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

    @property
    def instructions(self) -> int:
        """Instructions executed so far."""
        return self._board.instructions

    def run(self) -> int:
        """Run all rounds; return the virtual cycles that they took."""
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
