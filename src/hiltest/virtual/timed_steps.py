"""The band of many timed steps together: what ran in all of them is priced again at once."""

from __future__ import annotations

from collections.abc import Sequence

from hiltest.measurement import CycleBand
from hiltest.virtual.cycle_band import cycle_band
from hiltest.virtual.executions import Executions, together
from hiltest.virtual.peripherals.cycle_counter import CycleCounter
from hiltest.virtual.timing import TimingProfile


class TimedSteps:
    """Records what ran in steps that the firmware timed one after the other.

    Parameters
    ----------
    counter : CycleCounter
        That it read before and behind each, and before and behind the empty call in front of each.
    profile : TimingProfile
        That it was counted by.
    """

    def __init__(self, counter: CycleCounter, profile: TimingProfile) -> None:
        self._counter, self._profile = counter, profile
        self._cycles = 0
        self._whole: list[Executions] = []
        self._empty: list[Executions] = []
        self._known = True

    def add(self, cycles: Sequence[int], overhead_cycles: int) -> None:
        """Record the steps that were timed last, in order; after one that cannot be found nothing is known."""
        executed = self._counter.executed_in_steps(cycles, overhead_cycles)
        self._known = self._known and executed is not None
        self._cycles += sum(cycles)
        if executed:
            self._whole.append(executed[0])
            self._empty.append(executed[1])

    def band(self) -> CycleBand | None:
        """Return within what all steps together lie; None where nobody knows what ran."""
        if not self._known or not self._whole:
            return None
        whole, empty = together(self._whole), together(self._empty)
        return cycle_band(self._profile, self._cycles, whole, empty) if whole and empty else None
