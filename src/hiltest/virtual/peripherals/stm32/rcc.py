"""RCC: oscillators, PLL, prescalers, clock gates, resets of blocks, and the source of the latest reset."""

from __future__ import annotations

from fractions import Fraction

from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.rcm import ResetSource
from hiltest.virtual.peripherals.stm32.block import Block
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor

_CR, _PLLCFGR, _CFGR, _BDCR, _CSR, _DCKCFGR = 0x00, 0x04, 0x08, 0x70, 0x74, 0x8C
_RESETS, _GATES = 0x10, 0x30  # AHB1RSTR and AHB1ENR; bits of both are at the same places
_OFFSETS = {"AHB1ENR": 0x30, "AHB2ENR": 0x34, "AHB3ENR": 0x38, "APB1ENR": 0x40, "APB2ENR": 0x44}
_HSI, _HSE, _PLL, _PLLI2S = 1 << 0, 1 << 16, 1 << 24, 1 << 26  # CR: on; the next bit is ready
_RMVF, _REASONS = 1 << 24, 0xFE000000
_REASON = {
    ResetSource.POWER_ON: 0x0E000000,
    ResetSource.PIN: 0x04000000,
    ResetSource.SOFTWARE: 0x14000000,
    ResetSource.WATCHDOG: 0x24000000,
}
_HSI_HZ = Fraction(16_000_000)
#: Start-up by the data sheet (DS10314), typical: HSI 2.2 us, HSE 2 ms, LSI 15 us, LSE 2 s; PLL at most 300 us.
_START_US = {_HSI: 2, _HSE: 2000, _PLL: 200, _PLLI2S: 200}
_LSI_US, _LSE_US = 15, 2_000_000
_US = PICOSECONDS // 10**6
_AHB = {8: 2, 9: 4, 10: 8, 11: 16, 12: 64, 13: 128, 14: 256, 15: 512}
_APB = {4: 2, 5: 4, 6: 8, 7: 16}


