"""The cycle model in C gives the cycles, and leaves the states, of the model in Python.

Sequences and profiles are random: any instruction behind any other, executed, skipped, taken or not, at multiples of
four and between them, by any values of the rows, and with or without the rows that a profile need not have.
"""

from __future__ import annotations

import random
import subprocess
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hiltest.virtual.model import timing
from hiltest.virtual.model.profile_file import AT_LEAST, ROWS, RULES, load_profile
from hiltest.virtual.part.part_file import load_part

from .. import pipeline_model as pipeline  # the model in Python
from ..capstone_oracle import Instruction, decode
from ..price_model import RULE_ROWS, PriceModel
from .inner_library import inner_library

PROFILES = ("cortex-m4-trm/1", "cortex-m4-trm/2", "cortex-m4-trm/3")
OTHER_CORES = ("generic-m0plus", "generic-m3", "generic-m33")
UNPRICED = "doubt_permille"  # a row that says how far a count may be wrong
OF_DATA = ("unaligned", "load_other_block")  # rows that depend on the addresses of data, see test_data_addresses.py
OF_LOADS = ("load_same_base", "multiple_behind_store")
CANDIDATES = ("misplaced_on_end", "late_past_narrow")  # rows of no profile file, see rule_candidates.py
OF_OTHER_CORES = (*pipeline.MULTIPLIES, "refill_call", "refill_multiple")
OF_TRANSFERS = ("refill_table", "refill_load", "tail_chain", "fp_frame")
OPTIONAL = sorted({*RULE_ROWS, *OF_TRANSFERS, *OF_LOADS, *OF_OTHER_CORES, *CANDIDATES})
DEAREST = 1000
LONGEST_DIVISION = DEAREST - 1  # its result may be a cycle later
LARGEST = 24  # more than any sum of waits in these sequences: each row can be told from the others

BEFORE = {"": "0", "load": "ROW_load", "store": "ROW_store"}
TRANSFERS = {"": "TRANSFER_NONE", "direct": "TRANSFER_DIRECT", "indirect": "TRANSFER_INDIRECT"}

# Few registers, so that instructions often use the results of others. The numbers are IT EQ, ITE NE, ITT GT and ITETE
# LT: an assembler would want their blocks.
TEMPLATES = """
    nop; adds {a}, {b}, {c}; add.w {a}, {b}, {c}; adds {a}, #3; mov {a}, {b}; eor.w {a}, {b}, {c}; mul {a}, {b}, {c}
    umaal {a}, {d}, {b}, {c}; muls {a}, {b}; mla {a}, {b}, {c}, {d}; mls {a}, {b}, {c}, {d}
    umull {a}, {d}, {b}, {c}; smull {a}, {d}, {b}, {c}; umlal {a}, {d}, {b}, {c}; smlal {a}, {d}, {b}, {c}
    smlad {a}, {b}, {c}, {d}; sdiv {a}, {b}, {c}; udiv {a}, {b}, {c}; cmp {a}, {b}
    add sp, #8; sub sp, #8; movw {a}, #4660; clz {a}, {b}; bfi {a}, {b}, #3, #5; adr {a}, . + 16
    ldr {a}, [{b}]; ldr.w {a}, [{b}, #8]; ldr {a}, [{b}, {c}]; ldrb.w {a}, [{b}, {c}, lsl #2]; ldrsh.w {a}, [{b}, #-2]
    ldr {a}, [{b}], #4; ldr {a}, [{b}, #4]!; ldr {a}, [sp, #8]; ldr.w {a}, [pc, #8]; ldrt {a}, [{b}]
    str {a}, [{b}]; str.w {a}, [{b}, #8]; str {a}, [{b}, {c}]; strh.w {a}, [{b}, {c}, lsl #1]; strb {a}, [{b}], #1
    str {a}, [sp, #4]; ldrd {a}, {d}, [{b}]; strd {a}, {d}, [{b}, #8]!; ldm {b}!, {{r4, r5, r6}}; stm {b}!, {{r4, r5}}
    ldmdb {b}, {{r4-r7}}; stmdb.w {b}!, {{r4, r8, r9}}; push {{{a}, r4, lr}}; pop {{{a}, r4}}; push.w {{r4-r11}}
    ldrex {a}, [{b}]; strex {d}, {a}, [{b}]; ldrexb {a}, [{b}]; clrex; dmb; dsb; isb; mrs {a}, primask; cpsid i
    msr basepri, {a}; sev; wfi; svc 3; bkpt 1; yield; sev.w; nop.w
    vadd.f32 {s}, {t}, {u}; vsub.f32 {s}, {t}, {u}; vmul.f32 {s}, {t}, {u}; vnmul.f32 {s}, {t}, {u}
    vdiv.f32 {s}, {t}, {u}; vsqrt.f32 {s}, {t}; vmla.f32 {s}, {t}, {u}; vfma.f32 {s}, {t}, {u}; vfnms.f32 {s}, {t}, {u}
    vnmla.f32 {s}, {t}, {u}; vneg.f32 {s}, {t}; vabs.f32 {s}, {t}; vcmp.f32 {s}, {t}; vcmpe.f32 {s}, #0
    vmov.f32 {s}, {t}; vmov.f32 {s}, #1.0; vmov {s}, {a}; vmov {a}, {s}; vmov {a}, {d}, d1; vmov d1, {a}, {d}
    vmrs APSR_nzcv, fpscr; vmrs {a}, fpscr; vmsr fpscr, {a}; vcvt.s32.f32 {s}, {t}; vcvt.f32.u32 {s}, {t}
    vcvtb.f32.f16 {s}, {t}; vldr {s}, [{b}, #4]; vstr {s}, [{b}, #4]; vldr d1, [{b}]; vstr d1, [{b}]
    vldm {b}!, {{s0-s3}}; vstmdb {b}!, {{s2-s7}}; vpush {{d0-d2}}; vpop {{d0-d1}}; vldr {s}, [pc, #8]
    .hword 0xbf08; .hword 0xbf14; .hword 0xbfc4; .hword 0xbfb5
    b . + 8; b . + 10; beq . + 6; bne . + 12; b.w . + 8; b.w . + 10; bhi.w . + 6; bl . + 20; bl . + 22
    bx lr; bx {a}; blx {a}; cbz {a}, . + 8; cbnz {a}, . + 6; tbb [{b}, {c}]; tbh [{b}, {c}, lsl #1]
    pop {{pc}}; pop.w {{r4-r8, pc}}; ldm {b}, {{r4, pc}}; ldr pc, [{b}]; ldr.w pc, [{b}, {c}, lsl #2]; ldr pc, [{b}], #4
    mov pc, {a}; add pc, {a}
"""
VARIANTS = 6  # of each template, with other registers


