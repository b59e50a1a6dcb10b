"""The emulated Cortex-M4F: runs code, counts cycles, takes exceptions, reports faults.

Unicorn executes instructions and knows nothing of the processor's private
peripherals; exceptions, WFI, the FPU's access control and time are here. Its
`emu_start` is entered for as long as nothing has to be looked at: until the
next event of the calendar, an interrupt, WFI, or an exception return.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import unicorn
from unicorn import arm_const as arm
from unicorn import unicorn_py3
from unicorn.unicorn_py3.unicorn import uclib

from hiltest.errors import BoardFault
from hiltest.virtual.accounting import Accounting, AccountingFactory, Block
from hiltest.virtual.elf import FirmwareImage
from hiltest.virtual.exceptions import ExceptionUnit, VectorError
from hiltest.virtual.instructions import Instruction
from hiltest.virtual.interrupt import deferred_interrupt
from hiltest.virtual.memory import PERIPHERALS, BoardMemory
from hiltest.virtual.native import by_block
from hiltest.virtual.nvic import SVCALL, Nvic
from hiltest.virtual.registers import CoreRegisters
from hiltest.virtual.schedule import Schedule
from hiltest.virtual.timing import TimingProfile

RETURN_ADDRESS = 0x1FFEF000  # where a called function returns to: an executable page that the part does not have
_SLICE_CYCLES = 4_000_000  # the longest stretch without looking at the wall clock or Ctrl-C
_INTERRUPT_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p)
_INTR_UNDEFINED, _INTR_SVC, _INTR_BREAKPOINT, _INTR_EXCEPTION_RETURN = 1, 2, 7, 8

_ACCESS = {
    unicorn.UC_MEM_READ_UNMAPPED: "read of unmapped address",
    unicorn.UC_MEM_WRITE_UNMAPPED: "write to unmapped address",
    unicorn.UC_MEM_FETCH_UNMAPPED: "jump to unmapped address",
    unicorn.UC_MEM_WRITE_PROT: "write to flash at address",
    unicorn.UC_MEM_READ_PROT: "read of protected address",
    unicorn.UC_MEM_FETCH_PROT: "execution of data at address",
}


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
    """

    def __init__(
        self, image: FirmwareImage, profile: TimingProfile, *, accounting: AccountingFactory = by_block
    ) -> None:
        self.image = image
        self.profile = profile
        self.engine: Any = unicorn_py3.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self.engine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self.memory = BoardMemory(self.engine)
        self.engine.mem_map(RETURN_ADDRESS, 0x1000, unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC)
        self.registers = CoreRegisters(self.engine)
        self.schedule = Schedule(self._look_at)
        self.nvic = Nvic()
        self.exceptions = ExceptionUnit(self.registers, self.memory, self.nvic)
        self.fpu_enabled = False
        self.sleeping = False
        self.idle_cycles = 0
        self._fault: BaseException | None = None
        self._exc_return = 0
        self._stopped = False
        self._watched: set[int] = set()
        self._to_watch: Block | None = None
        self.accounting: Accounting = accounting(profile, self._read_code, self._attend, self._stop)
        self._install_hooks()
        # The binding's emu_start costs as much again as the emulator's own.
        handle, until, forever = self.engine._uch, ctypes.c_uint64(RETURN_ADDRESS), ctypes.c_uint64(0)
        self._enter: Callable[[int], int] = lambda begin: uclib.uc_emu_start(handle, begin, until, forever, forever)

    def _install_hooks(self) -> None:
        kind = unicorn.UC_HOOK_CODE if self.accounting.per_instruction else unicorn.UC_HOOK_BLOCK
        # The emulator keeps only the pointers.
        self._hooks = (
            self._hook(kind, *self.accounting.hook(RETURN_ADDRESS, self.abort)),
            self._hook(unicorn.UC_HOOK_INTR, _INTERRUPT_CALLBACK(self._on_interrupt), None),
        )
        unmapped = unicorn.UC_HOOK_MEM_UNMAPPED | unicorn.UC_HOOK_MEM_FETCH_PROT
        self.engine.hook_add(unmapped, self._on_invalid_memory)
        protected = unicorn.UC_HOOK_MEM_READ_PROT | unicorn.UC_HOOK_MEM_WRITE_PROT
        self.engine.hook_add(protected, self._on_invalid_memory, begin=0, end=PERIPHERALS[0] - 1)  # above: the bus
        self.engine.hook_add(unicorn.UC_HOOK_INSN_INVALID, self._on_invalid_instruction)

    def _hook(self, kind: int, function: Any, data: Any) -> tuple[Any, Any]:
        """Hook straight through the C interface: the binding's own wrapper doubles the cost of each call."""
        uclib.uc_hook_add(
            self.engine._uch, ctypes.byref(ctypes.c_size_t()), kind, function, data,
            ctypes.c_uint64(1), ctypes.c_uint64(0),
        )  # fmt: skip
        return function, data

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

    @property
    def instructions(self) -> int:
        """Instructions executed since power-on."""
        return self.accounting.instructions

    # -- called from hooks --------------------------------------------------------------------

    def abort(self, error: BaseException) -> None:
        """Stop the emulator; `run` raises `error`."""
        if self._fault is None:
            self._fault = error
        self.engine.emu_stop()

    def look_soon(self) -> None:
        """An event or interrupt may be due now: leave the emulator at the end of this block."""
        self.accounting.deadline = -1

    def _look_at(self, cycle: float) -> None:
        self.accounting.deadline = min(self.accounting.deadline, cycle)

    def _stop(self) -> None:
        self._stopped = True
        self.engine.emu_stop()

    def _read_code(self, address: int, size: int) -> bytes:
        return self.memory.read(address, size)

    def _attend(self, block: Block) -> bool:
        if block.uses_fpu:
            if not self.fpu_enabled:
                self._fault = self.fault("FPU used while CPACR disables it (NOCP)", block.address)
                return False
            self.exceptions.floating_point_runs()
        if block.alignment.registers and self._misaligned(block):
            return False
        if any(instruction.address not in self._watched for instruction in block.alignment.inside):
            self._to_watch = block
            return False
        if block.loops_to_itself and not self._can_leave_loop():
            self._fault = self.fault("hang: a loop to itself that no interrupt can end", block.address)
            return False
        if block.changes_masks and self.nvic.pending:
            self.look_soon()
        return True

    def _misaligned(self, block: Block) -> bool:
        registers = block.alignment.registers
        values = self.registers.cores(registers).read()
        together = 0
        for value in values:
            together |= value
        if not together & 3:
            return False
        register = next(r for r, value in zip(registers, values, strict=True) if value & 3)
        place = next((i for i in block.instructions if i.aligned_base == register), block.instructions[0])
        self._fault = self._unaligned(place, register)
        return True

    def _unaligned(self, instruction: Instruction, register: int) -> BoardFault:
        value = self.registers.cores((register,)).get()
        cause = f"unaligned access: r{register} = 0x{value:08x} in '{instruction.text}'"
        return self.fault(cause, instruction.address)

    def _watch(self, block: Block) -> None:
        """Have the bases that a block itself computes looked at when they are used.

        Few instructions are such, so a hook on each costs little; what the emulator
        has translated of the block must go, or it would not know of them.
        """
        for instruction in block.alignment.inside:
            if instruction.address in self._watched:
                continue
            self._watched.add(instruction.address)

            def look(_engine: Any, _address: int, _size: int, watched: Instruction) -> None:
                if self.registers.cores((watched.aligned_base,)).get() & 3:
                    self.abort(self._unaligned(watched, watched.aligned_base))

            self.engine.hook_add(
                unicorn.UC_HOOK_CODE, look, instruction, begin=instruction.address, end=instruction.address
            )
        self.engine.ctl_remove_cache(block.address, block.end)

    def _can_leave_loop(self) -> bool:
        masked = self.registers.primask.get() & 1 or self.registers.faultmask.get() & 1
        return not masked and (self.nvic.can_ever_wake or self.schedule.next_cycle < math.inf)

    def _on_interrupt(self, _engine: int, number: int, _data: int) -> None:
        try:
            self._note_interrupt(number, self.registers.pc.get())
            self._stop()
        except BaseException as error:  # re-raised by `run`; ctypes would print and drop it
            self.abort(error)

    def _note_interrupt(self, number: int, pc: int) -> None:
        if number == _INTR_SVC:
            self.nvic.pend(SVCALL)
        elif number == _INTR_EXCEPTION_RETURN:
            self._exc_return = pc
        elif number == _INTR_BREAKPOINT:
            self._fault = self.fault("breakpoint (BKPT)", pc)
        elif number == _INTR_UNDEFINED:
            self._fault = self.fault("undefined instruction", pc)
        else:
            self._fault = self._fault or self.fault(f"processor exception {number}", pc)

    def _on_invalid_memory(self, _engine: Any, access: int, address: int, size: int, _value: int, _data: Any) -> bool:
        pc = self.registers.pc.get()
        place = pc
        if access == unicorn.UC_MEM_FETCH_UNMAPPED:  # name the jump, not where it went
            place = self.accounting.jumped_from or pc
        what = _ACCESS.get(access, f"memory access {access} at")
        if self._fault is None:
            self._fault = self.fault(f"{what} 0x{address:08x} ({size} bytes)", place)
        return False

    def _on_invalid_instruction(self, _engine: Any, _data: Any) -> bool:
        pc = self.registers.pc.get()
        code = self._read_code(pc & ~1, 2)
        if code == b"\x20\xbf":  # WFE, which this emulator core lacks; the event register is always set here
            self.registers.pc.set((pc + 2) | 1)
            return True
        if self._fault is None:
            self._fault = self.fault(f"undefined instruction {code[::-1].hex()}", pc)
        return False

    def fault(self, cause: str, pc: int) -> BoardFault:
        """Describe a fault: function, line and registers included."""
        function = self.image.function_at(pc)
        return BoardFault(
            cause, pc=pc & ~1, function=function.name if function else "",
            location=self.image.location_at(pc), registers=self.registers.snapshot(),
        )  # fmt: skip

    # -- running ------------------------------------------------------------------------------

    def run(self, until_cycle: float, *, wake: Callable[[], bool] | None = None) -> bool:
        """Run until virtual time, until `wake` answers true, or until a called function returns.

        Parameters
        ----------
        until_cycle : float
            Virtual time [cycles]; reached at the end of the block that passes it.
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
        with deferred_interrupt(self.look_soon) as interrupted:
            while True:
                self.schedule.run_due(self.cycles)
                if (wake is not None and wake()) or self.cycles >= until_cycle or interrupted():
                    return False
                self._take_exception()
                if self.sleeping:
                    self._sleep(until_cycle)
                elif self._execute(min(self.schedule.next_cycle, until_cycle, self.cycles + _SLICE_CYCLES)):
                    return True

    def _take_exception(self) -> None:
        self.nvic.changed = False
        if not self.nvic.pending:
            return
        if self.sleeping and self.nvic.wakes():
            self.sleeping = False
        try:
            taken = self.exceptions.take()
        except VectorError as error:
            raise self.fault(str(error), self.registers.pc.get()) from error
        if taken:
            self.accounting.cycles += self.profile.exception_entry
            self.accounting.flush_pipeline()

    def _sleep(self, until_cycle: float) -> None:
        """Stay in WFI: jump to the next event, or to where the run ends."""
        target = min(self.schedule.next_cycle, until_cycle)
        if math.isinf(target):
            raise self.fault("hang: WFI with nothing that could wake the processor", self.registers.pc.get())
        jump = math.ceil(target) - self.cycles
        if jump > 0:
            self.idle_cycles += jump
            self.accounting.cycles += jump

    def _execute(self, deadline: float) -> bool:
        """Enter the emulator once; True when a called function returned."""
        self._exc_return = 0
        self._fault = None
        self._stopped = False
        self._to_watch = None
        self.accounting.deadline = deadline
        status = self._enter(self.registers.pc.get() | 1)
        pc = self.registers.pc.get()
        if status != unicorn.UC_ERR_OK and self._fault is None:
            self._fault = self.fault(str(unicorn_py3.UcError(status)), pc)
        self.accounting.settle(pc)
        if self._fault is not None:
            raise self._fault
        if self._exc_return:
            self.exceptions.leave(self._exc_return)
            self.accounting.cycles += self.profile.exception_return
            self.accounting.flush_pipeline()
            return False
        if self._to_watch is not None:
            self._watch(self._to_watch)
            return False
        if pc & ~1 == RETURN_ADDRESS:
            return True
        # Nobody asked it to stop: only WFI leaves the emulator by itself.
        self.sleeping = not (self._stopped or self.accounting.stopped)
        return False
