"""What functions can take of the stack at most, from their code: never less than they took, and refused where open."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build
from .test_stacks import DEEP

SHAPES = """
#include <stdint.h>
volatile uint32_t sink, given = 5u;
volatile uint8_t *seen;
__attribute__((noinline)) void leaf(uint32_t n)
{
    volatile uint8_t bytes[64];
    bytes[n & 63u] = (uint8_t)n;
    seen = bytes;
    sink += bytes[0];
}
__attribute__((noinline)) void branches(uint32_t n)
{
    volatile uint8_t bytes[200];
    if (n > 1000u) {
        bytes[n & 127u] = 1u;
        seen = bytes;
        leaf(n);
    }
}
__attribute__((noinline)) void cases(uint32_t n)
{
    switch (n) {
    case 0u: leaf(1u); break;
    case 1u: sink = 2u; break;
    case 2u: branches(2000u); break;
    case 3u: sink = 7u; break;
    case 4u: leaf(9u); sink++; break;
    case 5u: sink += 11u; break;
    default: break;
    }
}
__attribute__((noinline)) void loops(uint32_t n)
{
    for (uint32_t i = 0; i < n; i++) {
        branches(i);
        cases(i);
    }
}
__attribute__((noinline)) uint32_t again(uint32_t n)
{
    volatile uint32_t kept = n;
    return n == 0u ? 1u : again(n - 1u) + kept;
}
void (*volatile pointer)(uint32_t) = leaf;
__attribute__((noinline)) void through(uint32_t n)
{
    pointer(n);
    sink++;
}
__attribute__((noinline)) void grows(uint32_t n)
{
    volatile uint8_t bytes[n + 1u];
    bytes[n] = 1u;
    seen = bytes;
}
int main(void)
{
    for (;;) {
        loops(given + 1u);
        again(3u);
        through(1u);
        grows(given);
        given = 2500u;
        branches(given);
        given = 5u;
    }
}
"""
BOUNDED = ("leaf", "branches", "cases", "loops")


@pytest.mark.parametrize("level", ["-O0", "-Og", "-O2", "-Os"])
def test_the_bound_is_what_the_deepest_way_takes(build_c: Build, level: str) -> None:
    board = VirtualK64F(build_c(SHAPES, level, "-fno-inline", "-fno-optimize-sibling-calls"))
    watch = board.watch_calls(BOUNDED)
    board.run_until(0.01)
    taken = {name: watch.stack(name) for name in BOUNDED}
    assert all(taken.values())
    assert board.stack_bounds(BOUNDED) | {"": 0} == {**taken, "": 0}


def test_a_way_that_nothing_takes_counts_too(build_c: Build) -> None:
    once = SHAPES[: SHAPES.index("int main")] + "int main(void) { for (;;) { branches(given); } }"
    board = VirtualK64F(build_c(once, "-O0"))
    watch = board.watch_calls(["branches", "leaf"])
    board.run_until(0.001)
    assert not watch.calls("leaf")
    assert board.stack_bounds(["branches"])["branches"] == (watch.stack("branches") or 0) + 80
    assert board.stack_bounds(["leaf"])["leaf"] == 80


@pytest.mark.parametrize("level", ["-O0", "-O2"])
@pytest.mark.parametrize(
    ("function", "why"),
    [
        ("again", "it calls itself: again -> again"),
        ("through", "through calls through a pointer at 0x"),
        ("grows", "grows moves the stack pointer"),
    ],
)
def test_what_leaves_it_open_is_named(build_c: Build, level: str, function: str, why: str) -> None:
    board = VirtualK64F(build_c(SHAPES, level, "-fno-inline", "-fno-optimize-sibling-calls"))
    bounds = board.stack_bounds([function, "main"])
    assert why in str(bounds[function])
    assert isinstance(bounds["main"], str), "what it calls is open"


def test_frames_of_assembly_and_of_exceptions(build: Build, tmp_path: Path) -> None:
    (tmp_path / "deep.S").write_text(DEEP.replace("{function}", "calls"), encoding="utf-8")
    board = VirtualK64F(build(tmp_path / "deep.S"))
    board.run_until(0.001)
    bounds = board.stack_bounds(["plain", "calls", "beyond", "alone", "main", "SVC_Handler"])
    assert [bounds[name] for name in ("plain", "calls", "main", "SVC_Handler")] == [232, 32, 40, 8]
    assert "by a register" in str(bounds["beyond"])
    assert "to another stack" in str(bounds["alone"])
    assert board.memory_use()["stack_most"] == 8 + 32 + 32 + 8
    assert bounds[""] == 40 + 27 * 4 + 8, "which keeps room for floating-point state"
