"""Recorder of snapshots from which the slices of a solution can be repeated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.core.machine import Snapshot
from hiltest.virtual.processor.call_summary import Call
from hiltest.virtual.processor.cpu import Processor

_MOST_SLICES = 4000  # of a solution; limits the memory of the snapshots


@dataclass(frozen=True, slots=True)
class SolutionSlice:
    """A call that computes a part of a solution."""

    function: str
    begin: Snapshot
    """State before the first instruction."""
    cycles: int
    """Cycles without exceptions and other tasks."""


@dataclass(frozen=True, slots=True)
class RecordedSolution:
    """A solution that can be repeated."""

    slices: tuple[SolutionSlice, ...]
    ended: int
    """Cycle at which the last slice returned."""

    @property
    def cycles(self) -> int:
        return sum(part.cycles for part in self.slices)


class SliceRecorder:
    """Recorder of a snapshot at the beginning of each slice of the latest solution.

    Parameters
    ----------
    processor
        Processor that is not running.
    watch
        Counter of the functions whose calls are slices.
    ends
        Returns whether a slice completed a solution, from the slice and the word after the previous slice.
    """

    def __init__(self, processor: Processor, watch: CallWatch, ends: Callable[[Call, int], bool]) -> None:
        self._machine, self._ends = processor.machine, ends
        self._functions, self._running = watch.functions, watch.running
        for function in self._functions.values():
            self._running.listen(function, self._enter)

    def begin(self, before: int, *, is_whole: bool) -> None:
        """Ignore slices that began before now; the parameters are those of `sum_solutions`."""
        self._running.fetch()
        self._processed = {name: len(function.calls) for name, function in self._functions.items()}
        self._before, self._has_ended = before, is_whole
        # Snapshots of the current and of the latest complete solution, by the cycle of the entry.
        self._begun: dict[int, Snapshot] | None = None
        self._ended: dict[int, Snapshot] | None = None

    def latest(self) -> RecordedSolution | None:
        """Return the latest complete solution; None if there is none."""
        self._catch_up()
        ended = self._begun if self._begun and self._has_ended else self._ended
        if ended is None:
            return None
        calls = sorted(
            (call, name)
            for name, function in self._functions.items()
            for call in function.calls
            if call.entered in ended
        )
        slices = tuple(SolutionSlice(name, ended[call.entered], call.cycles) for call, name in calls)
        return RecordedSolution(slices, ended=max(call.returned for call, _ in calls))

    def _catch_up(self) -> None:
        """Process the slices that have returned since the last call."""
        self._running.fetch()
        returned = [
            call for name, function in self._functions.items() for call in function.calls[self._processed[name] :]
        ]
        for call in sorted(returned, key=lambda call: call.returned):
            self._has_ended = self._has_ended or self._ends(call, self._before)
            self._before = call.word
        self._processed = {name: len(function.calls) for name, function in self._functions.items()}

    def _enter(self, cycle: int) -> None:
        self._catch_up()
        if self._has_ended:
            self._ended, self._has_ended = self._begun, False
            self._begun = {}
        if self._begun is None:
            return
        self._begun[cycle] = self._machine.snapshot()
        if len(self._begun) > _MOST_SLICES:
            self._begun = None
