"""Exceptions are taken in the order of their priorities, and pre-empt what is less urgent."""

from __future__ import annotations

import pytest

from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.nvic import FIRST_INTERRUPT, HARD_FAULT, IDLE, NMI, PENDSV, SYSTICK, USAGE_FAULT, Nvic

from .conftest import PROGRAMS, Build
from .test_exceptions import word

ONE, TWO, THREE = FIRST_INTERRUPT + 1, FIRST_INTERRUPT + 2, FIRST_INTERRUPT + 3


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
    assert word(board, "pending_seen") == 16 + 2
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


def test_equal_priorities_go_by_number() -> None:
    nvic = Nvic()
    for exception in (THREE, ONE, TWO):
        nvic.set_enabled(exception - FIRST_INTERRUPT, True)
        nvic.pend(exception)
    taken = []
    while (exception := nvic.next_exception()) is not None:
        nvic.enter(exception)
        taken.append(exception)
        nvic.leave()
    assert taken == [ONE, TWO, THREE]


@pytest.mark.parametrize(
    ("masks", "taken"),
    [
        ((0, 0, 0), {NMI, HARD_FAULT, USAGE_FAULT, PENDSV}),
        ((1, 0, 0), {NMI, HARD_FAULT}),
        ((0, 1, 0), {NMI}),
        ((0, 0, 0x40), {NMI, HARD_FAULT, USAGE_FAULT}),
        ((0, 0, 0x0F), {NMI, HARD_FAULT, USAGE_FAULT, PENDSV}),  # bits that the part does not have
    ],
    ids=["none", "PRIMASK", "FAULTMASK", "BASEPRI", "BASEPRI without effect"],
)
def test_masks_hold_back_what_is_not_urgent_enough(masks: tuple[int, int, int], taken: set[int]) -> None:
    nvic = Nvic()
    nvic.set_priority(USAGE_FAULT, 0x20)
    nvic.set_priority(PENDSV, 0x40)
    ceiling = nvic.ceiling(*masks)
    exceptions = (NMI, HARD_FAULT, USAGE_FAULT, PENDSV)
    assert {exception for exception in exceptions if nvic.preempts(exception, ceiling)} == taken


def test_priorities_of_nmi_and_hard_fault_cannot_be_set() -> None:
    nvic = Nvic()
    for exception in (NMI, HARD_FAULT):
        nvic.set_priority(exception, 0xF0)
    assert [nvic.preemption_priority(exception) for exception in (NMI, HARD_FAULT)] == [-2, -1]


def test_an_exception_under_way_sets_the_priority_that_must_be_beaten() -> None:
    nvic = Nvic()
    nvic.set_priority(SYSTICK, 0x40)
    nvic.set_priority(PENDSV, 0x80)
    nvic.enter(SYSTICK)
    assert nvic.execution_priority() == 0x40
    assert not nvic.preempts(PENDSV)
    nvic.leave()
    assert nvic.execution_priority() == IDLE
    assert nvic.preempts(PENDSV)


def test_a_line_that_stays_high_interrupts_again() -> None:
    nvic = Nvic()
    nvic.set_enabled(1, True)
    nvic.set_line(1, True)
    nvic.enter(ONE)
    assert nvic.next_exception() is None
    nvic.leave()
    assert nvic.next_exception() == ONE
    nvic.enter(ONE)
    nvic.set_line(1, False)
    nvic.leave()
    assert nvic.next_exception() is None
