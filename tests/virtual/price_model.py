"""The cycle model in Python, which the core in C is compared with: a versioned table and four rules.

The table (``profiles/*.toml``) holds a value, an uncertainty range (`band`) and a source for every
row. The rules say what one instruction does to the next:

* a load whose address does not come from the load right before it overlaps it; a row may say that two loads which
  move the same base do not;
* a store with an immediate offset hides in the second cycle of a load right
  before it, and a load right behind a single store waits;
* a floating-point instruction waits one cycle for the result of the arithmetic
  right before it (a multiply-accumulate does not wait for its addend);
* VDIV and VSQRT keep the FPU busy while integer instructions go on underneath; so does a
  multiply-accumulate, by as many of its cycles as the table says (none, until it is measured).

What is remembered between instructions is a `PipelineState`. Only a control
transfer resets it; then an unfinished division is waited for, which errs on
the dear side. Instructions inside an IT block are priced as if executed, but where a row prices those that are
skipped. A profile may have more rules, of `pipeline_model`.
"""

from __future__ import annotations

from hiltest.virtual.model.timing import TimingProfile

from .capstone_oracle import Instruction
from .pipeline_model import MULTIPLIES, NEUTRAL, Late, PipelineState, Reached, Rules

# Neither leaves a pipeline state nor, behind none, waits: most of all instructions, priced at once.
_LEAVES_NOTHING = frozenset(
    {"data", "divide", "it", "barrier", "system", "exclusive", "fp_load", "fp_store", "fp_move_pair", "it_skipped"}
    | set(MULTIPLIES)
)
# Rows of the rules that a profile may have, see `pipeline_model`.
RULE_ROWS = frozenset(
    {
        "address_use",
        "address_use_fp",
        "it_folded",
        "it_skipped",
        "target_misplaced",
        "return_misplaced",
        "fetch_late",
        "fetch_late_fp",
        "fetch_late_integer",
        "fetch_late_access",
        "fetch_late_unbroken",
    }
)
_OWN_REFILLS = {"table_branch": "refill_table", "load": "refill_load", "multiple_base": "refill_multiple"}
_LINK_REGISTER = 1 << 14
_SINGLE_TRANSFERS = {"load": "load", "store": "store", "store_register_offset": "store"}


