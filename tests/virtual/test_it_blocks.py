"""What an IT block skips takes one cycle by version 2."""

from __future__ import annotations

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build
from .oracle import acted, called

TWO = "cortex-m4-trm/2"
# Of `work` with r0 = 0 and with another r0: the cycles of each instruction by the manual's table, added up by hand.
COUNTED = {
    # sub 1, cmp 1, it 0; LDR 2, MOV 1, skipped 1, skipped 1; bx 3; the other way skipped 1, skipped 1, LDM 3, VLDR 2
    "loads": (
        """
        sub r3, sp, #16
        cmp r0, #0
        ittee eq
        ldreq r1, [r3]
        moveq r2, #1
        ldmne.w r3, {r1, r2}
        vldrne s0, [r3]
        bx lr
    """,
        10,
        12,
    ),
    # push 2, cmp 1, it 0; pop to the PC 4; the other way skipped 1, then pop to the PC 4
    "return": (
        """
        push {lr}
        cmp r0, #0
        it eq
        popeq {pc}
        pop {pc}
    """,
        7,
        8,
    ),
    # cmp 1, it 0; branch 1, refill 1; the other way skipped 1, add 1; bx 3
    "branch": (
        """
        cmp r0, #0
        it eq
        beq.n 1f
        adds r0, #1
    1:  bx lr
    """,
        6,
        6,
    ),
    # vmov 1, cmp 1, it 0; VDIV 1, and 15 later VADD 1 can use it: 14 wait; the other way skipped 1, VADD 1; bx 3
    "division": (
        """
        vmov.f32 s1, #1.0
        cmp r0, #0
        it eq
        vdiveq.f32 s0, s1, s1
        vadd.f32 s2, s0, s1
        bx lr
    """,
        21,
        7,
    ),
    # vmov 1, then 1 for its result and VDIV 1, of 14 the FPU is busy 13 more, cmp 1, it 0; VMOV waits 12 and takes 1,
    # VADD 1; the other way skipped 1, VADD waits 11 and takes 1; bx 3
    "under a division": (
        """
        vmov.f32 s1, #1.0
        vdiv.f32 s0, s1, s1
        cmp r0, #0
        it eq
        vmoveq.f32 s2, s1
        vadd.f32 s3, s1, s1
        bx lr
    """,
        21,
        20,
    ),
    # sub 1, cmp 1, it 0; SUB 1, then 1 for the address and LDR 2; the other way skipped 1, LDR 2; bx 3
    "address": (
        """
        sub r3, sp, #16
        cmp r0, #0
        it eq
        subeq r3, #4
        ldr r1, [r3]
        bx lr
    """,
        9,
        8,
    ),
    # cmp 1, it 0; STR 1, CMP 1 with another answer, so that 1 is skipped; the other way skipped 3; bx 3
    "a comparison inside": (
        """
        cmp r0, #0
        ittt eq
        streq r0, [sp, #-4]
        cmpeq sp, #1
        ldreq r1, [sp]
        bx lr
    """,
        7,
        7,
    ),
}


def program(work: str) -> str:
    return f"""
        function main
        bx lr
        .section .fast, "ax", %progbits
        .balign 16
        function work
        {work}
        ends work
        .ltorg
    """


@pytest.mark.parametrize(("work", "if_zero", "if_not"), COUNTED.values(), ids=COUNTED)
def test_an_instruction_that_is_skipped_takes_a_cycle_and_leaves_nothing(
    build: Build, work: str, if_zero: int, if_not: int
) -> None:
    elf = build(program(work), "-Wl,--section-start=.fast=0x1fff4000")
    # Each way behind the other: what one has left must not show in the next.
    _, counted = acted(elf, lambda board: [board.call("work", zero).cycles for zero in (0, 1, 1, 0)], TWO)
    assert counted == [if_zero, if_not, if_not, if_zero]


def test_256_ways_through_it_blocks_take_the_cycles_of_the_model(build: Build) -> None:
    chosen = "".join(f"lsls r2, r0, #{bit}\n itt mi\n ldrmi r3, [r1]\n strmi r0, [r1]\n" for bit in range(24, 32))
    elf = build(program(f"sub r1, sp, #16\n again: {chosen} subs r0, #1\n bne.w again\n bx lr"))
    assert called(elf, "work", 255, profile=TWO).instructions == 255 * 34 + 2


def test_version_1_prices_as_executed_what_is_skipped(build: Build) -> None:
    elf = build(program(COUNTED["loads"][0]), "-Wl,--section-start=.fast=0x1fff4000")
    board = VirtualK64F(elf, profile="cortex-m4-trm/1")
    assert [board.call("work", argument).cycles for argument in (0, 1)] == [1 + 1 + 1 + 2 + 1 + 3 + 2 + 3] * 2
