"""How the processor waits, asleep or in a loop to itself, and whether anything could end that."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.virtual.exceptions import ExceptionUnit
from hiltest.virtual.faults import FaultLog
from hiltest.virtual.nvic import SYSTICK, EventRegister, Nvic
from hiltest.virtual.schedule import Schedule


class Waiting:
    """Sleep and rest of a processor.

    Parameters
    ----------
    exceptions : ExceptionUnit
    nvic : Nvic
    events : EventRegister
    schedule : Schedule
    fault_log : FaultLog

    Attributes
    ----------
    may_rest : bool
        Whether firmware that ends in a loop to itself, in thread mode and without a fault before, is at rest;
        otherwise that is a hang.
    has_end : bool
        Whether this run has a time when it stops.
    for_event : bool
        Whether it sleeps in WFE.
    sleeps_on_exit, sleeps_deeply : bool
        SCR.SLEEPONEXIT and SCR.SLEEPDEEP.
    gated : bool
        Whether it is in a sleep that no interrupt ends.
    on_sleep : callable
        Told that sleep begins, and that it ends.
    """

    def __init__(
        self, exceptions: ExceptionUnit, nvic: Nvic, events: EventRegister, schedule: Schedule, fault_log: FaultLog
    ) -> None:
        self.may_rest = True
        self.has_end = False
        self.for_event = self.sleeps_on_exit = self.sleeps_deeply = self.gated = False
        self.on_sleep: Callable[[bool], None] = lambda _begins: None
        self._sleeping = False
        self._exceptions = exceptions
        self._nvic = nvic
        self._events = events
        self._schedule = schedule
        self._fault_log = fault_log

    @property
    def sleeping(self) -> bool:
        """Whether it is in WFI or WFE."""
        return self._sleeping

    @sleeping.setter
    def sleeping(self, sleeps: bool) -> None:
        if sleeps is not self._sleeping:
            self._sleeping = sleeps
            self.on_sleep(sleeps)

    @property
    def instruction(self) -> str:
        """What it sleeps in."""
        return "WFE" if self.for_event else "WFI"

    @property
    def in_thread(self) -> bool:
        """Whether no handler runs, and no fault's handler has begun that has not returned."""
        return not self._nvic.active and self._fault_log.first_cause is None

    def rests(self, booted: bool) -> bool:
        """Whether a loop to itself is rest, of firmware that was booted."""
        return booted and self.has_end and self.may_rest and self.in_thread

    def can_leave_loop(self) -> bool:
        """Whether any interrupt could end a loop to itself."""
        ceiling = self._exceptions.ceiling()
        timed = self._schedule.wakes_ever and self._nvic.preempts(SYSTICK, ceiling)
        return timed or self._nvic.can_ever_wake(ceiling)

    def wake(self, ceiling: int, ceiling_asleep: int) -> None:
        """End sleep, if what is pending does that."""
        if (
            self._nvic.next_exception(ceiling=ceiling if self.for_event else ceiling_asleep) is not None
            or (self.for_event and self._events.take())
        ):  # fmt: skip
            self.sleeping = False

    def is_endless(self, until_cycle: float) -> bool:
        """Whether nothing could end this sleep before a cycle that may be infinite."""
        schedule, nvic = self._schedule, self._nvic
        if math.isinf(until_cycle) and (not schedule.wakes_ever or math.isinf(schedule.next_cycle)):
            return True
        ceiling, ceiling_asleep = self._exceptions.ceilings()
        ceiling = ceiling if self.for_event else ceiling_asleep
        possible = self.gated or nvic.preempts(SYSTICK, ceiling) or nvic.can_ever_wake(ceiling)
        return not (possible or (self.for_event and self._events.on_pend))
