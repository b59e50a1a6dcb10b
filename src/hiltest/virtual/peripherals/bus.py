"""The peripheral bus: the block at each address, and the bus error where there is none."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol, runtime_checkable

import unicorn
from unicorn.unicorn_py3.unicorn import uclib

from hiltest.virtual.cpu import Processor
from hiltest.virtual.engine import add_hook
from hiltest.virtual.memory import PERIPHERALS, PRIVATE_PERIPHERALS
from hiltest.virtual.native import PAGE_BYTES, Offsets, declared_registers, native_permission
from hiltest.virtual.peripherals.bit_band import PERIPHERAL_ALIAS, SRAM_ALIAS, AliasedSram, BitBandAlias
from hiltest.virtual.turn import Counting

_READ_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint, ctypes.c_void_p)
_WRITE_CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint, ctypes.c_uint64, ctypes.c_void_p
)
_PAGE = PAGE_BYTES
ALL_STEADY: Offsets = range(_PAGE)
NONE_STEADY: Offsets = range(0)
_PERMISSION_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_bool, ctypes.c_void_p, ctypes.c_int, ctypes.c_uint64, ctypes.c_int, ctypes.c_int64, ctypes.c_void_p
)


class Peripheral(Protocol):
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
    A block may declare `steady`: offsets of the bytes that only an event of the schedule changes, or the firmware by
    a write, and whose reading changes nothing. A loop that reads nothing else, and changes nothing, is passed over up
    to the next event. Where it depends on more than the offset, `read` tells the processor's accounting: `end_watch`,
    where this reading changed something, and `steady_until`, where what was read changes without an event.
    Nothing is steady of a block that does not say so. One that declares `counters`, bytes of registers that count with
    time, has `counting(offset)`, which returns a `Counting`. One that has `passed` is told of reads passed over.
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


class StoredRegisters:
    """A block whose registers keep what is written and do nothing else that firmware could see.

    Parameters
    ----------
    name : str
        As the reference manual calls it.
    base : int
        First address.
    initial : dict of int to int, optional
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
    """A block that wants to know of reads that were passed over."""

    def passed(self, addresses: Sequence[int], turns: int) -> None:
        """Take note of turns of a loop that were passed over, in each of which these addresses of it are read."""
        ...


