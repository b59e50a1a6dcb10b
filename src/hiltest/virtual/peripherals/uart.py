"""UART: a serial port, bit-timed, with its FIFOs and interrupts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hiltest.virtual.chip import ChipPeripheral
from hiltest.virtual.clock import PICOSECONDS, Clock
from hiltest.virtual.cpu import Processor
from hiltest.virtual.peripherals.bus import ALL_STEADY, read_by_bytes, write_by_bytes
from hiltest.virtual.peripherals.clocks import ClockGates
from hiltest.virtual.schedule import Event

_BDH, _BDL, _C2, _S1, _C3, _D, _C4, _C5 = 0x0, 0x1, 0x3, 0x4, 0x6, 0x7, 0xA, 0xB
_PFIFO, _CFIFO, _SFIFO, _TWFIFO, _TCFIFO, _RWFIFO, _RCFIFO = 0x10, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16
_TDRE, _TC, _RDRF, _IDLE, _OR, _FE = 0x80, 0x40, 0x20, 0x10, 0x08, 0x02
_TE, _RE = 0x08, 0x04
_RXUF, _TXOF, _RXOF = 0x01, 0x02, 0x04
_BITS_A_BYTE = 10
_BAUD_TOLERANCE = 0.03  # beyond this the last bits of a byte are sampled in their neighbours


class Uart:
    """A Kinetis UART.

    Parameters
    ----------
    processor : Processor
        Interrupts.
    clocks : ClockGates
        Time.
    clock : Clock
        The module clock.
    module : ChipPeripheral
        Which of the chip's UARTs this is.
    depth : int
        Bytes that its FIFOs hold: 8, or 1 where it has none.

    Attributes
    ----------
    line_baud : int
        Rate at the far end of the wire.
    on_request : callable
        Told the level of a source of DMA requests.
    """

    steady = frozenset(ALL_STEADY) - {_D}  # bytes come and go at events; reading S1 again shows the same flags again

    def __init__(
        self, processor: Processor, clocks: ClockGates, clock: Clock, module: ChipPeripheral, *, depth: int = 8
    ) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        self.line_baud = 115_200
        self.on_request: Callable[[int, bool], None] = lambda _source, _level: None
        self._requests = module.requests
        self._depth = depth
        self._sizes = 0x22 if depth == 8 else 0  # of both FIFOs, as PFIFO codes them
        self._nvic = processor.nvic
        self._time = clocks.time
        self._clock = clock
        self._status_interrupt, self._error_interrupt = module.interrupts
        self._sent = bytearray()
        self._incoming: deque[int] = deque()
        self._arriving = False
        self._sending: Event | None = None
        self.reset()

    def reset(self) -> None:
        """State after a chip reset; bytes go on arriving, at a receiver that is off."""
        if self._sending is not None:
            self._sending.cancel()
        self._registers = bytearray(0x20)
        self._registers[_BDL] = 0x04
        self._registers[_PFIFO] = self._sizes
        self._registers[_RWFIFO] = 1
        self._receive: deque[int] = deque()
        self._transmit: deque[int] = deque()
        self._shifting: int | None = None
        self._flags = 0  # IDLE, OR, FE
        self._flags_seen = 0
        self._quiet_since = 0  # picoseconds
        self._drive()

    # -- the far end of the wire --------------------------------------------------------------

    def host_write(self, data: bytes) -> None:
        """Put bytes on the line towards the board, one after the other at line speed."""
        self._incoming.extend(data)
        if not self._arriving and self._incoming:
            self._arriving = True
            self._arrive_at(self._time.now() + self._line_byte_ps())

    @property
    def host_waiting(self) -> int:
        """Bytes that the board has sent and the host has not fetched."""
        return len(self._sent)

    def host_read(self, size: int) -> bytes:
        """Fetch bytes that the board has sent."""
        data = bytes(self._sent[:size])
        del self._sent[:size]
        return data

    # -- timing -------------------------------------------------------------------------------

    def _line_byte_ps(self) -> int:
        return round(_BITS_A_BYTE * PICOSECONDS / self.line_baud)

    def _divisor(self) -> int:
        """Divide the module clock by a 32nd of this for 16 times the rate."""
        return ((self._registers[_BDH] & 0x1F) << 8 | self._registers[_BDL]) * 32 + (self._registers[_C4] & 0x1F)

    @property
    def baud(self) -> float:
        """The rate the firmware has set up [bit/s]."""
        divisor = self._divisor()
        return float(self._clock.hz) * 2 / divisor if divisor >= 32 else 0.0

    def _garbled(self) -> bool:
        return abs(self.baud / self.line_baud - 1) > _BAUD_TOLERANCE

    # -- receiving ----------------------------------------------------------------------------

    def _arrive_at(self, ps: int) -> None:
        self._time.at(ps, lambda: self._arrive(ps))

    def _arrive(self, ps: int) -> None:
        byte = self._incoming.popleft()
        if self.clocked and self._clock.hz and self._registers[_C2] & _RE:  # it stands still in STOP
            if self._garbled():
                byte ^= 0xFF
                self._flags |= _FE
            depth = self._depth if self._registers[_PFIFO] & 0x08 else 1
            if len(self._receive) < depth:
                self._receive.append(byte)
            else:
                self._flags |= _OR
                self._registers[_SFIFO] |= _RXOF
        next_ps = ps + self._line_byte_ps()
        self._quiet_since = ps
        if self._incoming:
            self._arrive_at(next_ps)
        else:
            self._arriving = False
            self._time.at(next_ps, self._line_idle(ps))
        self._drive()

    def _line_idle(self, since: int) -> Callable[[], None]:
        def idle() -> None:
            if self._quiet_since == since and not self._arriving:
                self._flags |= _IDLE
                self._drive()

        return idle

    # -- sending ------------------------------------------------------------------------------

    def _shift(self) -> None:
        if self._shifting is None and self._transmit:
            self._shift_at(self._clock.now())

    def _shift_at(self, tick: int) -> None:
        """Put the next byte on the line at a tick of the module clock."""
        self._shifting = self._transmit.popleft()
        end = tick + _BITS_A_BYTE * self._divisor() // 2
        self._sending = self._clock.at(end, lambda: self._shifted(end))

    def _shifted(self, tick: int) -> None:
        if self._shifting is not None:
            self._sent.append(self._shifting ^ 0xFF if self._garbled() else self._shifting)
        self._shifting = None
        if self._transmit:
            self._shift_at(tick)
        self._drive()

    # -- registers ----------------------------------------------------------------------------

    def _status(self) -> int:
        status = self._flags
        if len(self._transmit) <= self._registers[_TWFIFO]:
            status |= _TDRE
        if not self._transmit and self._shifting is None:
            status |= _TC
        if self._receive and len(self._receive) >= self._registers[_RWFIFO]:
            status |= _RDRF
        return status

    def _drive(self) -> None:
        # C2's TIE, TCIE, RIE and ILIE stand where S1 has TDRE, TC, RDRF and IDLE, and so do C5's TDMAS and RDMAS, which
        # make DMA requests of TDRE and RDRF.
        nvic, wanted = self._nvic, self._status() & self._registers[_C2] & 0xF0
        requested = wanted & self._registers[_C5] & (_TDRE | _RDRF)
        nvic.set_line(self._status_interrupt, bool(wanted & ~requested))
        nvic.set_line(self._error_interrupt, bool(self._flags & self._registers[_C3] & 0x0F))
        if len(self._requests) == 1:  # for both directions
            self.on_request(self._requests[0], bool(requested))
        else:
            for source, flag in zip(self._requests, (_RDRF, _TDRE), strict=True):
                self.on_request(source, bool(requested & flag))

    def read(self, offset: int, size: int) -> int:
        """Answer a byte register."""
        if size > 1:
            return read_by_bytes(self, offset, size)
        if offset == _S1:
            status = self._status()
            self._flags_seen = self._flags
            return status
        if offset == _D:
            return self._read_data()
        if offset == _SFIFO:
            empty = (0x40 if not self._receive else 0) | (0x80 if not self._transmit else 0)
            return self._registers[_SFIFO] & 0x07 | empty
        if offset == _TCFIFO:
            return len(self._transmit)
        if offset == _RCFIFO:
            return len(self._receive)
        return self._registers[offset] if offset < len(self._registers) else 0

    def _read_data(self) -> int:
        # Reading S1 and then D clears the flags that S1 showed.
        self._flags &= ~self._flags_seen
        self._flags_seen = 0
        if self._receive:
            value = self._receive.popleft()
        else:
            value = 0
            self._registers[_SFIFO] |= _RXUF
        self._drive()
        return value

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a byte register."""
        if size > 1:
            write_by_bytes(self, offset, size, value)
            return
        if offset == _D:
            self._write_data(value)
        elif offset == _CFIFO:
            if value & 0x80:
                self._transmit.clear()
            if value & 0x40:
                self._receive.clear()
            self._registers[_CFIFO] = value & 0x07
        elif offset == _SFIFO:
            self._registers[_SFIFO] &= ~value & 0x07
        elif offset == _PFIFO:
            self._registers[_PFIFO] = value & 0x88 | self._sizes
        elif offset not in (_S1, _TCFIFO, _RCFIFO) and offset < len(self._registers):
            self._registers[offset] = value
        self._drive()

    def _write_data(self, value: int) -> None:
        if not self._registers[_C2] & _TE:
            return
        depth = self._depth if self._registers[_PFIFO] & 0x80 else 1
        if len(self._transmit) >= depth:
            self._registers[_SFIFO] |= _TXOF
            return
        self._transmit.append(value & 0xFF)
        self._shift()
