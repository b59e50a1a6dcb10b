"""DWT: the cycle counter, and the slices of code between its readings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from hiltest.virtual.core.library import ffi, lib
from hiltest.virtual.core.machine import Machine, Snapshot
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.processor.slices import Slice

_READINGS = 400  # the core stores as many


@dataclass(frozen=True, slots=True)
class CounterReading:
    """One reading of CYCCNT."""

    cycles: int
    """Value that the firmware read."""
    snapshot: Snapshot
    """State before the instruction that read it."""
    answers: Any
    """Answers of devices to loads since the previous reading; None if there were too many."""

    @property
    def core_cycles(self) -> int:
        """Cycles since power-on, which no write to the counter changes."""
        cycles: int = self.snapshot.core.cycles
        return cycles

    @property
    def instructions(self) -> int:
        """Instructions executed since power-on."""
        instructions: int = self.snapshot.core.instructions
        return instructions

    def cycles_since(self, earlier: CounterReading) -> int:
        return (self.cycles - earlier.cycles) & 0xFFFFFFFF


class CycleCounter(CoreDevice):
    """DWT in the core's library: CYCCNT counts core cycles while TRCENA and CYCCNTENA are set."""

    counters = frozenset(range(4, 8))  # CYCCNT
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, machine: Machine) -> None:
        if not lib.machine_add_dwt(machine.handle):
            raise MemoryError
        super().__init__(machine, "DWT", 0xE0001000)
        self._machine = machine
        self._present = True
        self._readings: deque[CounterReading | None] = deque(maxlen=_READINGS)

    @property
    def present(self) -> bool:
        """Return whether the part has the counter; set it to False for a part without one (NOCYCCNT)."""
        return self._present

    @present.setter
    def present(self, present: bool) -> None:
        self._present = present
        lib.machine_set_counter(self._handle, present)

    @property
    def readings(self) -> deque[CounterReading | None]:
        """The latest readings by the firmware, oldest first; `forget` clears them.

        An entry None replaces the readings of a loop that polls the counter. Readings on its two sides are not
        successive.
        """
        reading = ffi.new("struct machine_reading *")
        while lib.machine_take_reading(self._handle, reading):
            self._readings.append(_reading(reading) if reading.snapshot else None)
        return self._readings

    def state(self) -> Any:
        """Return the state with the readings up to now."""
        self._readings = self.readings  # fetches the readings that the core still has
        return super().state()

    def restore(self, state: Any) -> None:
        """Return to a state; later readings are dropped."""
        self.readings.clear()
        super().restore(state)

    def forget(self) -> None:
        """Clear the readings before a request, so that its results come from new readings only."""
        self.readings.clear()

    def instructions_between(self, cycles: int) -> int | None:
        """Return the instructions between the latest two successive readings that are `cycles` apart.

        Firmware that times a function reads the counter before and after it; the difference that it reports identifies
        the two readings. The result is None if no two readings since `forget` differ by that many cycles.
        """
        readings = list(self.readings)
        for before, after in zip(readings[-2::-1], readings[:0:-1], strict=True):
            if before is not None and after is not None and after.cycles_since(before) == cycles:
                return after.instructions - before.instructions
        return None

    def executed_in(
        self, cycles: int, overhead_cycles: int, call: tuple[int, int] | None = None
    ) -> tuple[list[Slice], list[Slice]] | None:
        """Return the slices of a timed call, and of the empty call before it; None if they are unknown.

        Firmware reads the counter before and after an empty call, then before and after the timed call: these are the
        latest four successive readings since `forget` with those distances.

        Parameters
        ----------
        cycles, overhead_cycles
            As the firmware reports them.
        call
            Cycles since power-on at entry and return of the timed function, which the last two readings must enclose.
        """
        readings = list(self.readings)
        for place in range(len(readings) - 4, -1, -1):
            four = _successive(readings[place : place + 4])
            if not _match_step(four, cycles, overhead_cycles):
                continue
            if call is None or four[2].core_cycles <= call[0] <= call[1] <= four[3].core_cycles:
                return self._slices([four])
        return None

    def executed_in_steps(self, cycles: Sequence[int], overhead_cycles: int) -> tuple[list[Slice], list[Slice]] | None:
        """Return the slices of the latest timed steps, and of the empty calls before them.

        Each step has four readings, as in `executed_in`. The result is None if the latest readings do not match. After
        the reported steps, firmware may have timed one more step that it refused.
        """
        readings = list(self.readings)
        for end in (len(readings), len(readings) - 4):
            begin = end - 4 * len(cycles)
            steps = [_successive(readings[at : at + 4]) for at in range(begin, end, 4)] if begin >= 0 else []
            if steps and all(
                _match_step(four, step_cycles, overhead_cycles) for four, step_cycles in zip(steps, cycles, strict=True)
            ):
                return self._slices(steps)
        return None

    def _slices(self, steps: Iterable[Sequence[CounterReading]]) -> tuple[list[Slice], list[Slice]] | None:
        whole: list[Slice] = []
        empty: list[Slice] = []
        for four in steps:
            for slices, first, last in ((empty, four[0], four[1]), (whole, four[2], four[3])):
                if last.answers is None:
                    return None
                slices.append(_slice(self._machine, first, last))
        return whole, empty


def _reading(record: Any) -> CounterReading:
    count = record.answer_count
    answers = None if count < 0 else ffi.new("uint32_t[]", ffi.unpack(record.answers, count))
    return CounterReading(record.count, Snapshot(record.snapshot), answers)


def _slice(machine: Machine, first: CounterReading, last: CounterReading) -> Slice:
    """Return the slice between two successive readings."""
    instructions = last.instructions - first.instructions
    return Slice(machine, first.snapshot, last.core_cycles - first.core_cycles, instructions, last.answers)


def _successive(readings: Sequence[CounterReading | None]) -> list[CounterReading]:
    """Return the readings, or an empty list if one of them is None."""
    successive = [reading for reading in readings if reading is not None]
    return successive if len(successive) == len(readings) else []


def _match_step(four: Sequence[CounterReading], cycles: int, overhead_cycles: int) -> bool:
    """Return whether readings are those of a timed call and of the empty call before it."""
    if not four:
        return False
    spans = four[1].cycles_since(four[0]), four[3].cycles_since(four[2])
    return spans == (overhead_cycles, cycles + overhead_cycles)
