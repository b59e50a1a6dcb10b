"""Snapshots of where the slices of a solution began, so that they can be executed once more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.core.machine import Snapshot
from hiltest.virtual.processor.call_summary import Call
from hiltest.virtual.processor.cpu import Processor

_MOST_SLICES = 4000  # of a solution, so that their snapshots have room


@dataclass(frozen=True, slots=True)
class Slice:
    """One call of a solution."""

    function: str
    begin: Snapshot
    """State before its first instruction."""
    cycles: int
    """What it took, without exceptions and other tasks."""


@dataclass(frozen=True, slots=True)
class KeptSolution:
    """A solution that can be computed once more."""

    slices: tuple[Slice, ...]
    ended: int
    """Cycle at which its last slice returned."""

    @property
    def cycles(self) -> int:
        """Cycles of all slices."""
        return sum(each.cycles for each in self.slices)


class KeptSlices:
    """Keeps where the slices of the latest solution began.

    Parameters
    ----------
    processor
        The emulator must not be running.
    watch
        Of the functions whose calls are slices.
    ends
        Whether a slice was the last of a solution, by the slice and by what the one before it left.
    """

    def __init__(self, processor: Processor, watch: CallWatch, ends: Callable[[Call, int], bool]) -> None:
        self._machine, self._ends = processor.machine, ends
        self._functions, self._running = watch.functions, watch.running
        for function in self._functions.values():
            self._running.listen(function, self._enters)

    def begin(self, before: int, *, is_whole: bool) -> None:
        """Leave out what began before now; see `solved` for the parameters."""
        self._running.settle()
        self._seen = {name: len(each.calls) for name, each in self._functions.items()}
        self._before, self._has_ended = before, is_whole
        # Solutions under way and completed: a snapshot of each entry, by its cycle.
        self._begun: dict[int, Snapshot] | None = None
        self._ended: dict[int, Snapshot] | None = None

    def latest(self) -> KeptSolution | None:
        """Return the solution that was completed last; None where none was."""
        self._catch_up()
        ended = self._begun if self._begun and self._has_ended else self._ended
        if ended is None:
            return None
        calls = sorted(
            (call, name) for name, each in self._functions.items() for call in each.calls
            if call.entered in ended
        )  # fmt: skip
        slices = tuple(Slice(name, ended[call.entered], call.cycles) for call, name in calls)
        return KeptSolution(slices, ended=max(call.returned for call, _ in calls))

    def _catch_up(self) -> None:
        """Look at the slices that have returned meanwhile."""
        self._running.settle()
        returned = [
            call for name, each in self._functions.items() for call in each.calls[self._seen[name] :]
        ]
        for call in sorted(returned, key=lambda call: call.returned):
            self._has_ended = self._has_ended or self._ends(call, self._before)
            self._before = call.left
        self._seen = {name: len(each.calls) for name, each in self._functions.items()}

    def _enters(self, cycle: int) -> None:
        self._catch_up()
        if self._has_ended:
            self._ended, self._has_ended = self._begun, False
            self._begun = {}
        if self._begun is None:
            return
        self._begun[cycle] = self._machine.snapshot()
        if len(self._begun) > _MOST_SLICES:
            self._begun = None
