"""MCG: the generator of all clocks except those of the slow timers."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from fractions import Fraction

from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.peripherals.bus import ALL_STEADY, StoredRegisters

_C1, _C2, _C4, _C5, _C6, _S, _SC, _C7 = 0x0, 0x1, 0x3, 0x4, 0x5, 0x6, 0x8, 0xC
OSCILLATOR_HZ = 50_000_000  # the Ethernet PHY's clock on EXTAL0
RTC_HZ = 32_768
_SLOW_REFERENCE_HZ, _FAST_REFERENCE_HZ, IRC48M_HZ = 32_768, 4_000_000, 48_000_000
_EXTERNAL_HZ = (OSCILLATOR_HZ, RTC_HZ, IRC48M_HZ)  # by C7.OSCSEL
_LOW_DIVIDERS = (1, 2, 4, 8, 16, 32, 64, 128)  # for the FLL's external reference, by C1.FRDIV
_HIGH_DIVIDERS = (32, 64, 128, 256, 512, 1024, 1280, 1536)
_FLL_FACTORS = ((640, 732), (1280, 1464), (1920, 2197), (2560, 2929))  # by C4.DRST_DRS, without and with DMX32
_FIRST_PLL_FACTOR = 24


class ClockMode(Enum):
    """Modes of the generator, named as in the manual; the value is S.CLKST."""

    FEI = "FLL engaged, internal reference", 0
    FEE = "FLL engaged, external reference", 0
    FBI = "FLL bypassed, internal reference", 1
    FBE = "FLL bypassed, external reference", 2
    PBE = "PLL bypassed, external reference", 2
    PEE = "PLL engaged, external reference", 3
    BLPI = "bypassed, low power, internal reference", 1
    BLPE = "bypassed, low power, external reference", 2


_M = ClockMode
_PATHS = {
    _M.FEI: {_M.FEE, _M.FBI, _M.FBE},
    _M.FEE: {_M.FEI, _M.FBI, _M.FBE},
    _M.FBI: {_M.FEI, _M.FEE, _M.FBE, _M.BLPI},
    _M.FBE: {_M.FEI, _M.FEE, _M.FBI, _M.BLPE, _M.PBE},
    _M.PBE: {_M.FBE, _M.BLPE, _M.PEE},
    _M.PEE: {_M.PBE},
    _M.BLPI: {_M.FBI},
    _M.BLPE: {_M.FBE, _M.PBE},
}
_LOW_POWER = {_M.FBI: _M.BLPI, _M.FBE: _M.BLPE, _M.PBE: _M.BLPE}  # with C2.LP set
# By C1.CLKS, C1.IREFS and C6.PLLS, without C2.LP; other combinations are invalid.
_SELECTED = {
    (0, 1, 0): _M.FEI,
    (0, 0, 0): _M.FEE,
    (1, 1, 0): _M.FBI,
    (2, 0, 0): _M.FBE,
    (2, 0, 1): _M.PBE,
    (0, 0, 1): _M.PEE,
}
_INTERNAL = {_M.FEI, _M.FBI, _M.BLPI}


class ClockGenerator(StoredRegisters):
    """The multipurpose clock generator, which locks as soon as it is set up.

    It changes modes along the paths of the manual's diagram. If no path leads to the mode that the
    registers select, it stays in its mode, which S shows.

    Attributes
    ----------
    mode : ClockMode
    on_change : callable
        Called when a clock may have another rate.
    """

    steady = ALL_STEADY  # mode changes are immediate

    def __init__(self) -> None:
        self.on_change: Callable[[], None] = lambda: None
        self.mode = ClockMode.FEI
        base = 0x40064000
        super().__init__("MCG", base, mk64f12().reset_bytes(base))

    def reset(self) -> None:
        """Enter FEI: FLL on the internal reference."""
        super().reset()
        self.mode = ClockMode.FEI
        self._fast = False  # S.IRCST
        self.on_change()

    def read(self, offset: int, size: int) -> int:
        """Return registers; S follows from the others."""
        self._bytes[_S] = self._status()
        return super().read(offset, size)

    def write(self, offset: int, size: int, value: int) -> None:
        """Write registers, and change the mode accordingly; S is read-only."""
        super().write(offset, size, value)
        self._change_mode()
        self.on_change()

    def _change_mode(self) -> None:
        target = self.target
        through = _SELECTED.get(self._selection)
        if target is not None and (target in _PATHS[self.mode] or through in _PATHS[self.mode]):
            self.mode = target
        if self.internal_runs:
            self._fast = bool(self._bytes[_C2] & 1)

    @property
    def _selection(self) -> tuple[int, int, int]:
        control = self._bytes[_C1]
        return control >> 6, control >> 2 & 1, self._bytes[_C6] >> 6 & 1

    @property
    def target(self) -> ClockMode | None:
        """Mode that the registers select, or None."""
        selected = _SELECTED.get(self._selection)
        if selected is not None and self._bytes[_C2] & 2:
            return _LOW_POWER.get(selected, selected)
        return selected

    @property
    def internal_runs(self) -> bool:
        """Return whether MCGIRCLK runs."""
        return bool(self._bytes[_C1] & 2) or self.mode in (ClockMode.FBI, ClockMode.BLPI)

    @property
    def internal_runs_in_stop(self) -> bool:
        """Return whether MCGIRCLK continues in STOP: IREFSTEN."""
        return self._bytes[_C1] & 3 == 3

    def leave_stop(self, *, keeps_pll: bool) -> None:
        """Leave a stop: PEE becomes PBE, unless PLLSTEN0 kept the PLL running in a stop mode that allows it."""
        if self.mode is ClockMode.PEE and not (keeps_pll and self._bytes[_C5] & 0x20):
            self._bytes[_C1] = self._bytes[_C1] & 0x3F | 0x80
            self._change_mode()

    @property
    def _pll_runs(self) -> bool:
        enabled = self._bytes[_C6] & 0x40 or self._bytes[_C5] & 0x40 or self.mode is ClockMode.PEE  # PLLS, PLLCLKEN0
        return bool(enabled) and self.mode not in (ClockMode.BLPI, ClockMode.BLPE)

    def _status(self) -> int:
        mode = self.mode
        pll = mode in (ClockMode.PBE, ClockMode.PEE) or (mode is ClockMode.BLPE and self._bytes[_C6] & 0x40)
        crystal = self._bytes[_C2] & 4  # OSCINIT0 belongs to a crystal; an external clock needs no start
        return (
            (0x40 if self._pll_runs else 0)
            | (0x20 if pll else 0)
            | (0x10 if mode in _INTERNAL else 0)
            | mode.value[1] << 2
            | (2 if crystal else 0)
            | self._fast
        )

    # -- rates --------------------------------------------------------------------------------

    @property
    def _external_hz(self) -> Fraction:
        return Fraction(_EXTERNAL_HZ[min(self._bytes[_C7] & 3, 2)])

    @property
    def internal_hz(self) -> Fraction:
        """MCGIRCLK, if it runs [Hz]."""
        if self._fast:
            return Fraction(_FAST_REFERENCE_HZ, 1 << (self._bytes[_SC] >> 1 & 7))
        return Fraction(_SLOW_REFERENCE_HZ)

    @property
    def reference_hz(self) -> Fraction:
        """Input of the FLL, and MCGFFCLK [Hz]."""
        control = self._bytes[_C1]
        if control & 4:
            return Fraction(_SLOW_REFERENCE_HZ)
        low_range = not self._bytes[_C2] & 0x30 or self._bytes[_C7] & 3 == 1
        dividers = _LOW_DIVIDERS if low_range else _HIGH_DIVIDERS
        return self._external_hz / dividers[control >> 3 & 7]

    @property
    def fll_hz(self) -> Fraction:
        """MCGFLLCLK [Hz]."""
        control = self._bytes[_C4]
        return self.reference_hz * _FLL_FACTORS[control >> 5 & 3][control >> 7]

    @property
    def pll_hz(self) -> Fraction:
        """MCGPLLCLK; 0 while the PLL is stopped [Hz]."""
        if not self._pll_runs:
            return Fraction(0)
        divider = (self._bytes[_C5] & 0x1F) + 1
        return self._external_hz / divider * ((self._bytes[_C6] & 0x1F) + _FIRST_PLL_FACTOR)

    @property
    def output_hz(self) -> Fraction:
        """MCGOUTCLK [Hz]."""
        if self.mode is ClockMode.PEE:
            return self.pll_hz
        if self.mode in (ClockMode.FEI, ClockMode.FEE):
            return self.fll_hz
        return self.internal_hz if self.mode in _INTERNAL else self._external_hz
