"""Counting by block in C: the same numbers as `BlockAccounting`, from block_hook.c."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import ClassVar

from unicorn.unicorn_py3.unicorn import uclib

from hiltest.virtual.accounting import CodeHook
from hiltest.virtual.blocks import BLOCKS_KEPT, Block, ReadCode, conditions_at, priced_block
from hiltest.virtual.instructions import Instruction
from hiltest.virtual.native import library as native
from hiltest.virtual.registers import register_number
from hiltest.virtual.timing import NEUTRAL, PipelineState, TimingProfile

_PLACES = 4096  # of the table at first: the shipped firmware has about a thousand blocks
_NEVER = (1 << 63) - 1
_CYCLES, _INSTRUCTIONS, _DEADLINE, _RUNNING = range(4)  # words at the start of the counter


def _kept(instructions: Sequence[Instruction]) -> int:
    """Find the registers r0 to r12 that stay multiples of four: not written, or moved by whole words."""
    kept = 0x1FFF
    for instruction in instructions:
        moved = sum(1 << written for written, source in instruction.derived if written == source)
        kept &= ~instruction.core_writes | moved
    return kept


@lru_cache(maxsize=BLOCKS_KEPT)
def _reasons_and_registers(
    profile: TimingProfile, address: int, code: bytes, entry: PipelineState, conditions: int = 0
) -> tuple[Block, int, int, int]:
    """Price a block, and say what of it the hook must know beside the numbers: reasons, aligned, kept."""
    block = priced_block(profile, address, code, entry, conditions)
    reasons = (
        (native.USES_FPU if block.uses_fpu else 0)
        | (native.ALIGNMENT_INSIDE if block.alignment.inside else 0)
        | (native.CHANGES_MASKS if block.changes_masks or block.sends_event else 0)
        | (native.LOOPS_TO_ITSELF if block.loops_to_itself else 0)
    )
    aligned = sum(1 << register for register in block.alignment.registers)
    return block, reasons, aligned, _kept(block.instructions)


class NativeBlockAccounting:
    """Counts by translated block, in C.

    Parameters
    ----------
    profile, read_code, attend, stop
        As for `BlockAccounting`; `stop` is not called, `stopped` says so instead.
    """

    per_instruction: ClassVar[bool] = False

    def __init__(
        self, profile: TimingProfile, read_code: ReadCode, attend: Callable[[Block], bool], stop: Callable[[], None]
    ) -> None:
        self.stopped = False
        self._profile = profile
        self._read_code = read_code
        self._attend = attend
        self._abort: Callable[[BaseException], None] = lambda _error: stop()
        self._library = native.library()
        self._states = [NEUTRAL]
        self._state_numbers = {NEUTRAL: native.NEUTRAL_NUMBER}
        self._counter = native.Counter(
            running_number=-1, reasons=0xFFFFFFFF,
            registers=tuple(register_number(f"R{number}") for number in range(native.CORE_REGISTERS)),
            stop=ctypes.cast(uclib.uc_emu_stop, ctypes.c_void_p),
            read_register=ctypes.cast(uclib.uc_reg_read, ctypes.c_void_p),
            price=native.PRICE(self._on_price), attend=native.ATTEND(self._on_attend),
        )  # fmt: skip
        self._address = ctypes.addressof(self._counter)
        self._words = memoryview(self._counter).cast("B").cast("q")
        self._settle = self._library.hiltest_settle
        self.forget_code()

    # -- totals, which the hook writes --------------------------------------------------------

    @property
    def cycles(self) -> int:
        """Clock cycles of all blocks that have ended."""
        return self._words[_CYCLES]

    @cycles.setter
    def cycles(self, value: int) -> None:
        self._words[_CYCLES] = value

    @property
    def instructions(self) -> int:
        """Instructions of all blocks that have ended."""
        return self._words[_INSTRUCTIONS]

    @instructions.setter
    def instructions(self, value: int) -> None:
        self._words[_INSTRUCTIONS] = value

    @property
    def deadline(self) -> float:
        """When to stop [cycles]."""
        return self._words[_DEADLINE]

    @deadline.setter
    def deadline(self, value: float) -> None:
        # Totals are whole cycles: they reach a fraction when they reach the next whole one.
        self._words[_DEADLINE] = _NEVER if value >= _NEVER else math.ceil(value)

    # -- called by the emulator ---------------------------------------------------------------

    def hook(self, outside: int, abort: Callable[[BaseException], None]) -> CodeHook:
        """Return the function in C and the counter that it is to be given."""
        self._abort = abort
        self._counter.outside = outside
        return CodeHook(self._library.hiltest_block_begins, ctypes.c_void_p(self._address))

    def _on_price(self, address: int, size: int, state: int) -> int:
        try:
            self._add(address, self._read_code(address, size), state)
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._abort(error)
            return 0
        return 1

    def _on_attend(self, number: int) -> int:
        try:
            return self._attend(self._blocks[number])
        except BaseException as error:  # as above
            self._abort(error)
            return 0

    # -- the table of blocks ------------------------------------------------------------------

    def _add(self, address: int, code: bytes, state: int) -> None:
        self._priced_code[address, len(code)] = code
        known = self._profile, address, code, self._states[state]
        priced_alike = _reasons_and_registers(*known)
        if conditions := conditions_at(address, priced_alike[0], self._read_code):
            priced_alike = _reasons_and_registers(*known, conditions)
        block, reasons, aligned, kept = priced_alike
        self._blocks.append(block)
        priced = native.PricedBlock(
            address, len(code), state, self._number(block.exit_state), block.count, block.through, block.taken,
            reasons, aligned, kept, len(self._blocks) - 1,
        )  # fmt: skip
        self._priced.append(priced)
        if 2 * len(self._priced) > len(self._table):
            self._spread(2 * len(self._table))
        else:
            self._library.hiltest_add_block(self._address, ctypes.addressof(priced))

    def _number(self, state: PipelineState) -> int:
        number = self._state_numbers.setdefault(state, len(self._states))
        if number == len(self._states):
            self._states.append(state)
        return number

    def _spread(self, places: int) -> None:
        """Put every block into a table of that many places."""
        self._table = (native.PricedBlock * places)()
        self._counter.table = ctypes.addressof(self._table)
        self._counter.places_mask = places - 1
        for priced in self._priced:
            self._library.hiltest_add_block(self._address, ctypes.addressof(priced))

    def translated(self, address: int, size: int) -> None:
        """Take note that the emulator has translated a block; not for the first time where it was written to."""
        priced = self._priced_code.get((address, size))
        if priced is not None and priced != self._read_code(address, size):
            self.forget_code()

    def forget_code(self) -> None:
        """Drop cached blocks, but not the one whose end is still to be counted."""
        running = self._running
        self._blocks: list[Block] = []
        self._priced: list[native.PricedBlock] = []
        self._priced_code: dict[tuple[int, int], bytes] = {}
        if running is not None:
            self._blocks.append(running)
            self._words[_RUNNING] = 0
            self._last = native.PricedBlock.from_buffer_copy(native.PricedBlock.from_address(self._counter.running))
            self._counter.running = ctypes.addressof(self._last)
        self._spread(_PLACES)

    # -- where execution is -------------------------------------------------------------------

    @property
    def _running(self) -> Block | None:
        number = self._words[_RUNNING]
        return None if number < 0 else self._blocks[number]

    @property
    def jumped_from(self) -> int | None:
        """Address of the last instruction of the block that runs."""
        block = self._running
        return None if block is None else block.instructions[-1].address

    def now(self, pc: int) -> int:
        """Virtual time [cycles] at the start of the instruction at `pc`."""
        block = self._running
        return self.cycles if block is None else self.cycles + block.cycles_before(pc, self._profile)

    def instructions_now(self, pc: int) -> int:
        """Instructions before the one at `pc`."""
        block = self._running
        running = () if block is None else block.instructions
        return self.instructions + sum(1 for instruction in running if instruction.address < pc & ~1)

    def settle(self, pc: int) -> None:
        """Add the block that just ended; `pc` is where execution goes on."""
        self.stopped = bool(self._settle(self._address, pc & ~1))

    def begins(self, address: int, size: int) -> None:
        """Take note that a block is about to run; the emulator calls the hook itself."""
        self._library.hiltest_block_begins(None, address, size, self._address)

    def flush_pipeline(self) -> None:
        """An exception was entered or left: nothing overlaps across it."""
        self._counter.state = native.NEUTRAL_NUMBER
