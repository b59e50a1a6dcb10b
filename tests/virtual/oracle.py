"""The cycle model in Python as an oracle: a program executes one instruction at a time, and each is priced again.

The core executes and says where execution goes on; `PriceModel.step` prices what capstone decodes there, executed or
skipped, and the rows of the profile price exceptions. After each instruction both must have counted the same cycles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.calling import CallResult
from hiltest.virtual.core.library import lib
from hiltest.virtual.core.machine import NEVER
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE
from hiltest.virtual.model.timing import TimingProfile
from hiltest.virtual.processor import cpu

from .capstone_oracle import Instruction, decode
from .pipeline_model import NEUTRAL, REACHED, PipelineState
from .price_model import PriceModel

_ALWAYS = 14
_FLOATING_POINT_ACTIVE = 1 << 2  # CONTROL.FPCA
_STACKS_STATE, _SAVES_LAZILY = 1 << 31, 1 << 30  # FPCCR.ASPEN and LSPEN
_PC = 15


class Step(NamedTuple):
    """An instruction that execution comes to.

    Attributes
    ----------
    executes : bool
        Whether no IT block skips it.
    jumps : bool
        Whether it is a transfer that is taken.
    """

    instruction: Instruction
    executes: bool
    jumps: bool

    def priced(self, model: PriceModel, state: PipelineState) -> tuple[int, PipelineState]:
        """Return its cycles behind a state of the pipeline, and the state that it leaves."""
        skipped = not self.executes and model.prices_skipped
        cycles, remainder = model.step(self.instruction.skipped() if skipped else self.instruction, state)
        if not self.jumps:
            return cycles, remainder
        return cycles + model.taken(self.instruction), REACHED[model.reached(self.instruction)]


def priced(steps: Iterable[Step], profile: TimingProfile) -> int:
    """Return the cycles of steps without exceptions, the first of which finds an empty pipeline."""
    total, state, model = 0, NEUTRAL, PriceModel(profile)
    for step in steps:
        cycles, state = step.priced(model, state)
        total += cycles
    return total


def holds(condition: int, flags: int) -> bool:
    """Whether a condition holds; N, Z, C and V are bits 31 to 28 of `flags` (DDI 0403E, A7.3)."""
    negative, zero, carry, overflow = (bool(flags >> bit & 1) for bit in (31, 30, 29, 28))
    result = (
        zero,
        carry,
        negative,
        overflow,
        carry and not zero,
        negative == overflow,
        negative == overflow and not zero,
        True,
    )[condition >> 1]
    return result if condition >= _ALWAYS else result != bool(condition & 1)


def is_taken(code: bytes, flags: int, registers: Sequence[int]) -> bool:
    """Whether a transfer that is executed is taken, by its own condition if it has one."""
    first, second = (int.from_bytes(code[at : at + 2], "little") for at in (0, 2))
    if first >> 12 == 0b1101:  # B<c>, two bytes
        return holds(first >> 8 & 15, flags)
    if first & 0xF500 == 0xB100:  # CBZ, CBNZ
        return bool(registers[first & 7]) == bool(first >> 11 & 1)
    if first >> 11 == 0b11110 and second >> 14 == 0b10 and not second >> 12 & 1 and first >> 7 & 7 != 7:
        return holds(first >> 6 & 15, flags)  # B<c>, four bytes
    return True


@cache
def _decoded(address: int, code: bytes, in_it_block: bool) -> Instruction:
    return decode(address, code, int(in_it_block))[0]


class Oracle:
    """Stands between a board's processor and the core's library, see `watched`.

    Parameters
    ----------
    board : VirtualK64F

    Attributes
    ----------
    cycles : int
        Cycles since power-on as the model counts them: without sleep, and without what the core waited for memories.
    tell : callable
        Told each step that is over.
    """

    def __init__(self, board: VirtualK64F) -> None:
        self._processor = board.processor
        self._core: Any = board.processor.core
        self._handle = board.processor.machine.handle
        self._model = PriceModel(board.processor.profile)
        self._state: PipelineState = NEUTRAL
        self.cycles = self._counted
        self.tell: Callable[[Step], None] = lambda _step: None

    def __getattr__(self, name: str) -> Any:
        return getattr(lib, name)

    @property
    def _counted(self) -> int:
        cycles: int = self._core.cycles - self._core.idle_cycles - self._core.memory_cycles
        return cycles

    # -- functions of the library that cost time or empty the pipeline ------------------------

    def machine_run(self, handle: Any) -> int:
        """Execute instruction by instruction until there is another reason to stop."""
        assert handle == self._handle, "one board is watched at a time"
        while True:
            reason = self._step()
            if reason != lib.STOP_STEP:
                return reason

    def machine_deliver_fault(self, handle: Any) -> int:
        """Price the entries of fault handlers: more than one if an entry fails."""
        active, entry = self._core.active_count, self._entry()
        exception: int = lib.machine_deliver_fault(handle)
        entries = self._core.active_count - active
        if entries:
            self.cycles += entry + (entries - 1) * self._model.exception_entry
        self._state = NEUTRAL
        self._compare("the delivery of a fault")
        return exception

    def machine_save_floats(self, handle: Any) -> None:
        """Price floating-point state that is saved."""
        self.cycles += self._model.fp_frame if self._core.lazy_frame else 0
        lib.machine_save_floats(handle)

    def machine_flush_pipeline(self, handle: Any) -> None:
        """Empty the pipeline."""
        self._state = NEUTRAL
        lib.machine_flush_pipeline(handle)

    def machine_reset(self, handle: Any) -> None:
        """Empty the pipeline."""
        self._state = NEUTRAL
        lib.machine_reset(handle)

    # -- steps --------------------------------------------------------------------------------

    def _step(self) -> int:
        """Enter an exception if one is due, then execute one instruction, and nothing behind it."""
        reason = self._enter()
        if reason != lib.STOP_STEP:
            return reason
        core, deadline = self._core, self._core.deadline
        step, entry = self._next(), self._entry()
        lazily, active, instructions = core.lazy_frame != 0, core.active_count, core.instructions
        core.instruction_limit = instructions + 1
        core.deadline = soon = core.cycles + 1
        reason = self._run()
        if core.deadline == soon:  # nobody asked to look at once; an event may have come into the calendar
            core.deadline = min(deadline, ceil(min(self._processor.schedule.next_cycle, NEVER)))
            reason = lib.STOP_STEP if reason == lib.STOP_DEADLINE else reason
        if core.instructions == instructions + 1:
            assert step
            cycles = self._price(step, lazily=lazily, returns=core.active_count < active)
            if not cycles and core.active_count > active:  # behind an instruction without time of its own
                self._enters(entry)
        elif lazily and not core.lazy_frame:  # it saved the state, and then faulted
            self.cycles += self._model.fp_frame
        if reason == lib.STOP_FAULT:
            self._state = NEUTRAL
        if self._counted != self.cycles:
            self._compare(f"{step}")
        return reason

    def _enter(self) -> int:
        """Have the core do what comes before an instruction; STOP_STEP if that is next."""
        core = self._core
        entry, active = self._entry(), core.active_count
        core.instruction_limit = core.instructions
        reason = self._run()
        if core.active_count > active:
            self._enters(entry)
            self._compare("the entry of an exception")
        return reason

    def _run(self) -> int:
        reason: int = lib.machine_run(self._handle)
        self._core.instruction_limit = NEVER
        return reason

    def _compare(self, last: str) -> None:
        assert self._counted == self.cycles, f"the core counts {self._counted - self.cycles:+d} cycles: {last}"

    def _next_exception(self) -> int:
        exception: int = lib.machine_next_exception(self._handle, lib.machine_ceiling(self._handle, False))
        return exception

    def _entry(self) -> int:
        """Price the entry of an exception, if one came now; behind a return it was priced there (tail chaining)."""
        core, model = self._core, self._model
        extended = core.control & _FLOATING_POINT_ACTIVE and core.floating_control & _STACKS_STATE
        chained, saved = core.is_chained, core.is_chained and core.is_saved
        lazily = bool(extended and core.floating_control & _SAVES_LAZILY and not saved)
        saving = model.fp_frame if extended and not lazily and not saved else 0
        return saving + (0 if chained else model.exception_entry)

    def _enters(self, cycles: int) -> None:
        self.cycles += cycles
        self._state = NEUTRAL

    def _next(self) -> Step | None:
        """Look at the next instruction; None if no memory is there."""
        address, it_state = self._core.r[_PC], self._core.it_state
        code = self._code(address)
        if not code:
            return None
        predicated = bool(it_state & 15)
        instruction = _decoded(address, code, predicated)
        if not predicated and not instruction.transfer:
            return Step(instruction, executes=True, jumps=False)
        flags = lib.machine_xpsr(self._handle)
        executes = not predicated or holds(it_state >> 4, flags)
        selected = executes and bool(instruction.transfer) and is_taken(code, flags, self._core.r)
        return Step(instruction, executes, selected)

    def _code(self, address: int) -> bytes:
        """Return the four bytes at an address, or two at the end of a memory; none if there is no memory."""
        for size in (4, 2):
            with suppress(ValueError):
                return self._processor.memory.read(address, size)
        return b""

    # -- prices -------------------------------------------------------------------------------

    def _price(self, step: Step, *, lazily: bool, returns: bool) -> int:
        """Price what was executed or skipped; return its own cycles."""
        cycles, self._state = step.priced(self._model, self._state)
        saves = lazily and step.executes and step.instruction.uses_fpu
        self.cycles += cycles + (self._model.fp_frame if saves else 0)
        if returns:
            self._return(lazily=lazily)
        self.tell(step)
        return cycles

    def _return(self, *, lazily: bool) -> None:
        """Price a return from an exception, to what was interrupted or to the handler that follows at once."""
        model = self._model
        self._state = NEUTRAL
        restores = bool(self._core.control & _FLOATING_POINT_ACTIVE) and not lazily
        if model.tail_chain is not None and self._next_exception():
            self.cycles += model.tail_chain
        else:
            self.cycles += model.exception_return + (model.fp_frame if restores else 0)


@contextmanager
def watched(board: VirtualK64F) -> Iterator[Oracle]:
    """Have a board execute one instruction at a time, each of them priced by the model in Python as well."""
    oracle = Oracle(board)
    with mock.patch.object(cpu, "lib", oracle):
        yield oracle


# -- a program executed at once, and step by step ---------------------------------------------


def state(board: VirtualK64F) -> dict[str, object]:
    """Return all that a mistake in executing or counting can show in."""
    processor = board.processor
    return {
        "cycles": board.cycles,
        "instructions": board.instructions,
        "asleep": processor.idle_cycles,
        "registers": processor.registers.snapshot(),
        "RAM": [bytes(memory.view) for memory in processor.memory._ram],
        "readings": [
            (reading.core_cycles, reading.instructions) for reading in board.cycle_counter.readings if reading
        ],
        "events": [str(event) for event in board.events],
        "position": board.position(),
        "faults": [(entry.exception, str(entry.fault), entry.cycle) for entry in board.faults],
    }


def acted(
    firmware: Path | bytes,
    act: Callable[[VirtualK64F], Any],
    profile: str | TimingProfile = DEFAULT_PROFILE,
    *,
    tell: Callable[[Step], None] | None = None,
    **options: Any,
) -> tuple[VirtualK64F, Any]:
    """Do the same with two boards, of which one steps, and compare; return the other board and what came of it.

    A BoardFault is what came of it, too. `tell` is told each step.
    """
    boards = [VirtualK64F(firmware, profile=profile, **options) for _ in range(2)]
    result = _result(act, boards[0])
    with watched(boards[1]) as oracle:
        oracle.tell = tell or oracle.tell
        step_by_step = _result(act, boards[1])
    assert str(step_by_step) == str(result)
    states = [state(board) for board in boards]
    for name, value in states[0].items():
        assert states[1][name] == value, f"{name}, executed at once and step by step"
    return boards[0], result


def _result(act: Callable[[VirtualK64F], Any], board: VirtualK64F) -> Any:
    try:
        return act(board)
    except BoardFault as fault:
        return fault


def stepped(
    firmware: Path | bytes, function: str, *arguments: Any, profile: str | TimingProfile = DEFAULT_PROFILE
) -> tuple[CallResult, list[Step]]:
    """Call a function, at once and step by step, and compare; return also what it executes."""
    steps: list[Step] = []
    _, result = acted(firmware, lambda board: board.call(function, *arguments), profile, tell=steps.append)
    assert isinstance(result, CallResult), result
    return result, steps


def called(
    firmware: Path | bytes, function: str, *arguments: Any, profile: str | TimingProfile = DEFAULT_PROFILE
) -> CallResult:
    """Call a function, at once and step by step, and compare."""
    return stepped(firmware, function, *arguments, profile=profile)[0]


def ran(
    firmware: Path | bytes, until_s: float, profile: str | TimingProfile = DEFAULT_PROFILE, **options: Any
) -> VirtualK64F:
    """Run firmware until a virtual time, at once and step by step, and compare; a fault is raised."""
    board, fault = acted(firmware, lambda board: board.run_until(until_s), profile, **options)
    if fault is not None:
        raise fault
    return board
