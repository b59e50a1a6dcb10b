"""LEDs and buttons of the FRDM-K64F."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hiltest.errors import ConfigError
from hiltest.state import Restorable
from hiltest.virtual.part.chip import pin_place, table
from hiltest.virtual.peripherals.port import Port


def _pins(kind: str) -> dict[str, tuple[str, int]]:
    return {row["name"]: pin_place(row["pin"]) for row in table("frdm_k64f.csv") if row["kind"] == kind}


LEDS = _pins("led")  # active low
BUTTONS = _pins("button")  # to ground when pressed, with pull-ups on the board


@dataclass(frozen=True, slots=True)
class BoardEvent:
    """A change of an LED or a button."""

    time_s: float
    """Virtual time since power-on."""
    part: str
    """``LED red``, ``LED green``, ``LED blue``, ``SW2`` or ``SW3``."""
    on: bool
    """Lit, or pressed."""

    def __str__(self) -> str:
        return f"{self.time_s:.6f} s: {self.part} {'on' if self.on else 'off'}"


class LedsAndButtons(Restorable):
    """State and history of the LEDs and buttons.

    Parameters
    ----------
    time_s
        Returns the virtual time, also during an access to a peripheral.

    Attributes
    ----------
    events : list of BoardEvent
        Changes since power-on, in order.
    """

    def __init__(self, ports: Mapping[str, Port], time_s: Callable[[], float]) -> None:
        self.events: list[BoardEvent] = []
        self._ports = ports
        self._time_s = time_s
        self._on = dict.fromkeys([*LEDS, *BUTTONS], False)
        for letter, pin in BUTTONS.values():
            ports[letter].drive(pin, True)
        for letter, pin in LEDS.values():
            ports[letter].on_change = self._update_leds
            ports[letter].watch(1 << pin, follows_timers=True)

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
        self._check(button, BUTTONS)
        letter, pin = BUTTONS[button]
        self._record(button, pressed)
        self._ports[letter].drive(pin, not pressed)

    def _check(self, name: str, names: Mapping[str, object]) -> None:
        if name not in names:
            raise ConfigError(f"the FRDM-K64F has no {name!r}; it has {', '.join(names)}")

    def _update_leds(self, port: Port) -> None:
        driven_low = port.driven_low
        for led, (letter, pin) in LEDS.items():
            if self._ports[letter] is port:
                self._record(led, bool(driven_low >> pin & 1))

    def _record(self, name: str, on: bool) -> None:
        if self._on[name] != on:
            self._on[name] = on
            self.events.append(BoardEvent(self._time_s(), name, on))
