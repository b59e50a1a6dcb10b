"""A part that is absent for a time, or replaced by another one; then it returns in its power-on state."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.state import Restorable
from hiltest.world.sensors.register_device import RegisterDevice
from hiltest.world.sensors.sampling import SampledOutput


class FaultyPart(Restorable):
    """The device at the address of a part with a fault.

    Parameters
    ----------
    make
        Creates the part in its power-on state.
    begin_s, end_s
        Start and end of its absence, virtual time since power-on [s].
    stand_in
        Device that answers meanwhile at the same address; by default none.
    """

    def __init__(
        self, make: Callable[[], RegisterDevice], begin_s: float, end_s: float, stand_in: RegisterDevice | None = None
    ) -> None:
        self._make, self._begin_s, self._end_s, self._stand_in = make, begin_s, end_s, stand_in
        self._part = make()
        self._is_back = False
        self.address = self._part.address
        self.companions: tuple[FaultyPart, ...] = tuple(
            _Companion(self, index) for index in range(len(self._part.companions))
        )

    @property
    def latest(self) -> RegisterDevice:
        """The present or last part."""
        return self._part

    def parts(self) -> tuple[RegisterDevice, ...]:
        """Return the present or last part, and its replacement."""
        return (self._part,) if self._stand_in is None else (self._part, self._stand_in)

    @property
    def outputs(self) -> tuple[SampledOutput, ...]:
        """Outputs of the present or last part."""
        return self.latest.outputs

    @property
    def transferred(self) -> dict[int, int]:
        """Bytes that were read from the present or last part, by register."""
        return self.latest.transferred

    def settings(self) -> dict[int, int]:
        """Return the registers of the present or last part that firmware can write, by address."""
        return self.latest.settings()

    def sampled_settings(self) -> dict[int, int]:
        """Return these registers at its latest delivered sample."""
        return self.latest.sampled_settings()

    @property
    def temperature_register(self) -> int:
        """Register of the die temperature."""
        return self.latest.temperature_register

    def start(self, reading: bool, time_s: float) -> bool:
        """Answer the device address after START or repeated START; True is ACK."""
        device = self.present_part(time_s)
        return device is not None and device.start(reading, time_s)

    def write(self, value: int, time_s: float) -> bool:
        """Receive a byte from the master; True is ACK."""
        device = self.present_part(time_s)
        return device is not None and device.write(value, time_s)

    def read(self, time_s: float) -> int:
        """Return the next byte for the master: ones if no device pulls the line low."""
        device = self.present_part(time_s)
        return 0xFF if device is None else device.read(time_s)

    def stop(self, time_s: float) -> None:
        """Handle a STOP."""
        if device := self.present_part(time_s):
            device.stop(time_s)

    @property
    def pins(self) -> tuple[str, ...]:
        """Interrupt pins of the part."""
        return self.latest.pins

    def select(self, time_s: float) -> None:
        """Begin a transfer over SPI."""
        if device := self.present_part(time_s):
            device.select(time_s)

    def exchange(self, value: int, time_s: float) -> int:
        """Exchange a byte over SPI: ones if no device drives the line."""
        device = self.present_part(time_s)
        return 0xFF if device is None else device.exchange(value, time_s)

    def interrupt_levels(self, time_s: float) -> tuple[bool, ...]:
        """Return the levels of `pins`; those of an absent part are not driven."""
        device = self.present_part(time_s)
        levels = () if device is None else device.interrupt_levels(time_s)
        return (*levels, False, False)[: len(self.pins)]

    def next_interrupt_s(self, time_s: float) -> float:
        """Return the next time at which a level may change without an access [s], by the fault as well."""
        device = self.present_part(time_s)
        changes_s = [time for time in (self._begin_s, self._end_s) if time > time_s]
        return min(math.inf if device is None else device.next_interrupt_s(time_s), *changes_s, math.inf)

    def present_part(self, time_s: float) -> RegisterDevice | None:
        """Return the device that answers at a time, if any."""
        if self._begin_s <= time_s < self._end_s:
            return self._stand_in
        if time_s >= self._end_s and not self._is_back:
            self._is_back = True
            self._part = self._make()
            self.latest.power_up(self._end_s)
        return self._part


class _Companion(FaultyPart):
    """A further device in the package of a part with a fault."""

    def __init__(self, package: FaultyPart, index: int) -> None:
        self._package, self._index = package, index
        self._begin_s, self._end_s = package._begin_s, package._end_s
        self.address, self.companions = self.latest.address, ()

    def parts(self) -> tuple[RegisterDevice, ...]:
        """Return nothing: its state is the package's."""
        return ()

    @property
    def latest(self) -> RegisterDevice:
        """The present or last device."""
        return self._package.latest.companions[self._index]

    def present_part(self, time_s: float) -> RegisterDevice | None:
        """Return the device that answers at a time, if any; a stand-in has no companions."""
        package = self._package.present_part(time_s)
        return package.companions[self._index] if package is self._package.latest and package is not None else None
