"""A machine of the core with flash, RAM and a vector table, for tests of its exceptions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

from .inner_library import SOURCES, inner_library

FLASH_BYTES, RAM, RAM_BYTES = 0x10000, 0x1FFFE000, 0x4000  # the RAM lies on both sides of 0x20000000
RAM_END = RAM + RAM_BYTES
NMI, HARD_FAULT, MEM_MANAGE, BUS_FAULT, USAGE_FAULT, SVCALL, PENDSV, SYSTICK = 2, 3, 4, 5, 6, 11, 14, 15
FIRST_INTERRUPT, INTERRUPTS = 16, 86
IDLE = 256
THUMB = 1 << 24
NPRIV, SPSEL, FPCA = 1, 2, 4  # CONTROL
ASPEN, LSPEN = 1 << 31, 1 << 30  # FPCCR
PRICES = {"exception_entry": 12, "exception_return": 10, "tail_chain": 6, "fp_frame": 17}
HANDLERS = 0x1000  # exception n's handler begins at HANDLERS + 16 * n


@cache
def exception_library() -> tuple[Any, Any]:
    """Return `inner_library`, with what state.h declares."""
    ffi, library = inner_library()
    text = "".join((SOURCES / name).read_text() for name in ("events.h", "state.h"))
    declarations = re.sub(r"static inline [^{]*\{[^}]*\}", "", text)
    declarations = re.sub(r"^(#|static const ).*$", "", declarations, flags=re.MULTILINE)
    ffi.cdef(declarations, override=True)
    return ffi, library


class Machine:
    """A machine in C.

    Parameters
    ----------
    baseline : bool
        Whether the core is of ARMv6-M.
    prices : mapping
        Rows of its timing profile.

    Attributes
    ----------
    core : struct core
    flash, ram : buffer
        Bytes of its memories.
    """

    def __init__(self, *, baseline: bool = False, prices: Mapping[str, int] = PRICES) -> None:
        self._ffi, self._library = exception_library()
        destroy = self._library.machine_destroy
        self.pointer = self._ffi.gc(self._library.machine_create(baseline), destroy)
        self.core = self._library.machine_core(self.pointer)
        self.flash = self._memory(0, FLASH_BYTES, writable=False)
        self.ram = self._memory(RAM, RAM_BYTES, writable=True)
        for row, value in prices.items():
            assert self._library.machine_set_price(self.pointer, 0, row.encode(), value)
        core = self.core
        core.interrupts = INTERRUPTS
        core.priority_mask = 0xC0 if baseline else 0xF0
        core.thumb = 1
        core.zero = 1
        core.r[13], core.other_stack, core.r[15] = RAM + 0x2000, RAM + 0x3000, 0x800
        self.write_words(0, [HANDLERS + 16 * number + 1 for number in range(256)])

    def _memory(self, base: int, size: int, *, writable: bool) -> Any:
        memory = self._library.machine_add_memory(self.pointer, base, size, writable)
        assert memory != self._ffi.NULL
        return self._ffi.buffer(memory, size)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the core."""
        return getattr(self._library, name)(self.pointer, *arguments)

    def write_words(self, address: int, words: Sequence[int]) -> None:
        """Write words as a debugger does."""
        data = b"".join((word & 0xFFFFFFFF).to_bytes(4, "little") for word in words)
        assert self.call("machine_write", address, len(data), data)

    def read_words(self, address: int, count: int) -> list[int]:
        """Read words as a debugger does."""
        data = self._ffi.new("uint8_t[]", 4 * count)
        assert self.call("machine_read", address, 4 * count, data)
        read = bytes(data)
        return [int.from_bytes(read[at : at + 4], "little") for at in range(0, len(read), 4)]

    def pend(self, *exceptions: int) -> None:
        """Make exceptions pending; external interrupts are enabled too."""
        for exception in exceptions:
            if exception >= FIRST_INTERRUPT:
                self.call("machine_set_enabled", exception - FIRST_INTERRUPT, True)
            self.call("machine_pend", exception)

    def take(self) -> bool:
        """Enter the exception that pre-empts, if there is one."""
        return bool(self.call("take_exception"))

    def enter(self, exception: int) -> None:
        """Make an exception pending and enter it."""
        self.pend(exception)
        assert self.take()
        assert self.core.exception == exception

    def leave(self, exc_return: int | None = None, place: int = 0x900) -> bool:
        """Return by an EXC_RETURN, or else by the one in the link register."""
        return bool(self.call("leave_exception", self.core.r[14] if exc_return is None else exc_return, place))

    def deliver(self, kind: str, *, address: int = 0) -> int:
        """Note a fault and take it to its handler; return the exception that was entered."""
        self.core.fault.kind = 0
        number = getattr(self._library, f"FAULT_{kind}")
        self.call("note_fault", number, self._library.CAUSE_NONE, self.core.r[15], address, 0, 0)
        return int(self.call("machine_deliver_fault"))

    @property
    def fault(self) -> tuple[str, str]:
        """Kind and cause of the fault that is noted."""
        fault = self.core.fault
        return self._name("fault_kind", fault.kind), self._name("fault_cause", fault.cause)

    def _name(self, enumeration: str, value: int) -> str:
        name: str = self._ffi.typeof(f"enum {enumeration}").elements[value]
        return name.partition("_")[2]

    @property
    def active(self) -> list[int]:
        """Exceptions being handled, the one that runs last."""
        return list(self.core.active[0 : self.core.active_count])

    def members(self, set_name: str) -> set[int]:
        """Exceptions that a set of the core holds."""
        return set(_bits(getattr(self.core, set_name)))


def _bits(words: Iterable[int]) -> Iterable[int]:
    return (32 * index + bit for index, word in enumerate(words) for bit in range(32) if word >> bit & 1)