class Step(NamedTuple):
    """What execution does: which instruction, where, and how it goes."""

    number: int  # of the instruction in the assembled code
    halfword: int  # place
    predicated: bool
    goes: str  # "on", "skipped" or "away": a transfer that is taken


def source_lines() -> list[str]:
    """Return the assembly text of all instructions, the same in each run."""
    chance = random.Random(1)
    lines = []
    for template in TEMPLATES.replace("\n", ";").split(";"):
        for _ in range(VARIANTS if template.strip() else 0):
            a, b, c, d = (f"r{number}" for number in chance.sample(range(4), 4))
            s, t, u = (f"s{chance.randrange(3)}" for _ in range(3))
            lines.append(template.strip().format(a=a, b=b, c=c, d=d, s=s, t=t, u=u))
    return lines


@pytest.fixture(scope="session")
def codes(require_tool: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Assemble the instructions; returns the bytes of each, those of each row of a profile equally often."""
    folder = tmp_path_factory.mktemp("instructions")
    source, built, binary = (folder / name for name in ("all.s", "all.o", "all.bin"))
    source.write_text(".syntax unified\n.thumb\n" + "\n".join(source_lines()) + "\n")
    compiler, copier = require_tool("arm-none-eabi-as"), require_tool("arm-none-eabi-objcopy")
    command = [compiler, "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-o", str(built), str(source)]
    subprocess.run(command, check=True, timeout=60)
    subprocess.run([copier, "-O", "binary", built, binary], check=True, timeout=60)
    return balanced(split(binary))


def balanced(codes: Sequence[bytes]) -> list[bytes]:
    """Return some instructions so often that each row prices as many of them: most are of the row "data"."""
    rows: dict[str, list[bytes]] = {}
    for code in codes:
        rows.setdefault(decoded(code, 0x1000, False).row, []).append(code)
    largest = max(map(len, rows.values()))
    return [row[number % len(row)] for number in range(largest) for row in rows.values()]


def split(binary: Path) -> list[bytes]:
    """Return the bytes of each instruction of some code."""
    code = binary.read_bytes()
    return [code[item.address :][: item.size] for item in decode(0, code)]


@cache
def decoded(code: bytes, address: int, predicated: bool) -> Instruction:
    (instruction,) = decode(address, code, int(predicated))
    return instruction


@cache
def in_c(instruction: Instruction) -> Any:
    """Return an instruction as the model in C takes it."""
    ffi, library = inner_library()
    target = instruction.target
    assert target is not None or instruction.transfer != "direct", f"{instruction.text} has no target"
    return ffi.new(
        "struct instruction *",
        {
            "row": getattr(library, f"ROW_{instruction.row}"),
            "size": instruction.size,
            "words": instruction.words,
            "transfer": getattr(library, TRANSFERS[instruction.transfer]),
            "conditional": instruction.conditional,
            "in_it_block": instruction.predicated,
            "uses_fpu": instruction.uses_fpu,
            "immediate": target or 0,
            "address_registers": instruction.address_registers,
            "loaded_registers": instruction.loaded_registers,
            "core_writes": instruction.core_writes,
            "stepped_base": instruction.stepped_base,
            "loads_multiple": instruction.loads_multiple,
            "moves_from_fpu": instruction.moves_from_fpu,
            "fp_reads": instruction.fp_reads,
            "fp_writes": instruction.fp_writes,
            "fp_addend": instruction.fp_addend,
        },
    )


def state_in_c(state: pipeline.PipelineState) -> Any:
    """Return a state as it is to be in C: what is not set is zero."""
    ffi, library = inner_library()
    before = getattr(library, BEFORE[state.before]) if state.before else 0
    fields = state._asdict() | {"before": before, "late": int(state.late), "reached": int(state.reached)}
    return ffi.new("struct pipeline *", fields)


def prices_in_c(profile: timing.TimingProfile) -> Any:
    ffi, library = inner_library()
    prices = ffi.new("struct prices *")
    for name, row in profile.rows.items():
        assert name == UNPRICED or library.set_price(prices, name.encode(), row.value)
    return prices


def in_bytes(state: Any) -> bytes:
    ffi, _ = inner_library()
    return bytes(ffi.buffer(state))


def priced_in_python(
    profile: timing.TimingProfile, instruction: Instruction, goes: str, state: pipeline.PipelineState
) -> tuple[int, pipeline.PipelineState]:
    model = PriceModel(profile)
    observed = instruction.skipped() if goes == "skipped" and model.prices_skipped else instruction
    cycles, remainder = model.step(observed, state)
    if goes == "away":
        return cycles + model.taken(instruction), pipeline.REACHED[model.reached(instruction)]
    return cycles, remainder


def priced_in_c(prices: Any, instruction: Instruction, goes: str, state: Any) -> int:
    """Price an instruction; `state` is changed to what it leaves."""
    ffi, library = inner_library()
    function = library.price_skipped if goes == "skipped" else library.price_instruction
    other = ffi.new("struct pipeline *")
    ffi.buffer(other)[:] = b"\xff" * ffi.sizeof("struct pipeline")
    cycles: int = function(prices, in_c(instruction), instruction.address, state, other)
    assert function(prices, in_c(instruction), instruction.address, state, state) == cycles
    assert in_bytes(state) == in_bytes(other)  # whether it is written to the same place or to another one
    if goes == "away":
        cycles += library.price_refill(prices, in_c(instruction), state)
    return cycles


def assert_alike(profile: timing.TimingProfile, codes: Sequence[bytes], steps: Sequence[Step]) -> None:
    """Compare cycles and states behind each of some instructions."""
    prices = prices_in_c(profile)
    state: pipeline.PipelineState = pipeline.NEUTRAL
    state_c = state_in_c(state)
    for place, step in enumerate(steps):
        code = codes[step.number % len(codes)]
        instruction = decoded(code, 0x1000 + 2 * step.halfword, step.predicated)
        goes = "on" if step.goes == "away" and not instruction.transfer else step.goes
        expected, state = priced_in_python(profile, instruction, goes, state)
        counted = priced_in_c(prices, instruction, goes, state_c)
        text = f"instruction {place}: {instruction.text} at 0x{instruction.address:x} goes {goes}, {state}"
        assert counted == expected, text
        assert in_bytes(state_c) == in_bytes(state_in_c(state)), text


def profile_of(values: Mapping[str, int]) -> timing.TimingProfile:
    return timing.TimingProfile(
        "random/1", {name: timing.CostRow(value, (value, value), "") for name, value in values.items()}
    )


def random_values(chance: random.Random) -> dict[str, int]:
    """Return values of all rows that a profile must have, and of some that it may have; some are zero."""
    names = [*ROWS, *chance.sample(OPTIONAL, chance.choice((0, 0, 1, 3, len(OPTIONAL) // 2, len(OPTIONAL))))]
    low = {name: AT_LEAST.get(name, 0) for name in names}
    values = {name: max(least, chance.choice((0, 1, 2, chance.randint(0, LARGEST)))) for name, least in low.items()}
    if "misplaced_on_end" in values:
        values["misplaced_on_end"] = chance.choice((2, 3))
    values["fp_divide"] = chance.choice((1, 2, 14, chance.randint(1, LONGEST_DIVISION)))
    values["fp_divide_use"] = values["fp_divide"] + chance.randint(0, 1)
    return values


STEPS = st.lists(
    st.builds(
        Step, st.integers(0, 10_000), st.integers(0, 3), st.booleans(), st.sampled_from(("on", "on", "skipped", "away"))
    ),
    min_size=1,
    max_size=60,
)
RANDOMLY = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


@RANDOMLY
@given(st.randoms(use_true_random=False), STEPS)
def test_random_sequences_take_the_cycles_of_random_profiles(
    codes: list[bytes], chance: random.Random, steps: list[Step]
) -> None:
    assert_alike(profile_of(random_values(chance)), codes, steps)


def profile_named(name: str) -> timing.TimingProfile:
    return load_profile(name) if name in PROFILES else load_part(name).timing()


@pytest.mark.parametrize("name", [*PROFILES, *OTHER_CORES])
def test_three_instructions_of_any_three_rows_take_the_cycles_of_the_profiles_that_ship(
    name: str, codes: list[bytes]
) -> None:
    chance, profile = random.Random(name), profile_named(name)
    rows: dict[str, list[int]] = {}
    for number, code in enumerate(codes):
        rows.setdefault(decoded(code, 0x1000, False).row, []).append(number)
    assert rows.keys() == {row for row in (*ROWS, *pipeline.MULTIPLIES) if f"ROW_{row}" in row_names()}
    for three in product(rows.values(), repeat=3):
        # A multiply-accumulate behind them waits for all that they left in the FPU.
        numbers = [chance.choice(row) for row in three] + [chance.choice(rows["fp_accumulate"])]
        goes = chance.choices(("on", "skipped", "away"), weights=(8, 1, 3), k=4)
        steps = [Step(number, chance.randrange(4), False, way) for number, way in zip(numbers, goes, strict=True)]
        assert_alike(profile, codes, steps)


def row_names() -> set[str]:
    """Return the rows that a class of instructions has."""
    ffi, _ = inner_library()
    return set(ffi.typeof("enum cost_row").relements)


@pytest.mark.parametrize("name", PROFILES)
def test_a_transfer_that_is_not_taken_leaves_what_the_old_model_says(name: str, codes: list[bytes]) -> None:
    _, library = inner_library()
    profile = load_profile(name)
    prices = prices_in_c(profile)
    for code in codes:
        instruction = decoded(code, 0x1002, False)
        if instruction.transfer:
            ffi, _ = inner_library()
            past = ffi.new("struct pipeline *", library.pipeline_past(prices, in_c(instruction)))
            expected = pipeline.REACHED[PriceModel(profile).reached_past(instruction)]
            assert in_bytes(past) == in_bytes(state_in_c(expected)), instruction.text


@pytest.mark.parametrize("how", pipeline.Reached)
def test_states_that_no_code_before_decides_are_those_of_the_old_model(how: pipeline.Reached) -> None:
    ffi, library = inner_library()
    state = ffi.new("struct pipeline *", library.pipeline_reached(getattr(library, f"REACHED_{how.name}")))
    assert in_bytes(state) == in_bytes(state_in_c(pipeline.REACHED[how]))


def test_every_row_of_a_profile_but_its_doubt_is_a_price() -> None:
    ffi, library = inner_library()
    prices = ffi.new("struct prices *")
    rows = [*ROWS, *(name for name in RULES if name != UNPRICED), *CANDIDATES]
    for number, name in enumerate(rows):
        assert library.set_price(prices, name.encode(), number + 1), name
    assert list(prices.has) == [True] * library.PRICE_ROWS
    for number, name in enumerate(rows):
        assert prices.value[getattr(library, f"ROW_{name}")] == number + 1, name


@pytest.mark.parametrize(
    ("row", "value"),
    [
        ("", 1),
        ("loads", 1),
        ("loa", 1),
        (UNPRICED, 15),
        ("load", -1),
        ("load", DEAREST + 1),
    ],
)
def test_a_row_that_is_none_or_out_of_range_is_refused_and_changes_nothing(row: str, value: int) -> None:
    ffi, library = inner_library()
    prices = ffi.new("struct prices *")
    before = bytes(ffi.buffer(prices))
    assert not library.set_price(prices, row.encode(), value)
    assert bytes(ffi.buffer(prices)) == before


def test_the_dearest_values_are_priced_without_overflow(codes: list[bytes]) -> None:
    # All but a division, which is as long as `fpu_busy` can count.
    values = dict.fromkeys((*ROWS, *OPTIONAL), DEAREST) | {
        "fp_divide": LONGEST_DIVISION,
        "fp_divide_use": LONGEST_DIVISION,
        "fp_accumulate_hidden": LONGEST_DIVISION - 1,
    }
    chance = random.Random(0)
    steps = [Step(chance.randrange(len(codes)), chance.randrange(4), False, "on") for _ in range(1000)]
    assert_alike(profile_of(values), codes, steps)
