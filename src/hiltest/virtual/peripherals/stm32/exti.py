"""EXTI: interrupts at edges of pins, which SYSCFG selects."""

from __future__ import annotations

from functools import partial

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.stm32.block import Block, UnmodelledBlock
from hiltest.virtual.peripherals.stm32.gpio import PINS, Gpio
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.cpu import Processor

_IMR, _EMR, _RTSR, _FTSR, _SWIER, _PR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
_EXTICR = 0x08  # of SYSCFG: four lines a word, four bits a line
#: Lines of each interrupt; the last two, of the voltage detector and of the RTC's alarm, have no source.
_LINES = (1, 2, 4, 8, 16, 0x3E0, 0xFC00)


class PinSelection(UnmodelledBlock):
    """SYSCFG, of which the selection of pins for EXTI is modelled."""

    def read(self, offset: int, size: int) -> int:
        return Block.read(self, offset, size) if self._selects(offset) else super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        if self._selects(offset):
            Block.write(self, offset, size, value)
        else:
            super().write(offset, size, value)

    @staticmethod
    def _selects(offset: int) -> bool:
        return _EXTICR <= offset < _EXTICR + PINS

    def selected(self, port: int) -> int:
        """Return the lines that are connected to a port, by its number."""
        fields = int.from_bytes(self._bytes[_EXTICR : _EXTICR + PINS], "little")
        return sum(1 << line for line in range(PINS) if fields >> 32 * (line // 4) + 4 * (line % 4) & 15 == port)


class PinInterrupts(Block):
    """EXTI; its event lines, which wake WFE without an interrupt, have no model."""

    def __init__(
        self, processor: Processor, module: ChipPeripheral, selection: PinSelection, log: UnmodelledLog
    ) -> None:
        self._selection, self._log = selection, log
        self._pending = 0
        super().__init__(processor, module)

    def connect(self, port: Gpio) -> None:
        """Look at the edges of a port, whose name ends in its letter."""
        port.on_change.append(partial(self._look, ord(port.name[-1]) - ord("A")))

    def reset(self) -> None:
        super().reset()
        self._drive()

    def _look(self, port: int, rose: int, fell: int) -> None:
        edges = rose & self.word(_RTSR) | fell & self.word(_FTSR)
        if edges and (edges := edges & self._selection.selected(port)):
            self.change_word(_PR, put=edges)
            self._drive()

    def _drive(self) -> None:
        before, self._pending = self._pending, self.word(_PR) & self.word(_IMR)
        for number, lines in enumerate(_LINES):
            if (before ^ self._pending) & lines:
                self.drive_interrupt(bool(self._pending & lines), number)

    def write_word(self, offset: int, value: int, mask: int) -> None:
        if offset == _PR:
            self.change_word(_PR, clear=value)
            self.change_word(_SWIER, clear=value)
        elif offset == _SWIER:
            raised = value & ~self.word(_SWIER) & self.word(_IMR)
            self.change_word(_SWIER, put=value)
            self.change_word(_PR, put=raised)
        else:
            super().write_word(offset, value, mask)
        if offset == _EMR and value:
            self._log.note(self.base + offset, 4, value)
        self._drive()
