"""TIM2 to TIM5 and TIM9 to TIM11 as counters with update and compare events."""

from __future__ import annotations

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.stm32.block import Block
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_CR1, _DIER, _SR, _EGR, _CNT, _PSC, _ARR, _CCR1 = 0x00, 0x0C, 0x10, 0x14, 0x24, 0x28, 0x2C, 0x34
_CEN, _UDIS, _URS, _OPM, _ARPE, _UIF, _CHANNELS = 1, 2, 4, 8, 0x80, 1, 4


class Timer(Block):
    """A timer that counts upwards; down and centre-aligned counting, slave modes, capture and outputs have no model."""

    counters = frozenset(range(_CNT, _CNT + 4))
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, module: ChipPeripheral, clock: Clock, bits: int) -> None:
        self._clock, self._mask = clock, (1 << bits) - 1
        self._event: Event | None = None
        super().__init__(processor, module)

    def reset(self) -> None:
        super().reset()
        self.store_word(_ARR, self._mask)
        self._count = self._since = self._prescaler = 0  # the count at the tick `_since`; PSC from an update on
        self._reload = self._mask  # ARR, with ARPE from an update on
        self._plan()
        self.drive_interrupt(False)

    @property
    def _counts(self) -> bool:
        return bool(self.word(_CR1) & _CEN and self._reload)

    def _passed(self) -> int:
        """Return the counts since `_since`."""
        return (self._clock.now() - self._since) // (self._prescaler + 1) if self._counts else 0

    def _left(self) -> int:
        """Return the counts from `_count` to the next overflow; a count above ARR first runs to the largest number."""
        return (self._reload if self._count <= self._reload else self._mask) - self._count + 1

    def count(self) -> int:
        """Return the present count."""
        passed, left = self._passed(), self._left()
        return self._count + passed if passed < left else (passed - left) % (self._reload + 1)

    def _hold(self) -> None:
        """Keep the present count before a setting changes; the prescaler keeps its fraction of a count."""
        passed = self._passed()
        self._count = self.count()
        self._since = self._since + passed * (self._prescaler + 1) if self._counts else self._clock.now()

    def _plan(self) -> None:
        """Plan the next event that sets a flag which is clear, or loads a buffered register."""
        if self._event is not None:
            self._event.cancel()
            self._event = None
        if not self._counts:
            return
        left, status = self._left(), self.word(_SR)
        distances = [left]
        for channel in range(_CHANNELS):
            value = self.word(_CCR1 + 4 * channel) & self._mask
            if not status >> channel + 1 & 1 and value <= self._reload:
                ahead = value - self._count if value > self._count else left + value
                distances.append(ahead)
        tick = self._since + min(distances) * (self._prescaler + 1)
        self._event = self._clock.call_at(tick, self._reach)

    def _reach(self) -> None:
        """Set the flags of the count that is reached."""
        assert self._event is not None
        tick_before, left = self._since, self._left()
        due = (self._clock.now() - tick_before) // (self._prescaler + 1)
        flags = 0
        for channel in range(_CHANNELS):
            value = self.word(_CCR1 + 4 * channel) & self._mask
            ahead = value - self._count if value > self._count else left + value
            flags |= 1 << channel + 1 if value <= self._reload and ahead <= due else 0
        if due >= left:
            self._since = tick_before + left * (self._prescaler + 1)
            self._count = 0
            if self.word(_CR1) & _OPM:
                self.change_word(_CR1, clear=_CEN)
            if not self.word(_CR1) & _UDIS:
                self._load()
                flags |= _UIF
        else:
            self._hold()
        self.change_word(_SR, put=flags)
        self._plan()
        self._drive()

    def _load(self) -> None:
        self._prescaler, self._reload = self.word(_PSC) & 0xFFFF, self.word(_ARR) & self._mask

    def _drive(self) -> None:
        self.drive_interrupt(bool(self.word(_SR) & self.word(_DIER) & 0x1F))

    def read_word(self, offset: int) -> int:
        return self.count() if offset == _CNT else 0 if offset == _EGR else self.word(offset)

    def write_word(self, offset: int, value: int, mask: int) -> None:
        if offset == _SR:
            self.change_word(_SR, clear=mask & ~value)  # written ones have no effect
            self._hold()
        elif offset == _EGR:
            self._hold()
            self._generate(value)
        else:
            self._hold()
            before = self.count()
            super().write_word(offset, value, mask)
            self._configure(offset, before)
        self._plan()
        self._drive()

    def _generate(self, events: int) -> None:
        if events & 1 and not self.word(_CR1) & _UDIS:
            self._count, self._since = 0, self._clock.now()
            self._load()
            self.change_word(_SR, put=0 if self.word(_CR1) & _URS else _UIF)
        self.change_word(_SR, put=events & 0x1E)

    def _configure(self, offset: int, before: int) -> None:
        """Apply a register that was written while the count was `before`."""
        self._count = before
        if offset == _CNT:
            self._count, self._since = self.word(_CNT) & self._mask, self._clock.now()
        elif offset == _ARR and not self.word(_CR1) & _ARPE:
            self._reload = self.word(_ARR) & self._mask
        elif offset == _CR1:
            self._since = self._clock.now() if not self.word(_CR1) & _CEN else self._since
