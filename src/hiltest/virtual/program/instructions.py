"""Thumb instructions as the cycle model sees them: what costs time, and what waits for what."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import capstone
from capstone import arm_const as arm

from hiltest.virtual.program.stack_moves import Moves, stack_moves

_PC_BIT = 1 << 15
_LINK_BIT = 1 << 14
_STACK_BIT = 1 << 13


@dataclass(frozen=True, slots=True)
class Instruction:
    """One decoded instruction; of sets of registers bit n is r(n), of floating-point ones s(n).

    Attributes
    ----------
    row : str
        The row of the timing profile that prices it.
    words : int
        Words moved by a multiple transfer, else 0.
    address_registers, loaded_registers : int
        Core registers that an access takes its address from, and that a single load writes.
    fp_reads, fp_writes, fp_addend : int
        Single registers read, written, and read only as the addend of a MAC.
    transfer : str
        "" for none, "direct" (target in the instruction), "indirect".
    conditional : bool
        Whether a transfer may fall through.
    predicated : bool
        Whether it stands in an IT block, as far as that is known.
    core_writes : int
        Core registers written.
    lowers_stack : int
        Bytes by which it lowers the stack pointer; negative where it raises it.
    moves_stack : Moves
        Whether it moves it otherwise.
    """

    address: int
    size: int
    text: str
    row: str
    words: int = 0
    address_registers: int = 0
    loaded_registers: int = 0
    fp_reads: int = 0
    fp_writes: int = 0
    fp_addend: int = 0
    uses_fpu: bool = False
    transfer: str = ""
    conditional: bool = False
    predicated: bool = False
    core_writes: int = 0
    lowers_stack: int = 0
    moves_stack: Moves = Moves.AS_IT_SAYS

    def skipped(self) -> Instruction:
        """Return it as the pipeline sees it where its condition does not hold: it does nothing and passes."""
        return replace(
            self, row="it_skipped", words=0, address_registers=0, loaded_registers=0, fp_reads=0, fp_writes=0,
            fp_addend=0, uses_fpu=False, core_writes=0,
        )  # fmt: skip

    @property
    def misplaced(self) -> bool:
        """Whether it has four bytes and does not begin at a multiple of four: two words have to be fetched."""
        return self.size == 4 and self.address % 4 != 0

    @property
    def target(self) -> int | None:
        """Where it jumps, if that stands in it."""
        target = self.text.rpartition("#")[2]
        return int(target, 16) if self.transfer == "direct" and target.startswith("0x") else None

    def jumps_to(self, address: int) -> bool:
        """Whether it is an unconditional branch to `address`."""
        return not self.conditional and self.target == address

    def jumps_back(self, address: int) -> bool:
        """Whether it is a branch, conditional or not, to `address` or to what stands before it; calls are none."""
        target = self.target
        return target is not None and not self.calls and target <= address

    @property
    def calls(self) -> bool:
        """Whether it is a call, if it transfers control."""
        return bool(self.transfer and self.core_writes & _LINK_BIT)


_SINGLE_LOADS = {
    arm.ARM_INS_LDR, arm.ARM_INS_LDRB, arm.ARM_INS_LDRH, arm.ARM_INS_LDRSB, arm.ARM_INS_LDRSH,
    arm.ARM_INS_LDRT, arm.ARM_INS_LDRBT, arm.ARM_INS_LDRHT, arm.ARM_INS_LDRSBT, arm.ARM_INS_LDRSHT,
}  # fmt: skip
_SINGLE_STORES = {
    arm.ARM_INS_STR, arm.ARM_INS_STRB, arm.ARM_INS_STRH,
    arm.ARM_INS_STRT, arm.ARM_INS_STRBT, arm.ARM_INS_STRHT,
}  # fmt: skip
_MULTIPLES = {
    arm.ARM_INS_LDM, arm.ARM_INS_LDMDB, arm.ARM_INS_STM, arm.ARM_INS_STMDB, arm.ARM_INS_PUSH, arm.ARM_INS_POP,
    arm.ARM_INS_VLDMIA, arm.ARM_INS_VLDMDB, arm.ARM_INS_VSTMIA, arm.ARM_INS_VSTMDB,
    arm.ARM_INS_VPUSH, arm.ARM_INS_VPOP,
    arm.ARM_INS_FLDMDBX, arm.ARM_INS_FLDMIAX, arm.ARM_INS_FSTMDBX, arm.ARM_INS_FSTMIAX,
}  # fmt: skip
_DOUBLES = {arm.ARM_INS_LDRD, arm.ARM_INS_STRD}
_EXCLUSIVES = {
    arm.ARM_INS_LDREX, arm.ARM_INS_LDREXB, arm.ARM_INS_LDREXH,
    arm.ARM_INS_STREX, arm.ARM_INS_STREXB, arm.ARM_INS_STREXH,
}  # fmt: skip
_BARRIERS = {arm.ARM_INS_DMB, arm.ARM_INS_DSB, arm.ARM_INS_ISB}
_SYSTEM = {
    arm.ARM_INS_MRS, arm.ARM_INS_MSR, arm.ARM_INS_CPS, arm.ARM_INS_SVC, arm.ARM_INS_WFI, arm.ARM_INS_WFE,
    arm.ARM_INS_SEV, arm.ARM_INS_NOP, arm.ARM_INS_HINT, arm.ARM_INS_BKPT, arm.ARM_INS_CLREX, arm.ARM_INS_YIELD,
}  # fmt: skip
_ACCUMULATES = {
    arm.ARM_INS_VMLA, arm.ARM_INS_VMLS, arm.ARM_INS_VFMA, arm.ARM_INS_VFMS,
    arm.ARM_INS_VNMLA, arm.ARM_INS_VNMLS, arm.ARM_INS_VFNMA, arm.ARM_INS_VFNMS,
}  # fmt: skip
_BRANCHES = {
    arm.ARM_INS_B, arm.ARM_INS_BL, arm.ARM_INS_BLX, arm.ARM_INS_BX, arm.ARM_INS_BXJ,
    arm.ARM_INS_CBZ, arm.ARM_INS_CBNZ,
}  # fmt: skip
_TABLES = {arm.ARM_INS_TBB, arm.ARM_INS_TBH}
_LONG = (0x1D, 0x1E, 0x1F)  # the upper five bits of the first halfword of four bytes
_UNCONDITIONAL = {arm.ARM_CC_AL, arm.ARM_CC_INVALID}


@cache
def _disassembler() -> Any:
    engine = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
    engine.detail = True
    return engine


def disassemble(address: int, code: bytes) -> Iterator[Any]:
    """Return capstone's instructions of some code, as far as it knows them."""
    instructions: Iterator[Any] = _disassembler().disasm(code, address)
    return instructions


