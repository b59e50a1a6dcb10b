"""The emulated Cortex-M4F: runs code up to the next event of the queue, and reports faults.

The library `hiltest.virtual.core` executes instructions, counts their cycles and takes exceptions. It returns to this
module for events of the queue, sleep, faults and hangs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hiltest.errors import BoardFault, place_of
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import NEVER, Machine
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.processor.faults import FaultLog, describe_fault
from hiltest.virtual.processor.interrupt import deferred_interrupt
from hiltest.virtual.processor.memory import MK64FN1M0, BoardMemory
from hiltest.virtual.processor.nvic import Nvic
from hiltest.virtual.processor.registers import CoreRegisters
from hiltest.virtual.processor.running_calls import RunningCalls
from hiltest.virtual.processor.schedule import Event, Schedule
from hiltest.virtual.processor.waiting import Waiting
from hiltest.virtual.program.elf import FirmwareImage

RETURN_ADDRESS = 0x1FFEF000  # return address of called functions; the part has no memory there

_STOPS = {lib.STOP_BREAKPOINT, lib.STOP_WATCHPOINT, lib.STOP_STEP}  # only a debugger requests these

_PUSHED_AT_MOST, _LARGEST_FRAME = 64, 4096  # bytes of one PUSH, and of a function's stack frame


class Processor:
    """An emulated Cortex-M4F with its memories, event queue and cycle count.

    Parameters
    ----------
    image
        Source of the functions and lines in fault reports.
    profile
        Prices of the instructions.
    baseline
        True for a core of ARMv6-M, as the Cortex-M0.

    Attributes
    ----------
    core : struct core
        State of the core, see machine.h.
    calls : RunningCalls
        Calls of watched functions.
    is_running : bool
        True during `run`.
    fault_log : FaultLog
        Faults that the firmware's fault handlers received.
    waits_for : callable
        Returns a description of the unmodelled register that firmware polls; empty if there is none.
    at_breakpoint : callable
        Called at a BKPT with its address; a debugger raises an exception to halt, which `run` passes on.
    at_stop : callable
        Called with STOP_BREAKPOINT, STOP_WATCHPOINT or STOP_STEP of machine.h; may raise an exception, too.
    """

    def __init__(
        self,
        image: FirmwareImage,
        profile: TimingProfile,
        *,
        memories: MemoryMap = MK64FN1M0,
        baseline: bool = False,
    ) -> None:
        self.image = image
        self.profile = profile
        self.machine = Machine(profile, baseline=baseline)
        self.core = self.machine.core
        self.core.return_address = RETURN_ADDRESS
        self.memory = BoardMemory(self.machine, memories)
        self.registers = CoreRegisters(self.machine)
        self.schedule = Schedule(self._return_at)
        self.nvic = Nvic(self.machine)
        self.fault_log = FaultLog()
        self.waits_for: Callable[[], str] = lambda: ""
        self.at_breakpoint: Callable[[int], None] = lambda _address: None
        self.at_stop: Callable[[int], None] = lambda _reason: None
        self.calls = RunningCalls(self.machine, self.abort)
        self.waiting = Waiting(self.machine, self.nvic, self.schedule, self.fault_log)
        self._error: BaseException | None = None
        self.is_running = False

    @property
    def sleeping(self) -> bool:
        """Return whether the processor is in WFI or WFE."""
        return self.waiting.sleeping

    @sleeping.setter
    def sleeping(self, sleeps: bool) -> None:
        self.waiting.sleeping = sleeps

    @property
    def delivers_faults(self) -> bool:
        """Return whether faults enter the firmware's handlers; otherwise a fault ends the run."""
        delivers: bool = self.core.delivers_faults
        return delivers

    @delivers_faults.setter
    def delivers_faults(self, delivers: bool) -> None:
        self.core.delivers_faults = delivers

    @property
    def fpu_enabled(self) -> bool:
        """Return whether CPACR enables the FPU."""
        enabled: bool = self.core.fpu_enabled
        return enabled

    @fpu_enabled.setter
    def fpu_enabled(self, enabled: bool) -> None:
        lib.machine_set_fpu(self.machine.handle, enabled)

    def reset(self) -> None:
        """Return to the state after a processor reset, except for stack pointer and PC."""
        lib.machine_reset(self.machine.handle)
        self.fault_log.forget_open()
        self.sleeping = False

    def flush_pipeline(self) -> None:
        """Empty the pipeline: instructions do not overlap across a call by the host."""
        lib.machine_flush_pipeline(self.machine.handle)

    def save_floats(self) -> None:
        """Save the floating-point state of an exception that saves it lazily, as the next FPU instruction does."""
        lib.machine_save_floats(self.machine.handle)

    # -- time ---------------------------------------------------------------------------------

    @property
    def cycles(self) -> int:
        """Clock cycles since power-on; during an access to a peripheral, those at the beginning of the instruction."""
        cycles: int = self.core.cycles
        return cycles

    def now(self) -> int:
        """Return `cycles`."""
        cycles: int = self.core.cycles
        return cycles

    @property
    def instructions(self) -> int:
        """Instructions executed since power-on, excluding the current one."""
        instructions: int = self.core.instructions
        return instructions

    @property
    def idle_cycles(self) -> int:
        """Cycles of sleep since power-on."""
        cycles: int = self.core.idle_cycles
        return cycles

    # -- calls from peripherals ---------------------------------------------------------------

    def abort(self, error: BaseException) -> None:
        """Stop after the current instruction; `run` raises `error`."""
        if self._error is None:
            self._error = error
        self.return_soon()

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def return_soon(self) -> None:
        """Return from the core after the current instruction, because an event may be due."""
        self.core.deadline = -1

    def report_changing_read(self) -> None:
        """Report that the current read of a register has changed a peripheral."""
        lib.machine_load_changed(self.machine.handle)

    def _return_at(self, cycle: float) -> None:
        if cycle < self.core.deadline:
            self.core.deadline = math.ceil(cycle)

    # -- faults -------------------------------------------------------------------------------

    def place(self, pc: int) -> str:
        """Describe the place of an instruction."""
        function = self.image.function_at(pc)
        return place_of(pc & ~1, function.name if function else "", self.image.location_at(pc))

    def fault(self, cause: str, pc: int) -> BoardFault:
        """Return a fault with function, line and registers."""
        function = self.image.function_at(pc)
        return BoardFault(
            cause,
            pc=pc & ~1,
            function=function.name if function else "",
            location=self.image.location_at(pc),
            registers=self.registers.snapshot(),
        )

    def _hang(self, cause: str, pc: int) -> BoardFault:
        """Return the error for a hang; during a fault's handler it is the fault, with the hang as its end."""
        first = self.fault_log.first_cause
        return self.fault(f"hang: {cause}", pc) if first is None else first.ended(f"hang at {self.place(pc)}: {cause}")

    def _deliver(self) -> None:
        """Enter the firmware's handler for the fault that the core has recorded."""
        core = self.core
        place: int = core.fault.place
        cause = describe_fault(self.machine, self.memory.code_at(place))
        described = self.fault(f"stack overflow: {cause}" if self._overflows() else cause, place)
        if not self.delivers_faults:
            raise described
        exception: int = lib.machine_deliver_fault(self.machine.handle)
        if not exception:
            first = self.fault_log.first_cause
            if first is None:
                raise described.ended("lockup: no fault handler can run") from None
            raise first.ended(f"lockup at {self.place(place)}: {cause} while no fault handler can run") from None
        self.fault_log.record_delivery(described, exception, core.cycles, core.active_count)
        core.reports_returns = True

    def _overflows(self) -> bool:
        """Return whether the faulting access was to a stack that has left its memory."""
        fault = self.core.fault
        if fault.kind != lib.FAULT_DATA_BUS:
            return False
        above: int = fault.address - self.core.r[13]
        has_left = not self.memory.holds_stack(self.core.r[13], 4)
        return -_PUSHED_AT_MOST <= above < 0 or (has_left and 0 <= above < _LARGEST_FRAME)

    # -- running ------------------------------------------------------------------------------

    def run(self, until: Event, *, wake: Callable[[], bool] | None = None, for_bytes: bool = False) -> bool:
        """Run until a virtual time, until `wake` returns true, or until a called function returns.

        Parameters
        ----------
        until
            Event at which to stop, before the first instruction at or after its cycle.
        wake
            Called after every event.
        for_bytes
            True if `wake` need not be called before the bytes that `Uart.host_expect` describes have arrived.

        Returns
        -------
        bool
            True if a called function returned.

        Raises
        ------
        BoardFault
            If the processor faults or hangs.
        """
        core, schedule, waiting = self.core, self.schedule, self.waiting
        waiting.has_end = math.isfinite(until.at_cycle)
        core.leaves_sleep = not waiting.has_end  # Python must detect endless sleep
        core.stops_at = lib.HOST_NONE if wake is None else lib.HOST_BYTES if for_bytes else lib.HOST_ANY
        with self._mark_running(), deferred_interrupt(self.return_soon) as pass_interrupt_on:
            while True:
                now = core.cycles
                schedule.run_due(now)
                if waiting.in_python:
                    lib.machine_fire_events(self.machine.handle)
                    self._raise_error()
                    waiting.on_events()
                    schedule.run_due(now)  # events that the first ones have scheduled for now
                if (wake is not None and wake()) or now >= until.at_cycle:
                    return False
                pass_interrupt_on()
                if waiting.in_python:
                    waiting.wake()
                    if waiting.sleeping:
                        self._sleep(until.at_cycle)
                        continue
                if self._execute(min(schedule.next_cycle, until.at_cycle)):
                    return True

    @contextmanager
    def _mark_running(self) -> Iterator[None]:
        was_running, self.is_running = self.is_running, True
        try:
            yield
        finally:
            self.is_running = was_running

    def _sleep(self, until_cycle: float) -> None:
        """Sleep in WFI or WFE: advance to the next event, or to the end of the run."""
        core = self.core
        if self.waiting.is_endless(until_cycle):
            cause = f"{self.waiting.instruction} without anything that could wake the processor"
            raise self._hang(cause, core.r[15])
        jump = math.ceil(min(self.waiting.next_cycle, until_cycle)) - core.cycles
        if jump > 0:
            core.idle_cycles += jump
            core.cycles += jump

    def _execute(self, deadline: float) -> bool:
        """Enter the core once; return True if a called function returned."""
        core = self.core
        core.deadline = NEVER if math.isinf(deadline) else math.ceil(deadline)
        reason = lib.machine_run(self.machine.handle)
        if reason == lib.STOP_LOOP and self._error is None:
            reason = self._stay_in_loop()
        self._raise_error()
        if reason == lib.STOP_FAULT:
            self._handle_fault()
        elif reason in _STOPS:
            self.at_stop(reason)
        elif reason == lib.STOP_SLEEP:
            self.sleeping = True
        elif reason == lib.STOP_UNSTACKED:
            self.fault_log.record_return(core.active_count)
            core.reports_returns = self.fault_log.first_cause is not None
        return bool(reason == lib.STOP_RETURNED)

    def _stay_in_loop(self) -> int:
        """Stay in a branch to itself until the deadline, if an event can end it."""
        if not (self.waiting.rests(self.delivers_faults) or self.waiting.can_leave_loop()):
            raise self._hang("a branch to itself that no interrupt can end", self.core.r[15])
        self.core.may_loop = True
        try:
            reason: int = lib.machine_run(self.machine.handle)
        finally:
            self.core.may_loop = False
        return reason

    def _handle_fault(self) -> None:
        fault = self.core.fault
        if fault.kind == lib.FAULT_BREAKPOINT:
            self.at_breakpoint(fault.place)
        self._deliver()
