"""LPTMR: a 16-bit timer on clocks that go on while the processor is stopped, or a counter of pulses."""

from __future__ import annotations

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.pin_signals import PinSignal, PulseCounter
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

_CSR, _PSR, _CMR, _CNR = 0x0, 0x4, 0x8, 0xC
_TEN, _TMS, _TFC, _TPP, _TIE, _TCF = 0x01, 0x02, 0x04, 0x08, 0x40, 0x80
_PBYP = 0x04
_COUNTS = 1 << 16


class LowPowerTimer:
    """The LPTMR module; it goes on through every reset but power-on.

    As a counter of pulses it has no glitch filter: what PSR.PRESCALE says of it changes nothing.

    Parameters
    ----------
    processor : Processor
        Interrupts.
    clocks : ClockGates
        Its four clocks.
    module : ChipPeripheral
        Its addresses and interrupt.

    Attributes
    ----------
    inputs : dict of int to PulseCounter
        Pins that it may count, by CSR.TPS.
    """

    steady = range(0x1000)

    def __init__(self, processor: Processor, clocks: ClockGates, module: ChipPeripheral) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        (self._interrupt,) = module.interrupts
        self._nvic = processor.nvic
        self._clocks = clocks
        self._event: Event | None = None
        self.inputs = {select: PulseCounter() for select in (1, 2)}
        self.power_on()

    def reset(self) -> None:
        """Of a reset of the chip only the interrupt line notices anything."""
        self._drive()

    def power_on(self) -> None:
        """State after power-on: disabled."""
        self._cancel()
        self._control = self._prescale = self._compare = 0
        self._latched = 0  # CNR: the count when it was last written
        self._began = 0  # of this round, in ticks of what it counts
        self._flag = False
        self._drive()

    # -- counting -----------------------------------------------------------------------------

    @property
    def _source(self) -> Clock | PulseCounter | None:
        """What it counts; None for the output of a comparator, which is not modelled."""
        if self._control & _TMS:
            return self.inputs.get(self._control >> 4 & 3)
        clocks = self._clocks
        return (clocks.internal, clocks.low_power, clocks.slow_external, clocks.oscillator)[self._prescale & 3]

    @property
    def _shift(self) -> int:
        """Binary logarithm of the ticks that make one count."""
        return 0 if self._prescale & _PBYP or self._control & _TMS else (self._prescale >> 3 & 0xF) + 1

    def _counts(self) -> int:
        """Counts since this round began."""
        source = self._source
        return (source.now() - self._began) >> self._shift if source is not None and self._control & _TEN else 0

    def _advance(self) -> None:
        """Pass the rounds that are over: while the flag is set nothing tells of their ends."""
        if self._flag and not self._control & _TFC:
            rounds = self._counts() // (self._compare + 1)
            self._began += rounds * (self._compare + 1) << self._shift

    def _plan(self) -> None:
        """Come back when the count leaves the compare value, unless the flag tells of that already."""
        self._cancel()
        source = self._source
        if source is None or self._flag or not self._control & _TEN:
            return
        counts = self._counts()
        left = (self._compare - counts) % _COUNTS + 1
        self._plan_at(source, self._began + (counts + left << self._shift))

    def _plan_at(self, source: Clock | PulseCounter, tick: int) -> None:
        self._event = source.at(tick, self._compared, wakes=bool(self._control & _TIE))

    def _compared(self) -> None:
        self._event = None
        self._flag = True
        self._advance()
        self._drive()

    def _cancel(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None

    @property
    def signals(self) -> dict[str, PinSignal]:
        """What it counts, by name."""
        return {f"{self.name}_ALT{select}": pulses for select, pulses in self.inputs.items()}

    # -- registers ----------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Answer a word register; CNR is what it was when firmware last wrote there."""
        answers = {
            _CSR: self._control | (_TCF if self._flag else 0), _PSR: self._prescale, _CMR: self._compare,
            _CNR: self._latched,
        }  # fmt: skip
        return answers.get(offset & ~3, 0) >> 8 * (offset & 3)

    def write(self, offset: int, size: int, value: int) -> None:
        """Take a word register."""
        if offset == _CSR:
            self._write_control(value)
        elif offset == _PSR:
            self._prescale = value & 0x7F
        elif offset == _CMR:
            self._advance()
            self._compare = value & 0xFFFF
            self._plan()
        elif offset == _CNR:
            self._advance()
            self._latched = self._counts() % _COUNTS

    def _write_control(self, value: int) -> None:
        self._advance()
        was_enabled, self._control = self._control & _TEN, value & 0x7F
        for pulses in self.inputs.values():
            pulses.rising = not value & _TPP
        source = self._source
        if not was_enabled and source is not None:
            self._began = source.now()
        if value & _TCF or not value & _TEN:
            self._flag = False
        self._plan()
        self._drive()

    def _drive(self) -> None:
        self._nvic.set_line(self._interrupt, self._flag and bool(self._control & _TIE))
