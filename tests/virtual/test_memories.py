"""The K64F's memories: what an owner of a board measured, what the flash controller does, what SRAM leaves alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.measurement import runs_from_flash
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, MEMORY_ROWS, load_profile
from hiltest.virtual.profiling.image import ProfiledImage

from .conftest import SHIPPED, Build
from .test_cycle_counting import cloud, run_kernel
from .test_measured_sequences import FRAME, LDM_STM

PAGE = (Path(__file__).parents[2] / "docs" / "timing.md").read_text(encoding="utf-8")
MEMORIES = "cortex-m4-k64f/3"
ROWS = load_profile(MEMORIES).memory
CODE = {"flash": 0x8000, "lower": 0x1FFF4000, "upper": 0x20004000}
DATA = {"lower": 0x1FFF8000, "upper": 0x20010000}
LDR_STR = "ldr r0, [r1]\n str r0, [r2]"
# Clocks of 100 pairs, as they were measured on an FRDM-K64F at 120 MHz with prefetch on.
MEASURED = {
    ("flash", "lower"): (410, 1815),
    ("flash", "upper"): (310, 1810),
    ("lower", "lower"): (402, 1904),
    ("lower", "upper"): (302, 1804),
    ("upper", "lower"): (304, 1806),
    ("upper", "upper"): (405, 2106),
}
# Reading the timer is in what was measured, and not in what is counted: 3 and 4 clocks at L/U, where nothing waits. The
# timer counts every other clock. In flash a read at either end may have to wait for up to two flash clocks, 9 of the
# core's, by where the code happens to lie. Fetches over the system bus, in U, are a clock or two later at either end.
TOLERANCE = {"flash": 9, "lower": 4, "upper": 6}


def board_with(build: Build, code: str, data: str, pair: str) -> VirtualK64F:
    places = f"-Wl,--section-start=.fast={CODE[code]:#x},--section-start=.far={DATA[data]:#x}"
    return VirtualK64F(build(FRAME.format(sequence=f".rept 100\n {pair}\n .endr"), places), profile=MEMORIES)


def clocks(build: Build, code: str, data: str, pair: str) -> int:
    board = board_with(build, code, data, pair)
    return board.call("work").cycles - board.call("empty").cycles


@pytest.mark.parametrize(("code", "data"), MEASURED)
def test_pairs_in_every_memory_take_the_clocks_that_were_measured(build: Build, code: str, data: str) -> None:
    counted = [clocks(build, code, data, pair) for pair in (LDR_STR, LDM_STM)]
    assert counted == [pytest.approx(item, abs=TOLERANCE[code]) for item in MEASURED[code, data]]
    names = {"flash": "flash", "lower": "SRAM_L", "upper": "SRAM_U"}
    measured = MEASURED[code, data]
    row = f"| {names[code]}, {names[data]} | {measured[0]} | {counted[0]} | {measured[1]} | {counted[1]} |"
    assert row in PAGE.splitlines()


def test_a_call_takes_the_same_clocks_whatever_was_called_before(build: Build) -> None:
    # Each loads one constant from beside its code, which waits half a clock in the mean: nobody pays another's half.
    board = board_with(build, "lower", "upper", LDR_STR)
    work, empty = board.call("work"), board.call("empty")
    assert [board.call("empty"), board.call("empty"), board.call("work")] == [empty, empty, work]


def test_a_kernel_in_lower_sram_with_data_in_upper_sram_waits_only_for_its_constants() -> None:
    plain = run_kernel(VirtualK64F(SHIPPED), "magnetometer_direct", cloud(20, seed=1))
    board = VirtualK64F(SHIPPED, profile=MEMORIES)
    counted = run_kernel(board, "magnetometer_direct", cloud(20, seed=1))
    assert counted[1:] == plain[1:]
    # Its constants stand behind its code: a load of one meets a fetch in the same bank. Nothing else waits.
    assert 0 <= counted[0] - plain[0] <= 0.005 * plain[0]


@pytest.mark.parametrize(
    ("access", "parts"),
    [
        ("ldr r0, [r1]", 1),
        ("ldr r0, [r1, #1]", 3),
        ("ldr r0, [r1, #2]", 2),
        ("ldr r0, [r1, #3]", 3),
        ("str r0, [r1, #2]", 2),
        ("ldrh r0, [r1, #2]", 1),
        ("ldrsh r0, [r1, #1]", 2),
        ("strh r0, [r1, #3]", 2),
        ("ldrb r0, [r1, #3]", 1),
        ("vldm r1, {s0-s3}", 1),
    ],
)
def test_an_access_at_no_multiple_of_its_size_takes_a_clock_for_each_part(
    build: Build, access: str, parts: int
) -> None:
    places = f"-Wl,--section-start=.fast={CODE['lower']:#x},--section-start=.far={DATA['upper']:#x}"
    elf = build(FRAME.format(sequence=f"nop\n {access}\n nop"), places)
    aligned, cycles = (VirtualK64F(elf, profile=f"cortex-m4-trm/{version}").call("work").cycles for version in (2, 3))
    assert cycles - aligned == parts - 1


def test_a_call_is_counted_alike_with_and_without_its_profile_and_the_memories_on_top_of_the_instructions() -> None:
    argument = (b"123456789", 9)
    board = VirtualK64F(SHIPPED, profile=MEMORIES)
    counted = board.call("crc32", *argument)
    profiled = ProfiledImage(SHIPPED, timing=MEMORIES).call("crc32", *argument)
    assert (counted.value, counted.cycles, counted.instructions) == (
        profiled.value,
        profiled.cycles,
        profiled.instructions,
    )
    plain = VirtualK64F(SHIPPED).call("crc32", *argument)
    assert (plain.value, plain.instructions) == (counted.value, counted.instructions)
    core = board.processor.core
    assert plain.cycles == counted.cycles - core.memory_cycles + core.address_cycles


def test_code_in_flash_waits_and_its_total_carries_its_uncertainty() -> None:
    plain = ProfiledImage(SHIPPED).call("crc32", b"123456789", 9)
    called = ProfiledImage(SHIPPED, timing=MEMORIES).call("crc32", b"123456789", 9)
    assert (called.value, called.instructions) == (plain.value, plain.instructions)
    assert called.cycle_model == f"{MEMORIES}@flash"
    assert runs_from_flash(called.cycle_model)
    assert (called.memory_cycles or 0) - (plain.memory_cycles or 0) == called.cycles - plain.cycles > 0
    assert called.band is not None
    assert (called.band.low, called.band.high) == (round(0.85 * called.cycles), round(1.15 * called.cycles))
    assert (called.counts_memories, plain.counts_memories) == (True, False)


def test_what_the_memories_add_is_in_the_total_and_the_parts_still_add_up() -> None:
    called = ProfiledImage(SHIPPED, timing=MEMORIES).call("crc32", b"123456789", 9)
    parts = sum(called.work.values()) + sum(called.stalls.values()) + called.asleep_cycles
    assert parts + (called.memory_cycles or 0) == called.cycles


def test_the_default_profile_knows_no_memories_and_this_one_prices_instructions_alike() -> None:
    assert load_profile(DEFAULT_PROFILE).memory == {}
    assert load_profile(MEMORIES).rows == load_profile(DEFAULT_PROFILE).rows
    assert list(ROWS) == list(MEMORY_ROWS)


def test_a_file_may_change_a_few_rows_of_a_profile_that_ships(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    row = '[memory.flash_clocks]\nvalue = 4\nband = [4, 4]\nsource = "100 MHz"\n'
    file.write_text(f'name = "slower/1"\nbase = "{MEMORIES}"\n{row}', encoding="utf-8")
    mine = load_profile(str(file))
    assert mine.memory == ROWS | {"flash_clocks": mine.memory["flash_clocks"]}
    assert mine.memory["flash_clocks"].value == 4
    assert mine.rows == load_profile(DEFAULT_PROFILE).rows


def memory(row: str, value: int, most: int | None = None) -> str:
    """Write the profile with one other row."""
    band = f"[{value}, {most or value}]"
    return f'name = "a"\nbase = "{MEMORIES}"\n[memory.{row}]\nvalue = {value}\nband = {band}\nsource = "x"'


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('name = "a"\nbase = "gone/1"', 'base: must be a shipped profile: .*; not "gone/1"'),
        ('name = "a"\nbase = 3', "base: must be a shipped profile"),
        (
            f'name = "a"\nbase = "{DEFAULT_PROFILE}"\n[memory.flash_clocks]\nvalue = 4\nband = [4, 4]\nsource = "x"',
            "memory.flash_line_bytes is missing, 12 rows in total",
        ),
        (
            f'name = "a"\nbase = "{MEMORIES}"\n[memory.flash_clocks]\nvalue = 0\nband = [0, 4]\nsource = "x"',
            "flash_clocks.value: must be a whole number from 1",
        ),
        (memory("cache_sets", 3), "cache_sets.value: must be a power of two, not 3"),
        (memory("cache_sets", 4, 6), "cache_sets.band: must be a power of two, not 6"),
        (memory("flash_line_bytes", 7), "flash_line_bytes.value: must be a power of two, not 7"),
        (memory("flash_line_bytes", 2), "flash_line_bytes.value: must be a whole number from 4 to 1000, not 2"),
        (memory("flash_line_bytes", 4), "cache_entry_bytes must be at most flash_line_bytes"),
        (memory("flash_read_ahead", 2), "flash_read_ahead.value: must be a whole number from 0 to 1, not 2"),
        (memory("flash_uncertainty", 200), "flash_uncertainty.value: must be a whole number from 0 to 100, not 200"),
        (f'name = "a"\nbase = "{MEMORIES}"\n[memory.flash]\nvalue = 0', "memory: unknown key 'flash'"),
        (f'name = "a"\nbase = "{MEMORIES}"\nmemory = 3', r"no table \[memory.ROW\]"),
    ],
)
def test_what_is_no_memory_table_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=complaint):
        load_profile(str(tmp_path / "mine.toml"))
