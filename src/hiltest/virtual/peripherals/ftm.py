"""FTM: this module connects the channels of the timer (core/ftm.c) to pins."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.part.chip import ChipPeripheral
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.peripherals.pin_signals import PinSignal
from hiltest.virtual.peripherals.sim import ClockGates
from hiltest.virtual.processor.cpu import Processor

_CNT, _WORD = 0x04, 4
_FIRST_CHANNEL, _CHANNEL_BYTES, _CNTIN = 0x0C, 8, 0x4C
_SOPT4 = 0x00C  # in the SIM: a bit from 24 on selects FTM_CLKIN1


class FlexTimer(CoreDevice):
    """One FTM module.

    Parameters
    ----------
    note
        Called with address, size and value of a write that requests an unmodelled function.

    Attributes
    ----------
    signals : dict of str to PinSignal
        Inputs and outputs of the channels, by name.
    """

    counters = frozenset(range(_CNT, _CNT + _WORD))
    steady = frozenset(ALL_STEADY) - counters

    def __init__(
        self, processor: Processor, clocks: ClockGates, module: ChipPeripheral, note: Callable[[int, int, int], None]
    ) -> None:
        machine = processor.machine
        count = sum(register.address - module.base < _CNTIN for register in module.registers)
        channels = (count * _WORD - _FIRST_CHANNEL) // _CHANNEL_BYTES
        self._clocks = clocks
        self._channels = [
            PinSignal(partial(self._edge, channel), partial(self._level, channel), self._select_reports)
            for channel in range(channels)
        ]
        self.signals = {f"{module.name}_CH{channel}": signal for channel, signal in enumerate(self._channels)}
        self._callbacks = (  # the library keeps only the pointers
            guarded_callback(
                "void(void *, int32_t)", lambda channel: self._channels[channel].report_change(), processor.abort
            ),
            guarded_callback("void(void *, uint32_t, uint32_t, uint32_t)", note, processor.abort),
        )
        connections = ffi.new("struct machine_ftm *", (channels, *module.interrupts))
        connections.bus_clock, connections.fixed_clock = clocks.bus.number_in(machine), clocks.fixed.number_in(machine)
        connections.changed, connections.note = self._callbacks
        if not lib.machine_add_ftm(machine.handle, module.base, connections[0]):
            raise MemoryError
        super().__init__(machine, module.name, module.base)

    def parts(self) -> list[PinSignal]:
        return self._channels

    def clock_input(self, number: int, high: bool) -> None:
        """Set the level of FTM_CLKIN0 or 1."""
        if high and self._clocks.word(_SOPT4) >> 24 + int(self.name[-1]) & 1 == number:
            lib.machine_ftm_clock_edge(self._handle, self.base)

    def _edge(self, channel: int, high: bool) -> None:
        lib.machine_channel_edge(self._handle, self.base, channel, high)

    def _level(self, channel: int) -> bool | None:
        level = lib.machine_channel_level(self._handle, self.base, channel)
        return None if level < 0 else bool(level)

    def _select_reports(self) -> None:
        reporting = sum(signal.has_listeners << channel for channel, signal in enumerate(self._channels))
        lib.machine_report_channels(self._handle, self.base, reporting)
