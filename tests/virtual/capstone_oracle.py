"""Thumb instructions as capstone decodes them: an oracle for the core's decoder, and what the models of prices read."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import capstone
from capstone import arm_const as arm

_PC, _LR = 15, 14
_NAMES = {"sb": 9, "sl": 10, "fp": 11, "ip": 12, "sp": 13, "lr": _LR, "pc": _PC}
# Rows of the timing profile by mnemonic without suffix; the first that fits counts.
_ROWS = (
    ("load", r"ldr(s?[bh])?t?"),
    ("store", r"str[bh]?t?"),
    ("exclusive", r"(ld|st)rex[bh]?"),
    ("multiple_base", r"v?(push|pop)|[vf]?(ld|st)m(ia|ea|fd|db)?x?|(ld|st)rd"),
    ("table_branch", r"tb[bh]"),
    ("branch", r"cbn?z|b(l|lx|x|xj)?|b(eq|ne|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)"),
    ("barrier", r"dmb|dsb|isb|dfb"),
    ("divide", r"[su]div"),
    ("multiply", r"muls?"),
    ("multiply_accumulate", r"ml[as]"),
    ("multiply_long", r"[su]mull"),
    ("accumulate_long", r"[su]mlal|umaal"),
    ("it", r"it[te]*"),
    ("system", r"(mrs|msr)\w*|cps\w*|svc|wfi|wfe|sev|nop|hint|bkpt|clrex|yield|csdb|esb"),
    ("fp_load", r"vldr"),
    ("fp_store", r"vstr"),
    ("fp_divide", r"vdiv|vsqrt"),
    ("fp_accumulate", r"v(n?ml|fn?m)[as]"),
    ("fp", r"v.*"),
    ("data", r".*"),
)


@dataclass(frozen=True, slots=True)
class Instruction:
    """One decoded instruction, with the names that `struct instruction` of the core has.

    Attributes
    ----------
    row : str
        The row of the timing profile that prices it.
    transfer : str
        "" for none, "direct" (target in the instruction), "indirect".
    predicated : bool
        Whether it stands in an IT block.
    """

    address: int
    size: int
    text: str
    row: str = "data"
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
    stepped_base: int = 0
    loads_multiple: bool = False
    moves_from_fpu: bool = False

    def skipped(self) -> Instruction:
        """Return it as the pipeline sees it where its condition does not hold: it does nothing and passes."""
        return replace(
            self,
            row="it_skipped",
            words=0,
            address_registers=0,
            loaded_registers=0,
            fp_reads=0,
            fp_writes=0,
            fp_addend=0,
            uses_fpu=False,
            core_writes=0,
            stepped_base=0,
            loads_multiple=False,
            moves_from_fpu=False,
        )

    @property
    def misplaced(self) -> bool:
        """Whether it has four bytes and does not begin at a multiple of four: two words have to be fetched."""
        return self.size == 4 and self.address % 4 != 0

    @property
    def target(self) -> int | None:
        """Where it jumps, if that stands in it."""
        return int(self.text.rpartition("#")[2], 16) if self.transfer == "direct" else None


@cache
def _disassembler() -> Any:
    engine = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
    engine.detail = True
    return engine


def decode(address: int, code: bytes, conditions: int = 0) -> list[Instruction]:
    """Decode straight-line Thumb code, of which the first `conditions` instructions belong to an IT block."""
    decoded: list[Instruction] = []
    while code:
        raw = next(_disassembler().disasm(code, address, 1), None)
        if raw is None:
            decoded.append(Instruction(address, 4 if code[1] >> 3 >= 0x1D else 2, ".unknown"))
        else:
            decoded.append(_described(raw, predicated=conditions > 0))
        starts_block = raw is not None and raw.id == arm.ARM_INS_IT
        conditions = len(raw.mnemonic) - 1 if starts_block else max(conditions - 1, 0)
        address, code = address + decoded[-1].size, code[decoded[-1].size :]
    return decoded


@cache
def _masks_of(register: int) -> tuple[int, int]:
    name = _disassembler().reg_name(register) or ""
    kind, number = name[:1], _NAMES.get(name, int(name[1:]) if name[1:].isdigit() else -1)
    if name in _NAMES or (kind == "r" and number >= 0):
        return 1 << number, 0
    return 0, {"s": 1 << number, "d": 3 << 2 * number}.get(kind, 0) if number >= 0 else 0


def _masks(registers: list[int]) -> tuple[int, int]:
    """Return bits of the core's registers and of the s registers."""
    core = floating = 0
    for register in registers:
        masks = _masks_of(register)
        core, floating = core | masks[0], floating | masks[1]
    return core, floating


def _described(raw: Any, *, predicated: bool) -> Instruction:
    name = raw.mnemonic.partition(".")[0]
    row = next(row for row, pattern in _ROWS if re.fullmatch(pattern, name))
    registers = [operand.reg for operand in raw.operands if operand.type == arm.ARM_OP_REG]
    memory = next((operand.mem for operand in raw.operands if operand.type == arm.ARM_OP_MEM), None)
    reads, writes = raw.regs_access()
    fp_reads, (core_writes, fp_writes) = _masks(reads)[1], _masks(writes)
    moved, words, base, addend = registers, 0, [], 0
    if memory is not None:
        base = [memory.base, memory.index]
    elif row == "multiple_base":
        base, moved = ([arm.ARM_REG_SP], registers) if "p" in name else (registers[:1], registers[1:])
    if row == "store" and memory.index:
        row = "store_register_offset"
    elif row == "fp" and name == "vmov" and len(raw.operands) >= 3:
        row = "fp_move_pair"
    elif row in ("fp_load", "fp_store") and _masks(registers)[1].bit_count() == 2:
        row = "multiple_base"
    elif row == "fp_accumulate":
        fp_reads = _masks(registers[1:])[1]
        addend = _masks(registers[:1])[1] & ~fp_reads
    if row == "multiple_base":
        words = 2 if memory is not None else sum(mask.bit_count() for mask in _masks(moved))
    is_branch, writes_pc = row in ("branch", "table_branch"), bool(core_writes >> _PC & 1)
    is_direct = row == "branch" and (name.startswith("cb") or raw.operands[0].type == arm.ARM_OP_IMM)
    if row == "data" and writes_pc:
        row = "branch"
    transfers = is_branch or writes_pc
    has_condition = name.startswith("cb") or (raw.id == arm.ARM_INS_B and raw.cc not in (arm.ARM_CC_AL, 0))
    return Instruction(
        raw.address,
        raw.size,
        f"{raw.mnemonic} {raw.op_str}".strip(),
        row,
        words,
        _masks(base)[0] & ~(1 << _PC),
        _masks(registers[:1])[0] if row == "load" else 0,
        fp_reads,
        fp_writes,
        addend,
        name.startswith(("v", "fldm", "fstm")),
        ("direct" if is_direct else "indirect") if transfers else "",
        transfers and (predicated or has_condition),
        predicated,
        core_writes,
        _masks(base)[0] & core_writes if row == "load" and raw.writeback else 0,
        row == "multiple_base" and name.startswith(("ldm", "ldrd", "vld", "fldm", "pop", "vpop")),
        row == "fp" and name == "vmov" and bool(core_writes),
    )
