"""One instruction of a turn, taken apart: what it reads, where it writes, and when it runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from capstone import arm_const as arm

from hiltest.virtual.waits import intervals as of
from hiltest.virtual.waits.intervals import MASK, Value
from hiltest.virtual.waits.state import CONDITIONS, NotProvable, NotUniform, TurnState

LINK_REGISTER, STACK_POINTER = 14, 13
_PC = 15
_NUMBERS = {"sb": 9, "sl": 10, "fp": 11, "ip": 12, "sp": STACK_POINTER, "lr": LINK_REGISTER, "pc": _PC}

Operation = Callable[[TurnState], None]
Read = Callable[[TurnState], Value]


class DecodedInstruction:
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

    def register(self, number: int) -> Read:
        """Return what reads a core register."""
        return (lambda _state: Value(self.address + 4)) if number == _PC else (lambda state: state.get(number))

    def operand(self, index: int) -> Read:
        """Return what reads an operand, shifted as the instruction says."""
        operand = self.operands[index]
        if operand.type == arm.ARM_OP_IMM:
            constant = Value(operand.imm & MASK)
            return lambda _state: constant
        read = self.register(self.number(index))
        if not operand.shift.type:
            return read
        kind, places = operand.shift.type, operand.shift.value
        return lambda state: shifted(kind, read(state), places)

    def where(self) -> tuple[Read, Operation | None]:
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

    def writer(self, index: int = 0) -> Callable[[TurnState, Value], None]:
        """Return what writes the register that is an operand; a write to the pc must go where the turn goes."""
        number = self.number(index)
        if number == _PC:
            return lambda _state, value: self.go(value)
        return lambda state, value: state.set(number, value)

    def go(self, target: Value) -> None:
        """Jump: refuse a target where the turn does not go on.

        Raises
        ------
        NotProvable
            It is not known.
        NotUniform
            It is elsewhere.
        """
        if not target.is_known:
            raise NotProvable
        if target.low & ~1 != self.goes_to:
            raise NotUniform


def shifted(kind: int, value: Value, places: int) -> Value:
    """Shift by constant places.

    Raises
    ------
    NotProvable
        Of a rotation whose operand is not known.
    """
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
