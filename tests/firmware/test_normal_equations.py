"""The normal equations in assembly against the same in C: every bit, on whatever the moments are."""

from __future__ import annotations

import ctypes
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hiltest.virtual.board.k64f import VirtualK64F

from ..instances import instance
from .conftest import FIRMWARE, SHIPPED_ELF

Floats = NDArray[np.float32]
POWERS = [
    (x, y, degree - x - y) for degree in range(5) for x in range(degree, -1, -1) for y in range(degree - x, -1, -1)
]  # in the order of moments_t
SOLUTION = 27  # floats of solution_t
UNTOUCHED = np.float32(-123.0)


@pytest.fixture(scope="module")
def board() -> VirtualK64F:
    return VirtualK64F(SHIPPED_ELF)


def moments(points: NDArray[np.float64]) -> Floats:
    """Return the sums of all monomials, about an origin near the points' middle, as a mid-range is."""
    about = points - points.mean(axis=0) + 0.1 * np.ptp(points, axis=0)
    return np.array([np.prod(about**powers, axis=1).sum() for powers in POWERS], np.float32)


def on_board(board: VirtualK64F, sums: Floats) -> Floats:
    solution = np.full(SOLUTION, UNTOUCHED)
    board.call("quadric_fit", sums, solution)
    return solution


def on_host(library: ctypes.CDLL, sums: Floats) -> Floats:
    solution = np.full(SOLUTION, UNTOUCHED)
    library.quadric_fit.restype = ctypes.c_float
    library.quadric_fit(sums.ctypes.data_as(ctypes.c_void_p), solution.ctypes.data_as(ctypes.c_void_p))
    return solution


def test_every_bit_is_that_of_c(board: VirtualK64F, host_library: ctypes.CDLL) -> None:
    solved = 0
    for seed in range(300):
        points = instance(seed, 9 + seed, covered=(0.05, 1.0)).points_counts.astype(np.float64)
        sums = moments(points * 10.0 ** (seed % 7 - 3))  # and far from what counts are
        solution = on_board(board, sums)
        assert solution.tobytes() == on_host(host_library, sums).tobytes(), f"seed {seed}"
        solved += solution[0] != UNTOUCHED
    assert solved >= 290


_any_float = st.floats(width=32, allow_nan=True, allow_infinity=True)


@settings(deadline=None)
@given(
    sums=st.one_of(
        st.lists(_any_float, min_size=35, max_size=35),
        st.lists(st.sampled_from([0.0, 1.0, -1.0, 1e-30, 3e30, 4096.0]), min_size=35, max_size=35),
    )
)
def test_both_refuse_the_same_sums(board: VirtualK64F, host_library: ctypes.CDLL, sums: list[float]) -> None:
    """Most such sums are of no points; zero, negative and infinite pivots are among theirs."""
    values = np.array(sums, np.float32)
    ours, expected = on_board(board, values), on_host(host_library, values)
    # The sign and the digits of what is not a number are the machine's own.
    assert np.array_equal(ours, expected, equal_nan=True)


def test_its_frame_is_what_the_stack_check_adds_up(board: VirtualK64F) -> None:
    end, size, pattern = 0x2003_0000, 1024, b"\xa5"
    memory = board.processor.memory
    memory.write(end - size, pattern * size)
    on_board(board, moments(instance(1).points_counts.astype(np.float64)))
    remainder = memory.read(end - size, size)
    used = size - (len(remainder) - len(remainder.lstrip(pattern)))
    assert used == stack_check().ASSEMBLY_FRAMES["quadric_fit"]


def stack_check() -> ModuleType:
    path = Path(FIRMWARE) / "stack_check.py"
    spec = importlib.util.spec_from_file_location("stack_check", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
