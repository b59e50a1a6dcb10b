"""The peripheral bus: which block answers at which address, and what happens when none does."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from typing import Protocol

import unicorn
from unicorn.unicorn_py3.unicorn import uclib

from hiltest.virtual.cpu import Processor
from hiltest.virtual.memory import PERIPHERALS, PRIVATE_PERIPHERALS
from hiltest.virtual.native import native_permission

_READ_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint, ctypes.c_void_p)
_WRITE_CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint, ctypes.c_uint64, ctypes.c_void_p
)
_PAGE = 4096
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

    def word(self, offset: int) -> int:
        """The 32-bit register at an offset."""
        return int.from_bytes(self._bytes[offset : offset + 4], "little")

    def read(self, offset: int, size: int) -> int:
        """Answer what was written last."""
        return int.from_bytes(self._bytes[offset : offset + size], "little")

    def write(self, offset: int, size: int, value: int) -> None:
        """Keep what is written."""
        self._bytes[offset : offset + size] = value.to_bytes(size, "little")


class PeripheralBus:
    """Connects the processor's loads and stores to peripherals.

    Parameters
    ----------
    processor : Processor
        Whose accesses to serve.
    peripherals : iterable of Peripheral
        The blocks.
    register_name : callable
        Names the register of the chip at an address; None where it has nothing.
    """

    def __init__(
        self, processor: Processor, peripherals: Iterable[Peripheral], register_name: Callable[[int], str | None]
    ) -> None:
        self._processor = processor
        self._register_name = register_name
        self._pages: dict[int, Peripheral] = {}
        for peripheral in peripherals:
            self._pages[peripheral.base >> 12] = peripheral
        self._open: dict[int, ctypes.Array[ctypes.c_uint8]] = {}  # by window: pages that need no look
        self._callbacks: list[object] = []
        for region in (PRIVATE_PERIPHERALS, PERIPHERALS):  # `_permit` finds the window of an address in this order
            self._map(region)

    def _map(self, region: tuple[int, int]) -> None:
        """Have accesses to a window served here.

        The emulator tells a mapped device only where the block began. It looks up the exact
        instruction when an access is not permitted; so none is, and each is let pass here, or is a fault.
        A hook on all loads and stores would tell it too, and cost each load of RAM its fast path.
        """
        processor, pages, (base, size) = self._processor, self._pages, region
        nvic = processor.nvic

        def on_read(_engine: int, offset: int, size: int, _data: int) -> int:
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
            try:
                address = base + offset
                pages[address >> 12].write(address & 0xFFF, size, value & ((1 << (8 * size)) - 1))
                if nvic.changed:
                    self._notice()
            except BaseException as error:  # as above
                processor.abort(error)

        opened = (ctypes.c_uint8 * (size // _PAGE))()
        self._open[base] = opened
        ask = _PERMISSION_CALLBACK(self._permit)
        permit, data = native_permission(base, opened, ask) or (ask, None)
        callbacks = _READ_CALLBACK(on_read), _WRITE_CALLBACK(on_write), ask, permit, data
        self._callbacks.append(callbacks)  # the emulator keeps only the pointers
        read, write = callbacks[:2]
        engine = processor.engine._uch
        first, length = ctypes.c_uint64(base), ctypes.c_size_t(size)
        uclib.uc_mmio_map(engine, first, length, read, None, write, None)
        uclib.uc_mem_protect(engine, first, length, ctypes.c_uint32(unicorn.UC_PROT_NONE))
        uclib.uc_hook_add(
            engine, ctypes.byref(ctypes.c_size_t()), unicorn.UC_HOOK_MEM_READ_PROT | unicorn.UC_HOOK_MEM_WRITE_PROT,
            permit, data, first, ctypes.c_uint64(base + size - 1),
        )  # fmt: skip

    def _notice(self) -> None:
        self._processor.nvic.changed = False
        self._processor.look_soon()

    def _permit(self, _engine: int, access: int, address: int, _size: int, _value: int, _data: int) -> bool:
        """Say whether an access finds a peripheral; if not, it is a bus error."""
        peripheral = self._pages.get(address >> 12)
        if peripheral is None:
            name = self._register_name(address)
            reason = f"0x{address:08x}, where the chip has no peripheral"
            if name is not None:
                reason = f"{name} at 0x{address:08x}, which is not modelled, and not stored in strict mode"
        elif not peripheral.clocked:
            reason = f"{peripheral.name} while its clock gate in the SIM is closed"
        else:
            base = next(base for base in self._open if base <= address)
            self._open[base][(address - base) // _PAGE] = 1
            self._processor.registers.forget_condition()
            return True
        self._processor.traps.refuse(access, address, reason)
        return False

    def look_again(self) -> None:
        """Clock gates have changed: look at the next access to each page."""
        for opened in self._open.values():
            ctypes.memset(opened, 0, len(opened))