class ResetAndClocks(Block):
    """RCC.

    Attributes
    ----------
    core, pclk1, pclk2, timers1, timers2 : Clock
        HCLK, the clocks of APB1 and APB2, and those of their timers.
    time : Clock
        Virtual time in picoseconds since power-on.
    """

    def __init__(self, processor: Processor, module: ChipPeripheral, hse_hz: Fraction) -> None:
        self._hse_hz = hse_hz
        self.core, self.pclk1, self.pclk2, self.timers1, self.timers2, self.time = (
            Clock(processor.schedule, processor.now) for _ in range(6)
        )
        self._rates: dict[Clock, Fraction] = {}
        self._gated: list[tuple[Block | CoreDevice, int, int]] = []
        super().__init__(processor, module)

    def parts(self) -> list[Clock]:
        return list(self._rates)

    def gate(self, block: Block | CoreDevice, place: str) -> None:
        """Connect a block to its clock gate, such as ``APB1ENR.17``."""
        register, bit = place.split(".")
        self._gated.append((block, _OFFSETS[register], int(bit)))

    def reset(self) -> None:
        reasons = self.word(_CSR) & _REASONS if hasattr(self, "_bytes") else 0
        super().reset()
        self.change_word(_CSR, clear=_REASONS, put=reasons)
        self._derive()
        self._open_gates()

    def note_reset(self, source: ResetSource) -> None:
        """Note the source of the reset in CSR, whose flags only firmware or power-on clear."""
        before = 0 if source is ResetSource.POWER_ON else self.word(_CSR)
        self.change_word(_CSR, clear=_REASONS, put=before & _REASONS | _REASON.get(source, 0))

    @property
    def core_hz(self) -> float:
        """Core clock [Hz]."""
        return float(self.core.hz)

    def time_s(self) -> float:
        """Return the virtual time since power-on [s], also during an access to a peripheral."""
        return self.time.now() / PICOSECONDS

    def write_word(self, offset: int, value: int, mask: int) -> None:
        before = self.word(offset)
        after = before & ~mask | value
        if offset == _CR:
            self._write_control(before, after)
        elif offset == _CFGR:
            self.store_word(_CFGR, after & ~0xC | before & 0xC)
        elif offset == _CSR:
            self.change_word(_CSR, clear=_REASONS if after & _RMVF else 0)
            self._switch(_CSR, 1, after & 1, _LSI_US)
        elif offset == _BDCR:
            self.store_word(_BDCR, after & ~2 | before & 2)
            self._switch(_BDCR, 1, after & 1, _LSE_US)
        else:
            self.store_word(offset, after)
        self._derive()
        if _RESETS <= offset < _GATES:
            self._reset_blocks(offset + _GATES - _RESETS, after & ~before)
        elif offset in _OFFSETS.values():
            self._open_gates()

    def _write_control(self, before: int, after: int) -> None:
        """Start and stop oscillators; the one that drives the core stays on."""
        in_use = (_HSI, _HSE, _PLL, 0)[self.word(_CFGR) >> 2 & 3]
        ready = before & 2 * (_HSI | _HSE | _PLL | _PLLI2S)
        self.store_word(_CR, after & ~(2 * (_HSI | _HSE | _PLL | _PLLI2S)) | ready | in_use)
        for source, start_us in _START_US.items():
            self._switch(_CR, source, self.word(_CR) & source, start_us)

    def _switch(self, offset: int, switch: int, is_on: int, start_us: int) -> None:
        """Set the ready flag behind a switch after the start-up time, or clear it at once."""
        self.change_word(offset, clear=switch, put=switch if is_on else 0)
        if not is_on:
            self.change_word(offset, clear=2 * switch)
        elif not self.word(offset) & 2 * switch:
            self.time.call_after(start_us * _US, lambda: self._set_ready(offset, switch))

    def _set_ready(self, offset: int, switch: int) -> None:
        if self.word(offset) & switch:
            self.change_word(offset, put=2 * switch)
            self._derive()

    def _open_gates(self) -> None:
        for block, register, bit in self._gated:
            block.clocked = bool(self.word(register) >> bit & 1)

    def _reset_blocks(self, register: int, bits: int) -> None:
        for block, gate, bit in self._gated:
            if gate == register and bits >> bit & 1:
                block.reset()

    def _pll_hz(self) -> Fraction:
        settings = self.word(_PLLCFGR)
        source = self._hse_hz if settings >> 22 & 1 else _HSI_HZ
        return source * (settings >> 6 & 0x1FF) / max(settings & 0x3F, 1) / (2 * ((settings >> 16 & 3) + 1))

    def _derive(self) -> None:
        """Select the system clock, compute every rate, and apply those that have changed from now on."""
        wanted, control = self.word(_CFGR) & 3, self.word(_CR)
        if wanted < 3 and control & 2 * (_HSI, _HSE, _PLL)[wanted]:
            self.change_word(_CFGR, clear=0xC, put=wanted << 2)
        source = self.word(_CFGR) >> 2 & 3
        system_hz = (_HSI_HZ, self._hse_hz, self._pll_hz())[source if source < 3 else 0]
        settings = self.word(_CFGR)
        core_hz = system_hz / _AHB.get(settings >> 4 & 15, 1)
        dividers = [_APB.get(settings >> shift & 7, 1) for shift in (10, 13)]
        buses = [core_hz / divider for divider in dividers]
        timers = [self._timer_hz(core_hz, divider) for divider in dividers]
        rates = {self.core: core_hz, self.pclk1: buses[0], self.pclk2: buses[1]}
        rates |= {self.timers1: timers[0], self.timers2: timers[1], self.time: Fraction(PICOSECONDS)}
        if rates == self._rates:
            return
        self._rates = rates
        now = self.processor.now()
        for clock, hz in rates.items():
            clock.run_at(hz, core_hz, now)
        self.processor.schedule.replan()

    def _timer_hz(self, core_hz: Fraction, divider: int) -> Fraction:
        """Return the clock of timers: twice that of a divided bus, or up to four times with TIMPRE."""
        most = 4 if self.word(_DCKCFGR) >> 24 & 1 else 2
        return core_hz if divider <= most else core_hz * most / divider
