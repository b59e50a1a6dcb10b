"""Loops that lose cycles by where their instructions lie are named, and what is advised helps."""

from __future__ import annotations

from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.counts.profiling import CallProfile, profile_call

from .conftest import Build

TURNS = 100
FRAME = """
    function main
    bx lr
    .section .fast, "ax", %progbits
    .balign 16
    function work
    movw r0, #100
    movs r1, #0
    {before}
again:
    {body}
    subs r0, #1
    bne again
    bx lr
    ends work
"""
ADDITIONS = "\n".join(f"vadd.f32 s{register}, s30, s31" for register in range(12))


def profiled(build: Build, body: str, before: str = "", profile: str = "cortex-m4-trm/3") -> CallProfile:
    elf = build(FRAME.format(before=before, body=body), "-Wl,--section-start=.fast=0x1fff4000")
    return profile_call(VirtualK64F(elf, profile=profile), "work")


def test_a_loop_that_begins_badly_is_named_with_what_it_loses(build: Build) -> None:
    result = profiled(build, ADDITIONS)
    (loop,) = result.loops
    assert (loop.function, loop.address, loop.turns) == ("work", 0x1FFF4006, TURNS - 1)
    assert (loop.misplaced, loop.wide) == (12 * TURNS, 12 * TURNS)
    # Of twelve additions the fourth, seventh and tenth wait, and the first behind each branch back.
    assert loop.cycles == 3 * TURNS + TURNS - 1
    assert ".balign 4" in loop.advice


def test_beginning_the_loop_at_a_multiple_of_four_takes_it_away(build: Build) -> None:
    badly, well = profiled(build, ADDITIONS), profiled(build, ADDITIONS, before=".balign 4")
    assert well.loops == ()
    assert well.cycles == badly.cycles - badly.loops[0].cycles + 1  # and a NOP more


def test_the_instruction_that_is_to_have_four_bytes_is_named(build: Build) -> None:
    badly = profiled(build, f"adds r1, #1\n{ADDITIONS}", before=".balign 4")
    (loop,) = badly.loops
    assert "adds r1, #1" in loop.advice
    assert f"{0x1FFF4008:#010x}" in loop.advice
    assert profiled(build, f"adds.w r1, r1, #1\n{ADDITIONS}", before=".balign 4").loops == ()


def test_an_inner_loop_is_named_and_not_the_one_around_it(build: Build) -> None:
    inner = f"movs r2, #9\ninner:\n{ADDITIONS}\nsubs r2, #1\nbne inner"
    (loop,) = profiled(build, inner, before=".balign 4").loops
    assert loop.turns == 8 * TURNS


def test_a_loop_that_loses_less_than_a_hundredth_is_not_named(build: Build) -> None:
    divisions = "udiv r3, r4, r0\n" * 40
    assert profiled(build, f"nop\n{divisions}nop\n{ADDITIONS}").loops == ()


def test_a_profile_without_rules_of_fetching_names_none(build: Build) -> None:
    assert profiled(build, ADDITIONS, profile="cortex-m4-trm/1").loops == ()
