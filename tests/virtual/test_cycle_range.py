"""What a count would be under another table is what a board made with that table counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.boards import open_board
from hiltest.link.messages import Calibrate
from hiltest.link.replies import RunCost
from hiltest.measurement import DOUBT, CycleRange, Measurement, RowEffect, check, ratio_range
from hiltest.procedures.cycles import upload_points
from hiltest.procedures.golden_points import golden_points
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.calling import CallResult
from hiltest.virtual.core.library import ffi
from hiltest.virtual.counts.cycle_range import Move, cycle_range, moves
from hiltest.virtual.counts.profiling import profile_call
from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.model.timing import TimingProfile, replace_values

from .conftest import SHIPPED, Build
from .oracle import priced, stepped
from .test_cycle_counting import KERNELS, call_kernel, cloud, random_program, run_kernel

PROFILE = load_profile("cortex-m4-trm/1")
MOVES = {move.row: move for move in moves(PROFILE)}
BOTH = pytest.mark.parametrize("profile", ["cortex-m4-trm/1", "cortex-m4-trm/2"])
RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"


def file_with(folder: Path, values: dict[str, int], base: str = PROFILE.name) -> str:
    """Write a profile with other values, as a user would."""
    rows = load_profile(base).rows
    lines = ['name = "moved/1"', f'base = "{base}"']
    for row, value in values.items():
        lines += [f"[cost.{row}]", f"value = {value}", f"band = {list(rows[row].band)}", 'source = "moved"']
        lines += [f'against = "{rows[row].against}"'] if rows[row].against else []
    (folder / "moved.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(folder / "moved.toml")


def band_of(result: CallResult, profile: TimingProfile) -> CycleRange:
    assert result.executed
    band = cycle_range(profile, result.cycles, [result.executed])
    assert band
    return band


def ends(band: CycleRange) -> dict[tuple[str, str], int]:
    return {(row.row, end): getattr(row, end) for row in band.rows for end in ("low", "high")}


def all_at(band: CycleRange, *, dear: bool, profile: TimingProfile = PROFILE) -> dict[str, int]:
    """Put every row where its own effect makes the count greater, or less."""
    values: dict[str, int] = {}
    of = {move.row: move for move in moves(profile)}
    for row in band.rows:
        if row.row != DOUBT:
            values |= of[row.row].high if (row.high > row.low) is dear else of[row.row].low
    return values


def without_doubt(band: CycleRange) -> tuple[int, int]:
    """Return the ends that the rows make, without what no row explains."""
    doubt = sum((row.high - row.low) // 2 for row in band.rows if row.row == DOUBT)
    return band.low + doubt, band.high - doubt


@BOTH
@pytest.mark.parametrize("seed", [1, 2])
def test_random_code_counts_under_each_moved_row_what_was_predicted(build: Build, seed: int, profile: str) -> None:
    priced_by = load_profile(profile)
    result, steps = stepped(build(random_program(seed, length=220)), "work", profile=priced_by)
    band = band_of(result, priced_by)
    of = {move.row: move for move in moves(priced_by)}

    def counted(values: dict[str, int]) -> int:
        """Count by the model in Python with these values."""
        return priced(steps, replace_values(priced_by, values))

    predicted = {key: value for key, value in ends(band).items() if key[0] != DOUBT}
    assert ("fetch_late_fp" in {row for row, _ in predicted}) is (priced_by is not PROFILE)
    assert {"fp_accumulate", "fp_accumulate_hidden", "fp_store", "it", "refill_direct", "load_behind_store"} <= {
        row for row, _ in predicted
    }
    for row, move in of.items():
        for end in ("low", "high"):
            assert counted(getattr(move, end)) == predicted.get((row, end), result.cycles), (row, end)
    low, high = without_doubt(band)
    assert counted(all_at(band, dear=False, profile=priced_by)) == low
    assert counted(all_at(band, dear=True, profile=priced_by)) == high
    # What is not in the band does not enter: all of it at once.
    unmoved = (move.high for row, move in of.items() if (row, "low") not in predicted)
    others = {name: value for values in unmoved for name, value in values.items()}
    assert "divide" in others
    assert counted(others) == result.cycles


@BOTH
@pytest.mark.parametrize("kernel", KERNELS[:1])
def test_a_kernel_counts_under_moved_rows_what_was_predicted(tmp_path: Path, kernel: str, profile: str) -> None:
    priced_by = load_profile(profile)
    result, _ = call_kernel(VirtualK64F(SHIPPED, profile=profile), kernel, cloud(40, seed=1))
    band = band_of(result, priced_by)
    for dear, bound in zip((False, True), without_doubt(band), strict=True):
        moved_to = file_with(tmp_path, all_at(band, dear=dear, profile=priced_by), profile)
        assert run_kernel(VirtualK64F(SHIPPED, profile=moved_to), kernel, cloud(40, seed=1))[0] == bound


def timed(folder: Path, timing: str) -> tuple[RunCost, CycleRange | None]:
    """Have the firmware time itself, on a board whose rig names a profile."""
    rig = RIG.read_text(encoding="utf-8")
    rig = rig.replace('kind = "virtual"\n', f'kind = "virtual"\ntiming = "{timing}"\n', 1)
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    with open_board(load_rig(folder / "rig.toml")) as board:
        upload_points(board, golden_points(20))
        cost = board.session.request(Calibrate(20, "direct")).cost
        assert cost is not None
        return cost, board.cycle_range(cost)


def test_what_the_firmware_timed_is_priced_again_with_the_empty_call_subtracted(tmp_path: Path) -> None:
    cost, band = timed(tmp_path, PROFILE.name)
    assert band is not None
    assert band.low < cost.cycles < band.high
    predicted = ends(band)
    # Both in the empty call and in what is timed: a branch to a register, and back.
    for row, end in (("fp_store", "low"), ("refill_indirect", "high")):
        moved, _ = timed(tmp_path, file_with(tmp_path, getattr(MOVES[row], end)))
        assert moved.cycles == predicted[row, end] != cost.cycles
    assert moved.overhead_cycles > cost.overhead_cycles


def test_rows_whose_sum_was_measured_move_together() -> None:
    assert MOVES["load_behind_store"] == Move(
        "load_behind_store",
        {"load_behind_store": 0, "store_behind_load": 1},
        {"load_behind_store": 1, "store_behind_load": 0},
    )
    assert "store_behind_load" not in MOVES
    assert all(PROFILE.rows[row].band[0] < PROFILE.rows[row].band[1] for row in MOVES)


def test_a_profile_without_doubt_has_a_band_without_width() -> None:
    rows = {name: type(row)(row.value, (row.value, row.value), row.source) for name, row in PROFILE.rows.items()}
    result = VirtualK64F(SHIPPED, profile=PROFILE.name).call("crc32", b"123456789", 9)
    assert band_of(result, TimingProfile("sure/1", rows)) == CycleRange(result.cycles, result.cycles)


def test_a_count_of_version_2_has_a_doubt_that_no_row_explains() -> None:
    board = VirtualK64F(SHIPPED, profile="cortex-m4-trm/2")
    result = board.call("crc32", b"123456789" * 10, 90)
    band, cycles = band_of(result, board.processor.profile), result.cycles
    doubt = -(-15 * cycles // 1000)
    assert RowEffect(DOUBT, cycles - doubt, cycles + doubt) in band.rows
    assert band.low <= cycles - doubt
    assert band.high >= cycles + doubt


def test_what_no_row_explains_is_each_counts_own_in_a_ratio() -> None:
    def count(value: int) -> Measurement:
        low, high = value * 99 // 100, value * 101 // 100
        band = CycleRange(low, high, (RowEffect(DOUBT, low, high),))
        return check("cycles", value, unit="cycle", cycle_model="m", band=band)

    assert ratio_range(count(1000), count(1000)) == pytest.approx((0.99 / 1.01, 1.01 / 0.99))


SLEEP = """
    ldr r0, =0xE000E010
    movs r1, #1000
    str r1, [r0, #4]
    movs r1, #7
    str r1, [r0]
    wfi
"""


def program(code: str) -> str:
    """Return a program whose function `work` does this and returns."""
    return f"""
        function main
        bx lr
        function work
        {code}
        bx lr
        ends work
        .ltorg
    """


def test_a_count_that_is_more_than_instructions_has_no_band(build: Build) -> None:
    # Masked, an interrupt that is pending wakes WFI at once, but somebody slept: no table prices that.
    result = VirtualK64F(build(program(SLEEP)), profile=PROFILE.name).call("work")
    assert result.executed
    assert cycle_range(PROFILE, result.cycles, [result.executed]) is None


POLLS = """
    ldr r0, =0xE000E018
    ldr r1, =0x1fff8000
    movs r3, #{times}
1:  ldr r2, [r0]
    tst r2, #8
    beq 2f
    str r2, [r1]
2:  subs r3, #1
    bne 1b
"""


def test_devices_answer_what_they_have_answered(build: Build) -> None:
    # The way through the loop depends on SysTick, which counts on.
    elf = build(program(SLEEP.replace("wfi", "") + POLLS.format(times=20)))
    result = VirtualK64F(elf, profile=PROFILE.name).call("work")
    assert result.executed
    assert band_of(result, PROFILE).high > result.cycles
    assert len({answer & 8 for answer in result.executed.answers}) == 2
    other = replace(result.executed, answers=ffi.new("uint32_t[]", 20))
    assert cycle_range(PROFILE, result.cycles, [other]) is None


def test_a_call_that_polls_a_device_for_long_is_not_executed_again(build: Build) -> None:
    assert VirtualK64F(build(program(POLLS.format(times=250) * 5))).call("work").executed is None


def test_a_count_of_code_in_flash_at_no_wait_states_has_no_band(build: Build) -> None:
    called = profile_call(VirtualK64F(build(random_program(5, length=60))), "work")
    assert called.cycle_model == "cortex-m4-trm/3@flash"
    assert called.band is None
