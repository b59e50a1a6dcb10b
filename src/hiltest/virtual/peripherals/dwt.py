"""DWT: the cycle counter, and the slices between its readings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from hiltest.state import Restorable
from hiltest.virtual.core.machine import NEVER, Machine, Snapshot
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.slices import Slice

_CYCCNT, _WORD = 4, 4
_POLLS, _SOON_CYCLES = 16, 40  # as many readings so soon after each other time nothing
_READINGS = 400
"""Number of readings kept: four for each of the steps that one command times, 80 at most, and some."""


@dataclass(frozen=True, slots=True)
class CounterReading:
    """One reading of CYCCNT, with the instructions that had been executed by then.

    Attributes
    ----------
    cycles : int
        The answer.
    at : int
        Cycles since power-on, whatever the firmware does to the counter.
    instructions : int
    snapshot : Snapshot
        State before the instruction that read it.
    answers : array of uint32_t or None
        What devices answered to loads since the reading before; None if they were too many.
    """

    cycles: int
    at: int
    instructions: int
    snapshot: Snapshot
    answers: Any

    def cycles_since(self, earlier: CounterReading) -> int:
        """Return the cycles from an earlier reading to this one."""
        return (self.cycles - earlier.cycles) & 0xFFFFFFFF


class CycleCounter(Restorable):
    """DWT: CYCCNT counts core cycles while TRCENA and CYCCNTENA are set.

    Attributes
    ----------
    present : bool
        Set to False for a part without the counter (NOCYCCNT).
    readings : deque of CounterReading or None
        The last few times that the firmware read it, oldest first; `forget` begins anew. None is a reading that the
        core has answered, in a loop that polls the counter: nothing is successive across it, and it takes the place of
        others as any does.
    """

    name = "DWT"
    base = 0xE0001000
    counters = frozenset(range(4, 8))  # CYCCNT
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor) -> None:
        self.clocked = True
        self._processor = processor
        self.present = True
        self.readings: deque[CounterReading | None] = deque(maxlen=_READINGS)
        self._loads = 0
        self._place, self._read_at, self._polls = 0, 0, 0  # of the latest reading; how many like it came before
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: stopped at zero."""
        self._control = 0
        self._trace = False
        self._count = 0
        self._counted_from = 0

    @property
    def _running(self) -> bool:
        return self._trace and bool(self._control & 1) and self.present

    def _hold(self) -> None:
        if self._running:
            now = self._processor.now()
            self._count += now - self._counted_from
            self._counted_from = now

    def enable_trace(self, enabled: bool) -> None:
        """Set DEMCR.TRCENA."""
        self._hold()
        self._trace = enabled
        self._counted_from = self._processor.now()

    def read(self, offset: int, size: int) -> int:
        """Answer CTRL or CYCCNT; the other counters read as zero."""
        if offset == 0:
            return 0x40000000 | self._control | (0 if self.present else 1 << 25)
        if offset == _CYCCNT:
            self._hold()
            count = self._count & 0xFFFFFFFF
            self.readings.append(self._reading(count))
            if size == _WORD and self._running and self._is_polled():
                self._processor.counts(1, NEVER)
            return count
        return 0

    def _is_polled(self) -> bool:
        """Whether one instruction reads the counter over and over, each time soon after the last."""
        core = self._processor.core
        place, last_place = core.r[15], self._place
        is_soon = core.cycles - self._read_at <= _SOON_CYCLES
        self._place, self._read_at = place, core.cycles
        self._polls = self._polls + 1 if place == last_place and is_soon else 0
        return self._polls >= _POLLS

    def repeated(self, address: int, place: int, reads: int) -> None:
        """Take note that the core has answered so many readings by the instruction at `place`."""
        if address == self.base + _CYCCNT:
            self.readings.extend([None] * min(reads, _READINGS))
            self._place, self._read_at, self._polls = place, self._processor.core.cycles, _POLLS

    def _reading(self, count: int) -> CounterReading:
        machine, core = self._processor.machine, self._processor.core
        answers, self._loads = machine.answers(self._loads), core.device_loads
        return CounterReading(count, core.cycles, core.instructions, machine.snapshot(), answers)

    def write(self, offset: int, size: int, value: int) -> None:
        """Take CTRL or CYCCNT."""
        self._hold()
        if offset == 0:
            self._control = value & 1
        elif offset == _CYCCNT:
            self._count = value
        self._counted_from = self._processor.now()

    def forget(self) -> None:
        """Drop the readings so far: a request begins, and what it reports is of readings that come now."""
        self.readings.clear()

    def instructions_between(self, cycles: int) -> int | None:
        """Count the instructions between two successive readings that lie `cycles` apart, the latest such.

        Firmware that times a function reads the counter before and behind it; the difference that it reports finds
        the two readings. None when no two since `forget` differ by that many cycles.
        """
        readings = list(self.readings)
        for before, behind in zip(readings[-2::-1], readings[:0:-1], strict=True):
            if before is not None and behind is not None and behind.cycles_since(before) == cycles:
                return behind.instructions - before.instructions
        return None

    def executed_in(
        self, cycles: int, overhead_cycles: int, call: tuple[int, int] | None = None
    ) -> tuple[list[Slice], list[Slice]] | None:
        """Return what ran while something was timed, and in the empty call before it; None if that is unknown.

        Firmware reads the counter before and behind an empty call, then before and behind what it times: the latest
        four successive readings since `forget` that lie so far apart.

        Parameters
        ----------
        cycles, overhead_cycles : int
            As the firmware reports them.
        call : (int, int), optional
            Cycles since power-on when what was timed was entered and left: the readings must be those around it.
        """
        readings = list(self.readings)
        for place in range(len(readings) - 4, -1, -1):
            four = _known(readings[place : place + 4])
            if not four:
                continue
            if call is not None and not four[2].at <= call[0] <= call[1] <= four[3].at:
                continue
            spans = four[1].cycles_since(four[0]), four[3].cycles_since(four[2])
            if spans == (overhead_cycles, cycles + overhead_cycles):
                return self._slices([four])
        return None

    def executed_in_steps(self, cycles: Sequence[int], overhead_cycles: int) -> tuple[list[Slice], list[Slice]] | None:
        """Return what ran in all the steps that were timed last, and in the empty calls before them.

        None when the latest readings are not theirs: four to a step, as `executed_in` has them. A step that was
        refused is timed too, behind all that were taken, and not told.
        """
        readings = list(self.readings)
        for end in (len(readings), len(readings) - 4):
            begin = end - 4 * len(cycles)
            steps = [_known(readings[at : at + 4]) for at in range(begin, end, 4)] if begin >= 0 else []
            if steps and all(_are_of(four, each, overhead_cycles) for four, each in zip(steps, cycles, strict=True)):
                return self._slices(steps)
        return None

    def _slices(self, steps: Iterable[Sequence[CounterReading]]) -> tuple[list[Slice], list[Slice]] | None:
        whole: list[Slice] = []
        empty: list[Slice] = []
        for four in steps:
            for slices, first, last in ((empty, four[0], four[1]), (whole, four[2], four[3])):
                if last.answers is None:
                    return None
                slices.append(_slice(self._processor.machine, first, last))
        return whole, empty


def _slice(machine: Machine, first: CounterReading, last: CounterReading) -> Slice:
    """Return what ran between two successive readings."""
    instructions = last.instructions - first.instructions
    return Slice(machine, first.snapshot, last.at - first.at, instructions, last.answers)


def _known(readings: Sequence[CounterReading | None]) -> list[CounterReading]:
    """Return successive readings; nothing where one was passed over."""
    known = [each for each in readings if each is not None]
    return known if len(known) == len(readings) else []


def _are_of(four: Sequence[CounterReading], cycles: int, overhead_cycles: int) -> bool:
    """Say whether readings are those of a step and of the empty call before it."""
    if not four:
        return False
    spans = four[1].cycles_since(four[0]), four[3].cycles_since(four[2])
    return spans == (overhead_cycles, cycles + overhead_cycles)
