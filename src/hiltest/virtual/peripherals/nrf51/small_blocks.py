"""CLOCK and POWER, PPI, RNG and TEMP."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable

from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.nrf51.block import CLOCK_HZ, Alarm, Block, changed_bits
from hiltest.virtual.peripherals.nrf51.timers import Timer
from hiltest.virtual.peripherals.rcm import ResetSource
from hiltest.virtual.processor.cpu import Processor

_HF_START, _HF_STOP, _LF_START, _LF_STOP, _CALIBRATE = 0x00, 0x04, 0x08, 0x0C, 0x10
_HF_STARTED, _LF_STARTED, _CALIBRATED = 0x100, 0x104, 0x10C
_RESET_REASON, _HF_RUN, _HF_STATUS, _LF_RUN, _LF_STATUS, _LF_COPY, _LF_SOURCE = (
    0x400, 0x408, 0x40C, 0x414, 0x418, 0x41C, 0x518,
)  # fmt: skip
_RUNS, _CRYSTAL = 1 << 16, 1
_HF_START_US, _LF_START_US, _CALIBRATION_US = 800, 600, 16_000  # 16 MHz and 32.768 kHz crystal or RC, typical
_REASONS = {ResetSource.PIN: 1, ResetSource.WATCHDOG: 2, ResetSource.SOFTWARE: 4}
_ENABLED, _CHANNEL, _CHANNELS = 0x500, 0x510, 16
_MOST_TASKS = 256  # that one event leads to; channels that lead back to it end here
_RNG_CONFIG, _VALUE, _VALUE_READY = 0x504, 0x508, 0x100
_RAW_US, _CORRECTED_US = 167, 677  # a byte without and with bias correction, typical
_DATA_READY, _TEMP, _MEASUREMENT_US, _STEPS_A_DEGREE = 0x100, 0x508, 35, 4


def cycles_of(us: float) -> int:
    """Return the core cycles of a duration."""
    return round(us * CLOCK_HZ / 1_000_000)


class ClockAndPower(Block):
    """CLOCK and POWER, which share a page: oscillators start after their time, and the core keeps its clock."""

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self._fast = Alarm(processor, lambda: self._started(_HF_STARTED, _HF_STATUS, _CRYSTAL))
        self._slow = Alarm(processor, lambda: self._started(_LF_STARTED, _LF_STATUS, self.word(_LF_COPY)))
        self._calibration = Alarm(processor, lambda: self.set_event(_CALIBRATED))
        tasks = {
            _HF_START: self._start_fast,
            _HF_STOP: lambda: self._stop(self._fast, _HF_RUN, _HF_STATUS),
            _LF_START: self._start_slow,
            _LF_STOP: lambda: self._stop(self._slow, _LF_RUN, _LF_STATUS),
            _CALIBRATE: lambda: self._calibration.after(cycles_of(_CALIBRATION_US)),
        }
        super().__init__(processor, chip, module, tasks=tasks)

    def reset(self) -> None:
        """Keep RESETREAS, which firmware clears."""
        reasons = self.word(_RESET_REASON) if hasattr(self, "_bytes") else 0
        super().reset()
        self.store_word(_RESET_REASON, reasons)
        for alarm in self.parts():
            alarm.cancel()

    def note_reset(self, source: ResetSource) -> None:
        """Note the source of the reset in RESETREAS."""
        reasons = 0 if source is ResetSource.POWER_ON else self.word(_RESET_REASON)
        self.store_word(_RESET_REASON, reasons | _REASONS.get(source, 0))

    def _start_fast(self) -> None:
        self.store_word(_HF_RUN, 1)
        self._fast.after(cycles_of(_HF_START_US))

    def _start_slow(self) -> None:
        self.store_word(_LF_RUN, 1)
        self.store_word(_LF_COPY, self.word(_LF_SOURCE))
        self._slow.after(cycles_of(_LF_START_US))

    def _started(self, event: int, status: int, source: int) -> None:
        self.store_word(status, _RUNS | source)
        self.set_event(event)

    def _stop(self, start: Alarm, run: int, status: int) -> None:
        start.cancel()
        self.store_word(run, 0)
        self.store_word(status, 0)

    def write(self, offset: int, size: int, value: int) -> None:
        if offset == _RESET_REASON:
            self.store_word(offset, self.word(offset) & ~value)
        else:
            super().write(offset, size, value)


class EventRouter(Block):
    """PPI: channels from an event of a block to a task of another one. Channel groups are not modelled."""

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self._blocks: dict[int, Block | Timer] = {}
        self._channels: dict[int, list[int]] = {}  # task endpoints of the enabled channels, by event
        self._pending: list[int] = []
        self._is_routing = False
        super().__init__(processor, chip, module, tasks={})

    def connect(self, blocks: Iterable[Block | Timer]) -> None:
        """Connect the blocks whose events and tasks it routes."""
        for block in blocks:
            self._blocks[block.base] = block
            block.on_event = self._route

    def reset(self) -> None:
        super().reset()
        self._channels = {}
        self._pending.clear()

    def _route(self, event: int) -> None:
        self._pending += self._channels.get(event, ())
        if self._is_routing:
            return  # an event of a task: the loop below has it next
        self._is_routing = True
        try:
            for _ in range(_MOST_TASKS):
                if not self._pending:
                    return
                task = self._pending.pop(0)
                if block := self._blocks.get(task & ~0xFFF):
                    block.trigger(task & 0xFFF)
            self._pending.clear()
        finally:
            self._is_routing = False

    def read(self, offset: int, size: int) -> int:
        return super().read(_ENABLED if _ENABLED <= offset < _ENABLED + 12 else offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        if _ENABLED <= offset < _ENABLED + 12:
            self.store_word(_ENABLED, changed_bits(self.word(_ENABLED), offset - _ENABLED, value))
        else:
            super().write(offset, size, value)
        self._channels = {}
        for channel in range(_CHANNELS):
            if self.word(_ENABLED) >> channel & 1:
                event, task = self.word(_CHANNEL + 8 * channel), self.word(_CHANNEL + 8 * channel + 4)
                self._channels.setdefault(event, []).append(task)
        for block in self._blocks.values():
            if isinstance(block, Timer):
                block.route(any(event & ~0xFFF == block.base for event in self._channels))


class RandomNumbers(Block):
    """RNG: bytes that are a hash of the seed and of their number since power-on."""

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self.seed = 0
        self._made = 0
        self._next = Alarm(processor, self._make, wakes=True)
        super().__init__(processor, chip, module, tasks={0x00: self._start, 0x04: self._next.cancel},
                         shortcuts=((0, _VALUE_READY, 0x04),))  # fmt: skip

    def reset(self) -> None:
        super().reset()
        self._next.cancel()

    def _start(self) -> None:
        self._next.after(cycles_of(_CORRECTED_US if self.word(_RNG_CONFIG) & 1 else _RAW_US))

    def _make(self) -> None:
        self.store_word(_VALUE, hashlib.sha256(f"{self.seed} {self._made}".encode()).digest()[0])
        self._made += 1
        self._start()
        self.set_event(_VALUE_READY)


class Thermometer(Block):
    """TEMP, whose result has a resolution of 0.25 degC.

    Attributes
    ----------
    temperature_degc : callable
        Returns the temperature of the chip.
    """

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self.temperature_degc: Callable[[], float] = lambda: 25.0
        self._ready = Alarm(processor, self._measure)
        start = lambda: self._ready.after(cycles_of(_MEASUREMENT_US))  # noqa: E731
        super().__init__(processor, chip, module, tasks={0x00: start, 0x04: self._ready.cancel})

    def _measure(self) -> None:
        self.store_word(_TEMP, round(_STEPS_A_DEGREE * self.temperature_degc()))
        self.set_event(_DATA_READY)
