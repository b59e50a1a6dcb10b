"""Signals of peripherals on pins: what a timer puts out, takes in, or counts."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.virtual.processor.schedule import Event, Schedule


class PinSignal:
    """A signal of a peripheral; pins carry it while their multiplexers select it.

    Attributes
    ----------
    driven : bool or None
        Level that the peripheral gives it; None for an input.
    pins : int
        How many carry it.
    on_level : callable
        Told the new level of a pin that carries it.
    on_pins : callable
        Told that `pins` has changed.
    """

    def __init__(self) -> None:
        self.driven: bool | None = None
        self.pins = 0
        self.on_level: Callable[[bool], None] = lambda _high: None
        self.on_pins: Callable[[], None] = lambda: None
        self.settle: list[Callable[[], None]] = []  # of the ports whose pins may carry it

    def drive(self, high: bool | None) -> None:
        """Give it a level, or none."""
        if high is not self.driven:
            self.driven = high
            for settle in self.settle:
                settle()


class PulseCounter(PinSignal):
    """Counts edges of a pin; for a timer it is a clock.

    Attributes
    ----------
    rising : bool
        Whether it counts rising edges, or falling ones.
    """

    def __init__(self) -> None:
        super().__init__()
        self.rising = True
        self.on_level = self._count_edge
        self._count = 0
        self._due = Schedule()

    def now(self) -> int:
        """Edges so far."""
        return self._count

    def at(self, tick: int, action: Callable[[], None], *, wakes: bool = True) -> Event:
        """Call `action` at an edge, counted from the first."""
        return self._due.at(tick, action, wakes=wakes)

    def _count_edge(self, high: bool) -> None:
        if high == self.rising:
            self._count += 1
            self._due.run_due(self._count)
