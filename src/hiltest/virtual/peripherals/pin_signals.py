"""Signals of peripherals on pins: outputs, inputs and counted pulses of timers."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.state import Restorable


class PinSignal(Restorable):
    """A signal of a peripheral; pins carry it while their multiplexers select it.

    Parameters
    ----------
    on_level
        Called with the new level of a pin that carries the signal, unless the peripheral drives the pin.
    level
        Returns the level that the peripheral drives; None for an input.
    on_heard
        Called when `is_heard` has changed.
    """

    def __init__(
        self,
        on_level: Callable[[bool], None],
        level: Callable[[], bool | None] = lambda: None,
        on_heard: Callable[[], None] = lambda: None,
    ) -> None:
        self.on_level = on_level
        self.level = level
        self._on_heard = on_heard
        self._listeners: list[Callable[[], None]] = []

    @property
    def is_heard(self) -> bool:
        """Return whether the peripheral has to call `report_change` at each edge, because a listener needs it."""
        return bool(self._listeners)

    def hear(self, listener: Callable[[], None]) -> None:
        """Call a listener at each edge from now on."""
        self._listeners.append(listener)
        self._on_heard()

    def leave(self, listener: Callable[[], None]) -> None:
        """Stop calling a listener."""
        self._listeners.remove(listener)
        self._on_heard()

    def report_change(self) -> None:
        """Call the listeners, because the level has changed."""
        for listener in self._listeners:
            listener()