class PriceModel:
    """Prices instructions by the rows of a profile.

    Parameters
    ----------
    profile : TimingProfile

    Attributes
    ----------
    prices_skipped : bool
        Whether what an IT block skips has a price of its own.
    """

    def __init__(self, profile: TimingProfile) -> None:
        self.rows = profile.rows
        self._value = {key: row.value for key, row in profile.rows.items()}
        for multiply in MULTIPLIES:
            self._value.setdefault(multiply, self._value["data"])
        self._rules = Rules(self._value) if self.rows.keys() & RULE_ROWS else None
        self.prices_skipped = "it_skipped" in self.rows
        self._hidden = min(self._value["fp_accumulate_hidden"], self._value["fp_accumulate"] - 1)
        self.exception_entry = self._value["exception_entry"]
        self.exception_return = self._value["exception_return"]
        self.tail_chain = self._value.get("tail_chain")
        self.fp_frame = self._value.get("fp_frame", 0)

    def step(self, instruction: Instruction, state: PipelineState) -> tuple[int, PipelineState]:
        """Price one instruction as if it does not transfer control.

        Parameters
        ----------
        instruction : Instruction
            What is executed.
        state : PipelineState
            What the instructions before it left behind.

        Returns
        -------
        cycles : int
            Its cost, waiting included.
        state : PipelineState
            What it leaves for the next.
        """
        rules = self._rules
        if rules is None:
            return self._step(instruction, state)
        if rules.folds(instruction, state):
            return self._value["it_folded"], state._replace(late=Late.NOTHING, misplaced=0)
        cycles, remainder = self._step(instruction, state)
        late, late_fetch = rules.waits(instruction, state)
        return cycles + late + late_fetch, rules.leave(instruction, state, cycles + late, remainder)

    def _step(self, instruction: Instruction, state: PipelineState) -> tuple[int, PipelineState]:
        """Price one instruction by the four rules."""
        value = self._value
        row = instruction.row
        if state is NEUTRAL and row in _LEAVES_NOTHING and not instruction.transfer:
            return value[row], NEUTRAL
        wait = self._fp_wait(instruction, state) if instruction.uses_fpu else 0
        if row == "multiple_base":
            cycles = value[row] + instruction.words
            if instruction.loads_multiple and state.before == "store":
                cycles += value.get("multiple_behind_store", 0)
        elif row == "fp_divide":
            cycles = 1  # it is issued; the FPU is busy from here on
        elif row == "fp_accumulate":
            cycles = value[row] - self._hidden
        elif row == "load":
            cycles = self._load(instruction, state)
        elif row == "store" and state.before == "load":
            cycles = value["store_behind_load"]
        else:
            cycles = value[row]
        cycles += wait
        if instruction.transfer:
            # The branch resets the pipeline; a division still running is waited for.
            return cycles + max(state.fpu_busy - cycles, 0), NEUTRAL
        return cycles, self._leave(instruction, state, cycles)

    def taken(self, instruction: Instruction) -> int:
        """Cycles added when a transfer is taken: the pipeline refills."""
        return self._value[self.refill_row(instruction)]

    def refill_row(self, instruction: Instruction) -> str:
        """Return the row that prices the refill when a transfer is taken."""
        if instruction.transfer == "direct":
            calls = instruction.core_writes & _LINK_REGISTER and "refill_call" in self._value
            return "refill_call" if calls else "refill_direct"
        own = _OWN_REFILLS.get(instruction.row, "")
        return own if own in self._value else "refill_indirect"

    def reached(self, instruction: Instruction) -> Reached:
        """Say how a transfer, when it is taken, comes to what it leads to, where that can matter."""
        if self._rules is None:
            return Reached.ANYHOW
        if instruction.transfer == "direct":
            # Nothing at a multiple of four is misplaced: one state less to price it from.
            return Reached.BY_BRANCH if instruction.target is None or instruction.target % 4 else Reached.ANYHOW
        return Reached.BY_REGISTER

    def reached_past(self, instruction: Instruction) -> Reached:
        """Say how execution comes to what is behind a transfer that is not taken."""
        if self._rules is None or instruction.size == 4:
            return Reached.ANYHOW
        return Reached.PAST_BRANCH

    def _load(self, instruction: Instruction, state: PipelineState) -> int:
        depends = state.loaded & instruction.address_registers or state.stepped & instruction.stepped_base
        if state.before == "load" and not depends:
            return self._value["load_behind_load"]
        late = self._value["load_behind_store"] if state.before == "store" else 0
        return self._value["load"] + late

    def _fp_wait(self, instruction: Instruction, state: PipelineState) -> int:
        if state.divided & (instruction.fp_reads | instruction.fp_addend):
            return state.fpu_busy + self._value["fp_divide_use"] - self._value["fp_divide"]
        return state.fpu_busy + (self._value["fp_use"] if state.fp_result & instruction.fp_reads else 0)

    def _leave(self, instruction: Instruction, state: PipelineState, cycles: int) -> PipelineState:
        row = instruction.row
        if row == "fp_divide":
            return PipelineState(fpu_busy=self._value["fp_divide"] - 1, divided=instruction.fp_writes)
        before = _SINGLE_TRANSFERS.get(row, "")
        loaded = instruction.loaded_registers if row == "load" else 0
        if instruction.uses_fpu:
            computed = instruction.fp_writes if row in ("fp", "fp_accumulate") else 0
            busy, divided = (self._hidden if row == "fp_accumulate" else 0), 0
        else:
            busy = max(state.fpu_busy - cycles, 0)
            # The result is a cycle later than the FPU: remember it for the instruction that meets it then.
            pending = 0 < state.fpu_busy >= cycles
            computed, divided = (state.fp_result, state.divided) if pending else (0, 0)
        stepped = instruction.stepped_base if self._value.get("load_same_base", 0) else 0
        if not (before or loaded or computed or busy or divided):
            return NEUTRAL
        return PipelineState(before, loaded, computed, busy, divided, stepped=stepped)
