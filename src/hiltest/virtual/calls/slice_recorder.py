"""Snapshots at the beginnings of a solution's slices, for executing them again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.core.machine import Snapshot
from hiltest.virtual.processor.call_summary import Call
from hiltest.virtual.processor.cpu import Processor

_MOST_SLICES = 4000  # per solution, which limits the memory of their snapshots


@dataclass(frozen=True, slots=True)
class Slice:
    """One call, as a part of a solution."""

    function: str
    begin: Snapshot
    """State before the first instruction."""
    cycles: int
    """Cycles without exceptions and other tasks."""


@dataclass(frozen=True, slots=True)
class RecordedSolution:
    """A solution that can be computed again."""

    slices: tuple[Slice, ...]
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
        Watches the functions whose calls are slices.
    ends
        Returns whether a slice was the last of a solution, from the slice and the word after the previous slice.
    """

    def __init__(self, processor: Processor, watch: CallWatch, ends: Callable[[Call, int], bool]) -> None:
        self._machine, self._ends = processor.machine, ends
        self._functions, self._running = watch.functions, watch.running
        for function in self._functions.values():
            self._running.listen(function, self._enter)

    def begin(self, before: int, *, is_whole: bool) -> None:
        """Ignore slices that began before now; `sum_solutions` describes the parameters."""
        self._running.settle()
        self._processed = {name: len(function.calls) for name, function in self._functions.items()}
        self._before, self._has_ended = before, is_whole
        # The current and the latest complete solution: a snapshot for each entry, by its cycle.
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
        slices = tuple(Slice(name, ended[call.entered], call.cycles) for call, name in calls)
        return RecordedSolution(slices, ended=max(call.returned for call, _ in calls))

    def _catch_up(self) -> None:
        """Process the slices that have returned since the last call."""
        self._running.settle()
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
