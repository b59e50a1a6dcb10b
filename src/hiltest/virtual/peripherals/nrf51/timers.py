"""TIMER and RTC: counters whose compare events are planned, and whose counts are computed when they are needed."""

from __future__ import annotations

from functools import partial

from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.nrf51.block import CLOCK_HZ, Alarm, Block, changed_bits
from hiltest.virtual.processor.cpu import Processor

_START, _STOP, _CLEAR, _SHUTDOWN, _TRIGGER_OVERFLOW, _COUNT = 0x00, 0x04, 0x0C, 0x10, 0x0C, 0x08
_CAPTURE, _COMPARE, _CC, _CHANNELS = 0x40, 0x140, 0x540, 4
_MODE, _BITMODE, _PRESCALER = 0x504, 0x508, 0x510
_WIDTHS = (16, 8, 24, 32)  # bits, by BITMODE
_RTC_CLEAR, _OVERFLOW, _EVENTS_ENABLED, _COUNTER, _RTC_PRESCALER = 0x08, 0x104, 0x340, 0x504, 0x508
_RTC_BITS, _TRIGGERED = 24, 0xFFFFF0
_LOW_FREQUENCY_HZ = 32_768


class _Counter(Block):
    """A counter of a prescaled clock with four compare registers."""

    bits: int
    _alarm: Alarm

    def reset(self) -> None:
        self._running = False
        self._count = 0  # at the cycle `_since`, while it runs with the remainder of a tick before that cycle
        self._since = 0
        self._due = 0  # ticks since then at the planned event
        self._at: int | None = None  # cycle of the event that is being set
        super().reset()
        self._plan()

    def _ticks(self, cycles: int) -> int:
        """Return the ticks in a number of cycles since the prescaler began."""
        raise NotImplementedError

    def _cycle_of(self, ticks: int) -> int:
        """Return the first cycle at or after a number of ticks."""
        raise NotImplementedError

    def _now(self) -> int:
        return self._processor.now() if self._at is None else self._at

    def count(self) -> int:
        """Return the present count."""
        passed = self._ticks(self._now() - self._since) if self._running else 0
        return (self._count + passed) & (1 << self.bits) - 1

    def _set_count(self, count: int, *, running: bool) -> None:
        self._count, self._running, self._since = count, running, self._now()
        self._plan()

    def _start(self) -> None:
        if not self._running:
            self._set_count(self._count, running=True)

    def _stop(self) -> None:
        self._set_count(self.count(), running=False)

    def _clear(self) -> None:
        self._set_count(0, running=self._running)

    def _compared(self) -> dict[int, int]:
        """Return the counts at which events are due, by the address of the event."""
        return {_COMPARE + 4 * n: self.word(_CC + 4 * n) & (1 << self.bits) - 1 for n in range(_CHANNELS)}

    def _plan(self) -> None:
        """Plan the next compare event after the present count."""
        self._plan_after(self._ticks(self._now() - self._since))

    def _plan_after(self, ticks: int) -> None:
        compared = self._compared() if self._running else {}
        if not compared:
            self._alarm.cancel()
            return
        whole = 1 << self.bits
        now = (self._count + ticks) % whole
        self._due = ticks + min((at - now - 1) % whole + 1 for at in compared.values())
        self._alarm.at(self._since + self._cycle_of(self._due))

    def _compare(self) -> None:
        """Set the events of the planned count; the core may have passed it meanwhile."""
        due = self._due
        count, self._at = (self._count + due) & (1 << self.bits) - 1, self._since + self._cycle_of(due)
        for event in [event for event, at in self._compared().items() if at == count]:
            self.set_event(event)
        self._at = None
        if self._due == due and not self._alarm.is_planned:
            self._plan_after(due)


