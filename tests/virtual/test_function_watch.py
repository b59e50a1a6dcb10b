"""Calls of one function, counted from its first instruction to its return, whatever counts and however it is called."""

from __future__ import annotations

import pytest

from hiltest.virtual.accounting import AccountingFactory, BlockAccounting, InstructionAccounting
from hiltest.virtual.function_watch import FunctionWatch
from hiltest.virtual.k64f import VirtualK64F

from .conftest import Build

PROGRAM = """
#include <stdint.h>
volatile uint32_t sum, done;
__attribute__((noinline)) uint32_t work(uint32_t n)
{
    uint32_t i = 0;
    do {
        sum += i;
    } while (++i < n);
    return sum;
}
__attribute__((noinline)) uint32_t levels(uint32_t n)
{
    return n == 0u ? work(3u) : levels(n - 1u) + 1u;
}
__attribute__((noinline, naked)) void nothing(void)
{
    __asm volatile("bx lr");
}
int main(void)
{
    for (;;) {
        %s
        done++;
        for (volatile uint32_t i = 0; i < 500u; i++) {
        }
    }
}
"""


@pytest.fixture(params=["python", "native", "instruction"])
def counting(request: pytest.FixtureRequest) -> AccountingFactory:
    """Each way of counting."""
    if request.param == "native":
        hook: AccountingFactory = request.getfixturevalue("native_hook")
        return hook
    return BlockAccounting if request.param == "python" else InstructionAccounting


def watched(board: VirtualK64F, name: str) -> FunctionWatch:
    return FunctionWatch(board.processor, board.image.symbols[name].address)


def test_each_call_takes_what_the_function_takes_when_it_is_called_alone(
    build_c: Build, counting: AccountingFactory
) -> None:
    elf = build_c(PROGRAM % "work(7u); work(40u); nothing();", "-O2")
    board = VirtualK64F(elf, accounting=counting)
    watch, nothing = watched(board, "work"), watched(board, "nothing")
    board.run_until(0.0005)
    alone = [VirtualK64F(elf).call("work", n).cycles for n in (7, 40)]
    assert watch.cycles[:2] == alone
    assert nothing.cycles[0] == VirtualK64F(elf).call("nothing").cycles


def test_watching_changes_no_count(build_c: Build, counting: AccountingFactory) -> None:
    elf = build_c(PROGRAM % "work(7u); nothing();", "-O2")
    counts = []
    for is_watched in (False, True):
        board = VirtualK64F(elf, accounting=counting)
        board.run_until(0.0002)
        watch = watched(board, "work") if is_watched else None  # the code is translated by now
        board.run_until(0.0005)
        counts.append((board.cycles, board.instructions))
        assert watch is None or watch.cycles
    assert counts[0] == counts[1]


def test_a_function_that_calls_itself_has_a_call_for_each_level(build_c: Build) -> None:
    board = VirtualK64F(build_c(PROGRAM % "levels(3u);", "-O1", "-fno-optimize-sibling-calls"))
    watch = watched(board, "levels")
    board.run_until(0.0005)
    inner, *outer = watch.cycles[:4]
    assert [inner < each for each in outer] == [True] * 3
    assert outer == sorted(outer)


def test_what_was_before_it_began_is_forgotten(build_c: Build) -> None:
    board = VirtualK64F(build_c(PROGRAM % "work(7u);", "-O2"))
    watch = watched(board, "work")
    board.run_until(0.0005)
    assert watch.cycles
    watch.begin()
    assert watch.cycles == []
    board.run_until(0.001)
    assert watch.cycles
