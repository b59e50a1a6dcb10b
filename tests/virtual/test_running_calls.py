"""Calls of functions while firmware runs: each counts what the function takes alone, whatever interrupts it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, pairwise

import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.processor.call_summary import Call

from .conftest import PROGRAMS, Build

SMALL = """
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
FLOOD = ("-DSYSTICK=611u", "-DTIMER=433u")
FLOODED = ("integers", "floats", "straight", "masked", "levels")
ARGUMENTS = 7  # of the program's functions: 0 to 6, in turn
LEVELS = ("-O0", "-O2", "-Os")


def cycles_of(calls: Sequence[Call]) -> list[int]:
    return [call.cycles for call in calls]


def test_each_call_takes_what_the_function_takes_when_it_is_called_alone(build_c: Build) -> None:
    elf = build_c(SMALL % "work(7u); work(40u); nothing();", "-O2")
    board = VirtualK64F(elf)
    watch = board.watch_calls(["work", "nothing"])
    board.run_until(0.0005)
    alone = [VirtualK64F(elf).call("work", n).cycles for n in (7, 40)]
    assert cycles_of(watch.calls("work"))[:2] == alone
    assert watch.calls("nothing")[0].cycles == VirtualK64F(elf).call("nothing").cycles


@pytest.mark.parametrize("level", LEVELS)
def test_interrupts_are_counted_apart_and_each_call_takes_what_it_takes_alone(build: Build, level: str) -> None:
    elf = build(PROGRAMS / "watched.c", *FLOOD, level)
    board, calm = VirtualK64F(elf), VirtualK64F(elf)
    watch = board.watch_calls(FLOODED)
    board.run_until(0.02)
    for function in FLOODED:
        first = (0.75,) if function == "floats" else ()
        alone = cycle([calm.call(function, *first, n).cycles for n in range(ARGUMENTS)])
        calls = [call for call in watch.calls(function) if call.outermost]
        if function == "integers":  # it is called by another one too, in turn
            calls = calls[::2]
        assert len(calls) >= 30
        assert [(call.cycles, call.interrupted > 0) for call in calls] == [(next(alone), True) for _ in calls]


def test_a_reset_abandons_the_calls_that_are_under_way(build: Build) -> None:
    board = VirtualK64F(build(PROGRAMS / "watched.c", *FLOOD, "-O2"))
    watch = board.watch_calls([*FLOODED, "SysTick_Handler", "main"])
    board.run_until(0.01)
    board.reset()
    board.run_until(0.03)
    assert (watch.summary("main").abandoned, watch.summary("main").open) == (1, 1)
    for function in (*FLOODED, "SysTick_Handler"):
        assert watch.summary(function).abandoned <= 1
        assert watch.summary(function).refusal == ""


def test_watching_changes_no_count(build: Build) -> None:
    elf = build(PROGRAMS / "watched.c", *FLOOD, "-O2")
    counts = []
    for is_watched in (False, True):
        board = VirtualK64F(elf)
        board.run_until(0.0005)
        watch = board.watch_calls([*FLOODED, "handled"]) if is_watched else None  # the code is decoded by now
        board.run_until(0.002)
        counts.append((board.cycles, board.instructions, board.processor.registers.snapshot()))
        assert watch is None or watch.calls("integers")
    assert counts[0] == counts[1]


def test_a_handler_is_watched_like_any_function_and_what_interrupts_it_is_apart(build: Build) -> None:
    elf = build(PROGRAMS / "watched.c", *FLOOD, "-O2")
    board = VirtualK64F(elf)
    watch = board.watch_calls(["SysTick_Handler", "Interrupt48_Handler", "handled"])
    board.run_until(0.01)
    assert set(cycles_of(watch.calls("SysTick_Handler"))) == {VirtualK64F(elf).call("SysTick_Handler").cycles}
    takes = set(cycles_of(watch.calls("Interrupt48_Handler")))
    # Its first floating-point instruction saves the state of the code that it interrupts, if that has any.
    assert takes == {min(takes), min(takes) + board.processor.profile.rows["fp_frame"].value}
    nested = [call for call in watch.calls("SysTick_Handler") if call.interrupted]
    assert nested
    # Nothing is more urgent than the timer's own.
    assert not any(call.interrupted for call in watch.calls("Interrupt48_Handler"))
    under_way = watch.summary("SysTick_Handler").open
    assert len(watch.calls("handled")) - len(watch.calls("SysTick_Handler")) in (0, under_way)


