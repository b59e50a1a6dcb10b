"""What Thumb instructions do to the values of a turn; those that are not here end the proof."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from functools import partial
from typing import Any

from capstone import arm_const as arm

from hiltest.virtual.instructions import disassemble
from hiltest.virtual.waits import intervals as of
from hiltest.virtual.waits.intervals import MASK, Value
from hiltest.virtual.waits.state import CONDITIONS, NotProvable, NotUniform, TurnState

Operation = Callable[[TurnState], None]
_Read = Callable[[TurnState], Value]
_LOADS = {"ldr": (4, False), "ldrb": (1, False), "ldrh": (2, False), "ldrsb": (1, True), "ldrsh": (2, True)}
_STORES = {"str": 4, "strb": 1, "strh": 2}
_EXTENSIONS = {"uxtb": (8, False), "uxth": (16, False), "sxtb": (8, True), "sxth": (16, True)}
_SHIFTS = {"lsl": arm.ARM_SFT_LSL, "lsr": arm.ARM_SFT_LSR, "asr": arm.ARM_SFT_ASR}
_LOGIC: dict[str, Callable[[Value, Value], Value]] = {
    "and": of.conjunction, "orr": of.disjunction, "eor": of.difference,
    "bic": lambda first, second: of.conjunction(first, _inverse(second)),
    "orn": lambda first, second: of.disjunction(first, _inverse(second)),
}  # fmt: skip
_TESTS = {"tst": "and", "teq": "eor"}
_NOTHING = {"nop", "dsb", "dmb", "isb", "it"}
_MASKS = {"i": "primask", "f": "faultmask"}
_PC, _LR, _SP = 15, 14, 13
_NUMBERS = {"sb": 9, "sl": 10, "fp": 11, "ip": 12, "sp": _SP, "lr": _LR, "pc": _PC}


def _inverse(value: Value) -> Value:
    return of.subtract(Value(MASK), value)


class _Instruction:
    """One instruction of a turn, taken apart."""

    def __init__(self, raw: Any, *, transfers: bool, jumps: bool, goes_to: int) -> None:
        self.name: str = raw.insn_name()
        if self.name in ("hint", "it") or raw.mnemonic.startswith("it"):
            self.name = "nop" if raw.mnemonic.startswith(("nop", "it")) else "hint"
        self.mnemonic: str = raw.mnemonic
        self.text: str = raw.op_str
        self.operands = raw.operands
        self.sets_flags: bool = raw.update_flags
        self.writes_back: bool = raw.writeback
        self.address: int = raw.address
        self.end: int = raw.address + raw.size
        self.condition = CONDITIONS[raw.cc - 1] if 1 <= raw.cc <= len(CONDITIONS) else None
        self.transfers = transfers
        self.jumps = jumps
        self.goes_to = goes_to
        self._name_of = raw.reg_name

    def number(self, index: int) -> int:
        """Return the number of the core register that is an operand."""
        operand = self.operands[index]
        if operand.type != arm.ARM_OP_REG:
            raise NotProvable
        return self._number(operand.reg)

    def _number(self, register: int) -> int:
        name: str = self._name_of(register) or ""
        number = _NUMBERS.get(name, int(name[1:]) if name[:1] == "r" and name[1:].isdigit() else None)
        if number is None:
            raise NotProvable
        return number

    def register(self, number: int) -> _Read:
        """Return what reads a core register."""
        return (lambda _state: Value(self.address + 4)) if number == _PC else (lambda state: state.get(number))

    def operand(self, index: int) -> _Read:
        """Return what reads an operand, shifted as the instruction says."""
        operand = self.operands[index]
        if operand.type == arm.ARM_OP_IMM:
            constant = Value(operand.imm & MASK)
            return lambda _state: constant
        read = self.register(self.number(index))
        if not operand.shift.type:
            return read
        kind, places = operand.shift.type, operand.shift.value
        return lambda state: _shifted(kind, read(state), places)

    def where(self) -> tuple[_Read, Operation | None]:
        """Return what computes the address of a transfer, and what writes the base back."""
        operand = next(each for each in self.operands if each.type == arm.ARM_OP_MEM)
        base = self._number(operand.mem.base)
        if base == _PC:
            place = Value((self.address + 4 & ~3) + operand.mem.disp & MASK)
            return (lambda _state: place), None
        read, step = self.register(base), Value(operand.mem.disp & MASK)
        if operand.mem.index:
            index = self.register(self._number(operand.mem.index))
            places = operand.shift.value if operand.shift.type else 0
            return (lambda state: of.add(read(state), of.shifted_left(index(state), places))), None
        if not self.writes_back:
            return (lambda state: of.add(read(state), step)), None
        after = self.operands[-1]
        behind = after.type == arm.ARM_OP_IMM
        if behind:
            step = Value(after.imm & MASK)
        where = read if behind else (lambda state: of.add(read(state), step))
        return where, lambda state: state.set(base, of.add(read(state), step))


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
        (each.address, _operation(_Instruction(
            each, transfers=transfers and each.address + each.size == end, jumps=jumps, goes_to=goes_to
        )))
        for each in raw
    ]  # fmt: skip


def _operation(this: _Instruction) -> Operation:
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


# -- results and flags --------------------------------------------------------------------------


def _set_result(state: TurnState, value: Value) -> None:
    state.set("n", of.negative(value))
    state.set("z", of.zero(value))


def _write(this: _Instruction, index: int = 0) -> Callable[[TurnState, Value], None]:
    number = this.number(index)
    if number == _PC:
        goes_to = this.goes_to
        return lambda state, value: _go(value, goes_to)
    return lambda state, value: state.set(number, value)


def _go(target: Value, goes_to: int) -> None:
    if not target.is_known:
        raise NotProvable
    if target.low & ~1 != goes_to:
        raise NotUniform


def _nothing(_this: _Instruction) -> Operation:
    return lambda _state: None


def _sum(this: _Instruction) -> Operation:
    """ADD, SUB, RSB, CMP, CMN."""
    compares = this.name in ("cmp", "cmn")
    first, second = this.operand(0 if compares or len(this.operands) == 2 else 1), this.operand(len(this.operands) - 1)
    if this.name == "rsb":
        first, second = second, first
    adds = this.name in ("add", "addw", "cmn")
    compute = of.add if adds else of.subtract
    carry, overflow = (
        (of.carry_of_sum, of.overflow_of_sum) if adds else (of.carry_of_difference, of.overflow_of_difference)
    )
    write = None if compares else _write(this)
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


def _logic(this: _Instruction) -> Operation:
    """AND, ORR, EOR, BIC, ORN, TST, TEQ, MOV, MVN."""
    tests = this.name in _TESTS
    moves = this.name in ("mov", "movw", "mvn")
    first = this.operand(0 if tests or len(this.operands) == 2 else 1)
    last = this.operands[-1]
    second = this.operand(len(this.operands) - 1)
    compute = _LOGIC["and" if moves else _TESTS.get(this.name, this.name)]
    write = None if tests else _write(this)
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


def _shifted(kind: int, value: Value, places: int) -> Value:
    if kind == arm.ARM_SFT_LSL:
        return of.shifted_left(value, places)
    if kind == arm.ARM_SFT_LSR:
        return of.shifted_right(value, places)
    if kind == arm.ARM_SFT_ASR:
        return of.shifted_arithmetically(value, places)
    if kind == arm.ARM_SFT_ROR and value.is_known:
        places %= 32
        return Value((value.low >> places | value.low << 32 - places) & MASK)
    raise NotProvable


def _carry_of_shift(kind: int, value: Value, places: int) -> Value:
    if not value.is_known:
        return of.anything(value, most=1)
    if kind == arm.ARM_SFT_LSL:
        return Value(value.low << places >> 32 & 1)
    word = value.signed[0] if kind == arm.ARM_SFT_ASR else value.low
    return Value(word >> places - 1 & 1)


def _shift(this: _Instruction) -> Operation:
    """LSL, LSR, ASR by a constant or a register."""
    kind = _SHIFTS[this.name]
    source, count = this.operand(0 if len(this.operands) == 2 else 1), this.operand(len(this.operands) - 1)
    write, sets_flags = _write(this), this.sets_flags

    def run(state: TurnState) -> None:
        value, places = source(state), count(state)
        if not places.is_known:
            raise NotProvable
        by = places.low & 0xFF
        result = _shifted(kind, value, by)
        if sets_flags:
            _set_result(state, result)
            if by:
                state.set("c", _carry_of_shift(kind, value, by))
        write(state, result)

    return run


def _plain(this: _Instruction, compute: Callable[..., Value], *indices: int) -> Operation:
    reads, write, sets_flags = [this.operand(index) for index in indices], _write(this), this.sets_flags

    def run(state: TurnState) -> None:
        result = compute(*(read(state) for read in reads))
        if sets_flags:
            _set_result(state, result)
        write(state, result)

    return run


def _arithmetic(this: _Instruction) -> Operation:
    """Extensions, bit fields, products, quotients, MOVT."""
    name, operands = this.name, this.operands
    if name in _EXTENSIONS:
        bits, signed = _EXTENSIONS[name]
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


def _address_of(this: _Instruction) -> Operation:
    write, place = _write(this), Value((this.address + 4 & ~3) + this.operands[1].imm & MASK)
    return lambda state: write(state, place)


# -- memory -------------------------------------------------------------------------------------


def _load(this: _Instruction) -> Operation:
    size, signed = _LOADS[this.name]
    where, write_back = this.where()
    write = _write(this)

    def run(state: TurnState) -> None:
        value = state.load(where(state), size, signed=signed)
        if write_back is not None:
            write_back(state)
        write(state, value)

    return run


def _store(this: _Instruction) -> Operation:
    size = _STORES[this.name]
    where, write_back = this.where()
    read = this.operand(0)

    def run(state: TurnState) -> None:
        state.store(where(state), size, read(state))
        if write_back is not None:
            write_back(state)

    return run


def _pair(this: _Instruction) -> Operation:
    """LDRD, STRD."""
    where, write_back = this.where()
    reads, loads = [this.operand(0), this.operand(1)], this.name == "ldrd"
    writes = [_write(this, 0), _write(this, 1)] if loads else []

    def run(state: TurnState) -> None:
        first = where(state)
        places = first, of.add(first, Value(4))
        if write_back is not None:
            write_back(state)
        if loads:
            for write, value in zip(writes, [state.load(place, 4) for place in places], strict=True):
                write(state, value)
        else:
            for read, place in zip(reads, places, strict=True):
                state.store(place, 4, read(state))

    return run


def _multiple(this: _Instruction) -> Operation:
    """PUSH, POP, LDM, STM, up or down."""
    on_stack = this.name in ("push", "pop")
    base = _SP if on_stack else this.number(0)
    indices = range(0 if on_stack else 1, len(this.operands))
    size = 4 * len(indices)
    down = this.name in ("push", "stmdb", "ldmdb")
    step = Value((-size if down else size) & MASK)
    writes_back = on_stack or this.writes_back
    loads = this.name in ("pop", "ldm", "ldmdb")
    reads = [] if loads else [this.operand(index) for index in indices]
    writes = [_write(this, index) for index in indices] if loads else []

    def run(state: TurnState) -> None:
        begin = state.get(base)
        first = of.add(begin, step) if down else begin
        values = [read(state) for read in reads]
        places = [of.add(first, Value(4 * index)) for index in range(len(indices))]
        if writes_back:
            state.set(base, of.add(begin, step))
        for place, value in zip(places, values, strict=False):
            state.store(place, 4, value)
        loaded = [state.load(place, 4) for place in places] if loads else []
        for write, value in zip(writes, loaded, strict=True):
            write(state, value)

    return run


# -- transfers of control, and masks ------------------------------------------------------------


def _branch(this: _Instruction) -> Operation:
    condition, jumps = this.condition, this.jumps

    def run(state: TurnState) -> None:
        if (condition is None or condition(state)) != jumps:
            raise NotUniform

    return run


def _compare_and_branch(this: _Instruction) -> Operation:
    read, jumps, on_zero = this.operand(0), this.jumps, this.name == "cbz"

    def run(state: TurnState) -> None:
        if (state.is_true(of.zero(read(state))) == on_zero) != jumps:
            raise NotUniform

    return run


def _call(this: _Instruction) -> Operation:
    behind = Value(this.end | 1)
    if this.name == "bl":
        return lambda state: state.set(_LR, behind)
    read, links, goes_to = this.operand(0), this.name == "blx", this.goes_to

    def run(state: TurnState) -> None:
        target = read(state)
        if links:
            state.set(_LR, behind)
        _go(target, goes_to)

    return run


def _mask(this: _Instruction) -> Operation:
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
        write = _write(this)
        return lambda state: write(state, state.get(mask))
    read, bits = this.operand(1), Value(0xF0 if mask == "basepri" else 1)
    return lambda state: state.set(mask, of.conjunction(read(state), bits))


_MAKERS: Sequence[tuple[Container[str], Callable[[_Instruction], Operation]]] = (
    (_LOADS, _load), (_STORES, _store), (_LOGIC, _logic), ({*_TESTS, "mov", "movw", "mvn"}, _logic),
    ({"add", "addw", "sub", "subw", "rsb", "cmp", "cmn"}, _sum), (_SHIFTS, _shift),
    ({*_EXTENSIONS, "ubfx", "sbfx", "movt", "mul", "mla", "udiv"}, _arithmetic), ({"b"}, _branch),
    ({"cbz", "cbnz"}, _compare_and_branch), ({"bl", "bx", "blx"}, _call), (_NOTHING, _nothing),
    ({"push", "pop", "ldm", "stm", "ldmdb", "stmdb"}, _multiple), ({"ldrd", "strd"}, _pair),
    ({"adr"}, _address_of), ({"cps", "mrs", "msr"}, _mask),
)  # fmt: skip
