"""TWI: an I2C master that sends and receives single bytes."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.i2c_bus import I2cBus
from hiltest.virtual.peripherals.nrf51.block import CLOCK_HZ, Alarm, Block
from hiltest.virtual.processor.cpu import Processor

_START_RX, _START_TX, _STOP, _SUSPEND, _RESUME = 0x00, 0x08, 0x14, 0x1C, 0x20
_STOPPED, _RX_READY, _TX_SENT, _ERROR, _BYTE_BOUNDARY, _SUSPENDED = 0x104, 0x108, 0x11C, 0x124, 0x138, 0x148
_ERROR_SOURCE, _ENABLE, _SCL, _SDA, _RXD, _TXD, _FREQUENCY, _ADDRESS = (
    0x4C4, 0x500, 0x508, 0x50C, 0x518, 0x51C, 0x524, 0x588,
)  # fmt: skip
_ENABLED, _NO_ADDRESS_ACK, _NO_DATA_ACK = 5, 2, 4
_BITS_A_BYTE = 9  # with the acknowledge bit
_NO_BUS = I2cBus(())


class Twi(Block):
    """TWI0 or TWI1.

    Parameters
    ----------
    buses
        Buses of the board, by the numbers of the pins of SCL and SDA.

    Notes
    -----
    BB is generated before each byte; SUSPEND and STOP, by a task or by a shortcut of BB, take effect after it.
    """

    steady = frozenset(ALL_STEADY) - frozenset(range(_RXD, _RXD + 4))  # a read lets the next byte begin

    def __init__(
        self, processor: Processor, chip: Chip, module: ChipPeripheral, buses: Mapping[tuple[int, int], I2cBus]
    ) -> None:
        self._buses, self._bus = buses, _NO_BUS
        self._boundary = Alarm(processor, self._end_byte)
        self._end = Alarm(processor, self._stopped)
        tasks = {
            _START_RX: lambda: self._start(reads=True),
            _START_TX: lambda: self._start(reads=False),
            _STOP: self._stop,
            _SUSPEND: self._suspend,
            _RESUME: self._resume,
        }
        shortcuts = ((0, _BYTE_BOUNDARY, _SUSPEND), (1, _BYTE_BOUNDARY, _STOP))
        super().__init__(processor, chip, module, tasks=tasks, shortcuts=shortcuts)

    def reset(self) -> None:
        super().reset()
        self._boundary.cancel()
        self._end.cancel()
        self._is_open = self._reads = self._in_address = False  # a transfer is open; its direction; its first byte
        self._must_stop = self._must_suspend = self._is_suspended = False
        self._unread = False  # RXD holds a byte
        self._to_send: int | None = None

    @property
    def _time_s(self) -> float:
        return self._processor.now() / CLOCK_HZ

    def _bits(self, count: int) -> int:
        """Return the cycles of a number of bits."""
        return round(count * (1 << 32) / max(self.word(_FREQUENCY), 1))

    def _start(self, *, reads: bool) -> None:
        if self.word(_ENABLE) != _ENABLED:
            return
        if self._end.is_planned:  # the bit of a STOP, which ends now
            self._end.cancel()
            self._stopped()
        self._bus = self._buses.get((self.word(_SCL), self.word(_SDA)), _NO_BUS)
        self._is_open, self._reads, self._in_address = True, reads, True
        self._must_stop = self._must_suspend = self._is_suspended = self._unread = False
        self._boundary.after(self._bits(_BITS_A_BYTE + 1))

    def _stop(self) -> None:
        if self._boundary.is_planned:
            self._must_stop = True
        elif self.word(_ENABLE) == _ENABLED:
            self._end.after(self._bits(1))

    def _suspend(self) -> None:
        if self._boundary.is_planned:
            self._must_suspend = True

    def _resume(self) -> None:
        if self._is_suspended:
            self._is_suspended = False
            self._go_on()

    def _go_on(self) -> None:
        """Begin the next byte, if the transfer has one."""
        if not self._is_open or self._is_suspended or self._boundary.is_planned or self._end.is_planned:
            return
        if self._unread if self._reads else self._to_send is None:
            return  # the clock is stretched until firmware has read RXD, or written TXD
        self._boundary.after(self._bits(_BITS_A_BYTE))
        self.set_event(_BYTE_BOUNDARY)

    def _end_byte(self) -> None:
        if self._in_address:
            self._in_address = False
            if not self._bus.address(self.word(_ADDRESS) << 1 & 0xFF | self._reads, self._time_s):
                self._fail(_NO_ADDRESS_ACK)
                return
        elif self._reads:
            self.store_word(_RXD, self._bus.read(self._time_s))
            self._unread = True
            self.set_event(_RX_READY)
        else:
            byte, self._to_send = self._to_send or 0, None
            acknowledged = self._bus.write(byte, self._time_s)
            self.set_event(_TX_SENT)
            if not acknowledged:
                self._fail(_NO_DATA_ACK)
                return
        if self._must_stop:
            self._end.after(self._bits(1))
        elif self._must_suspend:
            self._must_suspend, self._is_suspended = False, True
            self.set_event(_SUSPENDED)
        else:
            self._go_on()

    def _fail(self, source: int) -> None:
        self._to_send = None
        self.store_word(_ERROR_SOURCE, self.word(_ERROR_SOURCE) | source)
        self._is_open = False
        if self._must_stop:
            self._end.after(self._bits(1))
        self.set_event(_ERROR)

    def _stopped(self) -> None:
        self._is_open = self._must_stop = self._is_suspended = False
        self._to_send = None
        self._bus.stop(self._time_s)
        self.set_event(_STOPPED)

    def read(self, offset: int, size: int) -> int:
        value = super().read(offset, size)
        if offset == _RXD and self._unread:
            self._unread = False
            self._processor.report_changing_read()
            self._go_on()
        return value

    def write(self, offset: int, size: int, value: int) -> None:
        if offset == _ERROR_SOURCE:
            self.store_word(offset, self.word(offset) & ~value)
            return
        super().write(offset, size, value)
        if offset == _TXD:
            self._to_send = value & 0xFF
            self._go_on()
        elif offset == _ENABLE and value != _ENABLED:
            self._boundary.cancel()
            self._end.cancel()
            self._is_open = False
