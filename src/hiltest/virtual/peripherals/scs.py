"""The processor's own peripherals in the core's library: NVIC, SCB and SysTick."""

from __future__ import annotations

from collections.abc import Callable

from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.peripherals.bus import ALL_STEADY
from hiltest.virtual.peripherals.core_device import CoreDevice
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor

_BASE, _SYSTICK = 0xE000E000, 0xE000E010
_CVR, _CALIB = 0x18, 0x1C  # SysTick


class SystemControlSpace(CoreDevice):
    """The page at 0xE000E000: SysTick, NVIC and SCB.

    Parameters
    ----------
    core
        The core clock, which SysTick counts.
    request_reset
        Called when AIRCR requests a system reset.
    """

    counters = frozenset(range(_CVR, _CALIB))
    steady = frozenset(ALL_STEADY) - counters

    def __init__(self, processor: Processor, core: Clock, request_reset: Callable[[], None]) -> None:
        machine = processor.machine
        self._on_request = guarded_callback("void(void *)", request_reset, processor.abort)
        connections = ffi.new("struct machine_system_control *", (self._on_request, ffi.NULL))
        if not (
            lib.machine_add_systick(machine.handle, core.number_in(machine))
            and lib.machine_add_system_control(machine.handle, connections[0])
        ):
            raise MemoryError
        super().__init__(machine, "SCS", _BASE)

    def reset(self) -> None:
        """Return to the state after a processor reset."""
        super().reset()
        lib.machine_reset_device(self._handle, _SYSTICK)
