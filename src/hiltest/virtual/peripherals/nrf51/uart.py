"""UART0: a serial port with a FIFO of six received bytes, and the far end of its wire."""

from __future__ import annotations

from collections import deque

from hiltest.virtual.part.chip import Chip, ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.far_end import FarEnd
from hiltest.virtual.peripherals.nrf51.block import CLOCK_HZ, Alarm, Block
from hiltest.virtual.peripherals.uart import describe_speeds
from hiltest.virtual.processor.cpu import Processor

_START_RX, _STOP_RX, _START_TX, _STOP_TX, _SUSPEND = 0x00, 0x04, 0x08, 0x0C, 0x1C
_RX_READY, _TX_READY, _ERROR, _RX_TIMEOUT = 0x108, 0x11C, 0x124, 0x144
_ERROR_SOURCE, _ENABLE, _RXD, _TXD, _BAUD_RATE = 0x480, 0x500, 0x518, 0x51C, 0x524
_ENABLED, _OVERRUN, _FRAMING = 4, 1, 4
_FIFO_BYTES, _BITS_A_BYTE = 6, 10
_TOLERANCE = 0.04  # of the rate: a byte's last bit is then sampled within it


class Uart(Block, FarEnd):
    """UART0."""

    steady = frozenset(ALL_STEADY) - frozenset(range(_RXD, _RXD + 4))  # a read takes the byte

    def __init__(self, processor: Processor, chip: Chip, module: ChipPeripheral) -> None:
        self.connect_far_end(module.name, self._expect_arrival)
        self._fifo: deque[int] = deque()
        self._receives = self._sends = False
        self._sending: int | None = None
        self._sent = Alarm(processor, self._end_byte)
        self._arrival = Alarm(processor, self._receive)
        tasks = {
            _START_RX: lambda: self._switch(receives=True),
            _STOP_RX: self._stop_receiving,
            _START_TX: lambda: self._switch(sends=True),
            _STOP_TX: lambda: self._switch(sends=False),
            _SUSPEND: lambda: self._switch(receives=False, sends=False),
        }
        super().__init__(processor, chip, module, tasks=tasks)

    def reset(self) -> None:
        super().reset()
        self._fifo.clear()
        self._receives = self._sends = False
        self._sending = None
        self._sent.cancel()

    def _switch(self, *, receives: bool | None = None, sends: bool | None = None) -> None:
        self._receives = self._receives if receives is None else receives
        self._sends = self._sends if sends is None else sends

    def _stop_receiving(self) -> None:
        self._receives = False
        self.set_event(_RX_TIMEOUT)

    @property
    def baud(self) -> float:
        """Rate that the firmware has set up [bit/s]."""
        return self.word(_BAUD_RATE) * CLOCK_HZ / (1 << 32)

    @property
    def wrong_speed(self) -> str:
        """Return a sentence if the firmware uses the line at another rate than its far end; empty otherwise."""
        is_on = self.word(_ENABLE) == _ENABLED
        return describe_speeds(self.name, self.baud, self.line_baud) if is_on and not self._is_understood else ""

    @property
    def _is_understood(self) -> bool:
        """Return whether both ends of the wire have the same rate."""
        return abs(self.baud / self.line_baud - 1.0) <= _TOLERANCE

    def _byte_cycles(self, baud: float) -> int:
        return round(_BITS_A_BYTE * CLOCK_HZ / baud)

    def read(self, offset: int, size: int) -> int:
        if offset != _RXD:
            return super().read(offset, size)
        value = self._fifo.popleft() if self._fifo else 0
        if self._fifo:
            self.set_event(_RX_READY)
        self._processor.report_changing_read()
        return value

    def write(self, offset: int, size: int, value: int) -> None:
        if offset == _TXD:
            if self._sends and self.word(_ENABLE) == _ENABLED and self.baud and self._sending is None:
                self._sending = value & 0xFF
                self._sent.after(self._byte_cycles(self.baud))
        elif offset == _ERROR_SOURCE:
            self.store_word(offset, self.word(offset) & ~value)
        else:
            super().write(offset, size, value)

    def _end_byte(self) -> None:
        byte, self._sending = self._sending, None
        if byte is not None:
            self.send_to_host(byte if self._is_understood else 0xFF)
        self.set_event(_TX_READY)

    def _expect_arrival(self) -> None:
        self._arrival.after(self._byte_cycles(self.line_baud))

    def _receive(self) -> None:
        """Take the byte from the host whose stop bit has arrived."""
        byte = self.take_from_host()
        if not self._receives or self.word(_ENABLE) != _ENABLED:
            return
        if not self._is_understood:
            self._fail(_FRAMING)
        elif len(self._fifo) == _FIFO_BYTES:
            self._fail(_OVERRUN)
        else:
            self._fifo.append(byte)
            if len(self._fifo) == 1:
                self.set_event(_RX_READY)

    def _fail(self, source: int) -> None:
        self.store_word(_ERROR_SOURCE, self.word(_ERROR_SOURCE) | source)
        self.set_event(_ERROR)
