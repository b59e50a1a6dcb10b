"""An SPI bus with its parts, as a master accesses them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from hiltest.state import HasState, Restorable


class SpiDevice(HasState, Protocol):
    """A part on the bus; times are virtual seconds since power-on."""

    def select(self, time_s: float) -> None:
        """Begin a transfer: chip select falls."""
        ...

    def exchange(self, value: int, time_s: float) -> int:
        """Exchange a byte, the highest bit first; return the byte of the part."""
        ...

    def stop(self, time_s: float) -> None:
        """End the transfer: chip select rises."""
        ...


class SpiBus(Restorable):
    """Bus that connects a master to the parts whose chip select is low.

    Parameters
    ----------
    devices
        Parts by the pin that selects them.
    """

    def __init__(self, devices: Mapping[str, SpiDevice]) -> None:
        self.devices = dict(devices)
        self._selected: dict[str, SpiDevice] = {}
        self._after_stop: dict[str, Callable[[], None]] = {}

    def parts(self) -> Iterable[SpiDevice]:
        return self.devices.values()

    def call_after_stop(self, device: SpiDevice, action: Callable[[], None]) -> None:
        """Call `action` at the end of each transfer with a part."""
        for pin, other in self.devices.items():
            if other is device:
                self._after_stop[pin] = action

    def set_select(self, pin: str, high: bool, time_s: float) -> None:
        """Follow the level of a chip select."""
        if not high and pin not in self._selected:
            self._selected[pin] = self.devices[pin]
            self.devices[pin].select(time_s)
        elif high and pin in self._selected:
            self._selected.pop(pin).stop(time_s)
            if action := self._after_stop.get(pin):
                action()

    def exchange(self, value: int, time_s: float) -> int:
        """Exchange a byte with the selected parts; without any, all bits are ones."""
        answer = 0xFF
        for device in self._selected.values():
            answer &= device.exchange(value, time_s)
        return answer
