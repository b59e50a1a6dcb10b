"""Sleep of the processor, branches to themselves, and the events that can end both."""

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
        True if a branch to itself, in thread mode and without an earlier fault, counts as rest; otherwise it is a hang.
    has_end : bool
        True if this run ends at a set time.
    in_python : bool
        True during sleep that Python handles; during other sleep, time passes within the core.
    on_sleep : callable
        Called when sleep that Python handles begins, and when it ends.
    on_events : callable
        Called during such sleep, when all due events have fired.
    """

    def __init__(self, machine: Machine, nvic: Nvic, schedule: Schedule, fault_log: FaultLog) -> None:
        self.may_rest = True
        self.has_end = self.in_python = False
        self.on_sleep: Callable[[bool], None] = lambda _begins: None
        self.on_events: Callable[[], None] = lambda: None
        self._core, self._handle = machine.core, machine.handle
        self._nvic = nvic
        self._schedule = schedule
        self._fault_log = fault_log

    @property
    def sleeping(self) -> bool:
        """Return whether the processor is in WFI or WFE."""
        sleeping: bool = self._core.sleeping
        return sleeping

    @sleeping.setter
    def sleeping(self, sleeps: bool) -> None:
        self._core.sleeping = sleeps
        if sleeps is not self.in_python:
            self.in_python = sleeps
            self.on_sleep(sleeps)

    @property
    def sleeps_deeply(self) -> bool:
        """Return SCR.SLEEPDEEP."""
        deeply: bool = self._core.sleeps_deeply
        return deeply

    @property
    def gated(self) -> bool:
        """Return whether the processor is in a sleep mode that no interrupt ends."""
        gated: bool = self._core.gated
        return gated

    @gated.setter
    def gated(self, gated: bool) -> None:
        self._core.gated = gated

    @property
    def instruction(self) -> str:
        """Instruction that the processor executed to sleep."""
        return "WFE" if self._core.waits_for_event else "WFI"

    @property
    def is_in_thread(self) -> bool:
        """Return whether no exception handler is active, and no fault's handler is unfinished."""
        return not self._core.active_count and self._fault_log.first_cause is None

    def rests(self, booted: bool) -> bool:
        """Return whether a branch to itself counts as rest."""
        return booted and self.has_end and self.may_rest and self.is_in_thread

    def can_leave_loop(self) -> bool:
        """Return whether any interrupt could end a branch to itself."""
        ceiling = self._nvic.ceiling()
        timed = self._is_planned and self._nvic.preempts(SYSTICK, ceiling)
        return timed or self._nvic.can_ever_wake(ceiling)

    @property
    def _is_planned(self) -> bool:
        """Return whether any event is planned that firmware may wait for."""
        return self._schedule.wakes_ever or lib.machine_next_event(self._handle) != NEVER

    @property
    def next_cycle(self) -> float:
        """Cycle of the next event of any peripheral; infinity if there is none."""
        cycle = lib.machine_next_event(self._handle)
        return min(self._schedule.next_cycle, math.inf if cycle == NEVER else cycle)

    def wake(self) -> None:
        """End sleep if a pending exception does so."""
        if lib.machine_wakes(self._handle):
            self.sleeping = False

    def is_endless(self, until_cycle: float) -> bool:
        """Return whether no event can end this sleep before a cycle, which may be infinite."""
        nvic = self._nvic
        if math.isinf(until_cycle) and (not self._is_planned or math.isinf(self.next_cycle)):
            return True
        for_event = self._core.waits_for_event
        ceiling = nvic.ceiling(without_primask=not for_event)
        possible = self.gated or nvic.preempts(SYSTICK, ceiling) or nvic.can_ever_wake(ceiling)
        return not (possible or (for_event and self._core.sends_on_pend))
