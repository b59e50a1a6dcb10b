"""GPIO: one port of 16 pins."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.stm32.block import Block
from hiltest.virtual.processor.cpu import Processor

_MODER, _OTYPER, _PUPDR, _IDR, _ODR, _BSRR, _LCKR = 0x00, 0x04, 0x0C, 0x10, 0x14, 0x18, 0x1C
PINS = 16
_OUTPUT, _ANALOG, _PULL_UP = 1, 3, 1


class Gpio(Block):
    """A port.

    Attributes
    ----------
    on_change : list of callable
        Called after pins have changed their levels, with those that rose and those that fell.
    """

    def __init__(self, processor: Processor, module: ChipPeripheral) -> None:
        self.on_change: list[Callable[[int, int], None]] = []
        self._outside = self._outside_high = self._levels = 0
        super().__init__(processor, module)

    def reset(self) -> None:
        super().reset()
        self._read_settings()
        self._settle()

    @property
    def levels(self) -> int:
        """Return the levels of the pins; bit n is pin n."""
        return self._levels

    def drive(self, pin: int, high: bool) -> None:
        """Drive a pin from outside of the chip."""
        self._outside |= 1 << pin
        self._outside_high = self._outside_high & ~(1 << pin) | high << pin
        self._settle()

    def _pins_with(self, register: int, value: int) -> int:
        """Return the pins whose two bits of a register have a value."""
        word = self.word(register)
        return sum(1 << pin for pin in range(PINS) if word >> 2 * pin & 3 == value)

    def _read_settings(self) -> None:
        self._outputs, self._analog = (self._pins_with(_MODER, mode) for mode in (_OUTPUT, _ANALOG))
        self._pulled_up = self._pins_with(_PUPDR, _PULL_UP)

    def _settle(self) -> None:
        out = self.word(_ODR)
        driven = self._outputs & ~(self.word(_OTYPER) & out)  # a high output with open drain drives nothing
        undriven = self._outside & self._outside_high | ~self._outside & self._pulled_up
        before, levels = self._levels, out & driven | undriven & ~driven
        self._levels = levels & ~self._analog & 0xFFFF
        rose, fell = self._levels & ~before, before & ~self._levels
        if rose or fell:
            for listener in self.on_change:
                listener(rose, fell)

    def read_word(self, offset: int) -> int:
        if offset == _IDR:
            return self._levels
        return 0 if offset == _BSRR else self.word(offset)

    def write_word(self, offset: int, value: int, mask: int) -> None:
        if offset == _BSRR:  # set wins over reset
            self.change_word(_ODR, clear=value >> 16, put=value & 0xFFFF)
        elif offset != _IDR:
            super().write_word(offset, value, mask)
            self._read_settings()
        self._settle()
