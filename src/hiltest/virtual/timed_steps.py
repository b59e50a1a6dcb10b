"""The band of many timed steps together: what ran in all of them is priced again at once."""

from __future__ import annotations

from collections.abc import Sequence

from hiltest.measurement import CycleBand
from hiltest.virtual.cycle_band import band_where_it_ran
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
    cycle_model : str
        Whose placement says where they ran.
    """

    def __init__(self, counter: CycleCounter, profile: TimingProfile, cycle_model: str) -> None:
        self._counter, self._profile, self._cycle_model = counter, profile, cycle_model
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
        """Return within what all steps together lie; None where that is unknown."""
        if not self._cycles:
            return None
        whole, empty = together(self._whole), together(self._empty)
        executed = (whole, empty) if self._known and whole and empty else None
        return band_where_it_ran(self._profile, self._cycle_model, self._cycles, executed)
