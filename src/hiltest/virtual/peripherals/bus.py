"""The peripheral bus: the block at each address, and the bus error where there is none."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from functools import cache
from typing import Any, Protocol, runtime_checkable

from hiltest.state import HasState, Restorable
from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import RefusedAccess
from hiltest.virtual.processor.cpu import Processor

_PAGE = 4096
Offsets = Collection[int]
ALL_STEADY: Offsets = range(_PAGE)
NONE_STEADY: Offsets = range(0)


class Peripheral(HasState, Protocol):
    """One block of registers.

    Attributes
    ----------
    name : str
        As the reference manual calls it.
    base : int
        First address; blocks are 4 KiB apart.
    clocked : bool
        Whether its clock gate is open. An access with a closed gate is a bus
        fault on the part, and a `BoardFault` here.

    Notes
    -----
    A block may declare `steady`: offsets of the bytes that change only at events of the schedule and at writes to any
    block, and whose reading changes nothing. The core asks for them once and answers again by itself until then. If a
    reading changes something all the same, `read` tells the processor: `read_changed`. A block may also declare
    `counters`: bytes that change with time, and whose reading changes nothing. The reading of all other bytes may
    change any block. A block that is a `CountsReads` is told of the readings that the core has answered.
    """

    name: str
    base: int
    clocked: bool

    def read(self, offset: int, size: int) -> int:
        """Answer a read of 1, 2 or 4 bytes."""
        ...

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a write of 1, 2 or 4 bytes."""
        ...

    def reset(self) -> None:
        """Return to the state after a chip reset."""
        ...


def read_by_bytes(peripheral: Peripheral, offset: int, size: int) -> int:
    """Answer a wide read of registers of one byte each."""
    return sum(peripheral.read(offset + index, 1) << 8 * index for index in range(size))


def write_by_bytes(peripheral: Peripheral, offset: int, size: int, value: int) -> None:
    """Take a wide write to registers of one byte each."""
    for index in range(size):
        peripheral.write(offset + index, 1, value >> 8 * index & 0xFF)


class StoredRegisters(Restorable):
    """A block whose registers keep what is written and do nothing else that firmware could see.

    Parameters
    ----------
    name
        As the reference manual calls it.
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
        """Return to the state after a chip reset."""
        self._bytes = bytearray(0x1000)
        for offset, value in self._initial.items():
            self._bytes[offset] = value

    @property
    def steady(self) -> Offsets:
        """Offsets of steady bytes: all, unless a class that answers reads in another way says nothing of it."""
        return ALL_STEADY if type(self).read is StoredRegisters.read else NONE_STEADY

    def word(self, offset: int) -> int:
        """The 32-bit register at an offset."""
        return int.from_bytes(self._bytes[offset : offset + 4], "little")

    def read(self, offset: int, size: int) -> int:
        """Answer what was written last."""
        return int.from_bytes(self._bytes[offset : offset + size], "little")

    def write(self, offset: int, size: int, value: int) -> None:
        """Keep what is written."""
        self._bytes[offset : offset + size] = value.to_bytes(size, "little")


@runtime_checkable
class CountsReads(Protocol):
    """A block that wants to know of readings that the core has answered by itself."""

    def repeated(self, address: int, place: int, reads: int) -> None:
        """Take note that the instruction at `place` has read an address so many times more."""
        ...


@cache
def _declared(steady: frozenset[int], counters: frozenset[int], *, counts_reads: bool) -> Any:
    """Return what a page declares, byte by byte; pages that declare the same share it."""
    tells = lib.DEVICE_TELLS if counts_reads else 0
    kinds = dict.fromkeys(counters, lib.DEVICE_KEEPS | tells)
    kinds |= dict.fromkeys(steady, lib.DEVICE_KEEPS | lib.DEVICE_STEADY | tells)
    return ffi.new("uint8_t[]", [kinds.get(offset, 0) for offset in range(_PAGE)])


class PeripheralBus(Restorable):
    """Connects the processor's loads and stores to peripherals.

    Parameters
    ----------
    processor
        Processor that makes the accesses.
    peripherals
        The blocks.
    register_name
        Names the register of the chip at an address; None where it has nothing. None: the memories are another part's.
    """

    def __init__(
        self, processor: Processor, peripherals: Iterable[Peripheral],
        register_name: Callable[[int], str | None] | None,
    ) -> None:  # fmt: skip
        self._register_name = register_name
        self._pages = {peripheral.base >> 12: peripheral for peripheral in peripherals}
        self._open: dict[int, Peripheral] = {}  # by page: those that need no look
        processor.machine.connect(self._checked_read, self._checked_write, processor.abort)
        self._declare(processor)

    def _declare(self, processor: Processor) -> None:
        """Tell the core which bytes are steady, and have it tell of repeated readings."""
        machine = processor.machine
        for page, peripheral in self._pages.items():
            steady = frozenset(getattr(peripheral, "steady", NONE_STEADY))
            counters = frozenset(getattr(peripheral, "counters", NONE_STEADY))
            if steady or counters:
                declared = _declared(steady, counters, counts_reads=isinstance(peripheral, CountsReads))
                lib.machine_declare_page(machine.handle, page << 12, declared)
        machine.tell_repeated(self._tell_repeated, processor.abort)

    def _tell_repeated(self, address: int, place: int, reads: int) -> None:
        peripheral = self._pages[address >> 12]
        if isinstance(peripheral, CountsReads):
            peripheral.repeated(address, place, reads)

    def _checked_read(self, address: int, size: int) -> int:
        """Answer a load, if it is no bus error."""
        peripheral = self._open.get(address >> 12)
        if peripheral is None or address % _PAGE + size > _PAGE:  # an access may straddle two pages
            peripheral = self._opened(address, size)
        return peripheral.read(address % _PAGE, size)

    def _checked_write(self, address: int, size: int, value: int) -> None:
        """Take a store, if it is no bus error."""
        peripheral = self._open.get(address >> 12)
        if peripheral is None or address % _PAGE + size > _PAGE:
            peripheral = self._opened(address, size)
        peripheral.write(address % _PAGE, size, value)

    def _opened(self, address: int, size: int) -> Peripheral:
        reason = self.reason_against(address, size)
        if reason is not None:
            raise RefusedAccess(reason)
        peripheral = self._open[address >> 12] = self._pages[address >> 12]
        return peripheral

    def read(self, address: int, size: int) -> int:
        """Read a register, as an access to its address would."""
        return self._pages[address >> 12].read(address & 0xFFF, size)

    def write(self, address: int, size: int, value: int) -> None:
        """Write a register, as an access to its address would."""
        self._pages[address >> 12].write(address & 0xFFF, size, value)

    def reason_against(self, address: int, size: int) -> str | None:
        """Say why an access is a bus error, if it is: every byte of it needs a peripheral with a clock."""
        for page in {address >> 12, (address + size - 1) >> 12}:
            peripheral = self._pages.get(page)
            if peripheral is None:
                if self._register_name is None:
                    return f"0x{address:08x}, where nothing is modelled: the memories are another part's"
                name = self._register_name(address)
                if name is None or page != address >> 12:
                    return f"0x{address:08x}, where the chip has no peripheral"
                return f"{name} at 0x{address:08x}, which is not modelled, and not stored in strict mode"
            if not peripheral.clocked:
                return f"{peripheral.name} while its clock gate in the SIM is closed"
        return None

    def look_again(self) -> None:
        """Check the next access to each page: clock gates have changed."""
        self._open.clear()
