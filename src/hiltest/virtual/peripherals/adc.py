"""ADC16: conversion of voltages, with the timing of the manual's table."""

from __future__ import annotations

import math
from collections.abc import Callable

from hiltest.state import Restorable
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.mcg import IRC48M_HZ
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.clock import PICOSECONDS, Clock
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.schedule import Event

REFERENCE_V = 3.3  # VREFH of the FRDM-K64F
_SC1A, _SC1B, _CFG1, _CFG2, _RA, _RB, _CV1, _CV2, _SC2, _SC3 = 0x0, 0x4, 0x8, 0xC, 0x10, 0x14, 0x18, 0x1C, 0x20, 0x24
_COCO, _AIEN, _DIFF, _CHANNEL = 0x80, 0x40, 0x20, 0x1F
_ADACT, _ADTRG, _ACFE, _ACFGT, _ACREN, _DMAEN = 0x80, 0x40, 0x20, 0x10, 0x08, 0x04
_CAL, _CALF, _ADCO, _AVGE = 0x80, 0x40, 0x08, 0x04
_TEMPERATURE, _BANDGAP, _VREFH, _VREFL, _OFF = 26, 27, 29, 30, 31
_BANDGAP_V = 1.0
_SENSOR_V, _SENSOR_V_PER_DEGC, _SENSOR_DEGC = 0.716, 0.00162, 25.0  # typical values of the data sheet
_OWN_HZ = {0: 5_200_000, 1: 6_200_000, 2: 2_400_000, 3: 4_000_000}  # ADACK, typical, by ADLPC and ADHSC
_OWN_START_S = 5e-6  # start-up time of ADACK, unless it already runs
# By CFG1.MODE: bits, and clocks of a conversion; for single-ended and for differential inputs.
_BITS, _PAIR_BITS = (8, 12, 10, 16), (9, 13, 11, 16)
_CONVERSION, _PAIR_CONVERSION = (17, 20, 20, 25), (27, 30, 30, 34)
_LONG_SAMPLE = (20, 12, 6, 2)  # further clocks, by CFG2.ADLSTS
_CALIBRATION_CLOCKS = 14_000  # with 32 averages, from the manual