class PeripheralBus:
    """Connects the processor's loads and stores to peripherals.

    Parameters
    ----------
    processor : Processor
        Processor that makes the accesses.
    peripherals : iterable of Peripheral
        The blocks.
    register_name : callable
        Names the register of the chip at an address; None where it has nothing. None: the memories are another part's.
    """

    def __init__(
        self, processor: Processor, peripherals: Iterable[Peripheral],
        register_name: Callable[[int], str | None] | None,
    ) -> None:  # fmt: skip
        self._processor = processor
        self._register_name = register_name
        self._pages: dict[int, Peripheral] = {}
        for peripheral in peripherals:
            self._pages[peripheral.base >> 12] = peripheral
        self._open: dict[int, ctypes.Array[ctypes.c_uint8]] = {}  # by window: pages that need no look
        self._callbacks: list[object] = []
        for region in (PRIVATE_PERIPHERALS, PERIPHERALS):
            self._map(region, *self._registers_from(region[0]), self.reason_against)
        sram = BitBandAlias(SRAM_ALIAS, AliasedSram(processor.memory))
        for alias in (sram, BitBandAlias(PERIPHERAL_ALIAS, self)):
            self._map(alias.region, *self._bits_of(alias), alias.reason_against)

    def _registers_from(self, base: int) -> tuple[Any, Any]:
        """Make the functions that the emulator calls for the registers from an address on."""
        processor, pages, nvic = self._processor, self._pages, self._processor.nvic

        def on_read(_engine: int, offset: int, size: int, _data: int) -> int:
            """Return what the registers of a page have there; after a fault anything will do, the run ends."""
            try:
                address = base + offset
                value = pages[address >> 12].read(address & 0xFFF, size)
                if nvic.changed:
                    self._notice()
                return value & ((1 << (8 * size)) - 1)
            except BaseException as error:  # re-raised by Processor.run; ctypes would print and drop it
                processor.abort(error)
                return 0

        def on_write(_engine: int, offset: int, size: int, value: int, _data: int) -> None:
            """Give a value to the registers of a page."""
            try:
                address = base + offset
                pages[address >> 12].write(address & 0xFFF, size, value & ((1 << (8 * size)) - 1))
                if nvic.changed:
                    self._notice()
            except BaseException as error:  # as above
                processor.abort(error)

        return _READ_CALLBACK(on_read), _WRITE_CALLBACK(on_write)

    def _bits_of(self, alias: BitBandAlias) -> tuple[Any, Any]:
        """Make the functions that the emulator calls for a bit-band alias."""
        processor, base = self._processor, alias.region[0]

        def on_read(_engine: int, offset: int, size: int, _data: int) -> int:
            """Return one bit of the aliased word."""
            try:
                return alias.read(base + offset, size)
            except BaseException as error:  # as above
                processor.abort(error)
                return 0

        def on_write(_engine: int, offset: int, size: int, value: int, _data: int) -> None:
            """Set or clear one bit of the aliased word."""
            try:
                alias.write(base + offset, size, value)
            except BaseException as error:  # as above
                processor.abort(error)

        return _READ_CALLBACK(on_read), _WRITE_CALLBACK(on_write)

    def _map(
        self, region: tuple[int, int], read: Any, write: Any, reason_against: Callable[[int, int], str | None]
    ) -> None:
        """Map a window of addresses to this bus.

        The emulator gives a mapped device only the start of the block. It looks up the exact
        instruction when an access is not permitted; so none is, and each is let pass here, or is a fault.
        A hook on all loads and stores would give it too, and cost each load of RAM its fast path.
        """
        processor, (base, size) = self._processor, region
        opened = self._open[base] = (ctypes.c_uint8 * (size // _PAGE))()

        def on_access(_engine: int, access: int, address: int, size: int, _value: int, _data: int) -> bool:
            """Say whether the access may go on to the page, which is opened for good by the first that may."""
            try:
                page = (address - base) // _PAGE
                if not opened[page] or address % _PAGE + size > _PAGE:  # an access may straddle two pages
                    reason = reason_against(address, size)
                    if reason is not None:
                        processor.traps.refuse(access, address, reason)
                        return False
                    opened[page] = 1
                processor.registers.forget_condition()
                return True
            except BaseException as error:  # as above
                processor.abort(error)
                return False

        ask = _PERMISSION_CALLBACK(on_access)
        steady = self._steady_pages(base, size)
        permit, data = native_permission(
            base, opened, ask, steady, processor.accounting, self._tell_passed
        ) or (ask, None)
        self._callbacks.append((read, write, ask, permit, data, steady))  # the emulator keeps only the pointers
        engine = processor.engine._uch
        first, length = ctypes.c_uint64(base), ctypes.c_size_t(size)
        uclib.uc_mmio_map(engine, first, length, read, None, write, None)
        uclib.uc_mem_protect(engine, first, length, ctypes.c_uint32(unicorn.UC_PROT_NONE))
        protected = unicorn.UC_HOOK_MEM_READ_PROT | unicorn.UC_HOOK_MEM_WRITE_PROT
        add_hook(processor.engine, protected, permit, data, within=(base, base + size - 1))

    def _steady_pages(self, base: int, size: int) -> Any:
        """Make the table of what the blocks of a window declare, page by page; nothing of an alias is steady."""
        pages = (ctypes.c_void_p * (size // _PAGE))()
        for page in range(len(pages)):
            peripheral = self._pages.get((base >> 12) + page)
            steady: Offsets = getattr(peripheral, "steady", NONE_STEADY)
            counters: Offsets = getattr(peripheral, "counters", NONE_STEADY)
            if len(steady) + len(counters) > 0:
                declared = declared_registers(steady, counters, counted=isinstance(peripheral, CountsReads))
                pages[page] = ctypes.addressof(declared)
        return pages

    def _tell_passed(self, addresses: Sequence[int], turns: int) -> None:
        """Tell blocks that count reads which addresses a turn of a loop read, and how many turns were passed over."""
        read: dict[int, list[int]] = {}
        for address in addresses:
            read.setdefault(address >> 12, []).append(address)
        for page, those in read.items():
            peripheral = self._pages[page]
            if isinstance(peripheral, CountsReads):
                peripheral.passed(those, turns)

    def _notice(self) -> None:
        self._processor.nvic.changed = False
        self._processor.look_soon()

    def read(self, address: int, size: int) -> int:
        """Read a register, as an access to its address would."""
        return self._pages[address >> 12].read(address & 0xFFF, size)

    def write(self, address: int, size: int, value: int) -> None:
        """Write a register, as an access to its address would."""
        self._pages[address >> 12].write(address & 0xFFF, size, value)
        if self._processor.nvic.changed:
            self._notice()

    def counting(self, address: int) -> Counting | None:
        """Return how the register at an address counts; None for one that is steady."""
        peripheral = self._pages[address >> 12]
        if address & 0xFFF not in getattr(peripheral, "counters", ()):
            return None
        counting: Counting = peripheral.counting(address & 0xFFF)  # type: ignore[attr-defined]
        return counting

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
        for opened in self._open.values():
            ctypes.memset(opened, 0, len(opened))
