"""Peripherals of the chip that the virtual board does not model: they store writes, and are reported."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from hiltest.state import Restorable
from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.processor.cpu import Processor

_PAGE_BYTES = 4096


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
    fault: str = "is not modelled"
    """Reason for which the access is listed."""

    def __str__(self) -> str:
        if self.written is None:
            value = "the stored value" if self.outcome == "was stored" else "0"
            access = f"read from {self.place} returned {value}"
        else:
            access = f"write of 0x{self.written:0{2 * self.size}x} from {self.place} {self.outcome}"
        return f"{self.register} at 0x{self.address:08x} {self.fault}; {access}"


class UnmodelledLog(Restorable):
    """Log of the first access to each unmodelled register, and detector of waiting for such a register.

    Attributes
    ----------
    on_wait : callable
        Called with one line when firmware waits for a register, once for each instruction that waits.
    """

    def __init__(self, processor: Processor, chip: Chip) -> None:
        self.on_wait: Callable[[str], None] = lambda line: warnings.warn(line, UnmodelledWarning, stacklevel=2)
        self._processor = processor
        self._chip = chip
        self._first: dict[str, UnmodelledAccess] = {}
        self._count: Counter[str] = Counter()
        self._reported: set[tuple[int, int]] = set()
        self._reported_interrupts: set[str] = set()
        self._handle = processor.machine.handle
        processor.machine.log_accesses(self._take, processor.abort)

    def pause(self, pauses: bool) -> None:
        """Count no accesses for a time, because they are a debugger's."""
        lib.machine_pause_accesses(self._handle, pauses)

    def state(self) -> Any:
        lib.machine_report_accesses(self._handle)
        return super().state()

    def restore(self, state: Any) -> None:
        super().restore(state)
        lib.machine_forget_accesses(self._handle)

    @property
    def accesses(self) -> tuple[UnmodelledAccess, ...]:
        """The first access to each register, in order."""
        lib.machine_report_accesses(self._handle)
        return tuple(replace(access, accesses=self._count[name]) for name, access in self._first.items())

    @property
    def polled(self) -> str:
        """Return a description of the register that firmware polls; empty if there is none."""
        latest = lib.machine_latest_access(self._handle)
        if latest.reads < lib.MACHINE_POLLED_READS:
            return ""
        name = self._chip.register_name(latest.address)
        return f", polling {name} at 0x{latest.address:08x}, which is not modelled"

    def note(self, address: int, size: int, written: int | None) -> None:
        """Record an access by the current instruction."""
        access = {"address": address, "size": size, "value": written or 0, "is_write": written is not None, "count": 1}
        lib.machine_note_access(self._handle, ffi.new("struct machine_access *", access)[0])

    def report_interrupts(self, clause: str, place: int) -> None:
        """Report once that firmware waits at `place` for interrupts of unmodelled modules, which a clause names."""
        if clause and clause not in self._reported_interrupts:
            self._reported_interrupts.add(clause)
            self.on_wait(f"firmware waits{clause}, at {self._processor.place(place)}")

    def _take(self, access: Any) -> None:
        """Take a report of the core: counts of an instruction's accesses, and whether it polls."""
        address, place = access.address, access.place
        name = self._chip.register_name(address) or f"0x{address:08x}"
        self._count[name] += access.count
        if name not in self._first:
            self._add(name, address, access.value if access.is_write else None, access.size, place, "was stored")
        if access.reads >= lib.MACHINE_POLLED_READS and (address, place) not in self._reported:
            self._reported.add((address, place))
            where = self._processor.place(place)
            self.on_wait(f"firmware waits for {name} at 0x{address:08x}, which is not modelled, at {where}")

    def note_command(self, name: str, address: int, code: int, outcome: str) -> None:
        """Record a command that a modelled peripheral does not carry out."""
        self._count[name] += 1
        if name not in self._first:
            self._add(name, address, code, 1, self._processor.registers.pc.get(), outcome)

    def note_without_clock(self, block: str, address: int, size: int, written: int | None) -> None:
        """Record an access to a block whose clock is off."""
        name = self._chip.register_name(address) or f"0x{address:08x}"
        self._count[name] += 1
        if name not in self._first:
            self._add(name, address, written, size, self._processor.registers.pc.get(), "was ignored")
            self._first[name] = replace(self._first[name], fault=f"has no clock, because RCC does not enable {block}")

    def _add(self, name: str, address: int, written: int | None, size: int, pc: int, outcome: str) -> None:
        place, now = self._processor.place(pc), self._processor.now()
        self._first[name] = UnmodelledAccess(name, address, written, size, place, now, outcome=outcome)


class UnmodelledPage(CoreDevice):
    """One page of unmodelled registers, in the core's library (core/stored.c)."""

    steady = ALL_STEADY
    counts_accesses = True

    def __init__(self, machine: Machine, base: int, peripherals: list[ChipPeripheral], chip: Chip) -> None:
        initial = bytearray(_PAGE_BYTES)
        for offset, value in chip.reset_bytes(base).items():
            initial[offset] = value
        if not lib.machine_add_stored(machine.handle, base, bytes(initial)):
            raise MemoryError
        super().__init__(machine, ", ".join(entry.name for entry in peripherals), base)
