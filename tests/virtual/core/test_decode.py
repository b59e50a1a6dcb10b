"""The decoder against two others, capstone and Unicorn, instruction by instruction.

All encodings with random fields and random halfwords are compared. Sections are those of the ARMv7-M Architecture
Reference Manual, DDI 0403E. UNPREDICTABLE encodings are undefined here if Unicorn takes them so; apart from those the
tables below name every difference and its reason.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

import pytest

from .. import capstone_oracle
from .decoder import (
    IT_ALWAYS,
    WIDE,
    decode,
    encodings,
    fields,
    instances,
    operation_name,
    random_instructions,
    row_name,
)

ADDRESS = 0x1002  # not a multiple of four, so that Align(PC, 4) matters
PC, SP = 15, 13
TRANSFERS = ("", "direct", "indirect")

# Fields that the cycle model reads and that have one name in both decoders.
COSTS = (
    "size",
    "words",
    "address_registers",
    "loaded_registers",
    "core_writes",
    "fp_reads",
    "fp_writes",
    "fp_addend",
    "uses_fpu",
    "conditional",
)

# Instances of each encoding and random pairs of halfwords; all of them outside an IT block and inside.
QUICK = (25, 8_000)
THOROUGH = pytest.param(1000, 500_000, marks=pytest.mark.ci)
COUNTS = ("of_each", "pairs")


@dataclass(frozen=True)
class Trial:
    """An instruction, and what the decoder and capstone make of it."""

    first: int
    second: int
    in_it_block: bool
    decoded: Any
    capstone: capstone_oracle.Instruction | None

    @property
    def bits(self) -> int:
        return self.first << 16 | self.second

    @property
    def text(self) -> str:
        return self.capstone.text if self.capstone else ""

    @property
    def operation(self) -> str:
        return operation_name(self.decoded)

    def matches(self, mask: int, value: int) -> bool:
        return self.first >= WIDE and self.bits & mask == value

    def field(self, low: int) -> int:
        """Four bits of a four-byte instruction."""
        return self.bits >> low & 0xF

    def __str__(self) -> str:
        place = " in an IT block" if self.in_it_block else ""
        return f"{self.first:04x} {self.second:04x}{place}: {self.operation}, {self.text or 'unknown to capstone'}"


def _trial(first: int, second: int, in_it_block: bool) -> Trial:
    decoded = decode(ADDRESS, first, second, IT_ALWAYS if in_it_block else 0)
    code = struct.pack("<2H", first, second)[: decoded.size]
    (reference,) = capstone_oracle.decode(ADDRESS, code, int(in_it_block))
    return Trial(first, second, in_it_block, decoded, None if reference.text == ".unknown" else reference)


def _trials(of_each: int, pairs: int) -> Iterable[Trial]:
    for source in (instances(of_each, seed=1), random_instructions(pairs, seed=2)):
        for first, second in source:
            for in_it_block in (False, True):
                yield _trial(first, second, in_it_block)


def _base_is_loaded(trial: Trial) -> bool:
    return trial.bits >> 21 & 1 == 1 and trial.second >> trial.field(16) & 1 == 1


def _moves_missing_registers(trial: Trial) -> bool:
    """Whether VLDR, VLDM or the like names d16 to d31, no register, or one past s31."""
    if not trial.matches(0xFE000E00, 0xEC000A00):
        return False
    is_double, is_multiple = bool(trial.bits & 0x100), trial.bits & 0x1200000 != 0x1000000
    high, low = (0, trial.bits >> 22 & 1)[:: -1 if is_double else 1]
    first = (trial.field(12) << 1 | low) + 32 * high
    count = trial.bits & (0xFE if is_double else 0xFF) if is_multiple else 1
    return count == 0 or first + count > 32


Reason = tuple[str, Callable[[Trial], bool]]

# Undefined here, although capstone has a text. It also knows the instructions of other architectures.
CAPSTONE_KNOWS_MORE: tuple[Reason, ...] = (
    ("the PC is an operand, UNPREDICTABLE (A5.1.2)", lambda t: re.search(r"\bpc\b", t.text) is not None),
    ("UDF (A7.7, UDF)", lambda t: t.text.startswith(("udf", "trap"))),
    (
        "conditional branch in an IT block, UNPREDICTABLE (A7.7, B)",
        lambda t: t.in_it_block and (t.first >> 12 == 0xD or t.matches(0xF800D000, 0xF0008000)),
    ),
    ("bits that should be zero (A7.7, BX) or ARMv8-M's BXNS and BLXNS", lambda t: t.first >> 8 == 0x47),
    ("CPS of the A bit, which ARMv7-M has not (B5.2, CPS)", lambda t: t.text.startswith(("cpsie", "cpsid"))),
    ("SBFX and UBFX past bit 31, UNPREDICTABLE (A7.7)", lambda t: t.text.startswith(("sbfx", "ubfx"))),
    ("BFC and BFI of no bit, UNPREDICTABLE (A7.7)", lambda t: t.text.startswith(("bfc", "bfi"))),
    ("bit 15 that should be zero (A5.3.11)", lambda t: t.matches(0xFE008000, 0xEA008000)),
    ("bit 6 that should be zero (A7.7, SXTB)", lambda t: t.matches(0xFF80F0C0, 0xFA00F0C0)),
    (
        "base in the list and written back, UNPREDICTABLE (A7.7, LDM)",
        lambda t: t.matches(0xFE400000, 0xE8000000) and _base_is_loaded(t),
    ),
    (
        "LDM or STM of one register or none, UNPREDICTABLE (A7.7, LDM)",
        lambda t: t.matches(0xFE400000, 0xE8000000) and t.second.bit_count() < 2,
    ),
    (
        "exclusive access with the SP or with one register twice, UNPREDICTABLE (A7.7, LDREX and STREX)",
        lambda t: t.text.startswith(("ldrex", "strex")) and t.matches(0xFF600000, 0xE8400000),
    ),
    (
        "acquire, release and TT of ARMv8-M",
        lambda t: t.matches(0xFF600000, 0xE8400000) and t.text[:2] in ("ld", "st", "tt"),
    ),
    ("MRS and MSR of other architectures", lambda t: t.text.startswith(("mrs", "msr"))),
    ("system registers of the FPU other than FPSCR (A7.7, VMSR)", lambda t: t.text.startswith(("vmrs", "vmsr"))),
    ("HVC, SMC and the like of other architectures", lambda t: t.text.startswith(("hvc", "smc", "dcps", "sg"))),
    ("Advanced SIMD (A5.3.18)", lambda t: t.matches(0xEF000000, 0xEF000000) or t.matches(0xFF100000, 0xF9000000)),
    (
        "coprocessor instructions of the second kind for the FPU, such as VSEL (A6.4)",
        lambda t: t.matches(0xFC000E00, 0xFC000A00),
    ),
    (
        "arithmetic of d registers, and of FPv5 (A6.4)",
        lambda t: t.matches(0xFF000F00, 0xEE000B00) or ".f64" in t.text or t.text.startswith("vrint"),
    ),
    (
        "more fraction bits than bits, UNPREDICTABLE (A7.7, VCVT)",
        lambda t: t.text.startswith("vcvt") and "#0xff" in t.text,
    ),
    ("transfer of d16 to d31, of no register or past s31 (A7.7, VLDM)", _moves_missing_registers),
)

# Defined here, although capstone does not know it.
CAPSTONE_KNOWS_LESS: tuple[Reason, ...] = (
    (
        "hint that is not allocated (A5.3.8)",
        lambda t: t.matches(0xFF7FF000, 0xF83FF000) or t.matches(0xFF70F000, 0xF930F000),
    ),
    ("STM of the SP, UNPREDICTABLE (A7.7, STM)", lambda t: t.operation == "STM" and t.second >> SP & 1 == 1),
    ("MRS and MSR of special registers that do not exist (B5.2, MRS)", lambda t: t.operation in ("MRS", "MSR")),
)

# Costs that differ: the field, the reason, and where.
COSTS_DIFFER: tuple[tuple[str, str, Callable[[Trial], bool]], ...] = (
    (
        "core_writes",
        "capstone leaves out the base that STMDB, VPUSH and VPOP write back",
        lambda t: t.operation in ("STM", "VSTM", "VLDM") and t.decoded.core_writes == 1 << t.decoded.n,
    ),
    (
        "core_writes",
        "capstone takes the value of STRBT and STRHT as written",
        lambda t: t.text.startswith(("strbt", "strht")),
    ),
    ("core_writes", "capstone lets SVC write the LR, which the exception's entry does", lambda t: t.operation == "SVC"),
    (
        "core_writes",
        "capstone lets B write the PC if it has a condition, and not without one",
        lambda t: t.operation == "B" and t.first != 0x46FF,
    ),
    ("core_writes", "MOV PC, PC is decoded as the branch that it is", lambda t: t.first == 0x46FF),
    ("transfer", "MOV PC, PC is decoded as the branch that it is", lambda t: t.first == 0x46FF),
    (
        "fp_writes",
        "capstone leaves out what VLDM loads, but not what VPOP loads",
        lambda t: t.text.startswith(("vldm", "fldm")) and t.decoded.fp_writes == _list_of_singles(t.decoded),
    ),
    (
        "fp_writes",
        "capstone takes what VPUSH stores as written",
        lambda t: t.operation == "VSTM" and t.decoded.fp_writes == 0,
    ),
    (
        "fp_reads",
        "capstone lets VMOV of half a d register read both halves, in both directions",
        lambda t: t.text.startswith("vmov.32"),
    ),
    ("fp_writes", "capstone lets VMOV of half a d register write both halves", lambda t: t.text.startswith("vmov.32")),
)


def _list_of_singles(decoded: Any) -> int:
    mask: int = ((1 << decoded.words) - 1) << decoded.d
    return mask


def _unexplained(trial: Trial, reasons: Iterable[Reason]) -> bool:
    return not any(holds(trial) for _, holds in reasons)


@cache
def _differences_to_capstone(of_each: int, pairs: int) -> tuple[list[str], dict[str, str]]:
    """Return the instructions that only one of both defines, and by field and operation examples of other costs."""
    definitions: list[str] = []
    costs: dict[str, str] = {}
    for trial in _trials(of_each, pairs):
        if trial.operation == "NO_COPROCESSOR":
            continue  # a fault whatever the instruction is
        is_defined = trial.operation != "UNDEFINED"
        if is_defined != (trial.capstone is not None):
            if _unexplained(trial, CAPSTONE_KNOWS_LESS if is_defined else CAPSTONE_KNOWS_MORE):
                definitions.append(str(trial))
        elif is_defined:
            costs.update(_other_costs(trial))
    return definitions, costs


def _other_costs(trial: Trial) -> Iterable[tuple[str, str]]:
    if trial.capstone is None:
        return
    costs = _costs(trial.decoded)
    expected = {field: getattr(trial.capstone, field) for field in (*COSTS, "row", "transfer")}
    for field, value in expected.items():
        if costs[field] != value and not any(name == field and holds(trial) for name, _, holds in COSTS_DIFFER):
            yield f"{field} of {trial.operation}", f"{trial}: {costs[field]}, expected {value}"


@pytest.mark.parametrize(COUNTS, [QUICK, THOROUGH])
def test_an_instruction_is_defined_if_capstone_knows_it_but_for_named_differences(of_each: int, pairs: int) -> None:
    definitions, _ = _differences_to_capstone(of_each, pairs)
    assert definitions[:20] == []


@pytest.mark.parametrize(COUNTS, [QUICK, THOROUGH])
def test_costs_and_size_are_those_of_capstone_but_for_named_differences(of_each: int, pairs: int) -> None:
    _, costs = _differences_to_capstone(of_each, pairs)
    assert list(costs.values()) == []


def _costs(decoded: Any) -> dict[str, Any]:
    """Return the fields of an instruction as the decoder in Python has them."""
    costs = {name: getattr(decoded, name) for name in COSTS}
    row = row_name(decoded)
    if row in ("fp_load", "fp_store"):
        costs["words"] = 0  # the decoder in Python counts words of multiple transfers alone
    return costs | {"row": row, "transfer": TRANSFERS[decoded.transfer]}


LONG_OF_BASELINE = {"BL T1", "DMB T1", "DSB T1", "ISB T1", "MRS T1", "MSR (register) T1"}
SHORT_WITHOUT_BASELINE = {"CBZ T1", "CBNZ T1", "IT T1"}


def test_a_baseline_core_has_the_instructions_of_armv6m_alone() -> None:
    """DDI 0419E, A5.2 and A5.3: those of two bytes but CBZ, CBNZ and IT, and six of four bytes."""
    for first, second in instances(20, seed=3):
        name, is_short = _encoding_name(first, second), first < WIDE
        is_of_both = name not in SHORT_WITHOUT_BASELINE if is_short else name in LONG_OF_BASELINE
        decoded, baseline = decode(ADDRESS, first, second), decode(ADDRESS, first, second, baseline=True)
        assert operation_name(baseline) == (operation_name(decoded) if is_of_both else "UNDEFINED"), name


def _encoding_name(first: int, second: int) -> str:
    """Name the encoding of an instruction. It may match several rows of its group: special cases stand first."""
    size, bits = (4, first << 16 | second) if first >= WIDE else (2, first)
    return next((row.name for row in encodings() if row.size == size and bits & row.mask == row.value), "")


def test_every_encoding_has_a_name_and_a_value_within_its_mask() -> None:
    names = [encoding.name for encoding in encodings()]
    assert len(names) > 300
    assert [name for name, count in Counter(names).items() if count > 1] == []
    for encoding in encodings():
        assert encoding.value & ~encoding.mask == 0, encoding.name
        assert encoding.size == (4 if encoding.value >> 16 else 2), encoding.name


def test_second_halfword_of_a_short_instruction_is_not_looked_at() -> None:
    for first, second in random_instructions(2000, seed=4):
        if first < WIDE:
            assert fields(decode(ADDRESS, first, second)) == fields(decode(ADDRESS, first, second ^ 0xFFFF))


# Neither capstone's text nor Unicorn tells these from instructions that must not have the PC as an operand.
WITH_PC = {
    "44f9": "ADD_I",
    "449f": "ADD_PC",
    "46f9": "MOV_I",
    "46cf": "MOV_PC",
    "4905": "LDR_L",
    "a1ff": "MOV_I",
    "bd02": "LDM",
    "f60f79ff": "MOV_I",
    "f6af79ff": "MOV_I",
    "f852fb04": "LDR_W",
    "f8dff004": "LDR_L",
    "f89f1005": "LDRB_L",
    "f8bf1006": "LDRH_L",
    "f99f1006": "LDRSB_L",
    "f9bf1006": "LDRSH_L",
    "f91ff008": "NOP",
    "e9df1202": "LDRD",
    "e9138002": "LDM",
    "e8dff001": "TBB",
    "e8dff011": "TBH",
    "eef1fa10": "VMRS",
    "eddf0a02": "VLDR",
}


def test_an_instruction_that_may_have_the_pc_as_an_operand_is_defined() -> None:
    decoded = {code: decode(ADDRESS, int(code[:4], 16), int(code[4:] or "0", 16)) for code in WITH_PC}
    assert {code: operation_name(instruction) for code, instruction in decoded.items()} == WITH_PC


@pytest.mark.parametrize(
    ("first", "it_state", "operation", "condition"),
    [(0xBE01, 0x08, "BKPT", 14), (0xBF08, 0x08, "IT", 14), (0xD000, 0x08, "UNDEFINED", 0), (0x0000, 0xF8, "MOV_R", 14)],
    ids=["breakpoint", "IT", "branch with a condition", "condition 15"],
)
def test_what_an_it_block_gives_its_condition_to_is_no_breakpoint_no_it_and_no_branch_with_a_condition(
    first: int, it_state: int, operation: str, condition: int
) -> None:
    decoded = decode(ADDRESS, first, 0, it_state)
    assert (operation_name(decoded), decoded.condition) == (operation, condition)
