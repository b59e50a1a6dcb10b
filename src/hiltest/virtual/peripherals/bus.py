"""The peripheral bus, which passes accesses to peripherals and raises bus errors."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from functools import cache
from typing import Any, Protocol

from hiltest.state import HasState, Restorable
from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import RefusedAccess
from hiltest.virtual.part.chip import Region
from hiltest.virtual.processor.cpu import Processor

_PAGE, _REGISTERS = 4096, 0x40000000
Offsets = Collection[int]
ALL_STEADY: Offsets = range(_PAGE)
NONE_STEADY: Offsets = range(0)


class Peripheral(HasState, Protocol):
    """One page of registers.

    Attributes
    ----------
    name : str
        Name in the reference manual.
    base : int
        First address; pages have 4 KiB.
    clocked : bool
        True if its clock gate is open. An access with a closed gate is a bus fault.

    Notes
    -----
    A peripheral may declare `steady`: offsets of bytes that change only at events of the queue and at writes to any
    peripheral, and whose reads have no side effects. The core reads them once, and repeats the values until then. If a
    read does have a side effect, `read` calls the processor's `report_changing_read`. A peripheral may also declare
    `counters`: bytes that change with time, and whose reads have no side effects. A read of any other byte may change
    any peripheral. A peripheral with a true `counts_accesses` has registers whose accesses the core counts.
    """

    name: str
    base: int
    clocked: bool

    def read(self, offset: int, size: int) -> int:
        """Return the value of 1, 2 or 4 bytes."""
        ...

    def write(self, offset: int, size: int, value: int) -> None:
        """Write 1, 2 or 4 bytes."""
        ...

    def reset(self) -> None:
        """Return to the state after a chip reset."""
        ...


def read_by_bytes(peripheral: Peripheral, offset: int, size: int) -> int:
    """Return the value of a wide read from one-byte registers."""
    return sum(peripheral.read(offset + index, 1) << 8 * index for index in range(size))


def write_by_bytes(peripheral: Peripheral, offset: int, size: int, value: int) -> None:
    """Split a wide write among one-byte registers."""
    for index in range(size):
        peripheral.write(offset + index, 1, value >> 8 * index & 0xFF)


class StoredRegisters(Restorable):
    """A peripheral whose registers only store writes.

    Parameters
    ----------
    name
        Name in the reference manual.
    base
        First address.
    initial
        Bytes that are not zero after reset, by offset.
    """

    def __init__(self, name: str, base: int, initial: dict[int, int] | None = None) -> None:
        self.name = name
        self.base = base
        self.clocked = True
        self._initial = initial or {}
        self.reset()

    def reset(self) -> None:
        self._bytes = bytearray(0x1000)
        for offset, value in self._initial.items():
            self._bytes[offset] = value

    @property
    def steady(self) -> Offsets:
        """Offsets of steady bytes: all, or none in a subclass that overrides `read` but not `steady`."""
        return ALL_STEADY if type(self).read is StoredRegisters.read else NONE_STEADY

    def word(self, offset: int) -> int:
        """Return the 32-bit register at an offset."""
        return int.from_bytes(self._bytes[offset : offset + 4], "little")

    def read(self, offset: int, size: int) -> int:
        return int.from_bytes(self._bytes[offset : offset + size], "little")

    def write(self, offset: int, size: int, value: int) -> None:
        self._bytes[offset : offset + size] = value.to_bytes(size, "little")


@cache
def _declare_bytes(steady: frozenset[int], counters: frozenset[int], *, counts_accesses: bool) -> Any:
    """Return the declaration of each byte of a page; pages with equal declarations share it."""
    counted = lib.DEVICE_COUNTS if counts_accesses else 0
    kinds = dict.fromkeys(counters, lib.DEVICE_KEEPS | counted)
    kinds |= dict.fromkeys(steady, lib.DEVICE_KEEPS | lib.DEVICE_STEADY | counted)
    return ffi.new("uint8_t[]", [kinds.get(offset, 0) for offset in range(_PAGE)])


class PeripheralBus(Restorable):
    """Bus between the processor and its peripherals.

    Parameters
    ----------
    register_name
        Returns the name of the chip's register at an address, or None. None for a bare part without such names.

    Attributes
    ----------
    store_in_flash : callable or None
        Called for stores to flash, with address, size and value, on a chip that programs flash by stores.
    """

    def __init__(
        self,
        processor: Processor,
        peripherals: Iterable[Peripheral],
        register_name: Callable[[int], str | None] | None,
    ) -> None:
        self._register_name = register_name
        self._pages = {peripheral.base >> 12: peripheral for peripheral in peripherals}
        self.store_in_flash: Callable[[int, int, int], None] | None = None
        self._open: dict[int, Peripheral] = {}  # by page: peripherals that need no further check
        processor.machine.connect(self._checked_read, self._checked_write, processor.abort)
        self._declare(processor)

    def _declare(self, processor: Processor) -> None:
        """Declare the steady bytes to the core."""
        machine = processor.machine
        for page, peripheral in self._pages.items():
            steady = frozenset(getattr(peripheral, "steady", NONE_STEADY))
            counters = frozenset(getattr(peripheral, "counters", NONE_STEADY))
            if steady or counters:
                counts = bool(getattr(peripheral, "counts_accesses", False))
                declared = _declare_bytes(steady, counters, counts_accesses=counts)
                lib.machine_declare_page(machine.handle, page << 12, declared)

    def _checked_read(self, address: int, size: int) -> int:
        """Read a register for a load; raise `RefusedAccess` for a bus error."""
        peripheral = self._open.get(address >> 12)
        if peripheral is None or address % _PAGE + size > _PAGE:  # an access may straddle two pages
            peripheral = self._open_peripheral(address, size)
        return peripheral.read(address % _PAGE, size)

    def _checked_write(self, address: int, size: int, value: int) -> None:
        """Write a register for a store; raise `RefusedAccess` for a bus error."""
        if self.store_in_flash is not None and address < _REGISTERS:
            self.store_in_flash(address, size, value)
            return
        peripheral = self._open.get(address >> 12)
        if peripheral is None or address % _PAGE + size > _PAGE:
            peripheral = self._open_peripheral(address, size)
        peripheral.write(address % _PAGE, size, value)

    def _open_peripheral(self, address: int, size: int) -> Peripheral:
        reason = self.reason_against(address, size)
        if reason is not None:
            raise RefusedAccess(reason)
        peripheral = self._open[address >> 12] = self._pages[address >> 12]
        return peripheral

    def has(self, address: int) -> bool:
        """Return whether an address is in the page of a peripheral."""
        return address >> 12 in self._pages

    def regions(self) -> list[Region]:
        """Return the pages of the peripherals."""
        return [(page << 12, _PAGE) for page in sorted(self._pages)]

    def read(self, address: int, size: int) -> int:
        """Read a register by its address, without checks."""
        return self._pages[address >> 12].read(address & 0xFFF, size)

    def write(self, address: int, size: int, value: int) -> None:
        """Write a register by its address, without checks."""
        self._pages[address >> 12].write(address & 0xFFF, size, value)

    def reason_against(self, address: int, size: int) -> str | None:
        """Return the reason why an access is a bus error, if it is: each byte needs a peripheral with an open gate."""
        for page in {address >> 12, (address + size - 1) >> 12}:
            peripheral = self._pages.get(page)
            if peripheral is None:
                if self._register_name is None:
                    return f"0x{address:08x}, where no peripheral is modelled: the memories are another part's"
                name = self._register_name(address)
                if name is None or page != address >> 12:
                    return f"0x{address:08x}, where the chip has no peripheral"
                return f"{name} at 0x{address:08x}, which is not modelled: in strict mode this is an error"
            if not peripheral.clocked:
                return f"{peripheral.name} while its clock gate in the SIM is closed"
        return None

    def recheck(self) -> None:
        """Check the next access to each page again, because clock gates have changed."""
        self._open.clear()
