"""The private peripherals of a Cortex-M4, and a part that has only these."""

from __future__ import annotations

from fractions import Fraction

from hiltest.virtual.calls.call_clock import CALL_HZ
from hiltest.virtual.part.chip import Chip
from hiltest.virtual.peripherals.bus import PeripheralBus
from hiltest.virtual.peripherals.dwt import CycleCounter
from hiltest.virtual.peripherals.rcm import ResetRequested, ResetSource
from hiltest.virtual.peripherals.scs import SystemControlSpace
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog
from hiltest.virtual.processor.clock import Clock
from hiltest.virtual.processor.cpu import Processor


def private_peripherals(processor: Processor, core: Clock) -> tuple[CycleCounter, SystemControlSpace]:
    """Return DWT and the system control space, which every Cortex-M4 has; SysTick counts the clock `core`."""

    def reset() -> None:
        processor.abort(ResetRequested(ResetSource.SOFTWARE))

    return CycleCounter(processor.machine), SystemControlSpace(processor, core, reset)


class BarePart:
    """A part with known memories: a processor without peripherals of the vendor.

    `unmodelled` stays empty, because any access to a peripheral is an error.
    """

    watchdog_resets = 0

    def __init__(self, processor: Processor) -> None:
        core = Clock(processor.schedule, processor.now)
        core.run_at(Fraction(CALL_HZ), Fraction(CALL_HZ), 0)
        self.unmodelled = UnmodelledLog(processor, Chip((), ()))
        self.cycle_counter, control = private_peripherals(processor, core)
        self.bus = PeripheralBus(processor, [self.cycle_counter, control], None)

    def describe_sleep(self) -> str:
        return ""
