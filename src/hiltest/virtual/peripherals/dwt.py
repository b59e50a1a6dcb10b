"""DWT: the cycle counter, and the slices between its readings."""

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

_READINGS = 400  # number of those kept, as the core keeps them


@dataclass(frozen=True, slots=True)
class CounterReading:
    """One reading of CYCCNT."""

    cycles: int
    """The answer."""
    snapshot: Snapshot
    """State before the instruction that read it."""
    answers: Any
    """What devices answered to loads since the reading before; None if they were too many."""

    @property
    def at(self) -> int:
        """Cycles since power-on, whatever the firmware does to the counter."""
        cycles: int = self.snapshot.core.cycles
        return cycles

    @property
    def instructions(self) -> int:
        """Instructions that had been executed by then."""
        instructions: int = self.snapshot.core.instructions
        return instructions

    def cycles_since(self, earlier: CounterReading) -> int:
        """Return the cycles from an earlier reading to this one."""
        return (self.cycles - earlier.cycles) & 0xFFFFFFFF


class CycleCounter(CoreDevice):
    """DWT, which the core's library has: CYCCNT counts core cycles while TRCENA and CYCCNTENA are set."""

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
        """Whether the part has the counter; set to False for one without it (NOCYCCNT)."""
        return self._present

    @present.setter
    def present(self, present: bool) -> None:
        self._present = present
        lib.machine_set_counter(self._handle, present)

    @property
    def readings(self) -> deque[CounterReading | None]:
        """The last few times that the firmware read it, oldest first; `forget` begins anew.

        None stands for those of a loop that polls the counter: nothing is successive across them.
        """
        taken = ffi.new("struct machine_reading *")
        while lib.machine_take_reading(self._handle, taken):
            self._readings.append(_reading(taken) if taken.snapshot else None)
        return self._readings

    def state(self) -> Any:
        """Return the state with the readings up to now."""
        self._readings = self.readings  # those that the core still has are taken
        return super().state()

    def restore(self, state: Any) -> None:
        """Go back to a state; readings that came later are dropped."""
        self.readings.clear()
        super().restore(state)

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
        cycles, overhead_cycles
            As the firmware reports them.
        call
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
                slices.append(_slice(self._machine, first, last))
        return whole, empty


def _reading(taken: Any) -> CounterReading:
    count = taken.answer_count
    answers = None if count < 0 else ffi.new("uint32_t[]", ffi.unpack(taken.answers, count))
    return CounterReading(taken.count, Snapshot(taken.snapshot), answers)


def _slice(machine: Machine, first: CounterReading, last: CounterReading) -> Slice:
    """Return what ran between two successive readings."""
    instructions = last.instructions - first.instructions
    return Slice(machine, first.snapshot, last.at - first.at, instructions, last.answers)


def _known(readings: Sequence[CounterReading | None]) -> list[CounterReading]:
    """Return successive readings; nothing where one was passed over."""
    known = [reading for reading in readings if reading is not None]
    return known if len(known) == len(readings) else []


def _are_of(four: Sequence[CounterReading], cycles: int, overhead_cycles: int) -> bool:
    """Say whether readings are those of a step and of the empty call before it."""
    if not four:
        return False
    spans = four[1].cycles_since(four[0]), four[3].cycles_since(four[2])
    return spans == (overhead_cycles, cycles + overhead_cycles)
