"""The emulated Cortex-M4F: runs code, counts cycles, takes exceptions, reports faults.

Unicorn executes instructions and knows nothing of the processor's private
peripherals; exceptions, WFI, the FPU's access control and time are here. Its
`emu_start` is entered for as long as nothing has to be looked at: until the
next event of the calendar, an interrupt, WFI, or an exception return.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import unicorn
from unicorn import unicorn_py3

from hiltest.errors import BoardFault, place_of
from hiltest.virtual.accounting import Accounting, AccountingFactory
from hiltest.virtual.blocks import CodeBlock
from hiltest.virtual.chip import MemoryMap
from hiltest.virtual.elf import FirmwareImage
from hiltest.virtual.engine import TRANSLATED_CALLBACK, add_hook, cortex_m4, entrance
from hiltest.virtual.exceptions import ExceptionUnit
from hiltest.virtual.executions import Snapshot
from hiltest.virtual.faults import Fault, FaultKind, FaultLog, Lockup
from hiltest.virtual.instructions import Instruction
from hiltest.virtual.interrupt import deferred_interrupt
from hiltest.virtual.it_watch import Watched
from hiltest.virtual.memory import FLASH, MK64FN1M0, SRAM, BoardMemory
from hiltest.virtual.native import by_block
from hiltest.virtual.nvic import SVCALL, EventRegister, Nvic
from hiltest.virtual.registers import CoreRegisters
from hiltest.virtual.schedule import Event, Schedule
from hiltest.virtual.timing import TimingProfile
from hiltest.virtual.traps import Traps
from hiltest.virtual.waiting import Waiting

RETURN_ADDRESS = 0x1FFEF000  # where a called function returns to: an executable page that the part does not have
_SLICE_CYCLES = 4_000_000  # the longest stretch without looking at the wall clock or Ctrl-C

_PUSHED_AT_MOST, _LARGEST_FRAME = 64, 4096  # bytes of one PUSH, and of what a function has on its stack

# Faults found after their instruction is over: a jump, or an SVC.
_BEHIND = {FaultKind.INSTRUCTION_BUS, FaultKind.EXECUTE_NEVER, FaultKind.SUPERVISOR_CALL}


class Processor:
    """An emulated Cortex-M4F with its memories, calendar and cycle count.

    Parameters
    ----------
    image : FirmwareImage
        Names functions and lines in faults.
    profile : TimingProfile
        Prices instructions.
    accounting : AccountingFactory
        What counts.
    memories : MemoryMap

    Attributes
    ----------
    fault_log : FaultLog
        What was delivered to the firmware's fault handlers.
    delivers_faults : bool
        Whether faults enter those handlers; otherwise each ends the run.
    cut_short : callable
        Told what has run before an instruction that faults within its block, which is counted as a whole.
    waits_for : callable
        Answers the register that is not modelled and is read over and over, if one is, else nothing.
    """

    def __init__(
        self, image: FirmwareImage, profile: TimingProfile, *, accounting: AccountingFactory = by_block,
        memories: MemoryMap = MK64FN1M0,
    ) -> None:  # fmt: skip
        self.image = image
        self.profile = profile
        self.engine: Any = cortex_m4()
        self.memory = BoardMemory(self.engine, memories)
        self.engine.mem_map(RETURN_ADDRESS, 0x1000, unicorn.UC_PROT_EXEC)
        self.registers = CoreRegisters(self.engine)
        self.schedule = Schedule(self._look_at)
        self.nvic = Nvic()
        self.exceptions = ExceptionUnit(self.registers, self.memory, self.nvic, profile, self._spend)
        self.fault_log = FaultLog()
        self.delivers_faults = False
        self.waits_for: Callable[[], str] = lambda: ""
        self.cut_short: Callable[[Snapshot], None] = lambda _snapshot: None
        self.event_register = EventRegister(self.nvic)
        self.waiting = Waiting(self.exceptions, self.nvic, self.event_register, self.schedule, self.fault_log)
        self.idle_cycles = 0
        self.traps = Traps(self.engine, self.registers, self.memory, stop=self._stop, abort=self.abort)
        self._error: BaseException | None = None
        self._stopped = False
        self._to_watch: CodeBlock | None = None
        self._chores: list[Callable[[], None]] = []
        self.accounting: Accounting = accounting(profile, self._read_code, self._attend, self._stop)
        self.traps.supervisor_call = self._call_supervisor
        self.traps.take_event = self.event_register.take
        self.exceptions.stacks = stacks = self.accounting.stacks
        stacks.read_pc, stacks.read = self.registers.pc.get, self.memory.read
        self.accounting.read_stack_pointer = self.registers.cores((13,)).get
        self.exceptions.stacked = self.accounting.stacked
        self.traps.jumped_from = lambda: self.accounting.jumped_from
        self._install_hooks()
        self._enter = entrance(self.engine, RETURN_ADDRESS)

    def _install_hooks(self) -> None:
        kind = unicorn.UC_HOOK_CODE if self.accounting.per_instruction else unicorn.UC_HOOK_BLOCK
        self._code_hook = self.accounting.hook(RETURN_ADDRESS, self.abort)
        if self._code_hook.function is not None:
            add_hook(self.engine, kind, *self._code_hook)
        self._data_hook = self.accounting.data_hook(self.registers.forget_condition, self.abort)
        if self._data_hook is not None:
            data = unicorn.UC_HOOK_MEM_READ | unicorn.UC_HOOK_MEM_WRITE
            add_hook(self.engine, data, *self._data_hook, within=(FLASH[0], sum(SRAM) - 1))
        self._watched_hook = self.accounting.watched_hook(self.abort)
        self._watched = Watched(self.engine, self._watched_hook)
        self._translation_hook = TRANSLATED_CALLBACK(self._on_translated)
        # Only RAM can be written to.
        for base, size in self.memory.map.ram:
            within = base, base + size - 1
            add_hook(self.engine, unicorn.UC_HOOK_EDGE_GENERATED, self._translation_hook, within=within)

    def _on_translated(self, _engine: int, block: Any, _before: int, _data: int) -> None:
        try:
            self.accounting.translated(block.contents.pc, block.contents.size)
        except BaseException as error:  # re-raised by `run`; ctypes would print and drop it
            self.abort(error)

    @property
    def sleeping(self) -> bool:
        """Whether it is in WFI or WFE."""
        return self.waiting.sleeping

    @sleeping.setter
    def sleeping(self, sleeps: bool) -> None:
        self.waiting.sleeping = sleeps

    # -- time ---------------------------------------------------------------------------------

    @property
    def cycles(self) -> int:
        """Clock cycles since power-on, while no instruction is being executed."""
        return self.accounting.cycles

    def now(self) -> int:
        """Clock cycles since power-on, inside a peripheral's access too."""
        return self.accounting.now(self.registers.pc.get())

    def instructions_now(self) -> int:
        """Instructions executed since power-on, inside a peripheral's access too."""
        return self.accounting.instructions_now(self.registers.pc.get())

    def executed(self) -> Snapshot | None:
        """Return how often every block has run, inside a peripheral's access; None where they are not counted."""
        return self.accounting.snapshot(self.registers.pc.get())

    @property
    def instructions(self) -> int:
        """Instructions executed since power-on."""
        return self.accounting.instructions

    # -- called from hooks --------------------------------------------------------------------

    def abort(self, error: BaseException) -> None:
        """Stop the emulator; `run` raises `error`."""
        if self._error is None:
            self._error = error
        self.engine.emu_stop()

    def look_soon(self) -> None:
        """Leave the emulator at the end of this block: an event or interrupt may be due."""
        self.accounting.deadline = -1

    def between_blocks(self, chore: Callable[[], None]) -> None:
        """Call an action at the end of this block, for changes that the emulator does not take while it runs."""
        self._chores.append(chore)
        self.look_soon()

    def _look_at(self, cycle: float) -> None:
        self.accounting.deadline = min(self.accounting.deadline, cycle)

    def _stop(self) -> None:
        self._stopped = True
        self.engine.emu_stop()

    def _read_code(self, address: int, size: int) -> bytes:
        try:
            return self.memory.read(address, size)
        except ValueError:
            raise self.fault(f"execution of 0x{address:08x}, where the part has no memory", address) from None

    @property
    def fpu_enabled(self) -> bool:
        """Whether CPACR lets code use the FPU."""
        return self.traps.fpu_enabled

    @fpu_enabled.setter
    def fpu_enabled(self, enabled: bool) -> None:
        self.traps.fpu_enabled = enabled

    def trap_division_by_zero(self, enabled: bool) -> None:
        """Whether division by zero faults (CCR.DIV_0_TRP)."""
        if enabled:
            self.between_blocks(lambda: self.traps.watch_divisions(self.image))
        self.traps.traps_division_by_zero = enabled

    def _attend(self, block: CodeBlock) -> bool:
        if block.uses_fpu and self.fpu_enabled:
            self.exceptions.floating_point_runs()
        suspects = self._suspects(block)
        watched = (*suspects, *block.alignment.inside)
        if (watched and self.traps.unwatched(watched)) or not self._watched.knows(block.watched):
            self._to_watch = block
            return False
        if suspects:
            self.look_soon()  # what counts must not take it from this block that the next ones are good
        if block.loops_to_itself and not (self.waiting.rests(self.delivers_faults) or self.waiting.can_leave_loop()):
            self._error = self._hang("a loop to itself that no interrupt can end", block.address)
            return False
        if block.sends_event:
            self.event_register.send()
        if block.changes_masks and self.nvic.pending:
            self.look_soon()
        return True

    def _suspects(self, block: CodeBlock) -> list[Instruction]:
        """Find the instructions of a block that will fault if they run."""
        suspects: list[Instruction] = []
        if block.uses_fpu and not self.fpu_enabled:
            suspects += [instruction for instruction in block.instructions if instruction.uses_fpu]
        if block.alignment.registers and self._misaligned(block):
            suspects += [instruction for instruction in block.instructions if instruction.aligned_base >= 0]
        return suspects

    def _misaligned(self, block: CodeBlock) -> bool:
        return any(value & 3 for value in self.registers.cores(block.alignment.registers).read())

    def _call_supervisor(self) -> bool:
        if not self.nvic.preempts(SVCALL, self.exceptions.ceiling()):
            return False
        self.nvic.pend(SVCALL)
        return True

    # -- faults -------------------------------------------------------------------------------

    def place(self, pc: int) -> str:
        """Name the place of an instruction."""
        function = self.image.function_at(pc)
        return place_of(pc & ~1, function.name if function else "", self.image.location_at(pc))

    def fault(self, cause: str, pc: int) -> BoardFault:
        """Describe a fault: function, line and registers included."""
        function = self.image.function_at(pc)
        return BoardFault(
            cause, pc=pc & ~1, function=function.name if function else "",
            location=self.image.location_at(pc), registers=self.registers.snapshot(),
        )  # fmt: skip

    def _hang(self, cause: str, pc: int) -> BoardFault:
        """Describe a hang; in a fault's handler, describe the fault."""
        first = self.fault_log.first_cause
        return self.fault(f"hang: {cause}", pc) if first is None else first.ended(f"hang at {self.place(pc)}: {cause}")

    def _deliver(self, fault: Fault) -> None:
        """Have the firmware's handler take a fault."""
        described = self.fault(f"stack overflow: {fault.cause}" if self._overflows(fault) else fault.cause, fault.place)
        if not self.delivers_faults:
            raise described
        try:
            exception = self.exceptions.take_fault(fault)
        except Lockup:
            first = self.fault_log.first_cause
            if first is None:
                raise described.ended("lockup: no fault handler can run") from None
            place = self.place(fault.place)
            raise first.ended(f"lockup at {place}: {fault.cause} where no fault handler can run") from None
        self.fault_log.delivered(described, exception, self.cycles, len(self.nvic.active))
        self._entered()

    def _overflows(self, fault: Fault) -> bool:
        """Whether an access was on the stack, and that has left its memory."""
        if fault.address is None:
            return False
        above = fault.address - self.registers.snapshot()["sp"]
        has_left = not self.memory.holds_stack(fault.address - above, 4)
        return -_PUSHED_AT_MOST <= above < 0 or (has_left and 0 <= above < _LARGEST_FRAME)

    def _entered(self) -> None:
        self.event_register.send()
        self.accounting.flush_pipeline()

    def _spend(self, cycles: int) -> None:
        self.accounting.cycles += cycles

    # -- running ------------------------------------------------------------------------------

    def run(self, until: Event, *, wake: Callable[[], bool] | None = None) -> bool:
        """Run until virtual time, until `wake` answers true, or until a called function returns.

        Parameters
        ----------
        until : Event
            Time when to stop; reached at the end of the block that passes it.
        wake : callable, optional
            Asked after every event.

        Returns
        -------
        bool
            Whether a called function returned.

        Raises
        ------
        BoardFault
            The processor met a fault or hung.
        """
        schedule, accounting = self.schedule, self.accounting
        self.waiting.has_end = math.isfinite(until.at_cycle)
        with deferred_interrupt(self.look_soon) as interrupted:
            while True:
                now = accounting.cycles
                schedule.run_due(now)
                if (wake is not None and wake()) or now >= until.at_cycle or interrupted():
                    return False
                self._take_exception()
                if self.sleeping:
                    self._sleep(until.at_cycle)
                elif self._execute(min(schedule.next_cycle, until.at_cycle, now + _SLICE_CYCLES)):
                    return True

    def _take_exception(self) -> None:
        self.nvic.changed = False
        if not self.nvic.pending:
            self.exceptions.is_chained = False  # what waited at the return has been withdrawn
            return
        if self.waiting.gated:
            return
        ceiling, ceiling_asleep = self.exceptions.ceilings()
        if self.sleeping:
            self.waiting.wake(ceiling, ceiling_asleep)
        active = len(self.nvic.active)
        fault = self.exceptions.take(ceiling)
        if len(self.nvic.active) > active:
            self._entered()
        if fault is not None:
            self._deliver(fault)

    def _sleep(self, until_cycle: float) -> None:
        """Stay in WFI or WFE: jump to the next event, or to where the run ends."""
        if self.waiting.is_endless(until_cycle):
            cause = f"{self.waiting.instruction} with nothing that could wake the processor"
            raise self._hang(cause, self.registers.pc.get())
        target = min(self.schedule.next_cycle, until_cycle)
        jump = math.ceil(target) - self.cycles
        if jump > 0:
            self.idle_cycles += jump
            self.accounting.cycles += jump

    def _execute(self, deadline: float) -> bool:
        """Enter the emulator once; True when a called function returned."""
        while self._chores:
            self._chores.pop(0)()
        self.traps.clear()
        self._error = None
        self._stopped = False
        self._to_watch = None
        self.accounting.deadline = deadline
        status = self._enter(self.registers.pc.get() | 1)
        pc = self.registers.pc.get()
        fault = self.traps.fault
        if self._error is not None:
            self.accounting.settle(pc)
            raise self._error
        if fault is not None:
            self._settle(fault, pc)
            self._deliver(fault)
            return False
        branch = self.accounting.jumped_from or pc
        self.accounting.settle(pc)
        if status != unicorn.UC_ERR_OK:
            raise self.fault(str(unicorn_py3.UcError(status)), pc)
        if self.traps.exc_return:
            self._leave_exception(self.traps.exc_return, branch)
            return False
        if self._to_watch is not None:
            block = self._to_watch
            self.traps.watch((*self._suspects(block), *block.alignment.inside), block.address, block.end)
            self._watched.watch(block.watched, block.address, block.end)
            return False
        if pc & ~1 == RETURN_ADDRESS:
            if self.delivers_faults:  # nothing called: firmware went there by itself
                cause = f"jump to unmapped address 0x{RETURN_ADDRESS:08x}"
                self._deliver(Fault(FaultKind.INSTRUCTION_BUS, cause, branch))
            return not self.delivers_faults
        # Nothing asked it to stop: only WFI leaves the emulator by itself.
        self.waiting.for_event = self.traps.waits_for_event
        self.sleeping = self.waiting.for_event or not (self._stopped or self.accounting.stopped)
        return False

    def _settle(self, fault: Fault, pc: int) -> None:
        """Count what ran before an instruction that faults, and not the rest of its block."""
        if fault.kind in _BEHIND:
            self.accounting.settle(pc)
            return
        cycles, instructions = self.accounting.now(pc), self.accounting.instructions_now(pc)
        if (snapshot := self.accounting.snapshot(pc)) is not None:
            self.cut_short(snapshot)
        self.accounting.settle(pc)
        self.accounting.cycles, self.accounting.instructions = cycles, instructions
        self.accounting.flush_pipeline()

    def _leave_exception(self, exc_return: int, place: int) -> None:
        fault = self.exceptions.leave(exc_return, place)
        if fault is not None:
            self._deliver(fault)
            return
        active = len(self.nvic.active)
        self.fault_log.returned(active)
        self.event_register.send()
        self.waiting.for_event = False
        self.sleeping = self.waiting.sleeps_on_exit and active == 0
        self.accounting.flush_pipeline()
