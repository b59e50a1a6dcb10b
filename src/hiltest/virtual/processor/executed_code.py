"""Execution counts of instructions."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.processor.cpu import Processor


@dataclass(frozen=True, slots=True)
class ExecutedCode:
    """Counts by address; those of several processors can be added."""

    executed: Counter[int] = field(default_factory=Counter)
    """Number of executions of each instruction; instructions that an IT block skips are not executed."""
    jumped: Counter[int] = field(default_factory=Counter)
    """Number of taken jumps of each transfer of control."""


class ExecutionWatch:
    """Counter of a processor's executions from now on, including those after resets and of rewritten code.

    Attributes
    ----------
    image : FirmwareImage
        Image that the processor runs.
    """

    def __init__(self, processor: Processor) -> None:
        self.image = processor.image
        self._machine, self._map = processor.machine, processor.memory.map
        if not lib.machine_watch_executions(self._machine.handle):
            raise MemoryError

    def code(self) -> ExecutedCode:
        """Return the counts; the processor must not be running."""
        code = ExecutedCode()
        for base, size in (*self._map.flash, *self._map.ram):
            counts = lib.machine_executions(self._machine.handle, base)
            pairs = np.frombuffer(ffi.buffer(counts, size // 2 * ffi.sizeof("struct machine_executions")), np.uint64)
            for column, counter in enumerate((code.executed, code.jumped)):
                numbers = pairs[column::2]
                (executed,) = np.nonzero(numbers)
                addresses = (base + 2 * executed).tolist()
                counter.update(dict(zip(addresses, numbers[executed].tolist(), strict=True)))
        return code
