"""Calls that do not simply return: tail calls, longjmp, tasks that are switched, stacks that are."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import FLAGS, PROGRAMS, Build
from .foreign import machine_for, program_named
from .foreign import watch as run_for
from .test_rtos import TICK_S, BuildTasks, build_tasks  # noqa: F401 (a fixture)

TAILS = """
#include <stdint.h>
#define APART __attribute__((noinline, noclone))
volatile uint32_t sum;
APART uint32_t worked(uint32_t n) { uint32_t i = 0; do { sum += i; } while (++i < n); return sum; }
APART uint32_t tails(uint32_t n) { sum += n; return worked(n + 1u); }
APART uint32_t by_pointer(uint32_t (*f)(uint32_t), uint32_t n) { sum += n; return f(n); }
APART uint32_t loops(uint32_t n) { uint32_t i = n; do { sum ^= i; } while (--i); return sum; }
__attribute__((naked, noinline)) uint32_t falls(uint32_t n) { __asm volatile("adds r0, #1\\n movs r1, #2"); }
__attribute__((naked, noinline)) uint32_t into(uint32_t n) { __asm volatile("adds r0, #2\\n bx lr"); }
int main(void)
{
    for (;;) {
        tails(5u); by_pointer(worked, 3u); loops(9u); falls(1u);
    }
}
"""


def test_a_call_that_ends_in_a_tail_call_contains_it_and_says_so(build_c: Build) -> None:
    elf = build_c(TAILS, "-O2", "-fno-reorder-functions", "-fno-toplevel-reorder")
    board = VirtualK64F(elf)
    watch = board.watch_calls(["tails", "worked", "by_pointer", "loops", "falls", "into"])
    board.run_until(0.0002)
    tails, worked = watch.calls("tails")[0], watch.calls("worked")[0]
    assert tails.cycles == VirtualK64F(elf).call("tails", 5).cycles
    assert tails.entered < worked.entered
    assert tails.returned == worked.returned
    for function, ended_in in (
        ("tails", ("worked",)),
        ("by_pointer", ("worked",)),
        ("worked", ()),
        ("loops", ()),
        ("falls", ("into",)),
    ):
        summary = watch.summary(function)
        assert (summary.ended_in, summary.abandoned) == (ended_in, 0), function
    # A loop that begins at the first instruction is one call.
    assert watch.calls("loops")[0].cycles == VirtualK64F(elf).call("loops", 9).cycles
    assert watch.calls("falls")[0].cycles == VirtualK64F(elf).call("falls", 1).cycles


JUMPS = """
#include <setjmp.h>
#include <stdint.h>
#define APART __attribute__((noinline, noclone))
volatile uint32_t sum, rounds;
static jmp_buf back;
APART void leaves(uint32_t n) { sum += n; if (n) longjmp(back, 1); }
APART void passes(uint32_t n) { volatile uint32_t kept[4] = {n}; leaves(kept[0]); sum += kept[1]; }
APART void simple(uint32_t n) { sum += n; }
int main(void)
{
    for (;;) {
        rounds++;
        if (setjmp(back) == 0) {
            passes(rounds % 3u);
        }
        simple(1u);
    }
}
"""


@pytest.mark.parametrize("level", ["-O0", "-O2"])
def test_calls_that_longjmp_leaves_are_abandoned_and_do_not_count(
    tmp_path: Path, require_tool: Callable[[str], str], level: str
) -> None:
    source, elf = tmp_path / "program.c", tmp_path / "program.elf"
    source.write_text(JUMPS)
    flags = [flag for flag in FLAGS if flag not in ("-O1", "-nostdlib")]
    command = [
        require_tool("arm-none-eabi-gcc"),
        *flags,
        level,
        "-nostartfiles",
        str(PROGRAMS / "start.S"),
        str(source),
        "-o",
        str(elf),
    ]
    subprocess.run(command, check=True, timeout=60)
    board = VirtualK64F(elf)
    watch = board.watch_calls(["leaves", "passes", "simple"])
    board.run_until(0.0004)
    rounds = len(watch.calls("simple"))
    assert rounds > 20
    alone = VirtualK64F(elf).call("passes", 0).cycles
    for function in ("leaves", "passes"):
        summary = watch.summary(function)
        # Two of three rounds are left by longjmp; the last is under way, or given up and not yet noticed.
        assert abs(summary.abandoned - 2 * rounds / 3) <= 2, function
        assert abs(summary.calls - rounds / 3) <= 2
        assert summary.open <= 1
        assert summary.refusal == ""
    assert watch.summary("passes").most == watch.summary("passes").least == alone


COROUTINES = """
#include <stdint.h>
#define APART __attribute__((noinline, noclone))
volatile uint32_t sum;
static uint32_t stacks[2][64], *saved[2];
__attribute__((naked, noinline)) void change(uint32_t **from, uint32_t **to)
{
    __asm volatile("push {r4-r11, lr}\\n str sp, [r0]\\n ldr sp, [r1]\\n pop {r4-r11, pc}");
}
APART void works(uint32_t me) { sum += me; change(&saved[me], &saved[1u - me]); sum ^= me; }
APART void plain(uint32_t n) { sum += n; }
void first(void) { for (;;) { works(0u); plain(1u); } }
void second(void) { for (;;) { works(1u); plain(2u); } }
int main(void)
{
    uint32_t *here;
    stacks[0][63] = (uint32_t)first;
    stacks[1][63] = (uint32_t)second;
    saved[0] = &stacks[0][63 - 8];
    saved[1] = &stacks[1][63 - 8];
    change(&here, &saved[0]);
}
"""


def test_stacks_that_are_switched_without_an_exception_are_refused_by_name(build_c: Build) -> None:
    board = VirtualK64F(build_c(COROUTINES, "-O2"))
    watch = board.watch_calls(["works", "plain"])
    board.run_until(0.0005)
    refused = watch.summary("works")
    assert "works" in refused.refusal
    assert (refused.least, refused.median, refused.most, refused.share) == (None, None, None, None)
    plain = watch.summary("plain")
    assert (plain.refusal, plain.least) == ("", plain.most)


@pytest.mark.parametrize("level", ["-O0", "-O2"])
def test_a_call_in_a_task_does_not_count_what_other_tasks_do(
    build_tasks: BuildTasks,  # noqa: F811 (the fixture)
    level: str,
) -> None:
    elf = build_tasks(level, "-fno-inline")
    board = VirtualK64F(elf)
    watch = board.watch_calls(["series", "kernel_switch", "SysTick_Handler", "PendSV_Handler"])
    board.run_until(90 * TICK_S)
    calls = watch.calls("series")
    switched = [call for call in calls if call.elsewhere]
    assert len(calls) > 40
    assert len(switched) > 5
    # The same work each time, in either task: what is left of a call is the same whoever ran in between.
    assert len({call.cycles for call in calls}) == 1
    assert watch.summary("series").abandoned == 0
    assert max(call.elsewhere for call in switched) > calls[0].cycles
    assert watch.summary("PendSV_Handler").calls > 10
    assert watch.summary("PendSV_Handler").abandoned == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["sdk_freertos_hello", "sdk_freertos_swtimer", "z_synchronization", "riot_thread_cooperation", "riot_ztimer_msg"],
)
def test_every_function_of_a_kernel_of_others_can_be_watched_at_once(name: str) -> None:
    program = program_named(name)
    plain, board = machine_for(program), machine_for(program)
    symbols = board.image.symbols.values()
    functions = [symbol.name for symbol in symbols if symbol.is_function and symbol.size]
    watch = board.watch_calls(functions)
    seconds = min(program.seconds, 0.5)
    messages = [run_for(program, item, seconds).text for item in (board, plain)]
    assert messages[0] == messages[1]
    assert board.cycles == plain.cycles
    summaries = [watch.summary(function) for function in functions]
    assert sum(summary.calls for summary in summaries) > 100
    assert {summary.function: summary.refusal for summary in summaries if summary.refusal} == {}
    assert all(summary.least > 0 for summary in summaries if summary.least is not None)
    # What a kernel starts from on a stack that it gives up then.
    assert sum(summary.abandoned for summary in summaries) <= 2
