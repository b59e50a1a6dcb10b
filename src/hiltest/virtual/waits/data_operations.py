"""What instructions on registers do to the values of a turn: sums, logic, shifts, products, and their flags."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from capstone import arm_const as arm

from hiltest.virtual.waits import intervals as of
from hiltest.virtual.waits.decoded import DecodedInstruction, Operation, shifted
from hiltest.virtual.waits.intervals import MASK, Value
from hiltest.virtual.waits.state import NotProvable, TurnState

EXTENSIONS = {"uxtb": (8, False), "uxth": (16, False), "sxtb": (8, True), "sxth": (16, True)}
SHIFTS = {"lsl": arm.ARM_SFT_LSL, "lsr": arm.ARM_SFT_LSR, "asr": arm.ARM_SFT_ASR}
LOGIC: dict[str, Callable[[Value, Value], Value]] = {
    "and": of.conjunction, "orr": of.disjunction, "eor": of.difference,
    "bic": lambda first, second: of.conjunction(first, _inverse(second)),
    "orn": lambda first, second: of.disjunction(first, _inverse(second)),
}  # fmt: skip
TESTS = {"tst": "and", "teq": "eor"}


def _inverse(value: Value) -> Value:
    return of.subtract(Value(MASK), value)


def _set_result(state: TurnState, value: Value) -> None:
    state.set("n", of.negative(value))
    state.set("z", of.zero(value))


def sum_operation(this: DecodedInstruction) -> Operation:
    """Return what ADD, SUB, RSB, CMP or CMN does."""
    compares = this.name in ("cmp", "cmn")
    first, second = this.operand(0 if compares or len(this.operands) == 2 else 1), this.operand(len(this.operands) - 1)
    if this.name == "rsb":
        first, second = second, first
    adds = this.name in ("add", "addw", "cmn")
    compute = of.add if adds else of.subtract
    carry, overflow = (
        (of.carry_of_sum, of.overflow_of_sum) if adds else (of.carry_of_difference, of.overflow_of_difference)
    )
    write = None if compares else this.writer()
    sets_flags = this.sets_flags

    def run(state: TurnState) -> None:
        one, other = first(state), second(state)
        result = compute(one, other)
        if sets_flags:
            _set_result(state, result)
            state.set("c", carry(one, other))
            state.set("v", overflow(one, other))
        if write is not None:
            write(state, result)

    return run


def logic_operation(this: DecodedInstruction) -> Operation:
    """Return what AND, ORR, EOR, BIC, ORN, TST, TEQ, MOV or MVN does."""
    tests = this.name in TESTS
    moves = this.name in ("mov", "movw", "mvn")
    first = this.operand(0 if tests or len(this.operands) == 2 else 1)
    last = this.operands[-1]
    second = this.operand(len(this.operands) - 1)
    compute = LOGIC["and" if moves else TESTS.get(this.name, this.name)]
    write = None if tests else this.writer()
    sets_flags, inverts = this.sets_flags, this.name == "mvn"
    # A constant that is no byte may be a rotated one, which sets the carry; a shifted operand does.
    carry_unknown = bool(last.shift.type) if last.type == arm.ARM_OP_REG else not 0 <= last.imm <= 0xFF

    def run(state: TurnState) -> None:
        other = second(state)
        result = (_inverse(other) if inverts else other) if moves else compute(first(state), other)
        if sets_flags:
            _set_result(state, result)
            if carry_unknown:
                state.set("c", of.anything(other, most=1))
        if write is not None:
            write(state, result)

    return run


def _carry_of_shift(kind: int, value: Value, places: int) -> Value:
    if not value.is_known:
        return of.anything(value, most=1)
    if kind == arm.ARM_SFT_LSL:
        return Value(value.low << places >> 32 & 1)
    word = value.signed[0] if kind == arm.ARM_SFT_ASR else value.low
    return Value(word >> places - 1 & 1)


def shift_operation(this: DecodedInstruction) -> Operation:
    """Return what LSL, LSR or ASR does, by a constant or a register."""
    kind = SHIFTS[this.name]
    source, count = this.operand(0 if len(this.operands) == 2 else 1), this.operand(len(this.operands) - 1)
    write, sets_flags = this.writer(), this.sets_flags

    def run(state: TurnState) -> None:
        value, places = source(state), count(state)
        if not places.is_known:
            raise NotProvable
        by = places.low & 0xFF
        result = shifted(kind, value, by)
        if sets_flags:
            _set_result(state, result)
            if by:
                state.set("c", _carry_of_shift(kind, value, by))
        write(state, result)

    return run


def _plain(this: DecodedInstruction, compute: Callable[..., Value], *indices: int) -> Operation:
    reads, write, sets_flags = [this.operand(index) for index in indices], this.writer(), this.sets_flags

    def run(state: TurnState) -> None:
        result = compute(*(read(state) for read in reads))
        if sets_flags:
            _set_result(state, result)
        write(state, result)

    return run


def arithmetic_operation(this: DecodedInstruction) -> Operation:
    """Return what an extension, a bit field, a product, a quotient or MOVT does."""
    name, operands = this.name, this.operands
    if name in EXTENSIONS:
        bits, signed = EXTENSIONS[name]
        return _plain(this, partial(of.extended, bits=bits, signed=signed), len(operands) - 1)
    if name in ("ubfx", "sbfx"):
        least, bits = operands[2].imm, operands[3].imm
        take = partial(of.extended, bits=bits, signed=name == "sbfx")
        return _plain(this, lambda value: take(of.shifted_right(value, least)), 1)
    if name == "movt":
        high = Value(operands[1].imm << 16 & MASK)
        return _plain(this, lambda value: of.disjunction(of.conjunction(value, Value(0xFFFF)), high), 0)
    if name == "mla":
        return _plain(this, lambda one, other, more: of.add(of.product(one, other), more), 1, 2, 3)
    return _plain(this, of.product if name == "mul" else of.quotient, len(operands) - 2, len(operands) - 1)


def address_operation(this: DecodedInstruction) -> Operation:
    """Return what ADR does."""
    write, place = this.writer(), Value((this.address + 4 & ~3) + this.operands[1].imm & MASK)
    return lambda state: write(state, place)
