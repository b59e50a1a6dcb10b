"""The chip of a board, as `hiltest.virtual.board.virtual_machine` uses it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

from hiltest.state import HasState
from hiltest.virtual.peripherals.bus import PeripheralBus
from hiltest.virtual.peripherals.dwt import CycleCounter
from hiltest.virtual.peripherals.i2c_bus import I2cBus
from hiltest.virtual.peripherals.rcm import ResetSource
from hiltest.virtual.peripherals.spi_bus import SpiBus
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.program.elf import LoadSegment


class ChipClocks(Protocol):
    """Clocks of a chip.

    Attributes
    ----------
    time : Clock
        Virtual time in picoseconds since power-on.
    """

    time: Clock

    @property
    def core_hz(self) -> float:
        """Core clock [Hz]."""
        ...

    def time_s(self) -> float:
        """Return the virtual time since power-on [s], also during an access to a peripheral."""
        ...


class ChipPins(Protocol):
    """Pins of a chip."""

    @property
    def levels(self) -> int:
        """Return the levels of the pins; bit n is pin n."""
        ...

    def drive(self, pin: int, high: bool) -> None:
        """Drive a pin from outside of the chip."""
        ...


class SerialLine(Protocol):
    """A UART with the far end of its wire.

    Attributes
    ----------
    name : str
        Name in the reference manual.
    """

    name: str

    @property
    def baud(self) -> float:
        """Rate that the firmware has set up [bit/s]."""
        ...

    @property
    def line_baud(self) -> int:
        """Rate at the far end of the wire [bit/s]."""
        ...

    @line_baud.setter
    def line_baud(self, baud: int) -> None: ...

    @property
    def wrong_speed(self) -> str:
        """Return a sentence if the firmware uses the line at another rate than its far end; empty otherwise."""
        ...

    def host_write(self, data: bytes) -> None:
        """Put bytes on the line towards the board, one after the other at line speed."""
        ...

    def host_expect(self, count: int, byte: int) -> None:
        """Set the end of a run with `for_bytes`: `count` unfetched bytes, or a byte with the value `byte`."""
        ...

    @property
    def host_arriving(self) -> int:
        """Bytes of the host that are on the line towards the board."""
        ...

    @property
    def host_waiting(self) -> int:
        """Bytes that the board has sent and the host has not fetched."""
        ...

    def host_read(self, size: int) -> bytes:
        """Return bytes that the board has sent."""
        ...

    @property
    def answer(self) -> tuple[int, int]:
        """Cycles from the host's latest byte to the board's next one, and those of them that the thread executed."""
        ...


class RandomSource(Protocol):
    """A random number generator.

    Attributes
    ----------
    seed : int
        Seed of its numbers; 0 until it is set.
    """

    seed: int


class MachineChip(HasState, Protocol):
    """A processor's peripherals on their bus.

    Attributes
    ----------
    watchdog_resets : int
        Resets by the watchdog since power-on.
    """

    bus: PeripheralBus
    cycle_counter: CycleCounter
    unmodelled: UnmodelledLog
    watchdog_resets: int

    @property
    def clocks(self) -> ChipClocks:
        """The clocks that the firmware has set up, and virtual time."""
        ...

    @property
    def uarts(self) -> Sequence[SerialLine]:
        """The serial ports; the first is the board's own."""
        ...

    @property
    def i2c_buses(self) -> Sequence[I2cBus]:
        """The I2C buses."""
        ...

    @property
    def spi_buses(self) -> Sequence[SpiBus]:
        """The SPI buses."""
        ...

    @property
    def random_numbers(self) -> RandomSource:
        """The random number generator."""
        ...

    @property
    def temperature_degc(self) -> Any:
        """Function that returns the temperature of the chip [degC]."""
        ...

    @temperature_degc.setter
    def temperature_degc(self, temperature_degc: Any) -> None: ...

    def power_on(self, segments: Iterable[LoadSegment]) -> None:
        """Give the flash its content at power-on, behind the segments of the image."""
        ...

    def reset(self, source: ResetSource) -> None:
        """Bring every peripheral to its state after a reset of the chip."""
        ...

    def pin(self, name: str) -> tuple[ChipPins, int]:
        """Return the port of a pin, and its number in the port."""
        ...

    def describe_sleep(self) -> str:
        """Return a description of the processor's sleep mode."""
        ...
