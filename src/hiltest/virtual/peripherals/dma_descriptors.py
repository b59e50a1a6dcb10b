"""Registers of the eDMA's descriptors, and which channels they start."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import StoredRegisters
from hiltest.virtual.peripherals.dma_descriptor import SIZE, Control, Descriptor
from hiltest.virtual.peripherals.dmamux import CHANNELS

_CSR = 0x1C


class DescriptorRegisters(StoredRegisters):
    """The second page of the eDMA: a descriptor for each channel.

    Parameters
    ----------
    module : ChipPeripheral
        Its addresses.
    look : callable
        Told that a channel was started by a write.

    Attributes
    ----------
    started : int
        Channels whose START is set, a bit each.
    """

    def __init__(self, module: ChipPeripheral, look: Callable[[], None]) -> None:
        self._look = look
        super().__init__(module.name, module.base + 0x1000)

    def reset(self) -> None:
        """Clear all of them; the part leaves them undefined."""
        super().reset()
        self.started = 0

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a register; of CSR what the controller owns stays as it is."""
        channel, place = divmod(offset, SIZE)
        if channel >= CHANNELS:
            return
        before = self.control(channel)
        super().write(offset, size, value)
        written = self.control(channel)
        if place + size <= _CSR or place >= _CSR + 2:
            return
        kept = before & (Control.ACTIVE | written & Control.DONE)
        if kept & Control.DONE:
            written &= ~(Control.MAJORELINK | Control.ESG)
        self._put_control(channel, written & ~(Control.ACTIVE | Control.DONE) | kept)
        if self.started:
            self._look()

    def control(self, channel: int) -> int:
        """CSR of a channel."""
        return int.from_bytes(self._bytes[SIZE * channel + _CSR : SIZE * channel + _CSR + 2], "little")

    def change_control(self, channel: int, *, clear: int, put: int) -> None:
        """Clear and set bits of a channel's CSR."""
        self._put_control(channel, self.control(channel) & ~clear | put)

    def _put_control(self, channel: int, value: int) -> None:
        self._bytes[SIZE * channel + _CSR : SIZE * channel + _CSR + 2] = value.to_bytes(2, "little")
        self.started = self.started & ~(1 << channel) | (value & Control.START) << channel

    def get(self, channel: int, *, offsets: bool) -> Descriptor:
        """Read a channel's descriptor."""
        return Descriptor.unpack(bytes(self._bytes[SIZE * channel : SIZE * (channel + 1)]), offsets=offsets)

    def put(self, channel: int, descriptor: Descriptor) -> None:
        """Write a channel's descriptor."""
        self._bytes[SIZE * channel : SIZE * (channel + 1)] = descriptor.pack()
        self._put_control(channel, descriptor.csr)
