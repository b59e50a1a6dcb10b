"""Code that firmware puts into RAM is what runs and what is counted, whatever stood there before."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build
from .oracle import acted
from .test_faults import HEAD

# A handler in RAM: it is the first code behind an exception. Three functions of equal
# size take turns in it.
OVERLAYS = (
    HEAD.replace("culprit:", "")
    + """
    ldr r0, =vectors
    movs r2, #0
1:  ldr r3, [r2]
    str r3, [r0, r2]
    adds r2, #4
    cmp r2, #256
    bne 1b
    ldr r1, =buffer + 1
    str r1, [r0, #64 + 4]
    ldr r1, =0xE000ED08
    str r0, [r1]
    ldr r0, =0xE000E100
    movs r1, #2
    str r1, [r0]
    mov r11, #40
again:
    ldr r5, =loads
    bl put
    ldr r5, =adds
    bl put
    ldr r5, =divides
    bl put
    subs r11, #1
    bne again
    movs r7, #0x77
    cpsid i
end:
    b end
    .thumb_func
put:
    ldr r4, =buffer
    movs r0, #0
2:  ldr r1, [r5, r0]
    str r1, [r4, r0]
    adds r0, #4
    cmp r0, #16
    bne 2b
    dsb
    isb
    ldr r0, =0xE000EF00
    movs r1, #1
    str r1, [r0]
    dsb
    isb
    bx lr
    .ltorg
    .balign 4
loads:
    ldr r3, [pc, #8]
    ldr r2, [r3]
    ldrd r0, r1, [r2]
    add r8, r1
    bx lr
    .word words
adds:
    movw r2, #2
    add r9, r2
    nop
    bx lr
    nop
    .balign 4
    nop
divides:
    udiv r0, r0, r8
    udiv r0, r0, r8
    add r10, #1
    bx lr
    .size main, . - main
    .data
    .balign 512
vectors: .space 512
buffer: .space 64
words: .word words, 7
"""
)


def counted(elf: Path) -> list[int]:
    """Run the overlays, and return r7 to r10."""

    def run(board: VirtualK64F) -> None:
        board.may_rest = False
        board.run_until(0.01)

    board, fault = acted(elf, run)
    assert isinstance(fault, BoardFault)
    assert "hang: a loop to itself" in str(fault)
    registers = board.processor.registers.snapshot()
    return [registers[f"r{number}"] for number in (7, 8, 9, 10)]


def test_other_code_of_the_same_size_at_the_same_address_is_counted_as_what_it_is(build: Build) -> None:
    assert counted(build(OVERLAYS)) == [0x77, 40 * 7, 40 * 2, 40]


def test_what_was_looked_at_is_not_blamed_for_the_code_that_replaced_it(build: Build) -> None:
    # Where LDRD stood stands a plain load now, with an odd address in the register: it may be unaligned.
    elf = build(OVERLAYS.replace("add r9, r2\n    nop", "ldr r0, [r2, #1]\n    add r9, r2"))
    assert counted(elf) == [0x77, 40 * 7, 40 * 2, 40]


def test_an_instruction_that_replaces_one_that_was_looked_at_is_looked_at(build: Build) -> None:
    code = OVERLAYS.replace("add r9, r2\n    nop", "ldrd r0, r1, [r2, #4]")
    code = code.replace("movw r2, #2", "mov r2, sp\n    adds r2, #2")
    board = VirtualK64F(build(code))
    with pytest.raises(BoardFault, match=r"unaligned access: r2 = 0x\w+2 in 'ldrd r0, r1, \[r2, #4\]'"):
        board.run_until(0.01)