def mnemonics(address: int, code: bytes) -> Iterator[tuple[int, str]]:
    """Yield address and mnemonic of each instruction, of one that capstone does not know an empty one.

    A fiftieth of the time that `decode` takes.
    """
    position = 0
    while position < len(code):
        size = 0
        for at, length, mnemonic, _ in _plain_disassembler().disasm_lite(code[position:], address + position):
            yield at, mnemonic
            size = at + length - address - position
        position += size
        if position + 1 < len(code):
            yield address + position, ""
            position += instruction_size(code[position:])
        else:
            break


@cache
def _plain_disassembler() -> Any:
    return capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)


@cache
def _register_masks(register: int) -> tuple[int, int]:
    """Core mask and floating-point mask of a capstone register number."""
    name = _disassembler().reg_name(register) or ""
    core = {"sb": 9, "sl": 10, "fp": 11, "ip": 12, "sp": 13, "lr": 14, "pc": 15}.get(name)
    if core is None and name[:1] == "r" and name[1:].isdigit():
        core = int(name[1:])
    if core is not None:
        return 1 << core, 0
    if name[:1] == "s" and name[1:].isdigit():
        return 0, 1 << int(name[1:])
    if name[:1] == "d" and name[1:].isdigit():
        return 0, 3 << (2 * int(name[1:]))
    return 0, 0


def _masks(registers: list[int]) -> tuple[int, int]:
    core = floating = 0
    for register in registers:
        core_mask, floating_mask = _register_masks(register)
        core |= core_mask
        floating |= floating_mask
    return core, floating


def decode(address: int, code: bytes, conditions: int = 0) -> list[Instruction]:
    """Decode straight-line Thumb code.

    Parameters
    ----------
    address : int
        Address of the first byte.
    code : bytes
        Exactly the code to decode.
    conditions : int
        Instructions at its beginning that belong to an IT block before it.

    Returns
    -------
    list of Instruction
        In order; covers all of `code`. Bytes that capstone does not know are
        taken as one 2- or 4-byte instruction of class "data".
    """
    engine = _disassembler()
    decoded: list[Instruction] = []
    position = 0
    while position < len(code):
        raw = next(iter(engine.disasm(code[position:], address + position, 1)), None)
        if raw is None:
            size = instruction_size(code[position:])
            decoded.append(Instruction(address + position, size, ".unknown", "data"))
            position += size
            continue
        decoded.append(_classify(raw, in_it_block=conditions > 0))
        conditions = len(raw.mnemonic) - 1 if raw.id == arm.ARM_INS_IT else max(conditions - 1, 0)
        position += raw.size
    return decoded


def instruction_size(code: bytes) -> int:
    """Return how many bytes the first instruction of some code has."""
    return 4 if code[1] >> 3 in _LONG else 2


