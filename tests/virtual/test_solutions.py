"""Functions that work in slices are summed by solution, and a solution that was not seen whole is none."""

from __future__ import annotations

import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.errors import ConfigError
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.solution_watch import EndsWhen, SolutionEnd
from hiltest.virtual.counts.recount import count_with_waits
from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.processor.call_summary import Call, sum_solutions, summarise_calls, summarise_solutions

from ..foreign_elf import foreign_elf
from .conftest import Build
from .foreign import RIG

SLICES = """
#include <stdint.h>
#define APART __attribute__((noinline, noclone))
volatile uint32_t sum;
struct fit { uint32_t kind; uint8_t progress, other; uint16_t done; } volatile fit;
APART void work(uint32_t n) { for (uint32_t i = 0; i < n; i++) sum += i; }
APART void begin_slice(void) { work(10u); fit.progress = 1u; }
APART void fit_slice(void)
{
    work(20u * fit.progress);
    if (++fit.progress == 5u) { fit.progress = 0u; fit.done++; }
}
int main(void)
{
    for (;;) {
        if (fit.progress == 0u) begin_slice(); else fit_slice();
        work(3u);
    }
}
"""
# A loop of 200 bytes: more than the cache of the flash holds; and each solution takes longer than the one before.
LONG_LOOP = (
    SLICES.replace("sum += i;", f'{{ sum += i; __asm volatile("{100 * "nop;"}"); }}')
    .replace("(fit.progress == 0u) begin_slice();", "(fit.progress == 0u) { fit.kind++; begin_slice(); }")
    .replace("work(10u)", "work(9u + fit.kind)")
)
ZERO = SolutionEnd("fit+4", size=1)
CHANGED = SolutionEnd("fit + 0x6", EndsWhen.CHANGED, size=2)


def test_slices_of_two_functions_make_a_solution(build_c: Build) -> None:
    board = VirtualK64F(build_c(SLICES, "-O2"))
    functions = ["begin_slice", "fit_slice"]
    watch, calls = board.watch_solutions(functions, ZERO), board.watch_calls(functions)
    board.run_until(0.01)
    summary = watch.summary
    assert summary.solutions > 10
    assert (summary.fewest_slices, summary.most_slices) == (5, 5)
    slices = calls.calls("begin_slice")[:1] + calls.calls("fit_slice")[:4]
    assert summary.median == sum(item.cycles for item in slices)
    assert (summary.least, summary.most) == (summary.median, summary.median)
    assert summary.longest_slice == max(item.cycles for item in slices)


@pytest.mark.parametrize("end", [ZERO, CHANGED])
def test_a_solution_that_had_begun_before_is_left_out(build_c: Build, end: SolutionEnd) -> None:
    board = VirtualK64F(build_c(SLICES, "-O2"))
    calls = board.watch_calls(["fit_slice"])
    while len(calls.calls("fit_slice")) < 2:  # in the middle of the first solution
        board.run_until(board.time_s + 2e-6)
    watch = board.watch_solutions(["begin_slice", "fit_slice"], end)
    board.run_until(0.01)
    assert watch.summary.fewest_slices == watch.summary.most_slices == 5
    watch.begin()
    assert watch.summary.solutions == 0
    assert watch.summary.least is None


def test_a_word_that_is_none_is_refused(build_c: Build) -> None:
    board = VirtualK64F(build_c(SLICES, "-O2"))
    for word, answer in (
        ("fitt", "'fitt' is not a variable"),
        ("main", "'main' is not a variable"),
        ("fit-1", "is not a variable"),
        ("fit+6", "4 bytes at fit"),
    ):
        with pytest.raises(ConfigError, match=answer):
            board.watch_solutions(["fit_slice"], SolutionEnd(word))
    board.watch_solutions(["fit_slice"], ZERO)
    with pytest.raises(ConfigError, match="another word"):
        board.watch_solutions(["fit_slice"], CHANGED)


@pytest.mark.parametrize("end", [ZERO, CHANGED])
def test_a_solution_takes_as_long_once_more_and_waits_as_it_does_from_flash(build_c: Build, end: SolutionEnd) -> None:
    elf, functions, profile = build_c(LONG_LOOP, "-O2"), ["begin_slice", "fit_slice"], load_profile("cortex-m4-k64f/3")
    board, slow = VirtualK64F(elf), VirtualK64F(elf, profile=profile)
    watch, waited = board.watch_solutions(functions, end), slow.watch_solutions(functions, end)
    for item, seconds in ((board, 0.005), (slow, 0.008)):
        item.run_until(seconds)
    stored = watch.latest()
    assert stored is not None
    assert (stored.cycles, len(stored.slices)) == (watch.solutions[-1].cycles, 5)
    assert watch.solutions[-1].cycles > watch.solutions[0].cycles
    again = count_with_waits(board, stored, profile)
    assert again.cycles - again.waits == stored.cycles
    # What the controller holds at a slice's entry differs, two lines at most: 10 clocks each.
    assert waited.solutions[len(watch.solutions) - 1].cycles == pytest.approx(again.cycles, abs=5 * 2 * 10)
    assert again.waits > 0.1 * stored.cycles


