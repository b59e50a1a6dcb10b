"""Moments of two points a word: the kernel against its model in whole numbers, bit by bit, wrapped sums included."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import hiltest
from hiltest.virtual.core.decoder import decode
from hiltest.virtual.program.elf import FirmwareImage, load_image

from ..instances import instance
from .packed_kernel import MOMENTS, BoardPacked, HostPacked, PackedKernel
from .references.packed_moments import BLOCK_POINTS, largest_shift, packed_moments, packed_sums

STACK_POINTER = 13
SHIPPED_ELF = Path(hiltest.__file__).parent / "firmware" / "hiltest-frdm-k64f.elf"
Points = NDArray[np.int64]


@pytest.fixture(scope="module")
def board() -> BoardPacked:
    return BoardPacked(SHIPPED_ELF)


@pytest.fixture(params=["host", "board"])
def kernel(request: pytest.FixtureRequest, board: BoardPacked, host_library: ctypes.CDLL) -> PackedKernel:
    return board if request.param == "board" else HostPacked(host_library)


def _random_points(random: np.random.Generator, count: int, *, far: bool = False) -> tuple[Points, Points]:
    """Points of any spread about any anchor, all within int16; all over a cube or, far away, near its corners."""
    anchor = random.integers(-3000, 3001, 3)
    spread = int(2.0 ** random.uniform(0.0, 14.8))
    offsets = random.integers(-spread, spread + 1, (count, 3))
    if far:
        offsets = np.sign(offsets) * spread - offsets // 8
    return np.clip(anchor + offsets, -32768, 32767), anchor


def _mid_range(points: Points) -> Points:
    middle: Points = np.trunc((points.min(axis=0).astype(np.int64) + points.max(axis=0)) / 2).astype(np.int64)
    return middle


def test_a_block_is_that_of_the_model_bit_by_bit(kernel: PackedKernel) -> None:
    random = np.random.default_rng(6)
    overflows = 0
    for case in range(120):
        count = max(case % BLOCK_POINTS + 1, 2)  # every size, so every remainder of the loops
        points, anchor = _random_points(random, count, far=case % 2 == 1)
        # Up to the largest K there is room for, where sums wrap: the model says what they wrap to.
        most = int(np.abs(points - anchor).max())
        shift = min(8, 15 - most.bit_length())
        got, expected = kernel.block(points, anchor, shift), packed_sums(points, anchor, shift)
        assert got.sums.tobytes() == expected.sums.tobytes(), f"case {case}: {count} points, K = {shift}"
        assert got.overflowed == expected.overflowed, f"case {case}: {count} points, K = {shift}"
        overflows += got.overflowed
    print(f"{overflows} of 120 overflow")
    assert overflows >= 10  # both answers are seen


def test_whole_clouds_are_those_of_the_model_bit_by_bit(kernel: PackedKernel) -> None:
    """Blocks are cut, redone and added alike; odd numbers, single points left over, both anchors."""
    random = np.random.default_rng(66)
    counts = [*range(9, 19), 99, 100, 101, 102, 103, 199, 200, 201, 202, 300, 301, 309, *random.integers(9, 310, 40)]
    redone = 0
    for case, count in enumerate(map(int, counts)):
        if case % 2:
            points, anchor = _random_points(random, count, far=case % 4 == 1)
        else:
            points = instance(case, count, field_ut=float(random.uniform(20.0, 90.0))).points_counts.astype(np.int64)
            anchor = _mid_range(points) if case % 4 else points[0]
        expected = packed_moments(points, anchor)
        got = kernel.sum(points, anchor)
        assert got[0] == count
        if expected is None:
            continue
        assert got[1:].tobytes() == expected[0].tobytes(), f"case {case}: {count} points"
        redone += expected[1][-1] < largest_shift(int(np.abs(points - anchor).max()))
    print(f"{redone} of {len(counts)} clouds redone with K - 1")
    assert redone >= 2  # and that path


def _near_one_corner(count: int, distance: int) -> Points:
    """All points as far away as the first K that is tried allows, on the same side: sums of degree 3 and 4 overflow."""
    points = np.full((count, 3), distance, dtype=np.int64)
    points[0] = -distance
    return points


@pytest.mark.parametrize("distance", [30_000, 32_767])
def test_what_no_shift_can_hold_is_summed_one_at_a_time(kernel: PackedKernel, distance: int) -> None:
    points, anchor = _near_one_corner(100, distance), np.zeros(3, dtype=np.int64)
    assert packed_moments(points, anchor) is None
    sums = kernel.sum(points, anchor)
    # float32 rounds each of the 100 additions once.
    assert sums[20] == pytest.approx(100.0 * distance**4, rel=100 * 2.0**-24)
    assert sums[10] == pytest.approx(98.0 * distance**3, rel=100 * 2.0**-24)


def test_points_farther_apart_than_16_bits_are_summed_one_at_a_time(kernel: PackedKernel) -> None:
    points = np.array([[-32768, -32768, -32768], [32767, 32767, 32767]] * 10)
    anchor = _mid_range(points)
    assert packed_moments(points, anchor) is None
    assert kernel.sum(points, anchor)[4] == pytest.approx(10.0 * (32768.0**2 + 32767.0**2), rel=20 * 2.0**-24)


def test_points_between_words_are_summed_one_at_a_time(board: BoardPacked) -> None:
    """The kernel's loads would end in a fault."""
    points = instance(1, 50).points_counts
    aligned, between = (board.sum(points, _mid_range(points), offset=offset) for offset in (0, 2))
    assert not np.array_equal(aligned, between)
    # Sums of even powers: each product is rounded by 2^-15 of the largest at most.
    even = [4, 7, 9, 20, 23, 25, 30, 32, 34]
    assert np.allclose(aligned[even], between[even], rtol=1e-3)


