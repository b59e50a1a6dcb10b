"""Clocks of the part, which count ticks at changing rates."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

from hiltest.errors import ConfigError
from hiltest.state import Restorable
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.processor.schedule import Event, Schedule

PICOSECONDS = 10**12  # in a second; the clock of virtual time ticks in picoseconds
_DENOMINATOR_BITS, _PRODUCT_BITS = 31, 62  # see machine_set_clock


class Clock(Restorable):
    """One clock of the part, which counts its ticks since power-on.

    Virtual time is counted in cycles of the core. Every clock has a rate relative to the core's, which changes
    when firmware sets up its clocks; earlier ticks keep their count.

    Parameters
    ----------
    schedule
        Event queue in cycles of the core.
    now
        Returns the cycle, also during an access to a peripheral.

    Attributes
    ----------
    hz : Fraction
        Present rate; 0 while the clock is stopped.
    """

    def __init__(self, schedule: Schedule, now: Callable[[], int]) -> None:
        self.hz = Fraction(0)
        self._schedule = schedule
        self._cycle = now
        # The ticks at a cycle are (passed + (cycle - since) * numerator) // denominator, exact in integers.
        self._since = 0
        self._passed = 0
        self._numerator = 0
        self._denominator = 1
        self._machine: Machine | None = None  # set if its peripherals in C count in this clock
        self._number = -1

    def number_in(self, machine: Machine) -> int:
        """Return the clock's number in the machine, which receives its rate from now on."""
        if self._machine is None:
            self._machine, self._number = machine, machine.add_clock()
            self._update_machine()
        return self._number

    def now(self) -> int:
        return self.ticks_at(self._cycle())

    def ticks_at(self, cycle: int) -> int:
        """Return the ticks up to a cycle of the core."""
        return (self._passed + (cycle - self._since) * self._numerator) // self._denominator

    def cycle_of(self, tick: int) -> float:
        """Return the first cycle of the core at or after a tick; infinity while the clock is stopped."""
        if not self._numerator:
            return self._since if tick * self._denominator <= self._passed else math.inf
        return self._since - (self._passed - tick * self._denominator) // self._numerator

    def call_at(self, tick: int, action: Callable[[], None], *, wakes: bool = True) -> Event:
        """Call `action` at a tick, even if the rate changes; `wakes` as in `Schedule.call_at`."""
        return self._schedule.call_at(self.cycle_of(tick), action, wakes=wakes, replan=lambda: self.cycle_of(tick))

    def call_after(self, ticks: int, action: Callable[[], None], *, wakes: bool = True) -> Event:
        """Call `action` a number of ticks from now."""
        return self.call_at(self.now() + ticks, action, wakes=wakes)

    def run_at(self, hz: Fraction, core_hz: Fraction, cycle: int) -> None:
        """Change the rate at a cycle; the caller must call the schedule's `replan` afterwards."""
        passed = Fraction(self._passed + (cycle - self._since) * self._numerator, self._denominator)
        rate = hz / core_hz
        self.hz = hz
        self._since = cycle
        self._denominator = math.lcm(rate.denominator, passed.denominator)
        self._numerator = rate.numerator * (self._denominator // rate.denominator)
        self._passed = passed.numerator * (self._denominator // passed.denominator)
        self._update_machine()

    def _update_machine(self) -> None:
        """Set the rate for peripherals in C, which round down if 64 bits do not hold a fraction of a tick."""
        if self._machine is None:
            return
        numerator, denominator, common = self._numerator, self._denominator, 1
        if not _fits(numerator, denominator):
            common = math.gcd(numerator, denominator)
            numerator, denominator = numerator // common, denominator // common
        if not _fits(numerator, denominator):
            raise ConfigError(
                f"64 bits cannot count a clock of {self.hz} Hz: {numerator}/{denominator} ticks per cycle"
            )
        ticks, remainder = divmod(self._passed // common, denominator)
        self._machine.set_clock(self._number, self._since, ticks, remainder, numerator, denominator)


def _fits(numerator: int, denominator: int) -> bool:
    """Return whether the core in C can count a clock with this rate exactly."""
    return denominator < 1 << _DENOMINATOR_BITS and numerator * denominator < 1 << _PRODUCT_BITS
