"""Instructions that fault after they have been executed many times without one."""

from __future__ import annotations

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.k64f import VirtualK64F

from .conftest import Build
from .test_faults import HEAD, TAIL

# The FPU is off at reset.
FPU_ON = """
    ldr r0, =0xE000ED88
    ldr r1, =0xF << 20
    str r1, [r0]
    dsb
    isb
"""

UNALIGNED = f"""
    {FPU_ON}
    ldr r0, =0x20000000
    movs r2, #100
again:
    vldr s0, [r0]
    vldmia r0!, {{s1}}
    subs r2, #1
    bne again
    adds r0, #2
    b last
last:
    vldr s0, [r0]
"""

INSIDE = f"""
    {FPU_ON}
    ldr r3, =0x20000000
    movs r2, #9
again:
    str r3, [sp, #-4]
    ldr r0, [sp, #-4]
    vldr s0, [r0]
    subs r2, #1
    bne again
    adds r3, #1
    movs r2, #1
    b again
"""

DISABLED = f"""
    {FPU_ON}
    movs r2, #9
again:
    vadd.f32 s0, s0, s0
    subs r2, #1
    bne again
    movs r1, #0
    str r1, [r0]
    b last
last:
    vadd.f32 s0, s0, s0
"""


@pytest.mark.parametrize(
    ("code", "cause"),
    [
        (UNALIGNED, "unaligned access: r0 = 0x20000192 in 'vldr s0"),
        (INSIDE, "unaligned access: r0 = 0x20000001 in 'vldr s0"),
        (DISABLED, "FPU used while CPACR disables it"),
    ],
    ids=["unaligned behind aligned ones", "loaded and unaligned within a block", "FPU switched off again"],
)
def test_an_instruction_that_was_right_many_times_faults_when_it_is_wrong(build: Build, code: str, cause: str) -> None:
    board = VirtualK64F(build(HEAD + code + TAIL))
    with pytest.raises(BoardFault, match=cause):
        board.run_until(0.01)


def test_a_base_made_of_the_stack_pointer_or_the_pc_is_aligned(build: Build) -> None:
    code = f"""
    {FPU_ON}
    movs r3, #1
    movs r4, #1
    b 1f
1:  add r3, sp, #-8
    vldr s0, [r3]
    adr r4, 2f
    vldr s1, [r4]
    b end
    .balign 4
2:  .word 0
end:
    b .
"""
    board = VirtualK64F(build(HEAD + code + TAIL))
    board.run_until(0.01)
    assert board.position().startswith("at rest")
