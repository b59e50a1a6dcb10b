"""Rules of version 2 of the cycle model: fetch, alignment and addresses, each on a few instructions."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.model.timing import moved

from .capstone_oracle import decode
from .pipeline_model import NEUTRAL, REACHED, PipelineState, Reached
from .price_model import PriceModel

VERSION_2 = load_profile("cortex-m4-trm/2")
ONE, TWO = PriceModel(load_profile("cortex-m4-trm/1")), PriceModel(VERSION_2)
DIGEST = "948bec611d8492ff4802aafb4584de486342b19705e2ddf1bdd7c6f36dd09249"

# Machine code, little-endian, written from the encodings in the ARMv7-M manual. The name says how many bytes it has.
NOP2 = bytes.fromhex("00bf")
CMP2 = bytes.fromhex("0028")  # cmp r0, #0
ADDS2 = bytes.fromhex("0132")  # adds r2, #1
ADDS_SP2 = bytes.fromhex("01b0")  # add sp, #4
LDR2 = bytes.fromhex("1368")  # ldr r3, [r2]
LDR_INDEX2 = bytes.fromhex("8b58")  # ldr r3, [r1, r2]
LDR4 = bytes.fromhex("d4f80030")  # ldr.w r3, [r4]
STR2 = bytes.fromhex("1360")  # str r3, [r2]
LDM2 = bytes.fromhex("38ca")  # ldmia r2, {r3, r4, r5}
PUSH2 = bytes.fromhex("01b4")  # push {r0}
VLDR4 = bytes.fromhex("92ed000a")  # vldr s0, [r2]
EOR4 = bytes.fromhex("81ea0200")  # eor.w r0, r1, r2
VADD4 = bytes.fromhex("31ee821a")  # vadd.f32 s2, s3, s4
VDIV4 = bytes.fromhex("80ee810a")  # vdiv.f32 s0, s1, s2
VADD_CHAIN4 = bytes.fromhex("30ee200a")  # vadd.f32 s0, s0, s1
VMOV_PAIR4 = bytes.fromhex("51ec100b")  # vmov r0, r1, d0
UMAAL4 = bytes.fromhex("e2fb6301")  # umaal r0, r1, r2, r3
IT2 = bytes.fromhex("08bf")  # it eq
MOVEQ2 = bytes.fromhex("0846")  # moveq r0, r1
BNE2 = bytes.fromhex("fed1")  # bne to itself
B4 = bytes.fromhex("fff7febf")  # b.w to itself
BX_LR2 = bytes.fromhex("7047")
POP_PC2 = bytes.fromhex("00bd")
TBB4 = bytes.fromhex("d2e801f0")  # tbb [r2, r1]
LDR_PC4 = bytes.fromhex("d4f800f0")  # ldr.w pc, [r4]


def cycles(
    code: bytes, model: PriceModel = TWO, *, at: int = 0x1000, state: PipelineState = NEUTRAL
) -> int:
    """Sum the cost of straight-line code that begins somewhere [cycles]."""
    total = 0
    for instruction in decode(at, code):
        cost, state = model.step(instruction, state)
        total += cost
    return total


def changed(values: Mapping[str, int]) -> PriceModel:
    return PriceModel(moved(VERSION_2, values))


def without(*rows: str) -> PriceModel:
    return changed(dict.fromkeys(rows, 0))


def test_version_2_never_changes_its_numbers() -> None:
    assert VERSION_2.digest == DIGEST


def test_version_2_has_the_rows_of_version_1() -> None:
    assert {name: TWO.rows[name] for name in ONE.rows} == ONE.rows


@pytest.mark.parametrize(
    "code",
    [ADDS2 + LDR2, ADDS2 + LDR_INDEX2, ADDS2 + STR2, ADDS2 + LDM2, ADDS2 + VLDR4, ADDS_SP2 + PUSH2, ADDS2 + TBB4],
    ids=["base", "index", "store", "multiple", "floating point", "stack", "table branch"],
)
def test_an_address_that_the_instruction_right_before_computed_costs_a_cycle_more(code: bytes) -> None:
    assert cycles(code) == cycles(code, ONE) + 1
    apart = code[:2] + NOP2 + code[2:]
    assert cycles(apart) == cycles(apart, ONE)


def test_only_computed_addresses_are_late() -> None:
    assert cycles(ADDS2 + LDR4) == cycles(ADDS2 + LDR4, ONE)
    assert cycles(CMP2 + LDR2) == cycles(CMP2 + LDR2, ONE)
    assert cycles(LDR2 + LDR_INDEX2) == cycles(LDR2 + LDR_INDEX2, ONE)  # a load right before has its own rule


def test_it_takes_no_cycle_behind_two_bytes_and_one_behind_four() -> None:
    assert cycles(CMP2 + IT2 + MOVEQ2) == 2
    assert cycles(EOR4 + IT2 + MOVEQ2) == 3
    assert cycles(IT2 + MOVEQ2) == 2


@pytest.mark.parametrize("code", [LDR2, STR2, LDM2, PUSH2, VLDR4, VADD_CHAIN4, UMAAL4, POP_PC2])
def test_an_instruction_that_is_skipped_takes_a_cycle_and_leaves_nothing(code: bytes) -> None:
    (instruction,) = decode(0x1000, code)
    assert TWO.step(instruction.skipped(), NEUTRAL) == (1, NEUTRAL._replace(narrow=len(code) == 2))
    assert changed({"it_skipped": 3}).step(instruction.skipped(), NEUTRAL)[0] == 3


def test_a_division_goes_on_under_what_is_skipped() -> None:
    divides, adds = decode(0x1000, VDIV4 + VADD4)
    _, busy = TWO.step(divides, NEUTRAL)
    cost, left = TWO.step(adds.skipped(), busy)
    assert (cost, left.fpu_busy) == (1, busy.fpu_busy - 1)


def test_an_address_is_late_through_an_it_that_takes_no_cycle() -> None:
    assert cycles(ADDS2 + IT2 + LDR2) == 1 + 0 + 2 + 1


def test_a_branch_that_is_not_taken_leaves_that_it_had_two_bytes_and_nothing_else() -> None:
    (branch,) = decode(0x1000, BNE2)
    assert TWO.step(branch, NEUTRAL)[1] == REACHED[TWO.reached_past(branch)]
    assert cycles(BNE2 + IT2 + MOVEQ2) == 2
    (wide,) = decode(0x1002, B4)
    assert TWO.step(wide, NEUTRAL)[1] == NEUTRAL == REACHED[TWO.reached_past(wide)]
    assert ONE.reached_past(branch) is Reached.ANYHOW


@pytest.mark.parametrize(("at", "target", "more"), [
    (0x1002, EOR4, 1), (0x1000, EOR4, 0), (0x1002, CMP2, 0), (0x1000, CMP2, 0),
])  # fmt: skip
def test_a_branch_to_a_misplaced_instruction_costs_a_cycle_more_and_a_return_to_it_none(
    at: int, target: bytes, more: int
) -> None:
    branched, returned = REACHED[Reached.BY_BRANCH], REACHED[Reached.BY_REGISTER]
    assert cycles(target, at=at, state=branched) == 1 + more
    assert cycles(target, at=at, state=returned) == 1
    assert cycles(target, changed({"return_misplaced": 1}), at=at, state=returned) == 1 + more


def test_only_the_first_instruction_behind_a_branch_pays_for_its_place() -> None:
    assert cycles(EOR4 * 3, at=0x1002, state=REACHED[Reached.BY_BRANCH]) == 4


def test_a_direct_branch_and_a_return_are_told_apart_in_version_2_alone() -> None:
    branch, back = decode(0x1002, B4)[0], decode(0x1000, BX_LR2)[0]
    assert TWO.reached(decode(0x1000, B4)[0]) is Reached.ANYHOW  # where nothing can be misplaced
    assert (TWO.reached(branch), TWO.reached(back)) == (Reached.BY_BRANCH, Reached.BY_REGISTER)
    assert (ONE.reached(branch), ONE.reached(back)) == (Reached.ANYHOW, Reached.ANYHOW)


def test_48_misplaced_floating_point_additions_lose_one_cycle_in_three() -> None:
    assert cycles(NOP2 + VADD4 * 48) == 64
    assert cycles(NOP2 + VADD4 * 48, without("fetch_late_fp")) == 49
    assert cycles(NOP2 * 2 + VADD4 * 48) == 50  # at multiples of four


def test_48_misplaced_integer_instructions_lose_nothing_with_nothing_slow_ahead() -> None:
    assert cycles(NOP2 + EOR4 * 48) == 49
    assert cycles(NOP2 + EOR4 * 48, changed({"fetch_late_integer": 1})) == 65


def test_the_third_of_three_misplaced_instructions_behind_a_slow_one_is_late() -> None:
    assert cycles(LDR2 + EOR4 * 2) == 4
    assert cycles(LDR2 + EOR4 * 3) == 6
    assert cycles(LDR2 + EOR4 * 48) == 51  # and the others are not
    assert cycles(LDR2 + EOR4 * 3, at=0x1002) == 5  # these are at multiples of four
    assert cycles(LDR2 + EOR4 * 3, without("fetch_late")) == 5


def test_anything_but_a_misplaced_instruction_between_lets_the_fetch_catch_up() -> None:
    assert cycles(LDR4 + CMP2 + EOR4 * 3) == 6
    assert cycles(LDR2 + EOR4 * 2 + CMP2 + NOP2 + EOR4 * 2) == 8
    assert cycles(LDR4 + CMP2 + EOR4 * 3, changed({"fetch_late_integer": 1})) == 7


def test_a_pair_of_moves_and_three_long_multiplications_are_late() -> None:
    assert cycles(NOP2 + VMOV_PAIR4 + UMAAL4 * 3) == 1 + 2 + 3 + 1
    assert cycles(VMOV_PAIR4 + UMAAL4 * 3) == 2 + 3


def test_a_floating_point_wait_makes_the_fetch_late_like_any_slow_instruction() -> None:
    waiting = NOP2 + VADD_CHAIN4 * 2 + EOR4 * 3
    assert cycles(waiting) == cycles(waiting, ONE) + 1
    assert cycles(waiting, without("fetch_late_fp")) == cycles(waiting)


def test_loads_that_overlap_do_not_make_the_fetch_late() -> None:
    assert cycles(LDR2 + EOR4 * 3) == 2 + 3 + 1
    assert cycles(LDR2 * 2 + EOR4 * 3, at=0x1002) == 2 + 1 + 3


@pytest.mark.parametrize(("code", "least"), [(TBB4, 6), (LDR_PC4, 5)], ids=["TBB", "LDR to the PC"])
def test_a_jump_through_a_table_takes_what_the_manual_says_at_least(code: bytes, least: int) -> None:
    (jump,) = decode(0x1000, code)
    row = TWO.rows[TWO.refill_row(jump)]
    base = TWO.step(jump, NEUTRAL)[0]
    assert base + TWO.taken(jump) == least == base + row.band[0]
    assert ONE.step(jump, NEUTRAL)[0] + ONE.taken(jump) == 4


@pytest.mark.parametrize("code", [BX_LR2, POP_PC2])
def test_other_jumps_to_registers_cost_what_they_did(code: bytes) -> None:
    (jump,) = decode(0x1000, code)
    assert TWO.taken(jump) == ONE.taken(jump) == 2
