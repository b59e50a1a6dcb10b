"""The virtual board's event queue, in order of clock cycles."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable
from typing import Any

from hiltest.state import Restorable


class Event:
    """An event in the queue."""

    __slots__ = ("action", "at_cycle", "replan", "wakes")

    def __init__(
        self,
        at_cycle: float,
        action: Callable[[], None] | None = None,
        wakes: bool = False,
        replan: Callable[[], float] | None = None,
    ) -> None:
        self.at_cycle = at_cycle
        self.wakes = wakes
        self.replan = replan
        self.action = action  # None if the event was cancelled or has fired

    def cancel(self) -> None:
        """Prevent the action from running."""
        self.action = None

    def fire(self) -> None:
        """Run the action, once."""
        action, self.action = self.action, None
        if action is not None:
            action()


class Schedule(Restorable):
    """Events in order of their clock cycles; events at one cycle keep the order of their creation.

    Parameters
    ----------
    planned
        Called with the cycle of every new event, which may be before the core's deadline.
    """

    def __init__(self, planned: Callable[[float], None] | None = None) -> None:
        self._planned = planned
        self._heap: list[tuple[float, int, Event]] = []
        self._order = itertools.count()

    def call_at(
        self,
        cycle: float,
        action: Callable[[], None],
        *,
        wakes: bool = True,
        replan: Callable[[], float] | None = None,
    ) -> Event:
        """Call `action` when virtual time reaches a cycle.

        Parameters
        ----------
        cycle
            Cycle of the core.
        wakes
            True if firmware may wait for the event.
        replan
            Returns the new cycle after clocks have changed their rates.
        """
        event = Event(cycle, action, wakes, replan)
        heapq.heappush(self._heap, (cycle, next(self._order), event))
        if self._planned is not None:
            self._planned(cycle)
        return event

    def replan(self) -> None:
        """Compute the cycles of all events again after clocks have changed their rates."""
        for _, _, event in self._heap:
            if event.replan is not None:
                event.at_cycle = event.replan()
        self._heap = [(event.at_cycle, order, event) for _, order, event in self._heap]
        heapq.heapify(self._heap)
        if self._planned is not None:
            self._planned(self.next_cycle)

    def state(self) -> Any:
        """Return the planned events with their changeable attributes."""
        return [(*entry, entry[2].action) for entry in self._heap if entry[2].action is not None]

    def restore(self, state: Any) -> None:
        """Replace all events by those of a state."""
        self._heap = [(cycle, order, event) for cycle, order, event, _ in state]
        heapq.heapify(self._heap)
        for cycle, _, event, action in state:
            event.at_cycle, event.action = cycle, action

    @property
    def next_cycle(self) -> float:
        """Time of the next event [cycles]; infinity if there is none."""
        heap = self._heap
        while heap and heap[0][2].action is None:
            heapq.heappop(heap)
        return heap[0][0] if heap else math.inf

    @property
    def wakes_ever(self) -> bool:
        """Return whether any event is planned that firmware may wait for."""
        return any(event.wakes and event.action is not None for _, _, event in self._heap)

    def run_due(self, now: float) -> None:
        """Run every event that is due at cycle `now`."""
        while self.next_cycle <= now:
            heapq.heappop(self._heap)[2].fire()
