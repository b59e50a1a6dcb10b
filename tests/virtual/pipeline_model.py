"""What one instruction leaves for the next: the state of the pipeline, and the rules of fetching and of addresses.

The rules are priced by rows that a profile may have or not (`RULES` of `profile_file`); without them
only what `price_model` says is remembered. They are:

* an address that the data-processing instruction right before made is late, and one that VMOV brought from the FPU;
* IT behind a 16-bit instruction is folded onto it;
* a taken branch to four bytes that do not begin at a multiple of four fetches twice;
* behind an instruction that occupies the core for two cycles or more, or a floating-point one, the third of three
  instructions on end of four bytes each, none at a multiple of four, finds its second half not fetched. Whether an
  integer instruction of one cycle begins that, too, is a row of its own. So is whether a load or store of one cycle
  does; with that row a run goes on where an instruction of two cycles or more is among the three.

Two rows are candidates of `hiltest.virtual.silicon` alone: ``misplaced_on_end`` says that it is another one of
such instructions on end, and ``late_past_narrow`` that an instruction of two bytes does not end the run of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from .capstone_oracle import Instruction

_ON_END = 3  # misplaced instructions until the fetch is late
MULTIPLIES = ("multiply", "multiply_accumulate", "multiply_long", "accumulate_long")
_MAKES_RESULTS = ("data", "divide", *MULTIPLIES)
_ACCESSES = ("load", "store", "store_register_offset")


class Reached(IntEnum):
    """How execution came to an instruction, where that is no matter of the code before it."""

    ANYHOW = 0
    BY_BRANCH = 1
    """The target stood in the instruction."""
    BY_REGISTER = 2
    PAST_BRANCH = 3
    """Behind a branch of two bytes that was not taken."""


class Late(IntEnum):
    """What may make the fetch late."""

    NOTHING = 0
    SLOW = 1
    """The core was occupied for two cycles or more."""
    FLOATING_POINT = 2
    INTEGER = 3
    ACCESS = 4


class PipelineState(NamedTuple):
    """State of the pipeline that the next instruction may wait for.

    ``before`` is "load", "store" or ""; ``loaded`` the core registers that load
    wrote; ``fp_result`` the single registers that were just computed, or will be
    when the FPU is free; ``fpu_busy`` the cycles until it is, and ``divided`` the
    registers that hold a division's result one cycle after that. ``computed`` are
    the core registers that the instruction before computed; ``narrow`` says that it
    had two bytes; ``late`` what may make the fetch late, and ``misplaced`` how many
    of four bytes, not at a multiple of four, were on end since. ``stepped`` is the base
    that the load before moved, and ``computed_by_fpu`` says that VMOV computed ``computed``.
    """

    before: str = ""
    loaded: int = 0
    fp_result: int = 0
    fpu_busy: int = 0
    divided: int = 0
    computed: int = 0
    narrow: bool = False
    late: Late = Late.NOTHING
    misplaced: int = 0
    reached: Reached = Reached.ANYHOW
    stepped: int = 0
    computed_by_fpu: bool = False


NEUTRAL = PipelineState()
#: Left by what no code before decides, by `Reached`.
REACHED = (
    NEUTRAL,
    PipelineState(reached=Reached.BY_BRANCH),
    PipelineState(reached=Reached.BY_REGISTER),
    PipelineState(narrow=True),
)


class Rules:
    """Rules of fetching and of addresses, by the rows of a profile.

    Parameters
    ----------
    value : mapping of str to int
        Values of the rows.
    """

    def __init__(self, value: Mapping[str, int]) -> None:
        self._address_use = value.get("address_use", 0), value.get("address_use_fp", 0)
        self._begins_by_access = bool(value.get("fetch_late_access", 0))
        self._unbroken = bool(value.get("fetch_late_unbroken", 0))
        self._folds = "it_folded" in value
        rows = ("", "fetch_late", "fetch_late_fp", "fetch_late_integer", "fetch_late_access")
        self._late = tuple(value.get(row, 0) for row in rows)
        self._reached = (0, value.get("target_misplaced", 0), value.get("return_misplaced", 0), 0)
        self._on_end = value.get("misplaced_on_end", _ON_END)
        self._past_narrow = bool(value.get("late_past_narrow", 0))

    def waits(self, instruction: Instruction, state: PipelineState) -> tuple[int, int]:
        """Return the cycles that an instruction waits for its address and for being fetched."""
        late_use = self._address_use[state.computed_by_fpu]
        address = late_use if state.computed & instruction.address_registers else 0
        if not instruction.misplaced:
            return address, 0
        late = self._late[state.late] if state.misplaced == self._on_end - 1 else 0
        return address, self._reached[state.reached] + late

    def folds(self, instruction: Instruction, state: PipelineState) -> bool:
        """Whether an instruction is an IT that is folded onto the one before it: it takes no time by itself."""
        return self._folds and state.narrow and instruction.row == "it"

    def leave(self, instruction: Instruction, state: PipelineState, cycles: int, left: PipelineState) -> PipelineState:
        """Return what an instruction leaves, where execution goes on behind it.

        Parameters
        ----------
        instruction : Instruction
        state : PipelineState
            What it found.
        cycles : int
            How long it occupied the core, what it waited for the fetch not included.
        left : PipelineState
            What it leaves without these rules.
        """
        if instruction.transfer:
            return REACHED[Reached.PAST_BRANCH if instruction.size == 2 else Reached.ANYHOW]
        late, misplaced = self._fetch_behind(instruction, state, cycles)
        by_fpu = instruction.moves_from_fpu
        makes = by_fpu or instruction.row in _MAKES_RESULTS
        computed = instruction.core_writes if makes and self._address_use[by_fpu] else 0
        return left._replace(
            computed=computed,
            narrow=self._folds and instruction.size == 2,
            late=late,
            misplaced=misplaced,
            computed_by_fpu=bool(computed) and by_fpu,
        )

    def _fetch_behind(self, instruction: Instruction, state: PipelineState, cycles: int) -> tuple[Late, int]:
        late, misplaced = state.late, state.misplaced + 1
        if not instruction.misplaced or misplaced >= self._on_end:
            late = Late.NOTHING
        if cycles >= 2 and not (late and self._unbroken):
            return Late.SLOW, 0
        if not late and self._begins_by_access and instruction.row in _ACCESSES:
            return Late.ACCESS, 0
        if not late and (instruction.uses_fpu or self._late[Late.INTEGER]):
            return Late.FLOATING_POINT if instruction.uses_fpu else Late.INTEGER, 0
        if not late and self._past_narrow and instruction.size == 2:
            return state.late, state.misplaced
        return (late, misplaced) if late else (Late.NOTHING, 0)
