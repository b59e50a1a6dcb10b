"""The BBC micro:bit v1.3: the nRF51822, the display of 5 x 5 LEDs, two buttons, and the sensors on its I2C bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.virtual.board.leds_and_buttons import LedsAndButtons
from hiltest.virtual.board.nrf51822 import PART, Nrf51822, pin_number
from hiltest.virtual.board.virtual_machine import VirtualMachine
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.chip import memories, table
from hiltest.virtual.part.part_file import load_part
from hiltest.virtual.peripherals.i2c_bus import HeldLine, I2cBus, I2cDevice
from hiltest.virtual.peripherals.nrf51.gpio import Gpio
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.program.elf import FirmwareImage

_TABLE = list(table("microbit_v1.csv", PART))
_SIDE = 5
#: Time for which an LED is seen after it was lit [s]: firmware lights the three rows of the matrix one after the other,
#: within 18 ms.
_SEEN_S = 0.02
BUTTONS = {row["name"]: pin_number(row["pin"]) for row in _TABLE if row["kind"] == "button"}
_PULLED_UP = {row["name"]: pin_number(row["pin"]) for row in _TABLE if row["kind"] == "pull-up"}


class Display(LedsAndButtons):
    """The LED matrix as an eye sees it, without events, and the buttons; for `time_s` see the base."""

    def __init__(self, pins: Gpio, time_s: Callable[[], float]) -> None:
        super().__init__("micro:bit", (), BUTTONS, lambda button, high: pins.drive(BUTTONS[button], high), time_s)
        self._pins = pins
        self._leds = {}
        for row in _TABLE:
            if row["kind"] == "led":
                x, y = map(int, row["name"].split())
                row_pin, column_pin = map(pin_number, row["pin"].split())
                self._leds[y, x] = row_pin, column_pin
        self._matrix = sum(1 << pin for pin in {pin for pins in self._leds.values() for pin in pins})
        self._lit: set[tuple[int, int]] = set()
        self._seen_until_s: dict[tuple[int, int], float] = {}
        for pin in _PULLED_UP.values():
            pins.drive(pin, True)
        self._driven = 0
        follow = pins.on_change

        def change(rose: int, fell: int) -> None:
            follow(rose, fell)
            driven = pins.driven & self._matrix
            if (rose | fell) & self._matrix or driven != self._driven:
                self._driven = driven
                self._update()

        pins.on_change = change

    def _update(self) -> None:
        levels, driven = self._pins.levels, self._pins.driven
        lit = {
            place
            for place, (row, column) in self._leds.items()
            if (driven & levels) >> row & 1 and (driven & ~levels) >> column & 1
        }
        for place in self._lit - lit:
            self._seen_until_s[place] = self._time_s() + _SEEN_S
        self._lit = lit

    def rows(self) -> tuple[str, ...]:
        """Return the five rows, top first: ``#`` for an LED that is or was lit within 20 ms, ``.`` for another."""
        now_s = self._time_s()
        visible = self._lit | {place for place, until_s in self._seen_until_s.items() if until_s > now_s}
        return tuple("".join("#" if (y, x) in visible else "." for x in range(_SIDE)) for y in range(_SIDE))


class VirtualMicrobit(VirtualMachine):
    """A micro:bit that runs an image.

    Parameters
    ----------
    elf
        File, or its content: firmware linked for the nRF51822, as ELF, Intel HEX or raw binary at 0.
    i2c
        Parts on the I2C bus of the board.
    profile
        Timing profile; by default that of the part.
    strict
        True if an access to a block that is not modelled is a bus error.
    """

    title = "BBC micro:bit v1.3"
    _chip: Nrf51822

    def __init__(
        self,
        elf: str | Path | bytes | FirmwareImage,
        *,
        i2c: Sequence[I2cDevice] = (),
        profile: str | TimingProfile | None = None,
        strict: bool = False,
    ) -> None:
        def nrf51822(processor: Processor) -> Nrf51822:
            buses = {(_PULLED_UP["SCL"], _PULLED_UP["SDA"]): I2cBus(i2c)}
            self._chip = Nrf51822(processor, buses, strict=strict)
            return self._chip

        part = load_part(PART)
        super().__init__(
            elf, profile=part.timing() if profile is None else profile, memory=memories(PART), chip=nrf51822,
            core=part.core,
        )  # fmt: skip
        self._leds_and_buttons = self._display = Display(self._chip.pins, self.clocks.time_s)

    def display_rows(self) -> tuple[str, ...]:
        return self._display.rows()

    def hold_line(self, bus: int, hold: HeldLine) -> None:
        """Refuse.

        Raises
        ------
        ConfigError
            Always, because the master of the nRF51822 has no model of a line that is held low.
        """
        raise ConfigError("the virtual micro:bit cannot hold an I2C line low; remove faults.held_line from the rig")
