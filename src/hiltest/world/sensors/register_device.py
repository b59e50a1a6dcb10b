"""An I2C part with a register file behind an auto-incrementing address pointer."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

from hiltest.state import Restorable
from hiltest.world.sensors.sampling import SampledOutput


class RegisterDevice(ABC, Restorable):
    """Common bus interface of all parts, over I2C and, if they have it, SPI.

    The first byte written after an address is the register pointer; each further byte
    written or read goes to the pointed register and moves the pointer on. The pointer
    survives STOP. Time is virtual time since power-on [s].

    Attributes
    ----------
    address : int
        7-bit address.
    outputs : tuple of SampledOutput
        Outputs of its measured quantities.
    transferred : dict of int to int
        The byte of each register that was read last; whoever asks may clear it.
    temperature_register : int
        Register of the die temperature, a signed byte.
    pins : tuple of str
        Interrupt pins by their names in the data sheet.
    companions : tuple of RegisterDevice
        Further devices in the same package, each with an address of its own.
    """

    temperature_register: ClassVar[int]

    def __init__(self, address: int) -> None:
        self.address = address
        self.pins: tuple[str, ...] = ("INT1", "INT2")
        self.companions: tuple[RegisterDevice, ...] = ()
        self.outputs: tuple[SampledOutput, ...] = ()
        self.transferred: dict[int, int] = {}
        self._samples = 0.0
        self._sampled: dict[int, int] = {}
        self._pointer = 0
        self._awaiting_pointer = False

    def parts(self) -> tuple[Restorable, ...]:
        """Return the outputs, and all other stateful members of the part."""
        return self.outputs

    def start(self, reading: bool, time_s: float) -> bool:
        """Answer the device address after START or repeated START; True is ACK."""
        if not self.responds(time_s):
            return False
        self.settle(time_s)
        self.release()
        self._awaiting_pointer = not reading
        return True

    def write(self, value: int, time_s: float) -> bool:
        """Receive a byte from the master; True is ACK."""
        self.settle(time_s)
        if self._awaiting_pointer:
            self.point_to(value)
            self._awaiting_pointer = False
            return True
        self.sampled_settings()
        acknowledged = self.write_register(self._pointer, value, time_s)
        self._pointer = self.following_write(self._pointer)
        return acknowledged

    def read(self, time_s: float) -> int:
        """Return the next byte for the master."""
        self.settle(time_s)
        value = self.transferred[self._pointer] = self.read_register(self._pointer, time_s)
        self._pointer = self.following(self._pointer)
        return value

    def stop(self, time_s: float) -> None:
        """Handle a STOP: output registers follow new samples again."""
        self.settle(time_s)
        self.release()

    def select(self, time_s: float) -> None:
        """Begin a transfer over SPI: chip select becomes active."""

    def exchange(self, value: int, time_s: float) -> int:
        """Exchange a byte over SPI; a part without SPI does not drive its line."""
        return 0xFF

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return the levels of `pins`: True is high. A missing pin is low."""
        return (False,) * len(self.pins)

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next time at which a level may change without an access [s]; infinity if none."""
        return math.inf

    def power_up(self, time_s: float) -> None:
        """Start at a different time than the board, like a part whose supply returns."""

    def responds(self, time_s: float) -> bool:
        """Return whether the part answers its address now."""
        return True

    def settings(self) -> dict[int, int]:
        """Return the present values of the registers that firmware can write, by address; empty if unknown."""
        return {}

    def sampled_settings(self) -> dict[int, int]:
        """Return the settings at the latest delivered sample, though they may have changed since; else the present."""
        samples = sum(output.delivered[0] for output in self.outputs)
        if samples != self._samples:
            self._samples, self._sampled = samples, self.settings()
        return self._sampled or self.settings()

    def point_to(self, pointer: int) -> None:
        """Set the register pointer from the first byte of a write."""
        self._pointer = pointer

    def following_write(self, register: int) -> int:
        """Return the register a write moves on to."""
        return (register + 1) & 0xFF

    def settle(self, time_s: float) -> None:
        """Perform pending transitions in time, before an access."""

    @abstractmethod
    def release(self) -> None:
        """End the hold that a burst read has on the output registers."""

    @abstractmethod
    def following(self, register: int) -> int:
        """Return the register a read moves on to."""

    @abstractmethod
    def read_register(self, register: int, time_s: float) -> int:
        """Return a register's byte, with the side effects of reading it."""

    @abstractmethod
    def write_register(self, register: int, value: int, time_s: float) -> bool:
        """Write a register (read-only ones ignore it); True is ACK."""


def signed_byte(value: float) -> int:
    """Return a number, rounded and limited to -128..127, as a two's-complement byte."""
    return max(-128, min(127, round(value))) & 0xFF
