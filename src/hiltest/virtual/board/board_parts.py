"""What is around the processor of a virtual board: the chip's blocks, and the board's LEDs, buttons and wires."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

from hiltest.errors import ConfigError
from hiltest.virtual.board.bare_part import BarePart
from hiltest.virtual.board.frdm_k64f import BoardEvent, LedsAndButtons
from hiltest.virtual.board.interrupt_wires import InterruptSource, InterruptWires
from hiltest.virtual.board.microcontroller import Microcontroller
from hiltest.virtual.peripherals.bus import PeripheralBus
from hiltest.virtual.peripherals.dwt import CycleCounter
from hiltest.virtual.peripherals.i2c_bus import HeldLine
from hiltest.virtual.peripherals.pit import PeriodicTimers
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.peripherals.uart import Uart
from hiltest.virtual.peripherals.unmodelled import UnmodelledAccess
from hiltest.virtual.peripherals.wdog import Watchdog


def _unknown() -> ConfigError:
    return ConfigError("the memories are another part's, and nothing is known of what is around its processor")


class BoardParts:
    """What programs reach around the processor of a board.

    Parameters
    ----------
    part : Microcontroller or BarePart
        With a bare part, everything but counter and bus raises `ConfigError`.
    """

    def __init__(self, part: Microcontroller | BarePart) -> None:
        self._part = part
        self._leds_and_buttons: LedsAndButtons | None = None
        if isinstance(part, Microcontroller):
            self._leds_and_buttons = LedsAndButtons(part.ports, part.clocks.time_s)

    @property
    def _chip(self) -> Microcontroller:
        if isinstance(self._part, BarePart):
            raise _unknown()
        return self._part

    @property
    def bus(self) -> PeripheralBus:
        """The bus of the peripherals."""
        return self._part.bus

    @property
    def cycle_counter(self) -> CycleCounter:
        """DWT, with the firmware's readings of it."""
        return self._part.cycle_counter

    @property
    def clocks(self) -> ClockGates:
        """The clocks that the firmware has set up, and virtual time."""
        return self._chip.clocks

    @property
    def uarts(self) -> tuple[Uart, ...]:
        """UART0 to UART5, each with the far end of its wire: `host_write`, `host_read`, `line_baud`."""
        return self._chip.uarts

    @property
    def uart0(self) -> Uart:
        """The first, which is the board's serial port."""
        return self._chip.uarts[0]

    @property
    def timers(self) -> PeriodicTimers:
        """The PIT."""
        return self._chip.timers

    @property
    def watchdog(self) -> Watchdog:
        """The watchdog."""
        return self._chip.watchdog

    @property
    def adc_volts(self) -> dict[tuple[int, int], float]:
        """Voltages of the converters' inputs by converter and channel, such as ``adc_volts[0, 12] = 1.2``.

        Of a differential channel it is that between its pins. Others have 0 V.
        """
        return self._chip.adc_volts

    @property
    def seed(self) -> int:
        """Seed of the numbers that the chip's random number generator makes from now on; 0 if none is set."""
        return self._chip.random_numbers.seed

    @seed.setter
    def seed(self, seed: int) -> None:
        self._chip.random_numbers.seed = seed

    def warm_by(self, temperature_degc: Callable[[], float]) -> None:
        """Say what answers the chip's temperature, which is 25 degC otherwise."""
        self._chip.temperature_degc = temperature_degc

    # -- registers that are not modelled ------------------------------------------------------

    @property
    def unmodelled(self) -> Sequence[UnmodelledAccess]:
        """First access to each register that keeps what is written and does nothing; `str` of one is a sentence."""
        return self._part.unmodelled.accesses

    def tell(self, told: Callable[[str], None]) -> None:
        """Say who is told, in a line, of a register that firmware waits for and that is not modelled.

        Otherwise that is an `UnmodelledWarning`.
        """
        self._part.unmodelled.told = told

    @contextlib.contextmanager
    def unnoticed(self) -> Iterator[None]:
        """Leave accesses out of `unmodelled` that are not the firmware's, for the time of the context."""
        self._part.unmodelled.listens = False
        try:
            yield
        finally:
            self._part.unmodelled.listens = True

    # -- pins ---------------------------------------------------------------------------------

    @property
    def events(self) -> list[BoardEvent]:
        """What the LEDs and buttons did since power-on."""
        return self._around.events

    @property
    def _around(self) -> LedsAndButtons:
        if self._leds_and_buttons is None:
            raise _unknown()
        return self._leds_and_buttons

    def press(self, button: str) -> None:
        """Press ``SW2`` or ``SW3``, and keep it pressed."""
        self._around.push(button, True)

    def release(self, button: str) -> None:
        """Release a button."""
        self._around.push(button, False)

    def is_on(self, what: str) -> bool:
        """Whether an LED (``LED red``, ``LED green``, ``LED blue``) is lit, or a button is pressed."""
        return self._around.is_on(what)

    def drive(self, pin: str, high: bool) -> None:
        """Give a pin such as ``PTC5`` a level from outside."""
        port, number = self._chip.pin(pin)
        port.drive(number, high)

    def level(self, pin: str) -> bool:
        """Level of a pin such as ``PTC5``, whoever gives it; low while it is analog."""
        port, number = self._chip.pin(pin)
        return bool(port.levels >> number & 1)

    def lead_interrupts(self, bus: int, part: InterruptSource, *, int1: str | None, int2: str | None) -> None:
        """Connect the interrupt pins of a part.

        Parameters
        ----------
        bus : int
            Which I2C bus the part is on: 0 or 1.
        part : InterruptSource
            One of the parts given for that bus.
        int1, int2 : str or None
            Pins of the processor, such as ``PTB9``; None leaves one open.
        """
        pins = self._chip.wire_to(int1), self._chip.wire_to(int2)
        wires = InterruptWires(part, pins, self.clocks.time)
        self._chip.i2c_buses[bus].after_stop(part, wires.look)
        wires.look()

    def hold_line(self, bus: int, held: HeldLine) -> None:
        """Pull a line of I2C bus 0 or 1 low for a time, as a part that is stuck or a short does."""
        self._chip.i2c_buses[bus].on_hold(held)