def _classify(raw: Any, *, in_it_block: bool) -> Instruction:
    reads, writes = raw.regs_access()
    _, fp_reads = _masks(reads)
    core_writes, fp_writes = _masks(writes)
    fields: dict[str, Any] = {
        "address": raw.address, "size": raw.size, "text": f"{raw.mnemonic} {raw.op_str}".strip(),
        "fp_reads": fp_reads, "fp_writes": fp_writes, "uses_fpu": _uses_fpu(raw),
    }  # fmt: skip
    memory = next((operand.mem for operand in raw.operands if operand.type == arm.ARM_OP_MEM), None)
    row = _price_class(raw, memory, core_writes)
    words = _words(raw) if row == "multiple_base" else 0
    fields |= {"row": row, "words": words, "core_writes": core_writes}
    fields["address_registers"] = _address_registers(raw, memory) & ~_PC_BIT
    if row == "load":
        # A base that is written back is not loaded: the next load may use it at once.
        fields["loaded_registers"] = _masks([raw.operands[0].reg])[0]
    if row == "fp_accumulate":
        addend = _masks([raw.operands[0].reg])[1]
        others = _masks([operand.reg for operand in raw.operands[1:]])[1]
        fields |= {"fp_reads": others, "fp_addend": addend & ~others}
    fields |= _control(raw, core_writes, in_it_block=in_it_block)
    fields["lowers_stack"], fields["moves_stack"] = stack_moves(
        raw, words, writes_it=bool(core_writes & _STACK_BIT), in_it_block=in_it_block
    )
    return Instruction(**fields, predicated=in_it_block)


def _uses_fpu(raw: Any) -> bool:
    mnemonic: str = raw.mnemonic
    return mnemonic.startswith(("v", "fldm", "fstm"))


def _price_class(raw: Any, memory: Any, core_writes: int) -> str:
    """Choose the row of the timing profile that prices an instruction."""
    kind = raw.id
    if kind in _SINGLE_LOADS:
        return "load"
    if kind in _SINGLE_STORES:
        return "store_register_offset" if memory is not None and memory.index else "store"
    if kind in _MULTIPLES or kind in _DOUBLES:
        return "multiple_base"
    if kind in (arm.ARM_INS_VLDR, arm.ARM_INS_VSTR):
        if raw.operands[0].reg and _register_masks(raw.operands[0].reg)[1].bit_count() == 2:
            return "multiple_base"
        return "fp_load" if kind == arm.ARM_INS_VLDR else "fp_store"
    if kind in _TABLES:
        return "table_branch"
    if kind in _BRANCHES:
        return "branch"
    if _uses_fpu(raw):
        return _fp_class(raw)
    for ids, row in ((_BARRIERS, "barrier"), (_SYSTEM, "system"), (_EXCLUSIVES, "exclusive")):
        if kind in ids:
            return row
    if kind in (arm.ARM_INS_SDIV, arm.ARM_INS_UDIV):
        return "divide"
    if kind == arm.ARM_INS_IT:
        return "it"
    return "branch" if core_writes & _PC_BIT else "data"


def _fp_class(raw: Any) -> str:
    if raw.id in (arm.ARM_INS_VDIV, arm.ARM_INS_VSQRT):
        return "fp_divide"
    if raw.id in _ACCUMULATES:
        return "fp_accumulate"
    if raw.id == arm.ARM_INS_VMOV and len(raw.operands) >= 3:
        return "fp_move_pair"
    return "fp"


def _address_registers(raw: Any, memory: Any) -> int:
    if memory is not None:
        return _masks([memory.base, memory.index])[0]
    if raw.id in _MULTIPLES:
        return _masks([_multiple_registers(raw)[0]])[0]
    return 0


def _multiple_registers(raw: Any) -> tuple[int, list[Any]]:
    """Return the base of a multiple transfer, and the operands that are moved."""
    if raw.id in (arm.ARM_INS_PUSH, arm.ARM_INS_POP, arm.ARM_INS_VPUSH, arm.ARM_INS_VPOP):
        return arm.ARM_REG_SP, raw.operands
    return raw.operands[0].reg, raw.operands[1:]


def _words(raw: Any) -> int:
    if raw.id not in _MULTIPLES:
        return 2
    core, floating = _masks([operand.reg for operand in _multiple_registers(raw)[1]])
    return core.bit_count() + floating.bit_count()


def _control(raw: Any, core_writes: int, *, in_it_block: bool) -> dict[str, Any]:
    kind = raw.id
    if kind in _TABLES or (kind not in _BRANCHES and core_writes & _PC_BIT):
        return {"transfer": "indirect", "conditional": in_it_block}
    if kind not in _BRANCHES:
        return {}
    if kind in (arm.ARM_INS_CBZ, arm.ARM_INS_CBNZ):
        return {"transfer": "direct", "conditional": True}
    direct = raw.operands[0].type == arm.ARM_OP_IMM
    conditional = in_it_block or (kind == arm.ARM_INS_B and raw.cc not in _UNCONDITIONAL)
    return {"transfer": "direct" if direct else "indirect", "conditional": conditional}
