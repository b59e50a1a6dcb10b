"""Signals of peripherals on pins: what a timer puts out, takes in, or counts."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.state import Restorable


class PinSignal(Restorable):
    """A signal of a peripheral; pins carry it while their multiplexers select it.

    Parameters
    ----------
    on_level
        Told the new level of a pin that carries it, unless the peripheral drives that.
    level
        Answers the level that the peripheral gives it; None for an input.
    on_heard
        Told that `is_heard` has changed.
    """

    def __init__(
        self, on_level: Callable[[bool], None], level: Callable[[], bool | None] = lambda: None,
        on_heard: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self.on_level = on_level
        self.level = level
        self._on_heard = on_heard
        self._listeners: list[Callable[[], None]] = []

    @property
    def is_heard(self) -> bool:
        """Whether the peripheral has to call `changed`, because somebody wants to know of each edge."""
        return bool(self._listeners)

    def hear(self, listener: Callable[[], None]) -> None:
        """Have a listener told of each edge from now on."""
        self._listeners.append(listener)
        self._on_heard()

    def leave(self, listener: Callable[[], None]) -> None:
        """Have a listener told no more."""
        self._listeners.remove(listener)
        self._on_heard()

    def changed(self) -> None:
        """Tell the listeners that the level has changed."""
        for listener in self._listeners:
            listener()
