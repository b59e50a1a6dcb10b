"""What the cycle model needs to know of an instruction, worked out from capstone's disassembly.

The virtual board priced instructions by this until it got a decoder of its own, which must agree with it. One
rule has been corrected: a single load of the stack pointer with write-back sets it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import capstone
from capstone import arm_const as arm

PC_BIT = 1 << 15
STACK_BIT = 1 << 13
WORD_BYTES = 4
AS_IT_SAYS, BY_A_REGISTER, ELSEWHERE = range(3)  # how the stack pointer moves, in the order of `enum stack_move`


@dataclass(frozen=True)
class Costs:
    """Fields of `struct instruction` that the cycle model reads; of sets of registers bit n is r(n) or s(n)."""

    row: str
    words: int = 0
    address_registers: int = 0
    loaded_registers: int = 0
    core_writes: int = 0
    fp_reads: int = 0
    fp_writes: int = 0
    fp_addend: int = 0
    uses_fpu: bool = False
    transfer: str = "none"
    conditional: bool = False
    lowers_stack: int = 0
    stack_move: int = AS_IT_SAYS


@dataclass(frozen=True)
class Disassembly:
    """An instruction that capstone knows."""

    size: int
    text: str
    costs: Costs


SINGLE_LOADS = {
    arm.ARM_INS_LDR, arm.ARM_INS_LDRB, arm.ARM_INS_LDRH, arm.ARM_INS_LDRSB, arm.ARM_INS_LDRSH,
    arm.ARM_INS_LDRT, arm.ARM_INS_LDRBT, arm.ARM_INS_LDRHT, arm.ARM_INS_LDRSBT, arm.ARM_INS_LDRSHT,
}  # fmt: skip
SINGLE_STORES = {
    arm.ARM_INS_STR, arm.ARM_INS_STRB, arm.ARM_INS_STRH,
    arm.ARM_INS_STRT, arm.ARM_INS_STRBT, arm.ARM_INS_STRHT,
}  # fmt: skip
PUSHES = {arm.ARM_INS_PUSH, arm.ARM_INS_VPUSH}
POPS = {arm.ARM_INS_POP, arm.ARM_INS_VPOP}
MULTIPLES = PUSHES | POPS | {
    arm.ARM_INS_LDM, arm.ARM_INS_LDMDB, arm.ARM_INS_STM, arm.ARM_INS_STMDB,
    arm.ARM_INS_VLDMIA, arm.ARM_INS_VLDMDB, arm.ARM_INS_VSTMIA, arm.ARM_INS_VSTMDB,
    arm.ARM_INS_FLDMDBX, arm.ARM_INS_FLDMIAX, arm.ARM_INS_FSTMDBX, arm.ARM_INS_FSTMIAX,
}  # fmt: skip
DOUBLES = {arm.ARM_INS_LDRD, arm.ARM_INS_STRD}
TABLES = {arm.ARM_INS_TBB, arm.ARM_INS_TBH}
BRANCHES = {
    arm.ARM_INS_B, arm.ARM_INS_BL, arm.ARM_INS_BLX, arm.ARM_INS_BX, arm.ARM_INS_BXJ,
    arm.ARM_INS_CBZ, arm.ARM_INS_CBNZ,
}  # fmt: skip
ACCUMULATES = {
    arm.ARM_INS_VMLA, arm.ARM_INS_VMLS, arm.ARM_INS_VFMA, arm.ARM_INS_VFMS,
    arm.ARM_INS_VNMLA, arm.ARM_INS_VNMLS, arm.ARM_INS_VFNMA, arm.ARM_INS_VFNMS,
}  # fmt: skip
OTHER_ROWS = {
    "barrier": {arm.ARM_INS_DMB, arm.ARM_INS_DSB, arm.ARM_INS_ISB},
    "system": {
        arm.ARM_INS_MRS, arm.ARM_INS_MSR, arm.ARM_INS_CPS, arm.ARM_INS_SVC, arm.ARM_INS_WFI, arm.ARM_INS_WFE,
        arm.ARM_INS_SEV, arm.ARM_INS_NOP, arm.ARM_INS_HINT, arm.ARM_INS_BKPT, arm.ARM_INS_CLREX, arm.ARM_INS_YIELD,
    },
    "exclusive": {
        arm.ARM_INS_LDREX, arm.ARM_INS_LDREXB, arm.ARM_INS_LDREXH,
        arm.ARM_INS_STREX, arm.ARM_INS_STREXB, arm.ARM_INS_STREXH,
    },
    "divide": {arm.ARM_INS_SDIV, arm.ARM_INS_UDIV},
    "it": {arm.ARM_INS_IT},
}  # fmt: skip
ALWAYS = {arm.ARM_CC_AL, arm.ARM_CC_INVALID}


@cache
def _disassembler() -> Any:
    engine = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
    engine.detail = True
    return engine


def disassemble(address: int, code: bytes, *, in_it_block: bool) -> Disassembly | None:
    """Return the first instruction of some code, or None if capstone does not know it."""
    raw = next(iter(_disassembler().disasm(code, address, 1)), None)
    if raw is None:
        return None
    return Disassembly(raw.size, f"{raw.mnemonic} {raw.op_str}".strip(), _costs(raw, in_it_block))


@cache
def _masks_of(register: int) -> tuple[int, int]:
    """Core mask and floating-point mask of a capstone register number."""
    name = _disassembler().reg_name(register) or ""
    core = {"sb": 9, "sl": 10, "fp": 11, "ip": 12, "sp": 13, "lr": 14, "pc": 15}.get(name)
    if core is not None:
        return 1 << core, 0
    kind, number = name[:1], name[1:]
    if not number.isdigit():
        return 0, 0
    return {"r": (1 << int(number), 0), "s": (0, 1 << int(number)), "d": (0, 3 << (2 * int(number)))}.get(kind, (0, 0))


def _masks(registers: list[int]) -> tuple[int, int]:
    core = floating = 0
    for register in registers:
        core_mask, floating_mask = _masks_of(register)
        core |= core_mask
        floating |= floating_mask
    return core, floating


def _costs(raw: Any, in_it_block: bool) -> Costs:
    reads, writes = raw.regs_access()
    fp_reads, fp_addend = _masks(reads)[1], 0
    core_writes, fp_writes = _masks(writes)
    memory = next((operand.mem for operand in raw.operands if operand.type == arm.ARM_OP_MEM), None)
    row = _row(raw, memory, core_writes)
    first = _masks([raw.operands[0].reg]) if raw.operands and raw.operands[0].type == arm.ARM_OP_REG else (0, 0)
    if row == "fp_accumulate":
        fp_reads = _masks([operand.reg for operand in raw.operands[1:]])[1]
        fp_addend = first[1] & ~fp_reads
    transfer, conditional = _transfer(raw, core_writes, in_it_block)
    words = _words(raw, row)
    lowers, move = _stack_move(raw, words, bool(core_writes & STACK_BIT), in_it_block)
    return Costs(
        row, words, _address_registers(raw, memory) & ~PC_BIT, first[0] if row == "load" else 0, core_writes,
        fp_reads, fp_writes, fp_addend, _uses_fpu(raw), transfer, conditional, lowers, move,
    )  # fmt: skip


def _uses_fpu(raw: Any) -> bool:
    mnemonic: str = raw.mnemonic
    return mnemonic.startswith(("v", "fldm", "fstm"))


def _row(raw: Any, memory: Any, core_writes: int) -> str:
    kind = raw.id
    if kind in SINGLE_LOADS:
        return "load"
    if kind in SINGLE_STORES:
        return "store_register_offset" if memory is not None and memory.index else "store"
    if kind in MULTIPLES or kind in DOUBLES:
        return "multiple_base"
    if kind in (arm.ARM_INS_VLDR, arm.ARM_INS_VSTR):
        if _masks_of(raw.operands[0].reg)[1].bit_count() == 2:
            return "multiple_base"
        return "fp_load" if kind == arm.ARM_INS_VLDR else "fp_store"
    if kind in TABLES:
        return "table_branch"
    if kind in BRANCHES:
        return "branch"
    if _uses_fpu(raw):
        return _fp_row(raw)
    for row, kinds in OTHER_ROWS.items():
        if kind in kinds:
            return row
    return "branch" if core_writes & PC_BIT else "data"


def _fp_row(raw: Any) -> str:
    if raw.id in (arm.ARM_INS_VDIV, arm.ARM_INS_VSQRT):
        return "fp_divide"
    if raw.id in ACCUMULATES:
        return "fp_accumulate"
    if raw.id == arm.ARM_INS_VMOV and len(raw.operands) >= 3:
        return "fp_move_pair"
    return "fp"


def _address_registers(raw: Any, memory: Any) -> int:
    if memory is not None:
        return _masks([memory.base, memory.index])[0]
    return _masks([_multiple_registers(raw)[0]])[0] if raw.id in MULTIPLES else 0


def _multiple_registers(raw: Any) -> tuple[int, list[Any]]:
    """Return the base of a multiple transfer, and the operands that are moved."""
    if raw.id in PUSHES or raw.id in POPS:
        return arm.ARM_REG_SP, raw.operands
    return raw.operands[0].reg, raw.operands[1:]


def _words(raw: Any, row: str) -> int:
    if row != "multiple_base":
        return 0
    if raw.id not in MULTIPLES:
        return 2
    core, floating = _masks([operand.reg for operand in _multiple_registers(raw)[1]])
    return core.bit_count() + floating.bit_count()


def _transfer(raw: Any, core_writes: int, in_it_block: bool) -> tuple[str, bool]:
    kind = raw.id
    if kind in TABLES or (kind not in BRANCHES and core_writes & PC_BIT):
        return "indirect", in_it_block
    if kind not in BRANCHES:
        return "none", False
    if kind in (arm.ARM_INS_CBZ, arm.ARM_INS_CBNZ):
        return "direct", True
    direct = raw.operands[0].type == arm.ARM_OP_IMM
    return "direct" if direct else "indirect", in_it_block or (kind == arm.ARM_INS_B and raw.cc not in ALWAYS)


def _stack_move(raw: Any, words: int, writes_it: bool, in_it_block: bool) -> tuple[int, int]:
    """Return by how many bytes the stack pointer is lowered, and how it moves otherwise."""
    operands = raw.operands
    first = operands[0].reg if operands and operands[0].type == arm.ARM_OP_REG else None
    if raw.id in PUSHES or raw.id in POPS:
        lowers = WORD_BYTES * words if raw.id in PUSHES else -WORD_BYTES * words
    elif raw.id == arm.ARM_INS_MSR:
        return 0, ELSEWHERE if raw.op_str.startswith(("msp", "psp", "control")) else AS_IT_SAYS
    elif raw.writeback and any(op.type == arm.ARM_OP_MEM and op.mem.base == arm.ARM_REG_SP for op in operands):
        last = operands[-1]
        lowers = -last.imm if last.type == arm.ARM_OP_IMM else -last.mem.disp
    elif raw.writeback and raw.id in MULTIPLES and first == arm.ARM_REG_SP:
        lowers = WORD_BYTES * words if "db" in raw.mnemonic else -WORD_BYTES * words
    elif first == arm.ARM_REG_SP and writes_it:
        sign = {arm.ARM_INS_SUB: 1, arm.ARM_INS_SUBW: 1, arm.ARM_INS_ADD: -1, arm.ARM_INS_ADDW: -1}.get(raw.id)
        if sign is None or operands[len(operands) - 2].reg != arm.ARM_REG_SP:
            return 0, ELSEWHERE
        if operands[-1].type != arm.ARM_OP_IMM:
            return 0, BY_A_REGISTER
        lowers = sign * operands[-1].imm
    else:
        return 0, AS_IT_SAYS
    return (0, BY_A_REGISTER) if in_it_block else (lowers, AS_IT_SAYS)
