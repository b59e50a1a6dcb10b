"""Signals of timers on pins: outputs, inputs and counted pulses."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.state import Restorable


class PinSignal(Restorable):
    """A signal of a peripheral, which is on a pin while the pin's multiplexer selects it.

    Parameters
    ----------
    on_level
        Called with the new level of a pin with the signal, unless the peripheral drives the pin.
    level
        Returns the level that the peripheral drives; None for an input.
    on_listeners
        Called when `has_listeners` may have changed.
    """

    def __init__(
        self,
        on_level: Callable[[bool], None],
        level: Callable[[], bool | None] = lambda: None,
        on_listeners: Callable[[], None] = lambda: None,
    ) -> None:
        self.on_level = on_level
        self.level = level
        self._on_listeners = on_listeners
        self._listeners: list[Callable[[], None]] = []

    @property
    def has_listeners(self) -> bool:
        """Return whether the peripheral must call `report_change` at each edge."""
        return bool(self._listeners)

    def add_listener(self, listener: Callable[[], None]) -> None:
        """Call a listener at each edge from now on."""
        self._listeners.append(listener)
        self._on_listeners()

    def remove_listener(self, listener: Callable[[], None]) -> None:
        """Stop calling a listener."""
        self._listeners.remove(listener)
        self._on_listeners()

    def report_change(self) -> None:
        """Call the listeners, because the level has changed."""
        for listener in self._listeners:
            listener()
