"""LEDs and buttons of the FRDM-K64F."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hiltest.virtual.board.leds_and_buttons import LedsAndButtons
from hiltest.virtual.part.chip import pin_place, table
from hiltest.virtual.peripherals.port import Port


def _pins(kind: str) -> dict[str, tuple[str, int]]:
    return {row["name"]: pin_place(row["pin"]) for row in table("frdm_k64f.csv") if row["kind"] == kind}


LEDS = _pins("led")  # active low
BUTTONS = _pins("button")  # to ground when pressed, with pull-ups on the board


class FrdmLedsAndButtons(LedsAndButtons):
    """State and history of the LEDs and buttons; for `time_s` see the base."""

    def __init__(self, ports: Mapping[str, Port], time_s: Callable[[], float]) -> None:
        def drive(button: str, high: bool) -> None:
            letter, pin = BUTTONS[button]
            ports[letter].drive(pin, high)

        self._ports = ports
        super().__init__("FRDM-K64F", LEDS, BUTTONS, drive, time_s)
        for letter, pin in LEDS.values():
            ports[letter].on_change = self._update_leds
            ports[letter].watch(1 << pin, follows_timers=True)

    def _update_leds(self, port: Port) -> None:
        driven_low = port.driven_low
        for led, (letter, pin) in LEDS.items():
            if self._ports[letter] is port:
                self._record(led, bool(driven_low >> pin & 1))
