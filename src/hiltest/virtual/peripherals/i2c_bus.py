"""An I2C bus with its parts, as a master accesses them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from hiltest.state import HasState, Restorable


class I2cDevice(HasState, Protocol):
    """A part on the bus; times are virtual seconds since power-on."""

    @property
    def address(self) -> int:
        """Seven-bit address."""
        ...

    def start(self, reading: bool, time_s: float) -> bool:
        """Address the part after START or repeated START; return True to acknowledge."""
        ...

    def write(self, value: int, time_s: float) -> bool:
        """Write a byte to the part; return True to acknowledge."""
        ...

    def read(self, time_s: float) -> int:
        """Return the next byte that the master reads."""
        ...

    def stop(self, time_s: float) -> None:
        """End the transfer: STOP on the bus."""
        ...


@dataclass(frozen=True, slots=True)
class HeldLine:
    """A line that is held low from `begin_s` to `end_s` [virtual s since power-on]."""

    line: Literal["scl", "sda"]
    begin_s: float
    end_s: float


class I2cBus(Restorable):
    """Bus that connects a master to parts by their addresses.

    Parameters
    ----------
    devices
        Parts with different addresses.

    Attributes
    ----------
    on_hold : callable
        Called to hold a line low for a time, instead of the previous hold.
    slave : I2cDevice or None
        Another I2C module of the chip, which hears addresses that no part has.
    is_refused : bool
        True if the master does not acknowledge the byte that it is reading.
    booting : dict of int to float
        Parts that were still booting when they were addressed last, by address, and the time of that [virtual s].
    """

    def __init__(self, devices: Sequence[I2cDevice]) -> None:
        self._devices = {device.address: device for device in devices}
        if len(self._devices) != len(devices):
            raise ValueError("two parts on one bus have the same address")
        self.on_hold: Callable[[HeldLine], None] = lambda _hold: None
        self.slave: I2cDevice | None = None
        self.is_refused = False
        self.booting: dict[int, float] = {}
        self._addressed: I2cDevice | None = None
        self._after_stop: dict[int, Callable[[], None]] = {}

    def parts(self) -> Iterable[I2cDevice]:
        return self._devices.values()

    def part_name(self, address: int) -> str:
        """Return the name of the part at an address, such as ``FXAS21002C``."""
        return type(self._devices[address]).__name__.upper()

    def call_after_stop(self, device: I2cDevice, action: Callable[[], None]) -> None:
        """Call `action` after each STOP that ends an access to a part."""
        self._after_stop[device.address] = action

    def address(self, byte: int, time_s: float) -> bool:
        """Send the address byte that follows a START."""
        device = self._devices.get(byte >> 1)
        self.booting.pop(byte >> 1, None)
        if device is None:
            is_slave = self.slave is not None and self.slave.address == byte >> 1
            device = self.slave if is_slave else None
            self._addressed = device
            return device is not None and device.start(bool(byte & 1), time_s)
        if not device.start(bool(byte & 1), time_s):
            self._addressed = None
            responds: Callable[[float], bool] | None = getattr(device, "responds", None)
            if responds is not None and not responds(time_s):
                self.booting[byte >> 1] = time_s
            return False
        self._addressed = device
        return True

    def write(self, value: int, time_s: float) -> bool:
        return self._addressed is not None and self._addressed.write(value, time_s)

    def read(self, time_s: float) -> int:
        """Return a data byte; without an addressed part all bits are ones."""
        return 0xFF if self._addressed is None else self._addressed.read(time_s)

    def stop(self, time_s: float) -> None:
        device, self._addressed = self._addressed, None
        if device is not None:
            device.stop(time_s)
            if action := self._after_stop.get(device.address):
                action()
