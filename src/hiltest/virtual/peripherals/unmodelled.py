"""Peripherals of the chip that the virtual board does not model: they store writes, and are reported."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

from hiltest.state import Restorable
from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters
from hiltest.virtual.processor.cpu import Processor

_POLLED_READS = 1000  # reads of a register by one instruction between writes: more than any driver needs


class UnmodelledWarning(UserWarning):
    """Warning that firmware waits for a register that is not modelled."""


@dataclass(frozen=True, slots=True)
class UnmodelledAccess:
    """The first access to an unmodelled register."""

    register: str
    """Name of the register, such as ``FTM0_SC``."""
    address: int
    written: int | None
    """Value of a write; None for a read."""
    size: int
    """Size of the access [bytes]."""
    place: str
    """Function and line of the instruction."""
    cycle: int
    """Time of the access [clock cycles since power-on]."""
    accesses: int = 1
    """Number of accesses to the register so far."""
    outcome: str = "was stored"
    """Effect of a write."""

    def __str__(self) -> str:
        if self.written is None:
            access = f"read from {self.place} returned the stored value"
        else:
            access = f"write of 0x{self.written:0{2 * self.size}x} from {self.place} {self.outcome}"
        return f"{self.register} at 0x{self.address:08x} is not modelled; {access}"


class UnmodelledLog(Restorable):
    """Log of the first access to each unmodelled register, and detector of waiting for such a register.

    Attributes
    ----------
    listens : bool
        True while accesses are recorded; those of a debugger are not.
    on_wait : callable
        Called with one line when firmware waits for a register, once for each instruction that waits.
    """

    def __init__(self, processor: Processor, chip: Chip) -> None:
        self.listens = True
        self.on_wait: Callable[[str], None] = lambda line: warnings.warn(line, UnmodelledWarning, stacklevel=2)
        self._processor = processor
        self._chip = chip
        self._first: dict[str, UnmodelledAccess] = {}
        self._count: Counter[str] = Counter()
        self._reads: dict[tuple[int, int], int] = {}  # since the last write, by address and instruction
        self._last = 0, 0
        self._reported: set[tuple[int, int]] = set()

    @property
    def accesses(self) -> tuple[UnmodelledAccess, ...]:
        """The first access to each register, in order."""
        return tuple(replace(access, accesses=self._count[name]) for name, access in self._first.items())

    @property
    def polled(self) -> str:
        """Return a description of the register that firmware polls; empty if there is none."""
        if self._reads.get(self._last, 0) < _POLLED_READS:
            return ""
        address = self._last[0]
        return f", polling {self._chip.register_name(address)} at 0x{address:08x}, which is not modelled"

    def count_repeats(self, address: int, place: int, reads: int) -> None:
        """Count reads of an address by the instruction at `place`."""
        self._last = address, place
        self._count[self._chip.register_name(address) or f"0x{address:08x}"] += reads
        self._add_reads(reads)

    def note(self, address: int, size: int, written: int | None) -> None:
        """Record an access."""
        if not self.listens:
            return
        self._last = address, self._processor.registers.pc.get()
        if written is None:
            self._add_reads(1)
        else:
            self._reads.clear()
        name = self._chip.register_name(address) or f"0x{address:08x}"
        self._add(name, address, written, size, "was stored")

    def note_command(self, name: str, address: int, code: int, outcome: str) -> None:
        """Record a command that a modelled peripheral does not carry out."""
        self._add(name, address, code, 1, outcome)

    def _add(self, name: str, address: int, written: int | None, size: int, outcome: str) -> None:
        self._count[name] += 1
        if name in self._first:
            return
        place = self._processor.place(self._processor.registers.pc.get())
        now = self._processor.now()
        self._first[name] = UnmodelledAccess(name, address, written, size, place, now, outcome=outcome)

    def _add_reads(self, reads: int) -> None:
        """Count reads by the last instruction, and report if it waits."""
        address, pc = self._last
        self._reads[self._last] = self._reads.get(self._last, 0) + reads
        if self._reads[self._last] >= _POLLED_READS and self._last not in self._reported:
            self._reported.add(self._last)
            name, place = self._chip.register_name(address), self._processor.place(pc)
            self.on_wait(f"firmware waits for {name} at 0x{address:08x}, which is not modelled, at {place}")


class UnmodelledPage(StoredRegisters):
    """One page of unmodelled registers."""

    steady = ALL_STEADY

    def __init__(self, base: int, peripherals: list[ChipPeripheral], chip: Chip, log: UnmodelledLog) -> None:
        self._log = log
        super().__init__(", ".join(entry.name for entry in peripherals), base, chip.reset_bytes(base))

    def count_repeats(self, address: int, place: int, reads: int) -> None:
        self._log.count_repeats(address, place, reads)

    def read(self, offset: int, size: int) -> int:
        """Return the last written value, or the value after reset."""
        address = self.base + offset
        self._log.note(address, size, None)
        return super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        self._log.note(self.base + offset, size, value)
        super().write(offset, size, value)
