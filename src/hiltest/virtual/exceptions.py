"""Entering and leaving exceptions as ARMv7-M does, and their cycles: frames, EXC_RETURN, lazy FPU state, escalation."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from hiltest.virtual.faults import Fault, FaultKind, FaultStatus, Lockup
from hiltest.virtual.memory import BoardMemory
from hiltest.virtual.nvic import HARD_FAULT, NMI, Nvic
from hiltest.virtual.registers import CoreRegisters
from hiltest.virtual.stacks import Stacks
from hiltest.virtual.timing import TimingProfile

_BASIC_BYTES, _EXTENDED_BYTES = 32, 104
_XPSR_REALIGNED = 1 << 9
_APSR = 0xF80F0000  # flags and GE bits, which an exception handler inherits
_THUMB = 1 << 24
_EXCEPTION_NUMBER = 0x1FF
_CONTROL_NPRIV, _CONTROL_SPSEL, _CONTROL_FPCA = 1, 2, 4
_FPCCR_ASPEN, _FPCCR_LSPEN = 1 << 31, 1 << 30
_NO_FRAME = 0
ON_PROCESS_STACK, OF_THREAD = 1, 2  # a frame lies at a multiple of eight
_RETURNS = {0xFFFFFFE1, 0xFFFFFFE9, 0xFFFFFFED, 0xFFFFFFF1, 0xFFFFFFF9, 0xFFFFFFFD}


class Follower(Protocol):
    """Is told of exceptions that are entered and left, before the cycles of that are counted."""

    @property
    def listens(self) -> bool:
        """Whether it wants to know now."""
        ...

    def reset(self) -> None:
        """Take note of a processor reset."""
        ...

    def paused(self) -> AbstractContextManager[None]:
        """Look away from what runs in the context: it is not the firmware's doing."""
        ...

    def entered(self, frame: int, /) -> object:
        """Take note of an entry: where registers were put, with `ON_PROCESS_STACK` and `OF_THREAD` where that holds."""
        ...

    def left(self, frame: int, cycles: int, /) -> object:
        """Take note of a return, of where the registers were taken from, and of the cycles that it takes."""
        ...


