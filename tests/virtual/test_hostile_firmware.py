"""Whatever firmware does ends as on the part, or in a BoardFault; never in an error of the host."""

from __future__ import annotations

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build
from .test_faults import HEAD

TAIL = "\nend:\n    b end\n    ends main\n    .ltorg\n"
GATES_OPEN = """
    ldr r0, =0x40048028
    ldr r1, =0xFFFFFFFF
    movs r2, #7
1:  str r1, [r0], #4
    subs r2, #1
    bne 1b
"""

CASES = {
    "a stack nowhere": ("ldr r0, =0x10000000\n mov sp, r0\n udf #1", "lockup.*after: undefined instruction"),
    "a stack that leaves SRAM": (
        "1: push {r0-r7}\n b 1b", "lockup.*after: stack overflow: write to unmapped address 0x1ffeff"
    ),
    "a jump to the last halfword of SRAM": (
        "ldr r1, =0x2002FFFE\n ldr r2, =0xBF00\n strh r2, [r1]\n adds r1, #1\n bx r1",
        "jump to unmapped address 0x20030000",
    ),
    "half an instruction at the end of SRAM": (
        "ldr r1, =0x2002FFFE\n ldr r2, =0xF3AF\n strh r2, [r1]\n adds r1, #1\n bx r1",
        "jump to unmapped address 0x20030000",
    ),
    "a loop in the last halfword of SRAM": (
        "ldr r1, =0x2002FFFE\n ldr r2, =0xE7FE\n strh r2, [r1]\n adds r1, #1\n bx r1",
        "hang: a loop to itself that no interrupt can end at 0x2002fffe",
    ),
    "a jump to where called functions return to": ("ldr r0, =0x1FFEF001\n bx r0", "address 0x1ffef000 at .*main"),
    "no memory at VTOR": ("ldr r0, =0xE000ED08\n ldr r1, =0x10000000\n str r1, [r0]\n svc 0", "no memory at VTOR"),
    "vectors of zero": ("ldr r0, =0xE000ED08\n ldr r1, =0x20010000\n str r1, [r0]\n svc 0", "vector 0x00000000"),
    "EXC_RETURN without an exception": ("ldr r0, =0xFFFFFFF9\n bx r0", "0xfffffff9 where no exception is active"),
    "an unaligned LDREX": ("ldr r0, =0x20000002\n ldrex r1, [r0]", "unaligned exclusive access at .* in main"),
    "a coprocessor": ("mrc p15, 0, r0, c0, c0, 0", r"coprocessor that is not there \(NOCP\) at .* in main"),
    "a word across the end of the peripherals": (
        f"{GATES_OPEN}\n ldr r0, =0x40052FFE\n ldr r1, [r0]",
        "read of 0x40052ffe, where the chip has no peripheral at .* in main",
    ),
}


@pytest.mark.parametrize("what", CASES)
def test_it_is_a_fault_that_says_what_happened(build: Build, what: str) -> None:
    code, ending = CASES[what]
    board = VirtualK64F(build(HEAD.replace("culprit:", "") + code + TAIL))
    board.may_rest = False
    with pytest.raises(BoardFault, match=ending):
        board.run_until(0.01)
    board.position()  # whoever waits for the board says where it is
