"""Exceptions are taken in the order of their priorities, and pre-empt what is less urgent."""

from __future__ import annotations

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import PROGRAMS, Build, word


def order(board: VirtualK64F) -> bytes:
    symbol = board.image.symbols["order"]
    return board.processor.memory.read(symbol.address, word(board, "order_length"))


def test_urgent_interrupts_nest_and_the_others_follow_in_order(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "priorities.c", "-DGROUPING=0u", "-DURGENT=0x40"))
    board.run_until(0.001)
    assert order(board).hex(" ") == (
        "01 11 21 12 13 31 02 "  # 2 within 1, 3 behind it
        "03 21 41 31 04 "  # all at once: 2, then 4 before 3
        "21 05 41 06 "  # BASEPRI lets 2 through, holds 4; 3 was withdrawn
        "07 21 08"  # FAULTMASK holds 2
    )
    assert word(board, "readback") == 0x80
    assert (word(board, "pending_seen"), word(board, "pending_in_handler")) == (16 + 2, 16 + 3)
    assert word(board, "depth_seen") == 1  # the last time, nothing was beneath it


def test_a_sub_priority_orders_and_does_not_preempt(build: Build) -> None:
    # With PRIGROUP = 6 one bit pre-empts: 0xA0 is of the group of 0x80, and of 0xC0.
    board = VirtualK64F(build(PROGRAMS / "priorities.c", "-DGROUPING=6u", "-DURGENT=0xA0"))
    board.run_until(0.001)
    assert order(board).hex(" ") == (
        "01 11 12 13 21 31 02 "  # 2 no longer within 1, but still before 3
        "03 41 21 31 04 "
        "05 41 21 06 "  # BASEPRI holds the whole group
        "07 21 08"
    )