class ExceptionUnit:
    """Moves register frames to and from the stack.

    Floating-point state is stacked lazily, as at reset (FPCCR.ASPEN, LSPEN): room
    is reserved at entry and filled when the handler first uses the FPU. Where an
    exception waits when a handler ends, its handler follows without a frame moved
    (tail chaining), if the profile has a row for that.

    Parameters
    ----------
    registers : CoreRegisters
    memory : BoardMemory
    nvic : Nvic
    profile : TimingProfile
        What entries, returns and floating-point frames take.
    spend : callable
        Counts cycles.

    Attributes
    ----------
    vector_table : int
        VTOR.
    status : FaultStatus
        What fault handlers read, and which of them are enabled.
    base_thread_enabled : bool
        CCR.NONBASETHRDENA: thread mode may be returned to while exceptions are active.
    floating_control : int
        FPCCR: ASPEN makes frames hold floating-point state, LSPEN makes that lazy.
    follower : Follower or None
    stacked : callable
        Told of each frame: the stack pointer before it, and behind it.
    stacks : Stacks
        Told of exceptions that interrupt code on the process stack.
    is_chained : bool
        The next entry follows a return at once.
    """

    def __init__(
        self, registers: CoreRegisters, memory: BoardMemory, nvic: Nvic, profile: TimingProfile,
        spend: Callable[[int], None],
    ) -> None:  # fmt: skip
        self._registers = registers
        self._memory = memory
        self._nvic = nvic
        self._profile = profile
        self._spend = spend
        self.status = FaultStatus()
        self.follower: Follower | None = None
        self.stacked: Callable[[int, int], None] = lambda _above, _lowest: None
        self.stacks = Stacks()
        self.reset()

    def reset(self) -> None:
        """State after a processor reset."""
        self.vector_table = 0
        self.base_thread_enabled = False
        self.status.reset()
        self.floating_control = _FPCCR_ASPEN | _FPCCR_LSPEN
        self._lazy_frame = _NO_FRAME  # where the floating-point state belongs while it is not yet saved
        self.is_chained = False
        self._is_saved = False  # the floating-point state is in the frame that both handlers of a chain share
        if self.follower is not None:
            self.follower.reset()

    def unfollowed(self) -> AbstractContextManager[None]:
        """Have the follower look away from what runs in the context."""
        return nullcontext() if self.follower is None else self.follower.paused()

    def floating_point_runs(self) -> None:
        """Prepare for a floating-point instruction: save lazily stacked state first."""
        if self._lazy_frame != _NO_FRAME:
            self._save_floating_point()
            self._spend(self._profile.fp_frame)

    def _save_floating_point(self) -> None:
        self._memory.write_words(self._lazy_frame, self._registers.floating_frame.read())
        self._lazy_frame = _NO_FRAME

    @property
    def lazy_frame(self) -> int:
        """Address at which floating-point state still has to be saved (FPCAR), or 0."""
        return self._lazy_frame

    def ceiling(self) -> int:
        """Return the priority that PRIMASK, FAULTMASK and BASEPRI raise execution to."""
        return self._nvic.ceiling(*self._registers.masks.read())

    def ceilings(self) -> tuple[int, int]:
        """Return that priority, and the same without PRIMASK, which does not keep WFI asleep."""
        primask, faultmask, basepri = self._registers.masks.read()
        awake = self._nvic.ceiling(0, faultmask, basepri)
        return self._nvic.ceiling(primask, faultmask, basepri) if primask else awake, awake

    def take(self, ceiling: int) -> Fault | None:
        """Enter the most urgent exception that the masks let pass, if there is one.

        Parameters
        ----------
        ceiling : int
            What the masks raise execution to, see `ceiling`.

        Returns
        -------
        Fault or None
            What went wrong on the way in; it is to be taken next.
        """
        exception = self._nvic.next_exception(ceiling=ceiling)
        return None if exception is None else self._enter(exception)

    def take_fault(self, fault: Fault) -> int:
        """Choose the handler that a fault goes to, record it there, and enter it.

        Returns
        -------
        int
            The exception that was entered.

        Raises
        ------
        Lockup
            When the fault comes where not even HardFault may run.
        """
        priority = self._nvic.execution_priority(self.ceiling())
        wanted = fault.kind.exception
        if wanted in self.status.enabled and self._nvic.preemption_priority(wanted) < priority:
            handler = wanted
        elif priority <= self._nvic.preemption_priority(HARD_FAULT):
            raise Lockup
        else:
            handler = HARD_FAULT
        self.status.record(fault, forced=handler != wanted)
        again = self._enter(handler)
        if again is not None and handler == HARD_FAULT:
            raise Lockup
        return handler if again is None else self.take_fault(again)

    def _enter(self, exception: int) -> Fault | None:
        registers = self._registers
        *frame, stack, control = registers.interrupted.read()
        xpsr, interrupted_at = frame[7], frame[6]
        from_handler = xpsr & _EXCEPTION_NUMBER != 0
        uses_psp = not from_handler and control & _CONTROL_SPSEL != 0
        # The emulator itself sets CONTROL.FPCA, with the instruction that uses the FPU.
        extended = control & _CONTROL_FPCA != 0 and self.floating_control & _FPCCR_ASPEN != 0
        size = _EXTENDED_BYTES if extended else _BASIC_BYTES
        base = (stack - size) & ~7
        frame[7] = (xpsr | _XPSR_REALIGNED) if base + size != stack else (xpsr & ~_XPSR_REALIGNED)
        frame[6] &= ~1
        exc_return = 0xFFFFFFE1 | (0 if extended else 0x10) | (0 if from_handler else 0x08) | (0x04 if uses_psp else 0)
        problem = self._push(base, frame, extended=extended)
        self.stacked(stack, base)
        if uses_psp:
            self.stacks.handler_begins(base)
        try:
            vector = self._memory.read_words(self.vector_table + 4 * exception, 1)[0]
        except ValueError:
            vector = 0
            problem = Fault(FaultKind.VECTOR_TABLE, f"no memory at VTOR 0x{self.vector_table:08x}", interrupted_at)
        if not vector & 1 and problem is None:
            cause = f"vector 0x{vector:08x} of exception {exception} has no Thumb bit"
            problem = Fault(FaultKind.INVALID_STATE, cause, interrupted_at)
        xpsr = (xpsr & _APSR) | _THUMB | exception
        control &= _CONTROL_NPRIV
        registers.entry.write([base, 0, xpsr, control, exc_return, vector])
        self._nvic.enter(exception)
        if self.follower is not None and self.follower.listens:
            self.follower.entered(base | (uses_psp and ON_PROCESS_STACK) | (0 if from_handler else OF_THREAD))
        self._spend(self._entry_cycles(saves=extended and self._lazy_frame == _NO_FRAME))
        self.is_chained = self._is_saved = False
        if exception == HARD_FAULT and problem is not None and problem.kind is FaultKind.STACKING:
            self.status.record(problem, forced=False)  # nothing is more urgent: the handler runs without a frame
            return None
        return problem

    def _push(self, base: int, frame: list[int], *, extended: bool) -> Fault | None:
        """Write a frame, or only reserve its space where stacking is lazy."""
        size = _EXTENDED_BYTES if extended else _BASIC_BYTES
        if not self._memory.holds_stack(base, size):
            return Fault(FaultKind.STACKING, f"no RAM for a stack frame at 0x{base:08x}", frame[6])
        self._memory.write_words(base, frame)
        if extended:
            self._lazy_frame = base + _BASIC_BYTES
            if (self.is_chained and self._is_saved) or not self.floating_control & _FPCCR_LSPEN:
                self._save_floating_point()
        return None

    def _entry_cycles(self, *, saves: bool) -> int:
        if self.is_chained:  # the return has counted it
            return 0 if self._is_saved or not saves else self._profile.fp_frame
        return self._profile.exception_entry + (self._profile.fp_frame if saves else 0)

    def _return_cycles(self, *, restores: bool) -> int:
        """Count what a return takes, to the code that was interrupted or to the handler that follows at once."""
        chain = self._profile.tail_chain
        waiting = chain is not None and self._nvic.pending and self._nvic.next_exception(ceiling=self.ceiling())
        if chain is not None and waiting:
            self.is_chained, self._is_saved = True, restores
            return chain
        return self._profile.exception_return + (self._profile.fp_frame if restores else 0)

    def leave(self, exc_return: int, place: int) -> Fault | None:
        """Return from the exception being handled.

        Parameters
        ----------
        exc_return : int
            The EXC_RETURN value that was branched to; bit 0 does not matter.
        place : int
            Address of the branch.

        Returns
        -------
        Fault or None
            Why it is no return (nothing has changed then), or why what it returns to cannot run.
        """
        exc_return |= 1
        to_thread = exc_return & 0x08 != 0
        uses_psp = exc_return & 0x04 != 0
        extended = exc_return & 0x10 == 0
        registers = self._registers
        msp, psp, control, faultmask = registers.returning.read()
        base = psp if uses_psp else msp
        size = _EXTENDED_BYTES if extended else _BASIC_BYTES
        if not self._nvic.active:  # no return then, but a jump to where nothing may be executed
            return Fault(FaultKind.EXECUTE_NEVER, f"EXC_RETURN 0x{exc_return:08x} where no exception is active", place)
        if not self._may_return(exc_return, to_thread=to_thread):
            return Fault(FaultKind.INVALID_RETURN, f"EXC_RETURN 0x{exc_return:08x} fits no active exception", place)
        if not self._memory.holds_stack(base, size):
            return Fault(FaultKind.UNSTACKING, f"no RAM with a stack frame at 0x{base:08x}", place)
        frame = list(self._memory.read_words(base, 8))
        if (frame[7] & _EXCEPTION_NUMBER == 0) != to_thread:
            return Fault(FaultKind.INVALID_RETURN, f"stacked xPSR 0x{frame[7]:08x} is of another mode", place)
        if uses_psp:
            self.stacks.handler_ends()
        restores = extended and self._lazy_frame == _NO_FRAME
        if extended:  # a frame of the basic size says nothing about the state that waits to be saved
            if restores:
                registers.floating_frame.write(self._memory.read_words(base + _BASIC_BYTES, 17))
            self._lazy_frame = _NO_FRAME
        if faultmask and self._nvic.active[-1] != NMI:
            registers.faultmask.set(0)
        self._nvic.leave()
        end = base + size + (4 if frame[7] & _XPSR_REALIGNED else 0)
        frame[6] |= 1
        frame[7] &= ~_XPSR_REALIGNED
        control = control & _CONTROL_NPRIV | (_CONTROL_SPSEL if uses_psp else 0) | (_CONTROL_FPCA if extended else 0)
        registers.resumed.write([0, frame[7], control, end, *frame])
        is_thumb = frame[7] & _THUMB != 0
        cycles = self._return_cycles(restores=restores) if is_thumb else 0
        if self.follower is not None and self.follower.listens:
            self.follower.left(base | (uses_psp and ON_PROCESS_STACK) | (to_thread and OF_THREAD), cycles)
        self._spend(cycles)
        if not is_thumb:
            return Fault(FaultKind.INVALID_STATE, f"stacked xPSR 0x{frame[7]:08x} has no Thumb bit", frame[6] & ~1)
        return None

    def _may_return(self, exc_return: int, *, to_thread: bool) -> bool:
        active = len(self._nvic.active)
        if exc_return not in _RETURNS:
            return False
        return (active == 1 or self.base_thread_enabled) if to_thread else active > 1
