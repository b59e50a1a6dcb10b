"""I2C masters: START, bytes of nine clocks, STOP, and the interrupt after each byte."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.virtual.chip import ChipPeripheral
from hiltest.virtual.clock import PICOSECONDS
from hiltest.virtual.cpu import Processor
from hiltest.virtual.i2c_bus import I2cBus
from hiltest.virtual.peripherals.bus import ALL_STEADY, read_by_bytes, write_by_bytes
from hiltest.virtual.peripherals.clocks import ClockGates
from hiltest.virtual.schedule import Event

_A1, _F, _C1, _S, _D, _C2, _FLT = range(7)
_IICEN, _IICIE, _MST, _TX, _TXAK, _RSTA, _DMAEN = 0x80, 0x40, 0x20, 0x10, 0x08, 0x04, 0x01
_TCF, _BUSY, _ARBL, _IICIF, _RXAK = 0x80, 0x20, 0x10, 0x02, 0x01
_CLOCKS_A_BYTE = 9
_START_CLOCKS = 1  # START or repeated START, set-up and hold

# Divider by ICR, MK64 reference manual, "I2C divider and hold values".
_DIVIDERS = (
    20, 22, 24, 26, 28, 30, 34, 40, 28, 32, 36, 40, 44, 48, 56, 68,
    48, 56, 64, 72, 80, 88, 104, 128, 80, 96, 112, 128, 144, 160, 192, 240,
    160, 192, 224, 256, 288, 320, 384, 480, 320, 384, 448, 512, 576, 640, 768, 960,
    640, 768, 896, 1024, 1152, 1280, 1536, 1920, 1280, 1536, 1792, 2048, 2304, 2560, 3072, 3840,
)  # fmt: skip


class I2c:
    """A Kinetis I2C module, as master.

    Parameters
    ----------
    processor : Processor
        Interrupts.
    clocks : ClockGates
        Time; the module clock is the bus clock.
    bus : I2cBus
        The parts on the wires.
    module : ChipPeripheral
        Which of the chip's modules this is.

    Attributes
    ----------
    on_request : callable
        Told the level of its source of DMA requests: from the end of a byte to the next access to D.
    """

    steady = frozenset(ALL_STEADY) - {_D}

    def __init__(self, processor: Processor, clocks: ClockGates, bus: I2cBus, module: ChipPeripheral) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        self._nvic = processor.nvic
        self._clocks = clocks
        self._bus = bus
        (self._interrupt,) = module.interrupts
        (self._request,) = module.requests
        self.on_request: Callable[[int, bool], None] = lambda _source, _level: None
        self._transfer: Event | None = None
        self.reset()

    def reset(self) -> None:
        """State after a chip reset."""
        if self._transfer is not None:
            self._transfer.cancel()
        self._transfer = None
        self._registers = bytearray(0x10)
        self._status = _TCF
        self._data = 0
        self._address_next = False
        self._receiving = False
        self._byte_asks = False
        self._lost_at_end = False
        self._enabled_s = self._clocks.time_s()
        self._drive()

    def read(self, offset: int, size: int) -> int:
        """Answer a byte register; reading D as receiver starts the next byte."""
        if size > 1:
            return read_by_bytes(self, offset, size)
        if offset == _S:
            return self._status | (_BUSY if self._sees_start else 0)
        if offset != _D:
            return self._registers[offset] if offset < len(self._registers) else 0
        value = self._data
        self._accessed()
        control = self._registers[_C1]
        if control & _MST and not control & _TX and self._transfer is None:
            self._receiving = True
            time_s = self._clocks.time_s()
            is_low = self._bus.holding("sda", time_s) is not None
            self._data = 0 if is_low else self._bus.read(time_s)
            self._lost_at_end = is_low and bool(control & _TXAK)
            self._begin(_CLOCKS_A_BYTE)
            # The byte that is under way can be read only when it is complete.
            self._arriving, self._data = self._data, value
        return value

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a byte register."""
        if size > 1:
            write_by_bytes(self, offset, size, value)
            return
        if offset == _C1:
            self._control(value)
        elif offset == _S:
            self._status &= ~(value & (_IICIF | _ARBL))
            self._drive()
        elif offset == _D:
            self._accessed()
            self._send(value)
        elif offset < len(self._registers):
            self._registers[offset] = value

    def _accessed(self) -> None:
        self._byte_asks = False
        self._drive()

    def _control(self, value: int) -> None:
        before = self._registers[_C1]
        self._registers[_C1] = value & ~_RSTA
        self._byte_asks &= bool(value & _DMAEN)
        if not value & _IICEN:
            self.reset()
            self._registers[_C1] = value & ~_RSTA
        elif value & _MST and (not before & _MST or value & _RSTA):
            self._status |= _BUSY
            self._address_next = True
        elif before & _MST and not value & _MST:
            self._bus.stop(self._clocks.time_s())
            self._status &= ~_BUSY
        self._drive()

    def _send(self, value: int) -> None:
        control = self._registers[_C1]
        if not (control & _MST and control & _TX) or self._transfer is not None:
            return
        self._receiving = False
        time_s = self._clocks.time_s()
        if self._bus.holding("sda", time_s):
            self._address_next = False
            # Of a byte that is all zeros nothing is lost, and low is what acknowledges it.
            self._acknowledged, self._lost_at_end = True, value != 0
            self._begin(_CLOCKS_A_BYTE - value.bit_length())
        elif self._address_next:
            self._address_next = False
            self._acknowledged = self._bus.address(value, time_s)
            self._begin(_CLOCKS_A_BYTE + _START_CLOCKS)
        else:
            self._acknowledged = self._bus.write(value, time_s)
            self._begin(_CLOCKS_A_BYTE)

    @property
    def _sees_start(self) -> bool:
        """Whether SDA fell while it was enabled and SCL high, which is a START to it, and no STOP has followed."""
        held = self._bus.holding("sda", self._clocks.time_s())
        return held is not None and held.begin_s >= self._enabled_s

    def _begin(self, clocks: int) -> None:
        """Begin a byte that takes so many clocks of the wire; it waits for as long as SCL is held."""
        self._status &= ~_TCF
        frequency = self._registers[_F]
        divider = _DIVIDERS[frequency & 0x3F] << (frequency >> 6)
        if held := self._bus.holding("scl", self._clocks.time_s()):
            for_good = math.isinf(held.end_s)
            self._transfer = Event(math.inf) if for_good else self._clocks.time.at(
                math.ceil(held.end_s * PICOSECONDS), self._complete
            )
        else:
            self._transfer = self._clocks.bus.after(clocks * divider, self._complete)

    def _complete(self) -> None:
        self._transfer = None
        self._byte_asks = bool(self._registers[_C1] & _DMAEN)
        self._status |= _TCF | _IICIF
        if self._lost_at_end:
            self._lost_at_end = False
            self._status |= _ARBL
            self._registers[_C1] &= ~_MST
        if self._receiving:
            self._data = self._arriving
        elif self._acknowledged:
            self._status &= ~_RXAK
        else:
            self._status |= _RXAK
        self._drive()

    def _drive(self) -> None:
        requested = bool(self._status & _IICIF and self._registers[_C1] & _IICIE)
        self._nvic.set_line(self._interrupt, requested)
        self.on_request(self._request, self._byte_asks)
