"""The oracle finds a core that counts by another price than the profile's."""

from __future__ import annotations

import pytest

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.core.library import lib

from .conftest import PROGRAMS, Build
from .oracle import watched
from .test_cycle_counting import random_program

TWO = "cortex-m4-trm/2"


def dearer(board: VirtualK64F, row: str) -> VirtualK64F:
    """Have a board's core count a cycle more for a row."""
    value = board.processor.profile.rows[row].value
    assert lib.machine_set_price(board.processor.machine.handle, row.encode(), value + 1)
    return board


@pytest.mark.parametrize("row", [
    "data", "load", "store", "branch", "it", "it_skipped", "multiple_base", "fp", "fp_use", "fp_divide", "fp_load",
    "fp_accumulate", "load_behind_load", "store_behind_load", "refill_direct", "refill_indirect", "address_use",
    "target_misplaced", "fetch_late", "fetch_late_fp",
])  # fmt: skip
def test_a_price_of_an_instruction_that_is_wrong_shows_in_a_call(build: Build, row: str) -> None:
    elf = build(random_program(1, length=220))
    board = VirtualK64F(elf, profile=TWO)
    with watched(board):
        board.call("work")
    board = dearer(VirtualK64F(elf, profile=TWO), row)
    with watched(board), pytest.raises(AssertionError, match=r"the core counts [+-]\d+ cycles: Step\(instruction="):
        board.call("work")


@pytest.mark.parametrize("row", ["exception_entry", "exception_return", "tail_chain", "fp_frame"])
def test_a_price_of_an_exception_that_is_wrong_shows_when_firmware_runs(build: Build, row: str) -> None:
    board = dearer(VirtualK64F(build(PROGRAMS / "exceptions.c"), profile=TWO), row)
    with watched(board), pytest.raises(AssertionError, match=r"the core counts [+-]1 cycles"):
        board.run_until(0.001)