class Timer(_Counter):
    """TIMER0 to TIMER2: the 16 MHz clock through a prescaler, or a counter of tasks."""

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self._alarm = Alarm(processor, self._compare)
        tasks = {_START: self._start, _STOP: self._stop, _CLEAR: self._clear, _SHUTDOWN: self._stop}
        tasks |= {_COUNT: self._count_up}
        tasks |= {_CAPTURE + 4 * n: partial(self._capture, n) for n in range(_CHANNELS)}
        clears = ((n, _COMPARE + 4 * n, _CLEAR) for n in range(_CHANNELS))
        stops = ((8 + n, _COMPARE + 4 * n, _STOP) for n in range(_CHANNELS))
        super().__init__(processor, chip, module, tasks=tasks, shortcuts=(*clears, *stops))

    @property
    def bits(self) -> int:  # type: ignore[override]
        """Width of the counter."""
        return _WIDTHS[self.word(_BITMODE) & 3]

    @property
    def _shift(self) -> int:
        return min(self.word(_PRESCALER) & 0xF, 9)

    def _ticks(self, cycles: int) -> int:
        return 0 if self._counts_tasks else cycles >> self._shift

    def _cycle_of(self, ticks: int) -> int:
        return ticks << self._shift

    @property
    def _counts_tasks(self) -> bool:
        return bool(self.word(_MODE) & 1)

    def _compared(self) -> dict[int, int]:
        return {} if self._counts_tasks else super()._compared()

    def _count_up(self) -> None:
        if self._counts_tasks and self._running:
            self._count = (self._count + 1) & (1 << self.bits) - 1
            for event, at in super()._compared().items():
                if at == self._count:
                    self.set_event(event)

    def _capture(self, channel: int) -> None:
        self.store_word(_CC + 4 * channel, self.count())
        self._plan()

    def write(self, offset: int, size: int, value: int) -> None:
        """Write a register; a change of the prescaler or width takes effect at once."""
        changes = offset in (_MODE, _BITMODE, _PRESCALER) or _CC <= offset < _CC + 4 * _CHANNELS
        if offset in (_MODE, _BITMODE, _PRESCALER):
            count = self.count()
            super().write(offset, size, value)
            self._set_count(count & (1 << self.bits) - 1, running=self._running)
        else:
            super().write(offset, size, value)
            if changes:
                self._plan()


class RealTimeCounter(_Counter):
    """RTC0 and RTC1: 24 bits that count the 32.768 kHz clock through a prescaler. The event TICK is not modelled."""

    bits = _RTC_BITS
    counters = frozenset(range(_COUNTER, _COUNTER + 4))
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self._alarm = Alarm(processor, self._compare)
        self._events_enabled = 0  # EVTEN
        tasks = {_START: self._start, _STOP: self._stop, _RTC_CLEAR: self._clear}
        tasks |= {_TRIGGER_OVERFLOW: lambda: self._set_count(_TRIGGERED, running=self._running)}
        super().__init__(processor, chip, module, tasks=tasks)

    def reset(self) -> None:
        self._events_enabled = 0
        super().reset()

    @property
    def _divider(self) -> int:
        return (self.word(_RTC_PRESCALER) & 0xFFF) + 1

    def _ticks(self, cycles: int) -> int:
        return cycles * _LOW_FREQUENCY_HZ // (CLOCK_HZ * self._divider)

    def _cycle_of(self, ticks: int) -> int:
        return -(-ticks * CLOCK_HZ * self._divider // _LOW_FREQUENCY_HZ)

    def _compared(self) -> dict[int, int]:
        """Return the counts of the events that interrupts or EVTEN enable."""
        wanted = self._enabled | self._events_enabled
        compared = {event: at for event, at in super()._compared().items() if wanted >> (event - 0x100) // 4 & 1}
        if wanted & 2:
            compared[_OVERFLOW] = 0
        return compared

    def read(self, offset: int, size: int) -> int:
        if offset == _COUNTER:
            return self.count()
        if _EVENTS_ENABLED <= offset < _EVENTS_ENABLED + 12:
            return self._events_enabled
        return super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        if _EVENTS_ENABLED <= offset < _EVENTS_ENABLED + 12:
            self._events_enabled = changed_bits(self._events_enabled, offset - _EVENTS_ENABLED, value)
        else:
            super().write(offset, size, value)
        self._plan()
