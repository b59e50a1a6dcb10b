"""Blocks of 1 KiB, four of which share a page of 4 KiB."""

from __future__ import annotations

from collections.abc import Iterable

from hiltest.state import Restorable
from hiltest.virtual.core.machine import RefusedAccess
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.cpu import Processor

_BLOCK_BITS, _BLOCK_BYTES = 10, 0x400


class Block(StoredRegisters):
    """A block whose registers are words that store writes, with bytes and halfwords as parts of them.

    Subclasses override `read_word` and `write_word`.
    """

    steady = ALL_STEADY

    def __init__(self, processor: Processor, module: ChipPeripheral) -> None:
        self.processor, self.module = processor, module
        initial = {
            register.address - module.base + byte: register.reset >> 8 * byte & 0xFF
            for register in module.registers
            for byte in range(4)
        }
        super().__init__(module.name, module.base, initial)

    def store_word(self, offset: int, value: int) -> None:
        """Set a register from inside of the block."""
        self._bytes[offset : offset + 4] = (value & 0xFFFFFFFF).to_bytes(4, "little")

    def change_word(self, offset: int, *, clear: int = 0, put: int = 0) -> None:
        """Clear bits of a register, and then set others."""
        self.store_word(offset, self.word(offset) & ~clear | put)

    def read_word(self, offset: int) -> int:
        return self.word(offset)

    def write_word(self, offset: int, value: int, mask: int) -> None:
        """Write the bits of a register that the mask contains; `value` has no others."""
        self.change_word(offset, clear=mask, put=value)

    def read(self, offset: int, size: int) -> int:
        return self.read_word(offset & ~3) >> 8 * (offset & 3)

    def write(self, offset: int, size: int, value: int) -> None:
        shift = 8 * (offset & 3)
        mask = (1 << 8 * size) - 1 << shift
        self.write_word(offset & ~3, value << shift & mask, mask)

    def drive_interrupt(self, is_driven: bool, number: int = 0) -> None:
        """Drive one of the interrupt lines of the block."""
        self.processor.nvic.set_line(self.module.interrupts[number], is_driven)


class UnmodelledBlock(Block):
    """A block without a model: its registers store writes, and accesses are named."""

    steady = ()

    def __init__(self, processor: Processor, module: ChipPeripheral, log: UnmodelledLog) -> None:
        self._log = log
        super().__init__(processor, module)

    def read(self, offset: int, size: int) -> int:
        self._log.note(self.base + offset, size, None)
        return super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        self._log.note(self.base + offset, size, value)
        super().write(offset, size, value)


class BlockPage(Restorable):
    """The blocks of a page. A block without its clock ignores writes and reads as zero, which is named once."""

    def __init__(self, base: int, blocks: Iterable[Block | CoreDevice], log: UnmodelledLog) -> None:
        self.base, self.clocked, self._log = base, True, log
        self._blocks = {(block.base - base) >> _BLOCK_BITS: block for block in blocks}
        self.name = ", ".join(block.name for block in self._blocks.values())
        self.steady = self._bytes("steady")
        self.counters = self._bytes("counters")

    def _bytes(self, kind: str) -> frozenset[int]:
        """Return the bytes of the page that the blocks declare as a kind."""
        return frozenset(
            block.base - self.base + offset
            for block in self._blocks.values()
            for offset in getattr(block, kind, ())
            if offset < _BLOCK_BYTES
        )

    def parts(self) -> Iterable[Block | CoreDevice]:
        return self._blocks.values()

    def reset(self) -> None:
        for block in self._blocks.values():
            block.reset()

    def _block(self, offset: int, size: int, written: int | None) -> Block | CoreDevice | None:
        """Return the block at an offset; None if its clock is off."""
        block = self._blocks.get(offset >> _BLOCK_BITS)
        if block is None:
            raise RefusedAccess(f"0x{self.base + offset:08x}, where the chip has no peripheral")
        if block.clocked:
            return block
        self._log.note_without_clock(block.name, self.base + offset, size, written)
        return None

    def read(self, offset: int, size: int) -> int:
        block = self._block(offset, size, None)
        return 0 if block is None else block.read(offset % _BLOCK_BYTES, size)

    def write(self, offset: int, size: int, value: int) -> None:
        block = self._block(offset, size, value)
        if block is not None:
            block.write(offset % _BLOCK_BYTES, size, value)
