"""SPI as master of parts whose chip selects are pins."""

from __future__ import annotations

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.spi_bus import SpiBus
from hiltest.virtual.peripherals.stm32.block import Block
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_CR1, _CR2, _SR, _DR, _I2SCFGR = 0x00, 0x04, 0x08, 0x0C, 0x1C
_MSTR, _SPE, _LSBFIRST, _SSI, _SSM, _DFF = 1 << 2, 1 << 6, 1 << 7, 1 << 8, 1 << 9, 1 << 11
_OTHER_MODES = 0xF400  # CR1: BIDIMODE, BIDIOE, CRCEN, CRCNEXT, RXONLY
_RXDMAEN, _TXDMAEN, _SSOE, _ERRIE, _RXNEIE, _TXEIE = 1, 2, 4, 1 << 5, 1 << 6, 1 << 7
_RXNE, _TXE, _MODF, _OVR, _BSY = 1, 2, 1 << 5, 1 << 6, 1 << 7


class Spi(Block):
    """A master with frames of 8 and 16 bits in both directions; slave, one-way modes, CRC and I2S have no model.

    Clock phase and polarity are not checked.
    """

    steady = frozenset(ALL_STEADY) - frozenset(range(_DR, _DR + 4))  # a read clears flags

    def __init__(
        self, processor: Processor, module: ChipPeripheral, bus: SpiBus, clock: Clock, time: Clock, log: UnmodelledLog
    ) -> None:
        self._bus, self._clock, self._time, self._log = bus, clock, time, log
        self._frame: Event | None = None
        super().__init__(processor, module)

    def reset(self) -> None:
        super().reset()
        self._abort()
        self._received = 0
        self._overrun_read = self._mode_fault_read = False  # DR was read after an overrun, SR after a mode fault
        self._drive()

    def _abort(self) -> None:
        if self._frame is not None:
            self._frame.cancel()
        self._frame, self._shifting = None, 0
        self._next: int | None = None  # frame in DR behind the one that is being sent
        self.store_word(_SR, self.word(_SR) & ~_BSY | _TXE)

    def _drive(self) -> None:
        status, control = self.word(_SR), self.word(_CR2)
        asks = (status & _TXE and control & _TXEIE) or (status & _RXNE and control & _RXNEIE)
        self.drive_interrupt(bool(asks or (status & (_OVR | _MODF) and control & _ERRIE)))
        is_on = self.word(_CR1) & _SPE
        levels = control & _RXDMAEN and status & _RXNE, is_on and control & _TXDMAEN and status & _TXE
        for number, level in zip(self.module.requests, levels, strict=False):
            self.processor.machine.set_request(number, bool(level))

    # -- frames -------------------------------------------------------------------------------

    @property
    def _bits(self) -> int:
        return 16 if self.word(_CR1) & _DFF else 8

    def _send(self, frame: int) -> None:
        if self._frame is None and self.word(_CR1) & (_SPE | _MSTR) == _SPE | _MSTR:
            self._shift(frame)
        else:
            self._next = frame
            self.change_word(_SR, clear=_TXE)

    def _shift(self, frame: int) -> None:
        self._shifting = frame
        self.change_word(_SR, put=_BSY | _TXE)
        clocks = self._bits << (self.word(_CR1) >> 3 & 7) + 1
        self._frame = self._clock.call_after(clocks, self._end_frame)

    def _end_frame(self) -> None:
        self._frame = None
        frame = self._exchange(self._shifting)
        if self.word(_SR) & _RXNE:
            self.change_word(_SR, put=_OVR)  # the frame is lost
        else:
            self._received = frame
            self.change_word(_SR, put=_RXNE)
        if self._next is None:
            self.change_word(_SR, clear=_BSY)
        else:
            frame, self._next = self._next, None
            self._shift(frame)
        self._drive()

    def _exchange(self, frame: int) -> int:
        bits, time_s = self._bits, self._time.now() / PICOSECONDS
        is_mirrored = self.word(_CR1) & _LSBFIRST
        frame = _mirror(frame, bits) if is_mirrored else frame
        answer = 0
        for shift in range(bits - 8, -1, -8):
            answer = answer << 8 | self._bus.exchange(frame >> shift & 0xFF, time_s)
        return _mirror(answer, bits) if is_mirrored else answer

    # -- registers ----------------------------------------------------------------------------

    def read_word(self, offset: int) -> int:
        value = self.word(offset)
        if offset == _SR:
            self._mode_fault_read = bool(value & _MODF)
            if self._overrun_read:
                self.change_word(_SR, clear=_OVR)
                self._overrun_read = False
                self.processor.report_changing_read()
                self._drive()
        elif offset == _DR:
            self._overrun_read = bool(self.word(_SR) & _OVR)
            self.change_word(_SR, clear=_RXNE)
            value = self._received
            self._drive()
        return value

    def write_word(self, offset: int, value: int, mask: int) -> None:
        if offset == _DR:
            self._send(value & (1 << self._bits) - 1)
        elif offset == _SR:
            return
        else:
            super().write_word(offset, value, mask)
        if offset == _CR1:
            self._control()
        if offset == _I2SCFGR and value:
            self._log.note(self.base + offset, 2, value)
        self._drive()

    def _control(self) -> None:
        control = self.word(_CR1)
        if self._mode_fault_read:
            self.change_word(_SR, clear=_MODF)
            self._mode_fault_read = False
        if control & _OTHER_MODES or control & (_SPE | _MSTR) == _SPE or control & (_SPE | _SSM) == _SPE:
            self._log.note(self.base + _CR1, 2, control)
        if control & _MSTR and control & _SSM and not control & _SSI:  # NSS is low: another master
            self.change_word(_CR1, clear=_MSTR | _SPE)
            self.change_word(_SR, put=_MODF)
        if not self.word(_CR1) & _SPE:
            self._abort()
        elif self._next is not None and self._frame is None:
            frame, self._next = self._next, None
            self._shift(frame)


def _mirror(frame: int, bits: int) -> int:
    return int(f"{frame:0{bits}b}"[::-1], 2)
