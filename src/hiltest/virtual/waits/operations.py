"""What Thumb instructions do to the values of a turn; those that are not here end the proof."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence

from hiltest.virtual.instructions import disassemble
from hiltest.virtual.waits import intervals as of
from hiltest.virtual.waits.data_operations import (
    EXTENSIONS,
    LOGIC,
    SHIFTS,
    TESTS,
    address_operation,
    arithmetic_operation,
    logic_operation,
    shift_operation,
    sum_operation,
)
from hiltest.virtual.waits.decoded import LINK_REGISTER, DecodedInstruction, Operation
from hiltest.virtual.waits.intervals import Value
from hiltest.virtual.waits.memory_operations import (
    LOADS,
    STORES,
    load_operation,
    multiple_operation,
    pair_operation,
    store_operation,
)
from hiltest.virtual.waits.state import NotProvable, NotUniform, TurnState

_NOTHING = {"nop", "dsb", "dmb", "isb", "it"}
_MASKS = {"i": "primask", "f": "faultmask"}


def compiled(
    address: int, code: bytes, *, transfers: bool, jumps: bool, goes_to: int
) -> list[tuple[int, Operation]]:
    """Return what a block of code does, instruction by instruction with its address.

    Parameters
    ----------
    address, code
        The block.
    transfers, jumps : bool
        Whether its last instruction is a transfer of control, and whether it jumps away in the turn.
    goes_to : int
        Where the next block begins.

    Raises
    ------
    NotProvable
        It has an instruction that cannot be followed.
    """
    raw = list(disassemble(address, code))
    if sum(each.size for each in raw) != len(code):
        raise NotProvable
    end = address + len(code)
    return [
        (each.address, _operation(DecodedInstruction(
            each, transfers=transfers and each.address + each.size == end, jumps=jumps, goes_to=goes_to
        )))
        for each in raw
    ]  # fmt: skip


def _operation(this: DecodedInstruction) -> Operation:
    for kinds, make in _MAKERS:
        if this.name in kinds:
            operation = make(this)
            break
    else:
        raise NotProvable
    condition = this.condition
    if condition is None or this.name == "b":
        return operation
    must_run = this.transfers and this.jumps

    def conditional(state: TurnState) -> None:
        if condition(state):
            operation(state)
        elif must_run:
            raise NotUniform

    return conditional


# -- transfers of control, and masks ------------------------------------------------------------


def _nothing(_this: DecodedInstruction) -> Operation:
    return lambda _state: None


def _branch(this: DecodedInstruction) -> Operation:
    condition, jumps = this.condition, this.jumps

    def run(state: TurnState) -> None:
        if (condition is None or condition(state)) != jumps:
            raise NotUniform

    return run


def _compare_and_branch(this: DecodedInstruction) -> Operation:
    read, jumps, on_zero = this.operand(0), this.jumps, this.name == "cbz"

    def run(state: TurnState) -> None:
        if (state.is_true(of.zero(read(state))) == on_zero) != jumps:
            raise NotUniform

    return run


def _call(this: DecodedInstruction) -> Operation:
    behind = Value(this.end | 1)
    if this.name == "bl":
        return lambda state: state.set(LINK_REGISTER, behind)
    read, links = this.operand(0), this.name == "blx"

    def run(state: TurnState) -> None:
        target = read(state)
        if links:
            state.set(LINK_REGISTER, behind)
        this.go(target)

    return run


def _mask(this: DecodedInstruction) -> Operation:
    """CPSID, CPSIE; MRS and MSR of PRIMASK, BASEPRI and FAULTMASK."""
    if this.name == "cps":
        if this.text not in _MASKS:
            raise NotProvable
        switched, value = _MASKS[this.text], Value(int(this.mnemonic.startswith("cpsid")))
        return lambda state: state.set(switched, value)
    names = this.text.split(", ")
    names.remove(names[0 if this.name == "mrs" else 1])
    (mask,) = names
    if mask not in ("primask", "basepri", "faultmask"):
        raise NotProvable
    if this.name == "mrs":
        write = this.writer()
        return lambda state: write(state, state.get(mask))
    read, bits = this.operand(1), Value(0xF0 if mask == "basepri" else 1)
    return lambda state: state.set(mask, of.conjunction(read(state), bits))


_MAKERS: Sequence[tuple[Container[str], Callable[[DecodedInstruction], Operation]]] = (
    (LOADS, load_operation), (STORES, store_operation), (LOGIC, logic_operation),
    ({*TESTS, "mov", "movw", "mvn"}, logic_operation),
    ({"add", "addw", "sub", "subw", "rsb", "cmp", "cmn"}, sum_operation), (SHIFTS, shift_operation),
    ({*EXTENSIONS, "ubfx", "sbfx", "movt", "mul", "mla", "udiv"}, arithmetic_operation), ({"b"}, _branch),
    ({"cbz", "cbnz"}, _compare_and_branch), ({"bl", "bx", "blx"}, _call), (_NOTHING, _nothing),
    ({"push", "pop", "ldm", "stm", "ldmdb", "stmdb"}, multiple_operation), ({"ldrd", "strd"}, pair_operation),
    ({"adr"}, address_operation), ({"cps", "mrs", "msr"}, _mask),
)  # fmt: skip
