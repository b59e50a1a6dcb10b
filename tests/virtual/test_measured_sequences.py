"""Sequences whose clocks others have published, run on the board: it counts what they measured.

The published code is not here; these are written from its description. Each stands between the same few instructions
as nothing does, and what those cost is subtracted, as whoever measured it did with the reading of the timer.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build

# Code in SRAM_L and data in SRAM_U, as test_memories has it; the STM32F429 has no banks to be in.
FRAME = """
    function main
    bx lr

    .section .fast, "ax", %progbits
    .macro kernel name
    .balign 16
    function \\name
    push {{r4-r11, lr}}
    ldr r1, =data
    add r2, r1, #256
    nop
    .endm
    .macro back name
    nop
    pop {{r4-r11, pc}}
    .ltorg
    ends \\name
    .endm

    kernel empty
    back empty

    kernel work
    {sequence}
    back work

    .section .far, "aw", %progbits
    .balign 16
data:
    .word data
    .space 508
"""
LDM_STM = "ldmia r1, {r3-r10}\n stmia r2, {r3-r10}"
# What was measured, and the clocks that its reading of the timer is known to.
ON_STM32F429 = {
    "100 loads": (".rept 100\n ldr r0, [r1]\n .endr", 101),
    "200 loads, none waits for another": (".rept 100\n ldr r0, [r1]\n ldr r3, [r1, #4]\n .endr", 201),
    "200 loads, each from the address before": (".rept 200\n ldr r1, [r1]\n .endr", 400),
    "200 additions, none waits for another": (
        ".rept 100\n vadd.f32 s0, s1, s2\n vadd.f32 s3, s4, s5\n .endr\n vmov r0, s8",
        201,
    ),
    "200 additions, each of the one before": (".rept 200\n vadd.f32 s0, s0, s1\n .endr\n vmov r0, s0", 401),
    "a division, a NOP, its result": ("vdiv.f32 s0, s1, s2\n nop\n vmov r0, s0", 16),
}


def clocks(build: Build, sequence: str) -> int:
    places = "-Wl,--section-start=.fast=0x1fff4000,--section-start=.far=0x20001000"
    elf: Path = build(FRAME.format(sequence=sequence), places)
    board = VirtualK64F(elf)
    return board.call("work").cycles - board.call("empty").cycles


@pytest.mark.parametrize("name", ON_STM32F429)
def test_a_sequence_takes_the_clocks_that_were_measured_on_an_stm32f429(build: Build, name: str) -> None:
    sequence, measured = ON_STM32F429[name]
    assert clocks(build, sequence) == measured
