"""How often each instruction has been executed: the core counts that always, and keeps it while somebody watches."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.processor.cpu import Processor


@dataclass(frozen=True, slots=True)
class ExecutedCode:
    """Counts by address; those of several processors may be added up."""

    executed: Counter[int] = field(default_factory=Counter)
    """How often each instruction was executed; skipped in an IT block is not executed."""
    jumped: Counter[int] = field(default_factory=Counter)
    """How often each transfer of control jumped away."""


class ExecutionWatch:
    """Keeps what a processor executes from now on, resets and code that is written anew included.

    Attributes
    ----------
    image : FirmwareImage
        What runs on it.
    """

    def __init__(self, processor: Processor) -> None:
        self.image = processor.image
        self._machine, self._map = processor.machine, processor.memory.map
        if not lib.machine_watch_executions(self._machine.handle):
            raise MemoryError

    def code(self) -> ExecutedCode:
        """Return what has been executed, while nothing is."""
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
