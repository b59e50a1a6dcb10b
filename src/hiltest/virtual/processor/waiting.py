"""How the processor waits, asleep or in a loop to itself, and whether anything could end that."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.state import Restorable
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import NEVER, Machine
from hiltest.virtual.processor.faults import FaultLog
from hiltest.virtual.processor.nvic import SYSTICK, Nvic
from hiltest.virtual.processor.schedule import Schedule


class Waiting(Restorable):
    """Sleep and rest of a processor.

    Attributes
    ----------
    may_rest : bool
        Whether firmware that ends in a loop to itself, in thread mode and without a fault before, is at rest;
        otherwise that is a hang.
    has_end : bool
        Whether this run has a time when it stops.
    is_told : bool
        Whether it is in a sleep that the core has left to Python: in others time passes within the core.
    on_sleep : callable
        Told that sleep begins, and that it ends.
    on_events : callable
        Told, in a sleep that the core has left to Python, that all events have fired that were due.
    """

    def __init__(self, machine: Machine, nvic: Nvic, schedule: Schedule, fault_log: FaultLog) -> None:
        self.may_rest = True
        self.has_end = self.is_told = False
        self.on_sleep: Callable[[bool], None] = lambda _begins: None
        self.on_events: Callable[[], None] = lambda: None
        self._core, self._handle = machine.core, machine.handle
        self._nvic = nvic
        self._schedule = schedule
        self._fault_log = fault_log

    @property
    def sleeping(self) -> bool:
        """Whether it is in WFI or WFE."""
        sleeping: bool = self._core.sleeping
        return sleeping

    @sleeping.setter
    def sleeping(self, sleeps: bool) -> None:
        self._core.sleeping = sleeps
        if sleeps is not self.is_told:
            self.is_told = sleeps
            self.on_sleep(sleeps)

    @property
    def sleeps_deeply(self) -> bool:
        """SCR.SLEEPDEEP."""
        deeply: bool = self._core.sleeps_deeply
        return deeply

    @property
    def gated(self) -> bool:
        """Whether it is in a sleep that no interrupt ends."""
        gated: bool = self._core.gated
        return gated

    @gated.setter
    def gated(self, gated: bool) -> None:
        self._core.gated = gated

    @property
    def instruction(self) -> str:
        """What it sleeps in."""
        return "WFE" if self._core.waits_for_event else "WFI"

    @property
    def in_thread(self) -> bool:
        """Whether no handler runs, and no fault's handler has begun that has not returned."""
        return not self._core.active_count and self._fault_log.first_cause is None

    def rests(self, booted: bool) -> bool:
        """Whether a loop to itself is rest, of firmware that was booted."""
        return booted and self.has_end and self.may_rest and self.in_thread

    def can_leave_loop(self) -> bool:
        """Whether any interrupt could end a loop to itself."""
        ceiling = self._nvic.ceiling()
        timed = self._is_planned and self._nvic.preempts(SYSTICK, ceiling)
        return timed or self._nvic.can_ever_wake(ceiling)

    @property
    def _is_planned(self) -> bool:
        """Whether anything is to come that firmware may wait for."""
        return self._schedule.wakes_ever or lib.machine_next_event(self._handle) != NEVER

    @property
    def next_cycle(self) -> float:
        """Cycle of the next event of any peripheral; infinity if there is none."""
        cycle = lib.machine_next_event(self._handle)
        return min(self._schedule.next_cycle, math.inf if cycle == NEVER else cycle)

    def wake(self) -> None:
        """End sleep, if what is pending does that."""
        if lib.machine_wakes(self._handle):
            self.sleeping = False

    def is_endless(self, until_cycle: float) -> bool:
        """Whether nothing could end this sleep before a cycle that may be infinite."""
        nvic = self._nvic
        if math.isinf(until_cycle) and (not self._is_planned or math.isinf(self.next_cycle)):
            return True
        for_event = self._core.waits_for_event
        ceiling = nvic.ceiling(without_primask=not for_event)
        possible = self.gated or nvic.preempts(SYSTICK, ceiling) or nvic.can_ever_wake(ceiling)
        return not (possible or (for_event and self._core.sends_on_pend))
