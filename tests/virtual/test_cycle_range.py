"""What a count would be under another table is what a board made with that table counts."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from hiltest.boards import open_board
from hiltest.link.messages import Calibrate
from hiltest.link.replies import RunCost
from hiltest.measurement import DOUBT, CycleRange, Measurement, RowEffect, check, ratio_range
from hiltest.procedures.cycles import upload_points
from hiltest.procedures.golden_points import golden_points
from hiltest.rig.file import load_rig
from hiltest.virtual.accounting import AccountingFactory, InstructionAccounting
from hiltest.virtual.cycle_range import Move, cycle_range, moves
from hiltest.virtual.executions import between
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.profile_file import load_profile
from hiltest.virtual.profiling import ProfilingAccounting, profile_call
from hiltest.virtual.timing import TimingProfile

from .conftest import SHIPPED, Build
from .test_cycle_counting import KERNELS, cloud, random_program, run_kernel
from .test_faults import HEAD, TAIL

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


def band_of_call(board: VirtualK64F, function: str, *arguments: bytes | int) -> tuple[int, CycleRange | None]:
    accounting = board.processor.accounting
    before = accounting.snapshot(0)
    result = board.call(function, *arguments)
    executed = between(before, accounting.snapshot(0))
    return result.cycles, cycle_range(board.processor.profile, result.cycles, executed) if executed else None


def ends(band: CycleRange) -> dict[tuple[str, str], int]:
    return {(each.row, end): getattr(each, end) for each in band.rows for end in ("low", "high")}


def all_at(band: CycleRange, *, dear: bool, profile: TimingProfile = PROFILE) -> dict[str, int]:
    """Put every row where its own effect makes the count greater, or less."""
    values: dict[str, int] = {}
    of = {move.row: move for move in moves(profile)}
    for each in band.rows:
        if each.row != DOUBT:
            values |= of[each.row].high if (each.high > each.low) is dear else of[each.row].low
    return values


def without_doubt(band: CycleRange) -> tuple[int, int]:
    """Return the ends that the rows make, without what no row explains."""
    doubt = sum((each.high - each.low) // 2 for each in band.rows if each.row == DOUBT)
    return band.low + doubt, band.high - doubt


@pytest.mark.slow  # a board for each row
@BOTH
@pytest.mark.parametrize("seed", [1, 2])
def test_random_code_counts_under_each_moved_row_what_was_predicted(
    build: Build, block_hook: AccountingFactory, tmp_path: Path, seed: int, profile: str
) -> None:
    # Its functions straddle pages, where the emulator cuts blocks in the middle of what waits for what.
    elf = build(random_program(seed, length=220))
    cycles, band = band_of_call(VirtualK64F(elf, accounting=block_hook, profile=profile), "work")
    assert band is not None
    priced = load_profile(profile)
    of = {move.row: move for move in moves(priced)}

    def counted(values: dict[str, int]) -> int:
        """Count on a board that was made with these values."""
        return VirtualK64F(elf, profile=file_with(tmp_path, values, profile), accounting=block_hook).call("work").cycles

    predicted = {key: value for key, value in ends(band).items() if key[0] != DOUBT}
    assert ("fetch_late_fp" in {row for row, _ in predicted}) is (priced is not PROFILE)
    assert {"fp_accumulate", "fp_accumulate_hidden", "fp_store", "it", "refill_direct", "load_behind_store"} <= {
        row for row, _ in predicted
    }
    for (row, end), expected in predicted.items():
        if expected != cycles:
            assert counted(getattr(of[row], end)) == expected, (row, end)
    low, high = without_doubt(band)
    assert counted(all_at(band, dear=False, profile=priced)) == low
    assert counted(all_at(band, dear=True, profile=priced)) == high
    # What is not in the band does not enter: all of it at once.
    unmoved = (move.high for row, move in of.items() if (row, "low") not in predicted)
    others = {name: value for each in unmoved for name, value in each.items()}
    assert "divide" in others
    assert counted(others) == cycles


def test_what_a_block_leaves_under_a_moved_row_is_met_by_the_block_behind_it(
    build: Build, block_hook: AccountingFactory, tmp_path: Path
) -> None:
    # The emulator cuts at the end of a page, right behind the multiply-accumulate: under a table that hides its cycles
    # the FPU is still busy there, and under the table that ran it is not.
    page_end = ".balign 4096\n .space 4092\n .thumb_func\n .global work\n .type work, %function\nwork:"
    elf = build(f"""
        .syntax unified
        .cpu cortex-m4
        .fpu fpv4-sp-d16
        .thumb
        .text
        .global main
        .thumb_func
    main:
        bx lr
        {page_end}
        vfma.f32 s0, s1, s2
        adds r0, r0, #1
        vadd.f32 s3, s4, s5
        bx lr
        .size work, . - work
    """)
    cycles, band = band_of_call(VirtualK64F(elf, accounting=block_hook), "work")
    assert band is not None
    predicted = ends(band)["fp_accumulate_hidden", "high"]
    board = VirtualK64F(elf, profile=file_with(tmp_path, {"fp_accumulate_hidden": 2}), accounting=block_hook)
    assert board.call("work").cycles == predicted == cycles - 1


@BOTH
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_counts_under_moved_rows_what_was_predicted(
    block_hook: AccountingFactory, tmp_path: Path, kernel: str, profile: str
) -> None:
    board = VirtualK64F(SHIPPED, accounting=block_hook, profile=profile)
    before = board.processor.accounting.snapshot(0)
    cycles, _, _ = run_kernel(board, kernel, cloud(40, seed=1))
    executed = between(before, board.processor.accounting.snapshot(0))
    assert executed is not None
    priced = load_profile(profile)
    band = cycle_range(priced, cycles, executed)
    assert band is not None
    for dear, bound in zip((False, True), without_doubt(band), strict=True):
        moved_to = file_with(tmp_path, all_at(band, dear=dear, profile=priced), profile)
        moved = VirtualK64F(SHIPPED, profile=moved_to, accounting=block_hook)
        assert run_kernel(moved, kernel, cloud(40, seed=1))[0] == bound


def test_a_board_with_some_rows_low_and_others_high_counts_a_ratio_within_its_band(tmp_path: Path) -> None:
    kernels = ("magnetometer_iterative", "magnetometer_direct_fast")

    def counts(board: VirtualK64F) -> list[Measurement]:
        """Count both kernels on the same points."""
        made = []
        for kernel in kernels:
            before = board.processor.accounting.snapshot(0)
            cycles, _, _ = run_kernel(board, kernel, cloud(100, seed=1))
            executed = between(before, board.processor.accounting.snapshot(0))
            band = cycle_range(board.processor.profile, cycles, executed) if executed else None
            made.append(check(kernel, cycles, unit="cycle", cycle_model="m", band=band))
        return made

    over, under = counts(VirtualK64F(SHIPPED, profile=PROFILE.name))
    assert over.band
    assert under.band
    band = ratio_range(over, under)
    assert band
    # Each row at the end that makes a ratio as low as the lowest still lower: some are low then, and others high.
    alone = [dict.fromkeys(MOVES, (each.value, each.value)) for each in (over, under)]
    for counted, each in zip(alone, (over.band, under.band), strict=True):
        counted |= {effect.row: (effect.low, effect.high) for effect in each.rows}
    values: dict[str, int] = {}
    for row, move in MOVES.items():
        low, high = (of - band[0] * to for of, to in zip(alone[0][row], alone[1][row], strict=True))
        values |= move.low if low < high else move.high
    moved_over, moved_under = counts(VirtualK64F(SHIPPED, profile=file_with(tmp_path, values)))
    assert moved_over.value
    assert moved_under.value
    assert band[0] == pytest.approx(moved_over.value / moved_under.value, rel=1e-9)


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
        "load_behind_store", {"load_behind_store": 0, "store_behind_load": 1},
        {"load_behind_store": 1, "store_behind_load": 0},
    )  # fmt: skip
    assert "store_behind_load" not in MOVES
    assert all(PROFILE.rows[row].band[0] < PROFILE.rows[row].band[1] for row in MOVES)


def test_a_profile_without_doubt_has_a_band_without_width() -> None:
    rows = {name: type(row)(row.value, (row.value, row.value), row.source) for name, row in PROFILE.rows.items()}
    board = VirtualK64F(SHIPPED, profile=PROFILE.name)
    before = board.processor.accounting.snapshot(0)
    cycles = board.call("crc32", b"123456789", 9).cycles
    executed = between(before, board.processor.accounting.snapshot(0))
    assert executed is not None
    assert cycle_range(TimingProfile("sure/1", rows), cycles, executed) == CycleRange(cycles, cycles)


def test_a_count_of_version_2_has_a_doubt_that_no_row_explains() -> None:
    board = VirtualK64F(SHIPPED, profile="cortex-m4-trm/2")
    cycles, band = band_of_call(board, "crc32", b"123456789" * 10, 90)
    assert band is not None
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


def test_the_row_that_moves_a_count_most_comes_first() -> None:
    board = VirtualK64F(SHIPPED, profile=PROFILE.name)
    points = np.asarray(cloud(30, seed=3))
    before = board.processor.accounting.snapshot(0)
    cycles, _, _ = run_kernel(board, "magnetometer_iterative", points)
    executed = between(before, board.processor.accounting.snapshot(0))
    assert executed is not None
    band = cycle_range(PROFILE, cycles, executed)
    assert band is not None
    moved = [max(abs(each.low - cycles), abs(each.high - cycles)) for each in band.rows]
    assert moved == sorted(moved, reverse=True)
    assert moved[-1] > 0


def test_a_count_that_is_more_than_instructions_has_no_band(build: Build, block_hook: AccountingFactory) -> None:
    # Masked, an interrupt that is pending wakes WFI at once, but somebody slept: no table prices that.
    elf = build(HEAD + """
        ldr r0, =0xE000E010
        movs r1, #1000
        str r1, [r0, #4]
        movs r1, #7
        str r1, [r0]
        wfi
    """ + TAIL)
    assert band_of_call(VirtualK64F(elf, accounting=block_hook), "main")[1] is None


def test_a_board_that_counts_by_instruction_knows_no_blocks() -> None:
    board = VirtualK64F(SHIPPED, accounting=InstructionAccounting)
    assert band_of_call(board, "crc32", b"1234", 4)[1] is None


RANGE_AND_POINT = struct.pack("<6h", 10, 10, 10, 20, 20, 20), struct.pack("<3h", 5, 15, 25)


def test_a_profiled_call_has_its_band(tmp_path: Path) -> None:
    arguments = [bytearray(each) for each in RANGE_AND_POINT]
    board = VirtualK64F(SHIPPED, accounting=ProfilingAccounting, profile=PROFILE.name)
    called = profile_call(board, "point_range_add", *arguments)
    assert called.cycle_model == f"{PROFILE.name}@sram"
    assert called.band is not None
    row = called.band.rows[0]
    moved = VirtualK64F(SHIPPED, profile=file_with(tmp_path, MOVES[row.row].high))
    assert moved.call("point_range_add", *map(bytearray, RANGE_AND_POINT)).cycles == row.high != called.cycles


def test_a_count_of_code_in_flash_at_no_wait_states_has_no_band(build: Build) -> None:
    called = profile_call(VirtualK64F(build(random_program(5, length=60)), accounting=ProfilingAccounting), "work")
    assert called.cycle_model == "cortex-m4-trm/2@flash"
    assert called.band is None
