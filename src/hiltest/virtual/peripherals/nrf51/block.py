"""Tasks, events, shortcuts and the interrupt that every block of the nRF51 has in the same places."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from hiltest.state import Restorable
from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_EVENTS, _EVENTS_END = 0x100, 0x180
_SHORTS, _INTEN, _INTENSET, _INTENCLR = 0x200, 0x300, 0x304, 0x308
_POWER = 0xFFC
#: High-frequency clock [Hz], which is also the core's; no prescaler changes it.
CLOCK_HZ = 16_000_000


class Block(StoredRegisters):
    """A block with tasks and events; its other registers store writes.

    A write of 1 triggers a task. An event is a register that the block sets, firmware clears, and bit n of INTEN lets
    interrupt, where n counts the event registers from 0x100. `on_event` passes events to the PPI.

    Parameters
    ----------
    shortcuts
        Bit of SHORTS, address of the event and of the task that it triggers.
    """

    steady = ALL_STEADY

    def __init__(
        self,
        processor: Processor,
        chip: Chip,
        module: ChipPeripheral,
        *,
        tasks: Mapping[int, Callable[[], None]],
        shortcuts: Iterable[tuple[int, int, int]] = (),
    ) -> None:
        self._processor = processor
        self._interrupt = module.interrupts[0] if module.interrupts else None
        self._tasks = tasks
        self._shortcuts = tuple(shortcuts)
        self._enabled = 0  # INTEN
        self._set_events = 0
        self.on_event: Callable[[int], None] = lambda _address: None
        super().__init__(module.name, module.base, chip.reset_bytes(module.base))

    def parts(self) -> list[Alarm]:
        return [value for value in vars(self).values() if isinstance(value, Alarm)]

    def reset(self) -> None:
        super().reset()
        self._enabled = self._set_events = 0
        self._drive()

    def trigger(self, offset: int) -> None:
        """Start a task; offsets without a task have no effect."""
        if task := self._tasks.get(offset):
            task()

    def set_event(self, offset: int) -> None:
        """Set an event: it interrupts if enabled, and triggers the tasks that SHORTS and the PPI connect to it."""
        self._set_events |= 1 << (offset - _EVENTS) // 4
        self._drive()
        shorts = self.word(_SHORTS)
        for bit, event, task in self._shortcuts if shorts else ():
            if event == offset and shorts >> bit & 1:
                self.trigger(task)
        self.on_event(self.base + offset)

    def has_event(self, offset: int) -> bool:
        return bool(self._set_events >> (offset - _EVENTS) // 4 & 1)

    def store_word(self, offset: int, value: int) -> None:
        """Set a register from inside of the block."""
        self._bytes[offset : offset + 4] = (value & 0xFFFFFFFF).to_bytes(4, "little")

    def read(self, offset: int, size: int) -> int:
        if _EVENTS <= offset < _EVENTS_END:
            return int(self.has_event(offset & ~3)) if offset % 4 == 0 else 0
        if _INTEN <= offset < _INTENCLR + 4:
            return self._enabled >> 8 * (offset % 4)
        return super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        """Trigger a task, clear an event, enable interrupts, or store a register."""
        if offset < _EVENTS:
            if value & 1:
                self.trigger(offset)
        elif offset < _EVENTS_END:
            if value & 1:
                self.set_event(offset)
            else:
                self._set_events &= ~(1 << (offset - _EVENTS) // 4)
                self._drive()
        elif _INTEN <= offset <= _INTENCLR:
            self._enabled = changed_bits(self._enabled, offset - _INTEN, value)
            self._drive()
        else:
            super().write(offset, size, value)
            if offset == _POWER and not value & 1:
                self.reset()

    def _drive(self) -> None:
        if self._interrupt is not None:
            self._processor.nvic.set_line(self._interrupt, bool(self._set_events & self._enabled))


def changed_bits(before: int, offset: int, value: int) -> int:
    """Return a register after a write to it (offset 0), to its set register (4) or to its clear register (8)."""
    return (value, before | value, before & ~value)[offset // 4]


class Alarm(Restorable):
    """One planned action of a block, at a cycle of the core; planning it again replaces it."""

    def __init__(self, processor: Processor, action: Callable[[], None], *, wakes: bool = True) -> None:
        self._processor, self._action, self._wakes = processor, action, wakes
        self._event: Event | None = None

    @property
    def is_planned(self) -> bool:
        return self._event is not None and self._event.action is not None

    def at(self, cycle: float) -> None:
        self.cancel()
        self._event = self._processor.schedule.call_at(cycle, self._action, wakes=self._wakes)

    def after(self, cycles: float) -> None:
        self.at(self._processor.now() + cycles)

    def cancel(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None
