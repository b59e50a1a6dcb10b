"""NVMC: flash that stores program and ERASEPAGE erases, and the facts about the chip in FICR."""

from __future__ import annotations

import struct

from hiltest.virtual.core.machine import RefusedAccess
from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.nrf51.block import Block
from hiltest.virtual.peripherals.nrf51.small_blocks import cycles_of
from hiltest.virtual.processor.cpu import Processor

_CONFIG, _ERASE_PAGE, _ERASE_ALL, _ERASE_UICR = 0x504, 0x508, 0x50C, 0x514
_WRITES, _ERASES = 1, 2
_PAGE, _FLASH_BYTES, UICR = 0x400, 0x40000, 0x10001000
_WORD_US, _PAGE_US = 46.3, 21_000.0  # program one word, erase one page: the largest times of the data sheet
_FICR = 0x10000000
#: FICR: page size, number of pages, RAM blocks and their size, configuration (256 KiB, 16 KiB, third revision), device
#: identity and address, and address type.
_FACTS = {0x10: _PAGE, 0x14: _FLASH_BYTES // _PAGE, 0x28: 0xFFFFFFFF, 0x2C: 0xFFFFFFFF, 0x34: 2, 0x38: 0x2000,
          0x3C: 0x2000, 0x5C: 0x007900, 0x60: 0x76697274, 0x64: 0x75616C21, 0xA0: 0xFFFFFFFF,
          0xA4: 0x6D626974, 0xA8: 0xC0DE}  # fmt: skip


class FlashControl(Block):
    """NVMC. The core stops while flash is programmed or erased, so that READY is always set."""

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self._memory = processor.memory
        super().__init__(processor, chip, module, tasks={})

    def write_facts(self) -> None:
        """Write FICR, which the factory has programmed."""
        for offset, value in _FACTS.items():
            self._memory.write(_FICR + offset, struct.pack("<I", value))

    def program(self, address: int, size: int, value: int) -> None:
        """Program flash by a store of the core, which clears bits.

        Raises
        ------
        RefusedAccess
            If CONFIG does not enable writes, or the address is in FICR.
        """
        if _FICR <= address < UICR:
            raise RefusedAccess(f"0x{address:08x} in FICR, which is read-only")
        if self.word(_CONFIG) & 3 != _WRITES:
            raise RefusedAccess(f"0x{address:08x} in flash while NVMC.CONFIG does not enable writes")
        before = int.from_bytes(self._memory.read(address, size), "little")
        self._memory.write(address, (before & value).to_bytes(size, "little"))
        self._wait(_WORD_US)

    def write(self, offset: int, size: int, value: int) -> None:
        super().write(offset, size, value)
        if self.word(_CONFIG) & 3 != _ERASES:
            return
        if offset == _ERASE_PAGE and value < _FLASH_BYTES:
            self._erase(value // _PAGE * _PAGE, _PAGE)
        elif offset == _ERASE_ALL and value & 1:
            self._erase(0, _FLASH_BYTES)
            self._erase(UICR, _PAGE)
        elif offset == _ERASE_UICR and value & 1:
            self._erase(UICR, _PAGE)

    def _erase(self, begin: int, size: int) -> None:
        self._memory.write(begin, b"\xff" * size)
        self._wait(_PAGE_US)

    def _wait(self, us: float) -> None:
        """Let time pass while the core is stopped."""
        self._processor.core.cycles += cycles_of(us)