class Converter(Restorable):
    """One ADC16 module.

    The converter is ideal: offset, gain and calibration registers store writes and change no result. Inputs a and b
    of CFG2.MUXSEL are the same. Hardware triggers are not modelled, and are reported.

    Parameters
    ----------
    note
        Called with address, size and value of a write that requests an unmodelled function.

    Attributes
    ----------
    volts : callable
        Returns the voltage of a channel [V]; of a differential channel, the one between its pins.
    temperature_degc : callable
        Returns the temperature of the chip [degC].
    on_request : callable
        Called with the module's DMA request source and its new level.
    """

    steady = frozenset(range(0x1000)) - frozenset(range(_RA, _RB + 4))

    def __init__(
        self, processor: Processor, clocks: ClockGates, module: ChipPeripheral, note: Callable[[int, int, int], None]
    ) -> None:
        self.name = module.name
        self.base = module.base
        self.clocked = True
        (self._interrupt,) = module.interrupts
        self.volts: Callable[[int], float] = lambda _channel: 0.0
        self.temperature_degc: Callable[[], float] = lambda: _SENSOR_DEGC
        self.on_request: Callable[[int, bool], None] = lambda _source, _level: None
        (self._request,) = module.requests
        self._nvic = processor.nvic
        self._clocks = clocks
        self._note = note
        self._initial = {register.address - module.base: register.reset for register in module.registers}
        self._event: Event | None = None
        self._end = clocks.time, 0
        self.reset()

    def reset(self) -> None:
        """Return to the state after reset: no channel is selected."""
        self._abort()
        self._registers = dict(self._initial)
        self._drive()

    # -- time ---------------------------------------------------------------------------------

    @property
    def _own_hz(self) -> int:
        return _OWN_HZ[self._registers[_CFG1] >> 6 & 2 | self._registers[_CFG2] >> 2 & 1]

    def _ticks(self, clocks: int, bus_clocks: int) -> tuple[Clock, int]:
        """Return the clock that times a conversion, and the ticks of that clock for a number of converter clocks."""
        config, sources = self._registers[_CFG1], self._clocks
        divided = clocks << (config >> 5 & 3)
        source = config & 3
        if source == 0:
            return sources.bus, divided + bus_clocks
        hz = {1: IRC48M_HZ, 2: float(sources.oscillator.hz)}.get(source, self._own_hz)
        bus_s = bus_clocks / float(sources.bus.hz) if sources.bus.hz else 0.0
        starts = source == 3 and not self._registers[_CFG2] & 8
        seconds = divided / hz + bus_s + (_OWN_START_S if starts else 0)
        return sources.time, round(seconds * PICOSECONDS)

    def _conversion_clocks(self, pair: bool, *, is_first: bool) -> int:
        config, more = self._registers[_CFG1], self._registers[_CFG2]
        one = (_PAIR_CONVERSION if pair else _CONVERSION)[config >> 2 & 3]
        if config & 0x10:  # ADLSMP
            one += _LONG_SAMPLE[more & 3]
        one += 2 if more & 4 else 0  # ADHSC
        first = (3 if config & 0x10 else 5) if is_first else 0
        return first + self._averages * one

    @property
    def _averages(self) -> int:
        return 4 << (self._registers[_SC3] & 3) if self._registers[_SC3] & _AVGE else 1

    # -- conversion ---------------------------------------------------------------------------

    def _abort(self) -> None:
        if self._event is not None:
            self._event.cancel()
            self._event = None

    def _start(self, *, is_first: bool = True) -> None:
        self._abort()
        control = self._registers[_SC1A]
        if control & _CHANNEL == _OFF:
            return
        clocks = self._conversion_clocks(bool(control & _DIFF), is_first=is_first)
        source, ticks = self._ticks(clocks, 5 if is_first else 0)
        before, end = self._end
        # The next conversion follows without a gap, even if the event for the end of this one fires late.
        begin = source.now() if is_first or before is not source else end
        self._end = source, begin + ticks
        self._event = source.call_at(begin + ticks, self._finish_conversion)

    def _finish_conversion(self) -> None:
        self._event = None
        result = self._result()
        if self._passes(result):
            self._registers[_RA] = result & 0xFFFF
            self._registers[_SC1A] |= _COCO
        if self._registers[_SC3] & _ADCO:
            self._start(is_first=False)
        self._drive()

    def _result(self) -> int:
        """Return the conversion result of the selected channel."""
        control, mode = self._registers[_SC1A], self._registers[_CFG1] >> 2 & 3
        channel = control & _CHANNEL
        inside = {
            _TEMPERATURE: _SENSOR_V - _SENSOR_V_PER_DEGC * (self.temperature_degc() - _SENSOR_DEGC),
            _BANDGAP: _BANDGAP_V,
            _VREFH: REFERENCE_V,
            _VREFL: 0.0,
        }
        volts = inside[channel] if channel in inside else self.volts(channel)
        full = 1 << (_PAIR_BITS[mode] - 1 if control & _DIFF else _BITS[mode])
        steps = math.floor(volts / REFERENCE_V * full + 0.5)
        return min(max(steps, -full if control & _DIFF else 0), full - 1)

    def _passes(self, result: int) -> bool:
        """Return whether the compare function accepts a result."""
        control = self._registers[_SC2]
        if not control & _ACFE:
            return True
        first, second = (_compare_value(self._registers[cv], self._registers[_SC1A]) for cv in (_CV1, _CV2))
        greater = bool(control & _ACFGT)
        if not control & _ACREN:
            return (result >= first) is greater
        if first <= second:
            return (first <= result <= second) is greater
        return result >= first or result <= second if greater else second < result < first

    # -- calibration --------------------------------------------------------------------------

    def _calibrate(self) -> None:
        self._abort()
        self._registers[_SC3] = self._registers[_SC3] & ~_CALF | _CAL
        self._registers[_SC1A] &= ~_COCO
        if self._registers[_SC2] & _ADTRG:
            self._fail()
            return
        source, ticks = self._ticks(_CALIBRATION_CLOCKS * self._averages // 32, 100)
        self._event = source.call_after(ticks, self._finish_calibration)

    def _finish_calibration(self) -> None:
        self._event = None
        self._registers[_SC3] &= ~_CAL
        self._registers[_SC1A] |= _COCO
        self._drive()

    def _fail(self) -> None:
        self._abort()
        self._registers[_SC3] = self._registers[_SC3] & ~_CAL | _CALF

    # -- registers ----------------------------------------------------------------------------

    def read(self, offset: int, size: int) -> int:
        """Return a register; reading a result clears its COCO."""
        register = offset & ~3
        value = self._registers.get(register, 0)
        if register in (_RA, _RB):
            self._registers[_SC1A if register == _RA else _SC1B] &= ~_COCO
            self._drive()
        elif register == _SC2 and self._event is not None:
            value |= _ADACT
        return value >> 8 * (offset & 3)

    def write(self, offset: int, size: int, value: int) -> None:
        if self._registers[_SC3] & _CAL:
            self._fail()  # a write aborts the calibration
        if offset == _SC1A:
            self._registers[_SC1A] = value & 0x7F
            if self._registers[_SC2] & _ADTRG:
                self._abort()
            else:
                self._start()
        elif offset == _SC2:
            self._registers[_SC2] = value & 0x7F
            if value & _ADTRG:
                self._note(self.base + offset, size, value)
        elif offset == _SC3:
            failed = self._registers[_SC3] & _CALF & ~value
            self._registers[_SC3] = value & 0x0F | failed
            if value & _CAL:
                self._calibrate()
        elif offset in self._registers and offset not in (_RA, _RB):
            self._registers[offset] = value & (0x7F if offset == _SC1B else 0xFFFF)
        self._drive()

    def _drive(self) -> None:
        done = self._registers[_SC1A]
        self.on_request(self._request, bool(done & _COCO and self._registers[_SC2] & _DMAEN))
        self._nvic.set_line(self._interrupt, bool(done & _COCO and done & _AIEN))


def _compare_value(value: int, control: int) -> int:
    """Return the value of a compare register, which is signed for differential inputs."""
    return value - 0x10000 if control & _DIFF and value & 0x8000 else value
