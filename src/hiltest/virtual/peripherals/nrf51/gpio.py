"""GPIO, and GPIOTE, which makes tasks and events of pins."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.nrf51.block import Block, changed_bits
from hiltest.virtual.processor.cpu import Processor

_OUT, _OUTCLR, _IN, _DIR, _DIRCLR, _PIN_CNF, _PINS = 0x504, 0x50C, 0x510, 0x514, 0x51C, 0x700, 32
_DIRECTION, _UNBUFFERED, _PULL_UP = 1, 2, 3  # PIN_CNF: DIR, INPUT, PULL
_SENSE_HIGH, _SENSE_LOW = 2, 3
_OUT_TASK, _IN_EVENT, _PORT, _CONFIG, _CHANNELS = 0x00, 0x100, 0x17C, 0x510, 4
_EVENT_MODE, _TASK_MODE = 1, 3
_RISING, _FALLING, _TOGGLE = 1, 2, 3  # CONFIG.POLARITY; as a task: set, clear, toggle


class Gpio(Block):
    """The 32 pins.

    Attributes
    ----------
    on_change : callable
        Called after a pin has changed its level or its driver, with the pins that rose and those that fell.
    """

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self.on_change: Callable[[int, int], None] = lambda _rose, _fell: None
        self._outside = self._outside_high = 0
        self._tasked = self._tasked_high = 0  # pins that GPIOTE drives
        self._levels = 0
        self._pulled_up = self._connected = self._senses_high = self._senses_low = 0  # pins, by PIN_CNF
        super().__init__(processor, chip, module, tasks={})

    def reset(self) -> None:
        self._tasked = self._tasked_high = 0
        super().reset()
        self._read_controls()
        self._settle()

    @property
    def levels(self) -> int:
        """Return the levels of the pins; bit n is pin n."""
        return self._levels

    @property
    def driven(self) -> int:
        """Return the pins that the chip drives."""
        return self.word(_DIR) | self._tasked

    @property
    def detected(self) -> int:
        """Return the pins at the level that their PIN_CNF senses."""
        return self._levels & self._senses_high | ~self._levels & self._senses_low

    def drive(self, pin: int, high: bool) -> None:
        """Drive a pin from outside of the chip."""
        self._outside |= 1 << pin
        self._outside_high = self._outside_high & ~(1 << pin) | high << pin
        self._settle()

    def drive_by_task(self, pin: int, high: bool | None) -> None:
        """Let GPIOTE drive a pin, or end that with None."""
        bit = 1 << pin
        self._tasked = self._tasked & ~bit if high is None else self._tasked | bit
        self._tasked_high = self._tasked_high & ~bit | bool(high) << pin
        self._settle()

    def _read_controls(self) -> None:
        self._pulled_up = self._connected = self._senses_high = self._senses_low = 0
        for pin in range(_PINS):
            control, bit = self.word(_PIN_CNF + 4 * pin), 1 << pin
            self._pulled_up |= bit if control >> 2 & 3 == _PULL_UP else 0
            self._connected |= 0 if control & _UNBUFFERED else bit
            self._senses_high |= bit if control >> 16 & 3 == _SENSE_HIGH else 0
            self._senses_low |= bit if control >> 16 & 3 == _SENSE_LOW else 0

    def _settle(self) -> None:
        out, driven = self.word(_OUT) & ~self._tasked | self._tasked_high, self.driven
        undriven = self._outside & self._outside_high | ~self._outside & self._pulled_up
        before, self._levels = self._levels, (out & driven | undriven & ~driven) & 0xFFFFFFFF
        self.on_change(self._levels & ~before, before & ~self._levels)

    def read(self, offset: int, size: int) -> int:
        if _OUT <= offset < _IN:
            return self.word(_OUT) >> 8 * (offset % 4)
        if offset & ~3 == _IN:
            return (self._levels & self._connected) >> 8 * (offset % 4)
        if _DIR <= offset < _DIRCLR + 4:
            return self.word(_DIR) >> 8 * (offset % 4)
        return super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        if _OUT <= offset <= _OUTCLR:
            self.store_word(_OUT, changed_bits(self.word(_OUT), offset - _OUT, value))
        elif _DIR <= offset <= _DIRCLR:
            self._set_directions(changed_bits(self.word(_DIR), offset - _DIR, value))
        else:
            super().write(offset, size, value)
            pin = (offset - _PIN_CNF) // 4
            if 0 <= pin < _PINS:
                self.store_word(_DIR, self.word(_DIR) & ~(1 << pin) | (value & _DIRECTION) << pin)
                self._read_controls()
        self._settle()

    def _set_directions(self, directions: int) -> None:
        """Write DIR, whose bits are also in PIN_CNF."""
        self.store_word(_DIR, directions)
        for pin in range(_PINS):
            control = self.word(_PIN_CNF + 4 * pin)
            self.store_word(_PIN_CNF + 4 * pin, control & ~_DIRECTION | directions >> pin & 1)


class PinEvents(Block):
    """GPIOTE."""

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral, pins: Gpio) -> None:
        self._pins = pins
        self._detects = False
        tasks = {_OUT_TASK + 4 * n: partial(self._output, n) for n in range(_CHANNELS)}
        super().__init__(processor, chip, module, tasks=tasks)

    def reset(self) -> None:
        super().reset()
        self._detects = False

    def look(self, rose: int, fell: int) -> None:
        """Set the events of pins that have changed."""
        for channel in range(_CHANNELS):
            mode, pin, polarity = self._configured(channel)
            edges = (rose if polarity & _RISING else 0) | (fell if polarity & _FALLING else 0)
            if mode == _EVENT_MODE and edges >> pin & 1:
                self.set_event(_IN_EVENT + 4 * channel)
        before, self._detects = self._detects, bool(self._pins.detected)
        if self._detects and not before:
            self.set_event(_PORT)

    def _configured(self, channel: int) -> tuple[int, int, int]:
        """Return mode, pin and polarity of a channel."""
        config = self.word(_CONFIG + 4 * channel)
        return config & 3, config >> 8 & 0x1F, config >> 16 & 3

    def _output(self, channel: int) -> None:
        mode, pin, polarity = self._configured(channel)
        if mode == _TASK_MODE:
            is_high = bool(self._pins.levels >> pin & 1)
            self._pins.drive_by_task(pin, not is_high if polarity == _TOGGLE else polarity == _RISING)

    def write(self, offset: int, size: int, value: int) -> None:
        channel = (offset - _CONFIG) // 4
        if not 0 <= channel < _CHANNELS:
            super().write(offset, size, value)
            return
        mode, pin, _ = self._configured(channel)
        if mode == _TASK_MODE:
            self._pins.drive_by_task(pin, None)
        super().write(offset, size, value)
        mode, pin, _ = self._configured(channel)
        if mode == _TASK_MODE:
            self._pins.drive_by_task(pin, bool(value >> 20 & 1))
