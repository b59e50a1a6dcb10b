"""Peripherals that the chip has and the virtual board does not model: they store writes, and are reported once."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

from hiltest.state import Restorable
from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters
from hiltest.virtual.processor.cpu import Processor

_POLLED_READS = 1000  # reads of one register by one instruction, with no write between: more than any driver needs


class UnmodelledWarning(UserWarning):
    """Firmware waits for a register that is not modelled."""


@dataclass(frozen=True, slots=True)
class UnmodelledAccess:
    """The first access to a register that does nothing."""

    register: str
    """Name of the register, ``FTM0_SC``."""
    address: int
    written: int | None
    """The value, for a write."""
    size: int
    """In bytes."""
    place: str
    """Function and line of the instruction."""
    cycle: int
    """When [clock cycles since power-on]."""
    accesses: int = 1
    """How many there have been to the register so far."""
    outcome: str = "kept"
    """What came of a write."""

    def __str__(self) -> str:
        if self.written is None:
            what = f"read from {self.place} got what it holds"
        else:
            what = f"write of 0x{self.written:0{2 * self.size}x} from {self.place} {self.outcome}"
        return f"{self.register} at 0x{self.address:08x} is not modelled; {what}"


class UnmodelledLog(Restorable):
    """Accesses to unmodelled registers, each register once, and the one that firmware waits for.

    Parameters
    ----------
    processor
        Says who touches it, and when.
    chip
        Has the names.

    Attributes
    ----------
    listens : bool
        Whether accesses are noted: a debugger's are not.
    told : callable
        Told, in a line and once for each place, what firmware waits for.
    """

    def __init__(self, processor: Processor, chip: Chip) -> None:
        self.listens = True
        self.told: Callable[[str], None] = lambda line: warnings.warn(line, UnmodelledWarning, stacklevel=2)
        self._processor = processor
        self._chip = chip
        self._first: dict[str, UnmodelledAccess] = {}
        self._count: Counter[str] = Counter()
        self._reads: dict[tuple[int, int], int] = {}  # since anything was written, by address and instruction
        self._last = 0, 0
        self._known: set[tuple[int, int]] = set()

    @property
    def accesses(self) -> tuple[UnmodelledAccess, ...]:
        """The first access to each register, in order."""
        return tuple(replace(each, accesses=self._count[name]) for name, each in self._first.items())

    @property
    def polled(self) -> str:
        """Words on the register that is read over and over, if one is, else nothing."""
        if self._reads.get(self._last, 0) < _POLLED_READS:
            return ""
        address = self._last[0]
        return f", polling {self._chip.register_name(address)} at 0x{address:08x}, which is not modelled"

    def repeated(self, address: int, place: int, reads: int) -> None:
        """Take note that the instruction at `place` has read an address so many times more."""
        self._last = address, place
        self._count[self._chip.register_name(address) or f"0x{address:08x}"] += reads
        self._add_reads(reads)

    def note(self, address: int, size: int, written: int | None) -> None:
        """Take note of an access."""
        if not self.listens:
            return
        self._last = address, self._processor.registers.pc.get()
        if written is None:
            self._add_reads(1)
        else:
            self._reads.clear()
        name = self._chip.register_name(address) or f"0x{address:08x}"
        self._add(name, address, written, size, "kept")

    def note_command(self, name: str, address: int, code: int, outcome: str) -> None:
        """Take note of a command that a modelled peripheral does not carry out."""
        self._add(name, address, code, 1, outcome)

    def _add(self, name: str, address: int, written: int | None, size: int, outcome: str) -> None:
        self._count[name] += 1
        if name in self._first:
            return
        place = self._processor.place(self._processor.registers.pc.get())
        now = self._processor.now()
        self._first[name] = UnmodelledAccess(name, address, written, size, place, now, outcome=outcome)

    def _add_reads(self, reads: int) -> None:
        """Take note of reads by the instruction that read last; those that show that firmware waits are told."""
        address, pc = self._last
        self._reads[self._last] = self._reads.get(self._last, 0) + reads
        if self._reads[self._last] >= _POLLED_READS and self._last not in self._known:
            self._known.add(self._last)
            name, place = self._chip.register_name(address), self._processor.place(pc)
            self.told(f"firmware waits for {name} at 0x{address:08x}, which is not modelled, at {place}")


class UnmodelledPage(StoredRegisters):
    """The registers of one page of addresses.

    Parameters
    ----------
    base
        First address.
    peripherals
        Which have registers there.
    chip
        Has their values after reset.
    """

    steady = ALL_STEADY

    def __init__(self, base: int, peripherals: list[ChipPeripheral], chip: Chip, log: UnmodelledLog) -> None:
        self._log = log
        super().__init__(", ".join(entry.name for entry in peripherals), base, chip.reset_bytes(base))

    def repeated(self, address: int, place: int, reads: int) -> None:
        """Take note that the instruction at `place` has read an address so many times more."""
        self._log.repeated(address, place, reads)

    def read(self, offset: int, size: int) -> int:
        """Answer what was written last, or the value after reset."""
        address = self.base + offset
        self._log.note(address, size, None)
        return super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        """Keep what is written."""
        self._log.note(self.base + offset, size, value)
        super().write(offset, size, value)
