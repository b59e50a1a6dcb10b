"""DSPI: an SPI master with FIFOs, chip selects, interrupts and requests for DMA."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.pin_signals import PinSignal
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.peripherals.spi_bus import SpiBus
from hiltest.virtual.processor.clock import PICOSECONDS
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_MCR, _TCR, _CTAR0, _CTAR1, _SR, _RSER, _PUSHR, _POPR, _TXFR0, _RXFR0 = (
    *(0x00, 0x08, 0x0C, 0x10, 0x2C, 0x30, 0x34, 0x38, 0x3C, 0x7C),
)
_MSTR, _ROOE, _PCSIS_SHIFT, _MDIS, _DIS_TXF, _DIS_RXF = 1 << 31, 1 << 24, 16, 1 << 14, 1 << 13, 1 << 12
_CLR_TXF, _CLR_RXF, _HALT = 1 << 11, 1 << 10, 1
_TCF, _TXRXS, _EOQF, _TFFF, _RFOF, _RFDF = 1 << 31, 1 << 30, 1 << 28, 1 << 25, 1 << 19, 1 << 17
_TFFF_DIRS, _RFDF_DIRS = 1 << 24, 1 << 16
_CONT, _EOQ, _CTCNT = 1 << 31, 1 << 27, 1 << 26
_DBR, _LSBFE = 1 << 31, 1 << 24
_PRESCALERS, _DELAY_PRESCALERS = (2, 3, 5, 7), (1, 3, 5, 7)
_SCALERS = (2, 4, 6, *(1 << power for power in range(3, 16)))  # of BR
_CHIP_SELECTS = 6


class Dspi(Restorable):
    """A DSPI module as master.

    Frames of 8 and 16 bits reach the parts; other sizes and the slave mode are reported. Pins of clock and data are not
    checked, nor are clock phase and polarity.

    Parameters
    ----------
    bus
        Parts that the module reaches.
    depth
        Capacity of each FIFO.
    note
        Called with address, size and value of a write that requests an unmodelled function.

    Attributes
    ----------
    signals : dict of str to PinSignal
        Chip selects by name, such as ``SPI0_PCS0``.
    """

    steady = frozenset(ALL_STEADY) - frozenset(range(_POPR, _POPR + 4))

    def __init__(
        self,
        processor: Processor,
        clocks: ClockGates,
        bus: SpiBus,
        module: ChipPeripheral,
        *,
        depth: int,
        note: Callable[[int, int, int], None],
    ) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        (self._interrupt,) = module.interrupts
        self._requests = module.requests[0], module.requests[-1]  # receive and send; both may share one
        self._nvic, self._set_request = processor.nvic, processor.machine.set_request
        self._clocks, self._bus, self._depth, self._note = clocks, bus, depth, note
        self._initial = {register.address - module.base: register.reset for register in module.registers}
        self._asserted = 0
        self._event: Event | None = None
        self.signals = {
            f"{module.name}_PCS{number}": PinSignal(lambda _high: None, partial(self._select_level, number))
            for number in range(_CHIP_SELECTS)
        }
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: disabled."""
        self._cancel()
        self._registers = dict(self._initial)
        self._flags = 0  # TCF, EOQF, RFOF, until firmware writes a one; TFFF and RFDF follow the FIFOs
        self._sending: deque[int] = deque()
        self._received: deque[int] = deque()
        self._end = 0
        self._assert_selects(0)
        self._drive()

    # -- registers ----------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Return a register; reading POPR takes a word from the FIFO."""
        register, value = offset & ~3, 0
        if register == _SR:
            value = self._status()
        elif register == _POPR:
            value = self._received.popleft() if self._received else 0
            self._drive()
        elif _TXFR0 <= register < _TXFR0 + 4 * self._depth or _RXFR0 <= register < _RXFR0 + 4 * self._depth:
            words, index = (
                (self._sending, register - _TXFR0) if register < _RXFR0 else (self._received, register - _RXFR0)
            )
            value = words[index >> 2] if index >> 2 < len(words) else 0
        else:
            value = self._registers.get(register, 0)
        return value >> 8 * (offset & 3) & (1 << 8 * size) - 1

    def write(self, offset: int, size: int, value: int) -> None:
        register, shift = offset & ~3, 8 * (offset & 3)
        mask = (1 << 8 * size) - 1 << shift
        if register == _SR:
            self._flags &= ~(value << shift)
        elif register in self._registers and register < _POPR:
            self._registers[register] = self._registers[register] & ~mask | value << shift
            if register == _MCR:
                self._write_control()
            elif register == _PUSHR and len(self._sending) < self._capacity(_DIS_TXF):
                self._sending.append(self._registers[_PUSHR])
        self._begin_frame()
        self._drive()

    def _write_control(self) -> None:
        control = self._registers[_MCR]
        if control & _CLR_TXF:
            self._sending.clear()
        if control & _CLR_RXF:
            self._received.clear()
        self._registers[_MCR] = control & ~(_CLR_TXF | _CLR_RXF)
        if not control & (_MSTR | _MDIS):
            self._note(self.base + _MCR, 4, control)  # slave mode
        if self._event is None and not self._is_running:
            self._assert_selects(0)
        for signal in self.signals.values():
            signal.report_change()  # the inactive levels may have changed

    def _capacity(self, disabled: int) -> int:
        return 1 if self._registers[_MCR] & disabled else self._depth

    @property
    def _is_running(self) -> bool:
        return self._registers[_MCR] & (_MSTR | _MDIS | _HALT) == _MSTR and not self._flags & _EOQF

    def _status(self) -> int:
        status = self._flags | (_TXRXS if self._is_running else 0) | (_RFDF if self._received else 0)
        status |= _TFFF if len(self._sending) < self._capacity(_DIS_TXF) else 0
        return status | len(self._sending) << 12 | len(self._received) << 4

    def _drive(self) -> None:
        enabled, status = self._registers[_RSER], self._status()
        to_dma = (_TFFF if enabled & _TFFF_DIRS else 0) | (_RFDF if enabled & _RFDF_DIRS else 0)
        active = status & enabled & (_TCF | _EOQF | _TFFF | _RFOF | _RFDF)
        self._nvic.set_line(self._interrupt, bool(active & ~to_dma))
        receives, sends = (bool(active & to_dma & flag) for flag in (_RFDF, _TFFF))
        receive_request, send_request = self._requests
        if receive_request == send_request:
            self._set_request(receive_request, receives or sends)
        else:
            self._set_request(receive_request, receives)
            self._set_request(send_request, sends)

    # -- frames -------------------------------------------------------------------------------

    def _cancel(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None

    def _begin_frame(self) -> None:
        if self._event is not None or not self._sending or not self._is_running:
            return
        command = self._sending.popleft()
        attributes, selects = self._attributes(command), command >> 16 & (1 << _CHIP_SELECTS) - 1
        clock_ticks = _PRESCALERS[attributes >> 16 & 3] * _SCALERS[attributes & 15]
        ticks = self._bits(attributes) * (clock_ticks // 2 if attributes & _DBR else clock_ticks)
        if selects & ~self._asserted or not selects:
            ticks += _delay(attributes, 22, 12)  # from chip select to clock
        if not command & _CONT:
            ticks += _delay(attributes, 20, 8) + _delay(attributes, 18, 4)  # after the clock, and after the transfer
        self._assert_selects(selects)
        self._end = max(self._end, self._clocks.bus.now()) + ticks
        self._event = self._clocks.bus.call_at(self._end, lambda: self._finish_frame(command))

    def _finish_frame(self, command: int) -> None:
        self._event = None
        word = self._transfer(command & 0xFFFF, self._attributes(command))
        if len(self._received) < self._capacity(_DIS_RXF):
            self._received.append(word)
        else:
            self._flags |= _RFOF
            if self._registers[_MCR] & _ROOE:
                self._received[-1] = word
        count = 0 if command & _CTCNT else self._registers[_TCR] >> 16
        self._registers[_TCR] = (count + 1 & 0xFFFF) << 16
        self._flags |= _TCF | (_EOQF if command & _EOQ else 0)
        if not command & _CONT:
            self._assert_selects(0)
        self._begin_frame()
        self._drive()

    def _attributes(self, command: int) -> int:
        return self._registers[_CTAR1 if command >> 28 & 7 == 1 else _CTAR0]

    @staticmethod
    def _bits(attributes: int) -> int:
        return (attributes >> 27 & 15) + 1

    def _transfer(self, word: int, attributes: int) -> int:
        """Exchange a frame with the parts, byte by byte."""
        bits = self._bits(attributes)
        if bits % 8:
            self._note(self.base + _CTAR0, 4, attributes)
            return (1 << bits) - 1
        time_s = self._clocks.time.now() / PICOSECONDS
        word = _mirror(word, bits) if attributes & _LSBFE else word
        answer = 0
        for shift in range(bits - 8, -1, -8):
            answer = answer << 8 | self._bus.exchange(word >> shift & 0xFF, time_s)
        return _mirror(answer, bits) if attributes & _LSBFE else answer

    # -- chip selects -------------------------------------------------------------------------

    def _assert_selects(self, selects: int) -> None:
        changed, self._asserted = self._asserted ^ selects, selects
        for number, signal in enumerate(self.signals.values()):
            if changed >> number & 1:
                signal.report_change()

    def _select_level(self, number: int) -> bool:
        inactive = bool(self._registers[_MCR] >> _PCSIS_SHIFT + number & 1)
        return inactive != bool(self._asserted >> number & 1)


def _delay(attributes: int, prescaler: int, scaler: int) -> int:
    """Return a delay [bus clocks] by the positions of its prescaler and scaler in CTAR."""
    return _DELAY_PRESCALERS[attributes >> prescaler & 3] << 1 + (attributes >> scaler & 15)


def _mirror(word: int, bits: int) -> int:
    return int(f"{word & (1 << bits) - 1:0{bits}b}"[::-1], 2)
