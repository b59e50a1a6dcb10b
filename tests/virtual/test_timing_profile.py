"""The cost table and its rules, against published measurements of real parts."""

from __future__ import annotations

import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.model.timing import TimingProfile, moved

from .capstone_oracle import decode
from .pipeline_model import NEUTRAL
from .price_model import PriceModel

PROFILE = load_profile("cortex-m4-trm/1")
DIGEST = "d18e92c2bf956d09b26e346d3e99f00a08a756378a73045aefdcd5d3a019fab1"

# Machine code, little-endian, written from the encodings in the ARMv7-M manual.
LDR_R0_R1 = bytes.fromhex("0868")  # ldr r0, [r1]
LDR_R1_R1 = bytes.fromhex("0968")  # ldr r1, [r1]
STR_R0_R2 = bytes.fromhex("1060")  # str r0, [r2]
NOP = bytes.fromhex("00bf")
VADD_S0_S0_S1 = bytes.fromhex("30ee200a")  # vadd.f32 s0, s0, s1
VADD_S2_S3_S4 = bytes.fromhex("31ee821a")  # vadd.f32 s2, s3, s4
VDIV_S0_S1_S2 = bytes.fromhex("80ee810a")  # vdiv.f32 s0, s1, s2
VMOV_R0_S0 = bytes.fromhex("10ee100a")  # vmov r0, s0
VFMA_S0_S1_S2 = bytes.fromhex("a0ee810a")  # vfma.f32 s0, s1, s2


def cycles(code: bytes, profile: TimingProfile = PROFILE) -> int:
    """Sum the cost of straight-line code [cycles], from a neutral pipeline on."""
    total, state, model = 0, NEUTRAL, PriceModel(profile)
    for instruction in decode(0x1000, code):
        cost, state = model.step(instruction, state)
        total += cost
    return total


def with_values(**values: int) -> TimingProfile:
    return moved(PROFILE, values)


def test_a_published_version_never_changes_its_numbers() -> None:
    # A correction is a new profile, and a new line here. Only a row that prices nothing may be added.
    assert PROFILE.digest == DIGEST


def test_every_row_has_a_source_and_a_band_around_its_value() -> None:
    for name, row in PROFILE.rows.items():
        assert row.source, name
        assert row.band[0] <= row.value <= row.band[1], name


def test_an_unknown_profile_is_named_with_those_that_exist() -> None:
    with pytest.raises(ConfigError, match="cortex-m4-trm/1"):
        load_profile("cortex-m4-trm/0")


@pytest.mark.parametrize(
    ("name", "code", "measured"),
    [
        ("100 loads", LDR_R0_R1 * 100, 101),
        ("200 loads, none waits for another", LDR_R0_R1 * 200, 201),
        ("200 loads, each from the address before", LDR_R1_R1 * 200, 400),
        ("VDIV, NOP, then its result", VDIV_S0_S1_S2 + NOP + VMOV_R0_S0, 16),
    ],
)
def test_sequences_cost_what_was_measured_on_an_stm32f429(name: str, code: bytes, measured: int) -> None:
    assert cycles(code) == measured, name


def test_floating_point_additions_cost_what_was_measured_on_an_stm32f429() -> None:
    # 200 additions and a VMOV that reads a register the last one did not write.
    assert cycles(VADD_S2_S3_S4 * 200 + VMOV_R0_S0) == 201
    # Each waits one cycle for the one before; so does the VMOV for the last.
    assert cycles(VADD_S0_S0_S1 * 200 + VMOV_R0_S0) == 401


def test_load_and_store_pairs_cost_what_was_measured_on_an_frdm_k64f() -> None:
    # 302 clocks for 100 pairs, read off a timer; a reading of 1 or 2 clocks of overhead is inside 1 %.
    assert cycles((LDR_R0_R1 + STR_R0_R2) * 100) == pytest.approx(302, rel=0.01)
    ldm8 = bytes.fromhex("90e8f80b")  # ldm.w r0, {r3-r9, r11}: eight words
    stm8 = bytes.fromhex("82e8f80b")  # stm.w r2, {r3-r9, r11}
    assert cycles((ldm8 + stm8) * 100) == pytest.approx(1804, rel=0.01)


@pytest.mark.parametrize(("store_behind_load", "load_behind_store"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_the_measured_pairs_fix_the_sum_of_two_rows_and_neither_alone(
    store_behind_load: int, load_behind_store: int
) -> None:
    profile = with_values(store_behind_load=store_behind_load, load_behind_store=load_behind_store)
    counted = cycles((LDR_R0_R1 + STR_R0_R2) * 100, profile)
    assert (counted == pytest.approx(302, rel=0.01)) == (store_behind_load + load_behind_store == 1)


def test_a_multiply_accumulate_does_not_wait_for_its_addend() -> None:
    assert cycles(VFMA_S0_S1_S2 * 10) == 30


@pytest.mark.parametrize("integers", range(5))
def test_integer_work_goes_on_under_a_multiply_accumulate_as_far_as_the_table_hides_it(integers: int) -> None:
    hidden = with_values(fp_accumulate_hidden=2)
    independent = VFMA_S0_S1_S2 + NOP * integers + VADD_S2_S3_S4
    dependent = VFMA_S0_S1_S2 + NOP * integers + VMOV_R0_S0
    assert cycles(independent) == 3 + integers + 1
    assert cycles(independent, hidden) == max(3, 1 + integers) + 1
    # The result is a cycle later than the FPU, whoever waits for it.
    assert cycles(dependent) == 3 + max(integers, 1) + 1
    assert cycles(dependent, hidden) == max(4, 1 + integers) + 1


def test_a_chain_of_multiply_accumulates_costs_the_same_with_nothing_to_hide_under_them() -> None:
    # The last one's cycles are hidden under what is not there.
    assert cycles(VFMA_S0_S1_S2 * 10, with_values(fp_accumulate_hidden=2)) == 30 - 2


def test_integer_work_goes_on_under_a_division() -> None:
    assert cycles(VDIV_S0_S1_S2 + NOP * 13 + VADD_S2_S3_S4) == 15
    assert cycles(VDIV_S0_S1_S2 + NOP * 14 + VMOV_R0_S0) == 16
    assert cycles(VDIV_S0_S1_S2 + VADD_S2_S3_S4) == 15


def test_a_branch_waits_for_an_unfinished_division() -> None:
    branch = bytes.fromhex("fee7")
    assert cycles(VDIV_S0_S1_S2 + branch) == 14


def test_the_state_behind_a_transfer_is_neutral() -> None:
    load, branch = decode(0, LDR_R0_R1 + bytes.fromhex("fee7"))
    _, state = PriceModel(PROFILE).step(load, NEUTRAL)
    assert state is not NEUTRAL
    assert PriceModel(PROFILE).step(branch, state)[1] is NEUTRAL
