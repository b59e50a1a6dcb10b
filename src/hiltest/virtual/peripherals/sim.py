"""SIM: clock gates, and the dividers and sources of clocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction

from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.part.unique_id import VIRTUAL_UNIQUE_ID
from hiltest.virtual.peripherals.bus import ALL_STEADY, Peripheral, StoredRegisters
from hiltest.virtual.peripherals.mcg import IRC48M_HZ, OSCILLATOR_HZ, RTC_HZ, ClockGenerator
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor

_SOPT1, _SOPT2, _CLKDIV1 = 0x000, 0x004, 0x044
_SCGC_FIRST, _SCGC_LAST = 0x028, 0x040  # SCGC1..SCGC7 in the page at 0x40048000
_LOW_POWER_OSCILLATOR_HZ = 1000


class _Options(StoredRegisters):
    """First page of the SIM, which reports its changes."""

    steady = ALL_STEADY
    on_change: Callable[[], None] = staticmethod(lambda: None)

    def reset(self) -> None:
        super().reset()
        self.on_change()

    def write(self, offset: int, size: int, value: int) -> None:
        super().write(offset, size, value)
        self.on_change()


class ClockGates(StoredRegisters):
    """Second page of the SIM: clock gates, dividers, identification.

    Attributes
    ----------
    core, bus, flexbus, flash : Clock
        MCGOUTCLK behind the dividers.
    pll_fll : Clock
        MCGPLLCLK, MCGFLLCLK or IRC48M, as SOPT2 selects.
    internal, fixed : Clock
        MCGIRCLK and MCGFFCLK.
    oscillator, rtc, low_power : Clock
        OSCERCLK, 32.768 kHz, and the 1 kHz that always runs.
    slow_external : Clock
        ERCLK32K, as SOPT1 selects; the system oscillator's 50 MHz are too fast for it.
    time : Clock
        Virtual time in picoseconds since power-on.
    options : StoredRegisters
        First page of the SIM.
    on_gates : callable
        Called when gates may have opened or closed.
    """

    def __init__(self, processor: Processor, generator: ClockGenerator) -> None:
        self._processor = processor
        self._generator = generator
        self.core, self.bus, self.flexbus, self.flash = self._clocks(4)
        self.pll_fll, self.internal, self.fixed = self._clocks(3)
        self.oscillator, self.rtc, self.low_power, self.slow_external, self.time = self._clocks(5)
        self._rates: dict[Clock, Fraction] = {}
        self._nominal_core_hz = Fraction(0)
        self.options = _Options("SIM (SOPT)", 0x40047000, mk64f12().reset_bytes(0x40047000))
        self._crystal_runs = False
        self._stopped: set[Clock] = set()
        generator.on_change = self.options.on_change = self._derive
        self._gated: list[tuple[Peripheral, list[tuple[int, int]]]] = []
        self.on_gates: Callable[[], None] = lambda: None
        # UIDH, UIDMH, UIDML, UIDL: words in this order, each little-endian.
        unique = {0x054 + (index ^ 3): byte for index, byte in enumerate(VIRTUAL_UNIQUE_ID)}
        super().__init__("SIM", 0x40048000, mk64f12().reset_bytes(0x40048000) | unique)

    def _clocks(self, count: int) -> list[Clock]:
        return [Clock(self._processor.schedule, self._processor.now) for _ in range(count)]

    def parts(self) -> list[Clock]:
        return list(self._rates)

    def gate(self, peripheral: Peripheral, gates: Iterable[tuple[int, int]]) -> None:
        """Connect a peripheral to its clock gates; the clock runs while any of these bits of SCGC1 to SCGC7 is set."""
        bits = [(_SCGC_FIRST + 4 * (register - 1), bit) for register, bit in gates]
        if bits:
            self._gated.append((peripheral, bits))
            self._open_gates()

    def reset(self) -> None:
        """Close every gate that is not open after reset."""
        self._stopped = set()
        super().reset()
        self._derive()
        self._open_gates()

    def write(self, offset: int, size: int, value: int) -> None:
        """Store the value; open and close gates."""
        super().write(offset, size, value)
        if _SCGC_FIRST <= offset <= _SCGC_LAST + 3:
            self._open_gates()
        else:
            self._derive()

    def _open_gates(self) -> None:
        for peripheral, bits in self._gated:
            peripheral.clocked = any(self.word(register) >> bit & 1 for register, bit in bits)
        self.on_gates()

    # -- rates --------------------------------------------------------------------------------

    @property
    def core_hz(self) -> float:
        """Core and system clock [Hz]."""
        return float(self.core.hz)

    @property
    def bus_hz(self) -> float:
        """Bus clock [Hz]."""
        return float(self.bus.hz)

    def time_s(self) -> float:
        """Return the virtual time since power-on [s], also during an access to a peripheral."""
        return self.time.now() / PICOSECONDS

    @property
    def crystal_runs(self) -> bool:
        """Return whether the RTC has switched its oscillator on."""
        return self._crystal_runs

    @crystal_runs.setter
    def crystal_runs(self, runs: bool) -> None:
        self._crystal_runs = runs
        self._derive()

    def stop(self, *, external_runs: bool) -> None:
        """Stop core, bus and all clocks of the generator, as in STOP.

        Parameters
        ----------
        external_runs
            True if OSCERCLK continues.
        """
        self._stopped = {self.core, self.bus, self.flexbus, self.flash, self.pll_fll, self.fixed}
        self._stopped |= set() if self._generator.internal_runs_in_stop else {self.internal}
        self._stopped |= set() if external_runs else {self.oscillator}
        self._derive()

    def restart(self, *, from_stop: bool) -> None:
        """Restart all clocks; the PLL has lost its lock, unless STOP kept it."""
        self._stopped = set()
        self._generator.leave_stop(keeps_pll=from_stop)
        self._derive()

    def _derive(self) -> None:
        """Compute every rate, and apply those that have changed from now on."""
        generator, dividers, source = self._generator, self.word(_CLKDIV1), self.word(_SOPT2) >> 16 & 3
        rates = {
            divided: generator.output_hz / ((dividers >> shift & 0xF) + 1)
            for divided, shift in ((self.core, 28), (self.bus, 24), (self.flexbus, 20), (self.flash, 16))
        }
        rates |= {
            self.pll_fll: {0: generator.fll_hz, 1: generator.pll_hz}.get(source, Fraction(IRC48M_HZ)),
            self.internal: generator.internal_hz if generator.internal_runs else Fraction(0),
            self.fixed: generator.reference_hz,
            self.oscillator: Fraction(OSCILLATOR_HZ),
            self.rtc: Fraction(RTC_HZ if self._crystal_runs else 0),
            self.low_power: Fraction(_LOW_POWER_OSCILLATOR_HZ),
            self.time: Fraction(PICOSECONDS),
        }
        selected = {2: self.rtc, 3: self.low_power}.get(self.options.word(_SOPT1) >> 18 & 3)
        rates[self.slow_external] = rates[selected] if selected else Fraction(0)
        nominal_core_hz = rates[self.core]  # time is counted in its cycles, even while the clock is stopped
        rates |= dict.fromkeys(self._stopped, Fraction(0))
        if rates == self._rates and nominal_core_hz == self._nominal_core_hz:
            return
        self._nominal_core_hz = nominal_core_hz
        self._rates = rates
        now = self._processor.now()
        for clock, hz in rates.items():
            clock.run_at(hz, nominal_core_hz, now)
        self._processor.schedule.replan()
