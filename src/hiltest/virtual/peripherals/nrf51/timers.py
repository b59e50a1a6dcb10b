"""TIMER, in the core's library (core/nrf51_timer.c), and RTC, whose compare events are planned here."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.nrf51.block import CLOCK_HZ, Alarm, Block, changed_bits
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor

_START, _STOP, _CLEAR, _TRIGGER_OVERFLOW = 0x00, 0x04, 0x08, 0x0C
_COMPARE, _CC, _CHANNELS = 0x140, 0x540, 4
_OVERFLOW, _EVENTS_ENABLED, _COUNTER, _PRESCALER = 0x104, 0x340, 0x504, 0x508
_COUNTS, _TRIGGERED = 1 << 24, 0xFFFFF0
_LOW_FREQUENCY_HZ = 32_768


class Timer(CoreDevice):
    """TIMER0 to TIMER2.

    Attributes
    ----------
    on_event : callable
        Called with the address of each compare event while `is_routed`.
    """

    steady = ALL_STEADY

    def __init__(self, processor: Processor, clock: Clock, module: ChipPeripheral) -> None:
        machine = processor.machine
        self.on_event: Callable[[int], None] = lambda _address: None
        self._route = guarded_callback("void(void *, uint32_t)", lambda event: self.on_event(event), processor.abort)
        connections = ffi.new("struct machine_nrf51_timer *")
        (connections.interrupt,), connections.clock = module.interrupts, clock.number_in(machine)
        connections.route = self._route
        if not lib.machine_add_nrf51_timer(machine.handle, module.base, connections[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)

    def route(self, is_routed: bool) -> None:
        """Report events from now on, or no longer."""
        lib.machine_route_nrf51_timer(self._handle, self.base, is_routed)

    def trigger(self, offset: int) -> None:
        """Start a task."""
        self.write(offset, 4, 1)


class RealTimeCounter(Block):
    """RTC0 and RTC1: 24 bits that count the 32.768 kHz clock through a prescaler. The event TICK is not modelled."""

    counters = frozenset(range(_COUNTER, _COUNTER + 4))
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self._alarm = Alarm(processor, self._compare)
        tasks = {_START: self._start, _STOP: self._stop, _CLEAR: self._clear}
        tasks |= {_TRIGGER_OVERFLOW: lambda: self._set_count(_TRIGGERED, running=self._running)}
        super().__init__(processor, chip, module, tasks=tasks)

    def reset(self) -> None:
        self._events_enabled = 0  # EVTEN
        self._running = False
        self._count = 0  # at the cycle `_since`
        self._since = 0
        self._due = 0  # ticks since then at the planned event
        super().reset()
        self._plan()

    @property
    def _divider(self) -> int:
        return (self.word(_PRESCALER) & 0xFFF) + 1

    def _ticks(self) -> int:
        """Return the counts since `_since`."""
        cycles = self._processor.now() - self._since
        return cycles * _LOW_FREQUENCY_HZ // (CLOCK_HZ * self._divider) if self._running else 0

    def count(self) -> int:
        """Return the present count."""
        return (self._count + self._ticks()) % _COUNTS

    def _set_count(self, count: int, *, running: bool) -> None:
        self._count, self._running, self._since = count, running, self._processor.now()
        self._plan()

    def _start(self) -> None:
        if not self._running:
            self._set_count(self._count, running=True)

    def _stop(self) -> None:
        self._set_count(self.count(), running=False)

    def _clear(self) -> None:
        self._set_count(0, running=self._running)

    def _compared(self) -> dict[int, int]:
        """Return the counts of the events that interrupts or EVTEN enable, by the address of the event."""
        wanted = self._enabled | self._events_enabled
        counts = {_COMPARE + 4 * n: self.word(_CC + 4 * n) % _COUNTS for n in range(_CHANNELS)} | {_OVERFLOW: 0}
        return {event: at for event, at in counts.items() if wanted >> (event - 0x100) // 4 & 1}

    def _plan(self) -> None:
        """Plan the next event after the present count."""
        self._plan_after(self._ticks())

    def _plan_after(self, ticks: int) -> None:
        compared = self._compared() if self._running else {}
        if not compared:
            self._alarm.cancel()
            return
        now = self._count + ticks
        self._due = ticks + min((at - now - 1) % _COUNTS + 1 for at in compared.values())
        self._alarm.at(self._since - -self._due * CLOCK_HZ * self._divider // _LOW_FREQUENCY_HZ)

    def _compare(self) -> None:
        """Set the events of the planned count; the core may have passed it meanwhile."""
        due = self._due
        count = (self._count + due) % _COUNTS
        for event in [event for event, at in self._compared().items() if at == count]:
            self.set_event(event)
        if self._due == due and not self._alarm.is_planned:
            self._plan_after(due)

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