def test_something_else_may_change_the_data_between_the_slices_of_a_solution(build_c: Build) -> None:
    elf = build_c(SLICES.replace("work(3u);", "fit.kind += 7u;").replace("20u *", "fit.kind % 40u +"), "-O2")
    board = VirtualK64F(elf)
    watch = board.watch_solutions(["begin_slice", "fit_slice"], ZERO)
    board.run_until(0.002)
    stored = watch.latest()
    assert stored is not None
    again = count_with_waits(board, stored, load_profile("cortex-m4-k64f/3"))
    assert again.cycles - again.waits == stored.cycles


def test_a_slice_that_depends_on_a_device_is_not_counted_again(build_c: Build) -> None:
    # It works as long as SysTick's counter says.
    source = SLICES.replace("20u *", "(*(volatile uint32_t *)0xE000E018 & 0xFFu) +").replace(
        "int main(void)\n{",
        "int main(void)\n{\n    ((volatile uint32_t *)0xE000E010)[1] = 9999u;\n"
        "    ((volatile uint32_t *)0xE000E010)[0] = 5u;",
    )
    board = VirtualK64F(build_c(source, "-O2"))
    watch = board.watch_solutions(["begin_slice", "fit_slice"], ZERO)
    board.run_until(0.002)
    stored = watch.latest()
    assert stored is not None
    with pytest.raises(ConfigError, match=r"fit_slice: slice \d of 5 takes .* external state"):
        count_with_waits(board, stored, load_profile("cortex-m4-k64f/3"))


def test_no_solution_is_kept_before_one_is_complete(build_c: Build) -> None:
    board = VirtualK64F(build_c(SLICES, "-O2"))
    watch, calls = board.watch_solutions(["begin_slice", "fit_slice"], ZERO), board.watch_calls(["fit_slice"])
    while len(calls.calls("fit_slice")) < 3:
        assert watch.latest() is None
        board.run_until(board.time_s + 2e-6)
    watch.begin()  # in its middle: the rest of that one is none
    while len(calls.calls("fit_slice")) < 4:
        board.run_until(board.time_s + 2e-6)
    assert watch.latest() is None
    board.run_until(board.time_s + 1e-3)
    stored = watch.latest()
    assert stored is not None
    assert len(stored.slices) == 5


@pytest.mark.slow
def test_slices_of_anothers_calibration_are_as_many_as_its_source_says() -> None:
    bench = VirtualBench(load_rig(RIG), firmware=foreign_elf("nxp_sensor_fusion.elf"))
    # sfg.MagCal.iCalInProgress: how many elements are being fitted, or 0.
    watch = bench.machine.watch_solutions(["fUpdateMagCalibration4Slice"], SolutionEnd("sfg+0xa80", size=1))
    bench.machine.run_until(0.3)
    bench.tumble(20.0)
    bench.machine.run_until(6.5)
    assert (watch.summary.solutions, watch.summary.most_slices) == (1, 17)


def call(entered: int, cycles: int, remainder: int = 0, **more: int) -> Call:
    return Call(entered, entered + cycles + sum(more.values()), word=remainder, **more)


def test_a_slice_within_another_counts_with_that_one() -> None:
    slices = [call(0, 50, 1), call(10, 20, 1), call(100, 30, 0), call(200, 7, 1)]
    result = sum_solutions(slices, lambda item, _before: item.word == 0, before=0, is_whole=True)
    assert [(item.cycles, item.slices, item.longest) for item in result] == [(80, 2, 50)]
    assert summarise_solutions(result).most == 80
    assert sum_solutions(slices, lambda item, _before: item.word == 0, before=1, is_whole=False) == []


def test_a_summary_counts_what_is_apart_and_nothing_of_no_calls() -> None:
    calls = [
        call(0, 40),
        call(100, 10, interrupts=25)._replace(interrupted=2),
        call(200, 30, elsewhere=500),
        call(210, 5)._replace(outermost=False),
    ]
    summary = summarise_calls("fit", calls, 1000, abandoned=3, open_calls=1, ended_in=("g",))
    assert (summary.calls, summary.least, summary.median, summary.most) == (4, 5, 10, 40)
    assert summary.share == pytest.approx(0.08)
    assert (summary.interrupted, summary.interrupts, summary.elsewhere) == (1, 25, 500)
    assert (summary.abandoned, summary.open, summary.ended_in, summary.refusal) == (3, 1, ("g",), "")
    none = summarise_calls("fit", [], 1000)
    assert (none.calls, none.least, none.median, none.most, none.share) == (0, None, None, None, 0.0)
    refused = summarise_calls("fit", calls, 1000, came_back=2)
    assert (refused.least, refused.share) == (None, None)
    assert "fit: 2 calls returned" in refused.refusal