@pytest.mark.parametrize(("count", "most"), [(100, 56.0), (300, 58.0)])
def test_a_point_costs(board: BoardPacked, count: int, most: float) -> None:
    points = instance(1, count, stretch=0.1, covered=(1.0, 1.0)).points_counts
    board.sum(points, _mid_range(points))
    assert board.last is not None
    print(f"{count} points: {board.last.cycles} cycles, {board.last.cycles / count:.2f} a point")
    assert board.last.cycles / count <= most


def test_an_overflow_costs_one_attempt_more(board: BoardPacked) -> None:
    """And no third: with a K that has just overflowed there is nothing to be tried again."""
    near, anchor = _near_one_corner(100, 760), np.zeros(3, dtype=np.int64)
    even = instance(1, 100, stretch=0.1, covered=(1.0, 1.0)).points_counts
    board.sum(even, _mid_range(even))
    once = board.last
    assert once is not None
    board.sum(near, anchor)
    assert board.last is not None
    print(f"once {once.cycles}, redone {board.last.cycles}")
    assert once.cycles + 5_000 < board.last.cycles <= 2 * once.cycles


def test_the_kernel_fits_the_memory_it_was_given() -> None:
    symbol = load_image(SHIPPED_ELF).symbols["packed_moments_block"]
    print(f"{symbol.size} bytes of code")
    assert symbol.size <= 2300


def test_the_scratch_of_a_block_is_what_the_kernel_writes_and_the_rest_of_the_frame_are_locals(
    board: BoardPacked,
) -> None:
    points = instance(1, BLOCK_POINTS, stretch=0.1, covered=(1.0, 1.0)).points_counts
    written = board.bytes_written(points, _mid_range(points), 5)
    assert written == 1800
    frame = _frame(load_image(SHIPPED_ELF), "packed_moments_sum")
    print(f"{written} bytes of scratch in a frame of {frame}")
    assert frame == 1980
    # Locals: the sums of a further block, the kernel's task, and 4 to align the frame.
    assert frame - written == 4 * MOMENTS + 36 + 4


def _frame(image: FirmwareImage, function: str) -> int:
    """Bytes that a function takes from the stack at once, besides the registers that it pushes."""
    symbol = image.symbols[function]
    start = symbol.address & ~1
    (code,) = (
        segment.data[start - segment.run_address :][: symbol.size]
        for segment in image.segments
        if segment.run_address <= start < segment.run_address + len(segment.data)
    )
    return max(-item.number for item in decode(start, code) if item.result == STACK_POINTER and item.is_sum)
