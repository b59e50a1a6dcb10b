"""USART: bytes with their bit times, flags and interrupts, and the far end of the wire."""

from __future__ import annotations

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.far_end import FarEnd
from hiltest.virtual.peripherals.stm32.block import Block
from hiltest.virtual.peripherals.uart import describe_speeds
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_SR, _DR, _BRR, _CR1, _CR3 = 0x00, 0x04, 0x08, 0x0C, 0x14
_FE, _ORE, _IDLE, _RXNE, _TC, _TXE = 1 << 1, 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7
_READ_CLEARS = 0x1F  # PE, FE, NF, ORE, IDLE: by a read of SR and then of DR
_WRITE_CLEARS = _RXNE | _TC
_UE, _TE, _RE, _OVER8, _EIE = 1 << 13, 1 << 3, 1 << 2, 1 << 15, 1
_BITS_A_BYTE = 10
_TOLERANCE = 0.03  # beyond it the last bits are sampled during adjacent bits


class Usart(Block, FarEnd):
    """A USART with eight data bits, no parity and one stop bit; other frames and DMA requests are not modelled."""

    steady = frozenset(ALL_STEADY) - frozenset(range(8))  # reads of SR and DR clear flags

    def __init__(self, processor: Processor, module: ChipPeripheral, clock: Clock, time: Clock) -> None:
        self._clock, self._time = clock, time
        self._sending: Event | None = None
        self.connect_far_end(module.name, self._expect_arrival)
        super().__init__(processor, module)

    def reset(self) -> None:
        super().reset()
        if self._sending is not None:
            self._sending.cancel()
        self._sending, self._shifting = None, 0
        self._next: int | None = None  # byte in DR behind the one that is being sent
        self._received = 0
        self._flags_read = 0
        self._drive()

    @property
    def _divider(self) -> int:
        """Clocks of the block for a bit."""
        ratio = self.word(_BRR) & 0xFFFF
        return (ratio >> 4) * 8 + (ratio & 7) if self.word(_CR1) & _OVER8 else ratio

    @property
    def baud(self) -> float:
        """Rate that the firmware has set up [bit/s]."""
        return float(self._clock.hz) / self._divider if self._divider else 0.0

    @property
    def _is_understood(self) -> bool:
        return abs(self.baud / self.line_baud - 1.0) <= _TOLERANCE

    @property
    def wrong_speed(self) -> str:
        """Return a sentence if the firmware uses the line at another rate than its far end; empty otherwise."""
        control = self.word(_CR1)
        is_on = control & _UE and control & (_TE | _RE)
        return describe_speeds(self.name, self.baud, self.line_baud) if is_on and not self._is_understood else ""

    def _drive(self) -> None:
        status, control = self.word(_SR), self.word(_CR1)
        asks = status & control & (_TXE | _TC | _RXNE | _IDLE)  # the enabling bits are at the places of the flags
        asks |= status & _ORE if control & _RXNE else 0
        self.drive_interrupt(bool(asks))

    def _set(self, flags: int) -> None:
        self.change_word(_SR, put=flags)
        self._drive()

    # -- sending ------------------------------------------------------------------------------

    def _send(self, byte: int) -> None:
        if self._flags_read & _TC:
            self.change_word(_SR, clear=_TC)
        if not self.word(_CR1) & _UE or not self.word(_CR1) & _TE or not self._divider:
            return
        if self._sending is None:
            self._shift(byte)
        else:
            self._next = byte
            self.change_word(_SR, clear=_TXE)

    def _shift(self, byte: int) -> None:
        self._shifting = byte
        self._sending = self._clock.call_after(_BITS_A_BYTE * self._divider, self._end_byte)

    def _end_byte(self) -> None:
        self.send_to_host(self._shifting if self._is_understood else self._shifting ^ 0xFF)
        self._sending = None
        if self._next is None:
            self._set(_TC)
        else:
            byte, self._next = self._next, None
            self._shift(byte)
            self._set(_TXE)

    # -- receiving ----------------------------------------------------------------------------

    def _expect_arrival(self) -> None:
        self._time.call_after(round(_BITS_A_BYTE * PICOSECONDS / self.line_baud), self._receive)

    def _receive(self) -> None:
        """Take the byte from the host whose stop bit has arrived."""
        byte = self.take_from_host()
        if not self.clocked or self.word(_CR1) & (_UE | _RE) != _UE | _RE:
            return
        if not self._to_board:
            self._time.call_after(round(_BITS_A_BYTE * PICOSECONDS / self.line_baud), self._be_idle)
        if self.word(_SR) & _RXNE:
            self._set(_ORE)
            return
        self._received = byte if self._is_understood else byte ^ 0xFF
        self._set(_RXNE if self._is_understood else _RXNE | _FE)

    def _be_idle(self) -> None:
        if not self._to_board:
            self._set(_IDLE)

    # -- registers ----------------------------------------------------------------------------

    def read_word(self, offset: int) -> int:
        if offset == _SR:
            self._flags_read = self.word(_SR)
        elif offset == _DR:
            self.change_word(_SR, clear=_RXNE | self._flags_read & _READ_CLEARS)
            self._flags_read &= ~_READ_CLEARS
            self._drive()
            return self._received
        return self.word(offset)

    def write_word(self, offset: int, value: int, mask: int) -> None:
        if offset == _DR:
            self._send(value & 0xFF)
        elif offset == _SR:
            self.change_word(_SR, clear=mask & ~value & _WRITE_CLEARS)
        else:
            super().write_word(offset, value, mask)
        self._drive()
