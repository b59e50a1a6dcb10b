"""How instructions move the stack pointer."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from capstone import arm_const as arm

_PUSHES = {arm.ARM_INS_PUSH, arm.ARM_INS_VPUSH}
_POPS = {arm.ARM_INS_POP, arm.ARM_INS_VPOP}
_WORD_BYTES = 4
_POINTERS = ("msp", "psp", "control")  # CONTROL says which of the two SP is


class Moves(IntEnum):
    """How far an instruction moves the stack pointer, if that does not stand in it."""

    AS_IT_SAYS = 0
    BY_A_REGISTER = 1
    ELSEWHERE = 2


def stack_moves(raw: Any, words: int, *, writes_it: bool, in_it_block: bool) -> tuple[int, Moves]:
    """Return by how much an instruction of capstone's lowers the stack pointer.

    Parameters
    ----------
    raw : CsInsn
    words : int
        Words that it transfers.
    writes_it : bool
        Capstone says that it writes the stack pointer.
    in_it_block : bool
        It may be skipped.

    Returns
    -------
    lowers : int
        Bytes; negative where it raises it, and 0 where that is not known before it is executed.
    moves : Moves
    """
    operands = raw.operands
    bases = [operand.mem.base for operand in operands if operand.type == arm.ARM_OP_MEM]  # none in a multiple transfer
    if raw.id in _PUSHES or raw.id in _POPS:
        lowers = _WORD_BYTES * words if raw.id in _PUSHES else -_WORD_BYTES * words
    elif raw.id == arm.ARM_INS_MSR:
        return 0, Moves.ELSEWHERE if raw.op_str.startswith(_POINTERS) else Moves.AS_IT_SAYS
    elif raw.writeback and arm.ARM_REG_SP in bases:
        last = operands[-1]
        lowers = -last.imm if last.type == arm.ARM_OP_IMM else -last.mem.disp
    elif raw.writeback and not bases and operands[0].type == arm.ARM_OP_REG and operands[0].reg == arm.ARM_REG_SP:
        lowers = _WORD_BYTES * words if "db" in raw.mnemonic else -_WORD_BYTES * words  # VSTMDB, VLDMIA and the like
    elif operands and operands[0].type == arm.ARM_OP_REG and operands[0].reg == arm.ARM_REG_SP and writes_it:
        sign = {arm.ARM_INS_SUB: 1, arm.ARM_INS_SUBW: 1, arm.ARM_INS_ADD: -1, arm.ARM_INS_ADDW: -1}.get(raw.id)
        if sign is None or operands[len(operands) - 2].reg != arm.ARM_REG_SP:
            return 0, Moves.ELSEWHERE
        if operands[-1].type != arm.ARM_OP_IMM:
            return 0, Moves.BY_A_REGISTER
        lowers = sign * operands[-1].imm
    else:
        return 0, Moves.AS_IT_SAYS
    return (0, Moves.BY_A_REGISTER) if in_it_block else (lowers, Moves.AS_IT_SAYS)
