"""The firmware's kernel of packed moments: plain C on this machine, assembly on a virtual board that did not boot."""

from __future__ import annotations

import ctypes
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.calling import CallResult

from .bench import COSTS_BY

MOMENTS = 35  # the count comes first


@dataclass(frozen=True)
class KernelSums:
    """What the kernel answered, without the count that moments_t begins with."""

    sums: NDArray[np.float32]
    overflowed: bool


class PackedKernel(Protocol):
    """Something that runs the firmware's kernel."""

    def block(self, points: ArrayLike, anchor: ArrayLike, shift: int) -> KernelSums: ...

    def sum(self, points: ArrayLike, anchor: ArrayLike) -> NDArray[np.float32]: ...


def _counts(points: ArrayLike) -> NDArray[np.int16]:
    return np.ascontiguousarray(points, dtype="<i2")


def _settings(count: int, anchor: ArrayLike, shift: int) -> bytes:
    """packed_block_t from its count on."""
    x, y, z = (int(item) & 0xFFFF for item in np.asarray(anchor))
    lanes = ~(((1 << shift) - 1) << 16) & 0xFFFFFFFF
    words = (count, y << 16 | x, x << 16 | z, z << 16 | y, 0x8000 + shift, lanes)
    return struct.pack("<6If", *words, 2.0 ** (16 - 2 * shift))


def _range(counts: NDArray[np.int16]) -> bytes:
    """magnetometer_points_t from its count on."""
    return struct.pack("<H6hH", len(counts), *counts.min(axis=0).tolist(), *counts.max(axis=0).tolist(), 0)


class HostPacked:
    """In a library of this machine."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    def block(self, points: ArrayLike, anchor: ArrayLike, shift: int) -> KernelSums:
        counts = _counts(points)
        sums = (ctypes.c_float * MOMENTS)()
        block = struct.pack("PP", counts.ctypes.data, 0) + _settings(len(counts), anchor, shift)
        overflowed = self._library.packed_moments_block(block, sums)
        return KernelSums(np.array(sums, dtype=np.float32)[1:], bool(overflowed))

    def sum(self, points: ArrayLike, anchor: ArrayLike) -> NDArray[np.float32]:
        counts = _counts(points)
        sums = (ctypes.c_float * MOMENTS)()
        task = struct.pack("P", counts.ctypes.data) + _range(counts)
        self._library.packed_moments_sum(task, (ctypes.c_int32 * 3)(*np.asarray(anchor).tolist()), sums)
        return np.array(sums, dtype=np.float32)


class BoardPacked:
    """The shipped firmware's."""

    # In SRAM_U behind everything the image uses, below the stack.
    POINTS, BLOCK, ANCHOR, SUMS, PAIRS = 0x20020000, 0x20024000, 0x20024040, 0x20024080, 0x20024200
    STACK, STACK_BYTES = 0x2002F000, 0x1000  # ends where SRAM_U does

    def __init__(self, elf: Path) -> None:
        self._board = VirtualK64F(elf, profile=COSTS_BY)
        end = max(segment.run_address + segment.run_size for segment in self._board.image.segments)
        assert end <= self.POINTS
        self.last: CallResult | None = None

    def block(self, points: ArrayLike, anchor: ArrayLike, shift: int) -> KernelSums:
        counts, memory = _counts(points), self._board.processor.memory
        # Around the pairs nothing may change.
        fence = bytes(range(64))
        behind = self.PAIRS + 36 * ((len(counts) + 1) // 2)
        memory.write(self.PAIRS - len(fence), fence)
        memory.write(behind, fence)
        memory.write(self.POINTS, counts.tobytes())
        memory.write(self.BLOCK, struct.pack("<II", self.POINTS, self.PAIRS) + _settings(len(counts), anchor, shift))
        self.last = self._board.call("packed_moments_block", self.BLOCK, self.SUMS)
        assert memory.read(self.PAIRS - len(fence), len(fence)) == memory.read(behind, len(fence)) == fence
        return KernelSums(self._answer()[1:], bool(self.last.value))

    def bytes_written(self, points: ArrayLike, anchor: ArrayLike, shift: int) -> int:
        """How many bytes of its scratch the kernel writes; one that it does not keeps what filled it, twice."""
        memory, room = self._board.processor.memory, 0xC00
        untouched = np.ones(room, dtype=bool)
        for fill in (b"\x55", b"\xaa"):
            memory.write(self.PAIRS, fill * room)
            counts = _counts(points)
            memory.write(self.POINTS, counts.tobytes())
            task = struct.pack("<II", self.POINTS, self.PAIRS) + _settings(len(counts), anchor, shift)
            memory.write(self.BLOCK, task)
            self._board.call("packed_moments_block", self.BLOCK, self.SUMS)
            untouched &= np.frombuffer(memory.read(self.PAIRS, room), np.uint8) == fill[0]
        return room - int(untouched.sum())

    def sum(self, points: ArrayLike, anchor: ArrayLike, *, offset: int = 0) -> NDArray[np.float32]:
        counts, memory = _counts(points), self._board.processor.memory
        memory.write(self.POINTS + offset, counts.tobytes())
        memory.write(self.BLOCK, struct.pack("<I", self.POINTS + offset) + _range(counts))
        memory.write(self.ANCHOR, struct.pack("<3i", *np.asarray(anchor).tolist()))
        self._fill_stack()
        self.last = self._board.call("packed_moments_sum", self.BLOCK, self.ANCHOR, self.SUMS)
        return self._answer()

    def _fill_stack(self) -> None:
        """NaN, so that what was never written is seen in whatever is made of it."""
        self._board.processor.memory.write(self.STACK, bytes.fromhex("0000c07f") * (self.STACK_BYTES // 4))

    def _answer(self) -> NDArray[np.float32]:
        return np.frombuffer(self._board.processor.memory.read(self.SUMS, 4 * MOMENTS), dtype="<f4").copy()
