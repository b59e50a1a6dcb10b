"""State and history of the LEDs and buttons of a board."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from hiltest.errors import ConfigError
from hiltest.state import Restorable


@dataclass(frozen=True, slots=True)
class BoardEvent:
    """A change of an LED or a button."""

    time_s: float
    """Virtual time since power-on."""
    part: str
    """Such as ``LED red`` or ``SW2`` of the FRDM-K64F, ``button A`` of the micro:bit."""
    on: bool
    """Lit, or pressed."""

    def __str__(self) -> str:
        return f"{self.time_s:.6f} s: {self.part} {'on' if self.on else 'off'}"


class LedsAndButtons(Restorable):
    """LEDs and buttons, by name.

    Parameters
    ----------
    board
        Name of the board, for people.
    drive
        Drives the pin of a button: low while it is pressed.
    time_s
        Returns the virtual time, also during an access to a peripheral.

    Attributes
    ----------
    events : list of BoardEvent
        Changes since power-on, in order.
    """

    def __init__(
        self,
        board: str,
        leds: Iterable[str],
        buttons: Iterable[str],
        drive: Callable[[str, bool], None],
        time_s: Callable[[], float],
    ) -> None:
        self.events: list[BoardEvent] = []
        self._board, self._buttons = board, tuple(buttons)
        self._drive, self._time_s = drive, time_s
        self._on = dict.fromkeys([*leds, *self._buttons], False)
        for button in self._buttons:
            drive(button, True)

    def is_on(self, name: str) -> bool:
        """Return whether an LED is lit or a button is pressed.

        Raises
        ------
        ConfigError
            If the board has no such LED or button.
        """
        self._check(name, self._on)
        return self._on[name]

    def push(self, button: str, pressed: bool) -> None:
        """Press or release a button.

        Raises
        ------
        ConfigError
            If the board has no such button.
        """
        self._check(button, self._buttons)
        self._record(button, pressed)
        self._drive(button, not pressed)

    def _check(self, name: str, names: Iterable[str]) -> None:
        if name not in names:
            raise ConfigError(f"the {self._board} has no {name!r}; it has {', '.join(names)}")

    def _record(self, name: str, on: bool) -> None:
        if self._on[name] != on:
            self._on[name] = on
            self.events.append(BoardEvent(self._time_s(), name, on))