def test_a_function_that_calls_itself_has_a_call_for_each_level_and_the_share_has_the_outermost(build_c: Build) -> None:
    board = VirtualK64F(build_c(SMALL % "levels(3u);", "-O1", "-fno-optimize-sibling-calls"))
    watch = board.watch_calls(["levels"])
    board.run_until(0.0005)
    inner, *outer = watch.calls("levels")[:4]
    assert [inner.cycles < call.cycles for call in outer] == [True] * 3
    assert cycles_of(outer) == sorted(cycles_of(outer))
    assert [call.outermost for call in outer] == [False, False, True]
    outermost = [call.cycles for call in watch.calls("levels") if call.outermost]
    assert watch.summary("levels").share == sum(outermost) / watch.cycles


def test_what_began_before_is_left_out(build_c: Build) -> None:
    board = VirtualK64F(build_c(SMALL % "work(2000u);", "-O2"))
    first = board.watch_calls(["work"])
    board.run_until(0.0002)  # in the middle of the first call
    assert not first.calls("work")
    assert first.summary("work").open == 1
    second = board.watch_calls(["work"])
    board.run_until(0.002)
    assert len(second.calls("work")) == len(first.calls("work")) - 1
    first.begin()
    assert first.calls("work") == []
    assert first.summary("work").least is None


def test_each_call_of_a_loop_that_waits_is_seen(build_c: Build) -> None:
    source = """
    #include <stdint.h>
    volatile uint32_t ticks;
    void SysTick_Handler(void) { ticks++; }
    __attribute__((noinline)) uint32_t now(void) { return ticks; }
    __attribute__((noinline)) void wait(uint32_t until) { while (now() < until) { } }
    __attribute__((noinline)) void spin(uint32_t until) { while (ticks < until) { } }
    int main(void)
    {
        WORD(0xE000E014u) = 20000u; WORD(0xE000E010u) = 7u;
        for (;;) { wait(ticks + 3u); spin(ticks + 3u); }
    }
    """
    board = VirtualK64F(build_c(source, "-O2"))
    watch = board.watch_calls(["now", "wait", "spin"])
    board.run_until(0.02)
    assert len(watch.calls("now")) > 1000
    assert len(watch.calls("spin")) > 2
    ticks = watch.calls("wait")[0].interrupted
    assert ticks == 3
    first, last = watch.calls("wait")[0].entered, watch.calls("wait")[0].returned
    entries = [call.entered for call in watch.calls("now") if first <= call.entered < last]
    gaps = [later - earlier for earlier, later in pairwise(entries)]
    assert sum(gap != min(gaps) for gap in gaps) <= ticks  # a turn follows another one at once, but for a tick between


def test_functions_that_are_called_from_very_many_places_are_refused_by_name(build_c: Build) -> None:
    many = """
    __attribute__((noinline, naked)) void many(void)
    {
        __asm volatile("push {r4, lr}\\n .rept 9000\\n bl nothing\\n .endr\\n pop {r4, pc}");
    }
    int main(void)"""
    board = VirtualK64F(build_c(SMALL.replace("int main(void)", many) % "many(); work(7u);", "-O2"))
    watch = board.watch_calls(["work", "nothing"])
    board.run_until(0.01)
    assert "nothing: " in watch.summary("nothing").refusal
    assert watch.summary("nothing").least is None
    assert "came from too many places" in watch.summary("work").refusal


def test_an_unknown_function_is_refused_with_those_near(build_c: Build) -> None:
    board = VirtualK64F(build_c(SMALL % "work(7u);", "-O2"))
    with pytest.raises(ConfigError, match=r"no function 'wrok'; near: work"):
        board.watch_calls(["wrok"])
    with pytest.raises(ConfigError, match="no function 'sum'"):
        board.watch_calls(["sum"])
