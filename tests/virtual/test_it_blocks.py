"""What an IT block skips takes one cycle by version 2, however it is counted."""

from __future__ import annotations

import pytest

from hiltest.virtual import accounting as python_accounting
from hiltest.virtual.accounting import AccountingFactory, BlockAccounting, InstructionAccounting
from hiltest.virtual.cycle_range import cycle_range
from hiltest.virtual.executions import between
from hiltest.virtual.k64f import VirtualK64F
from hiltest.virtual.native import accounting as native_accounting
from hiltest.virtual.native.accounting import NativeBlockAccounting

from .conftest import Build

TWO = "cortex-m4-trm/2"
# Of `work` with r0 = 0 and with another r0: the cycles of each instruction by the manual's table, added up by hand.
COUNTED = {
    # sub 1, cmp 1, it 0; LDR 2, MOV 1, skipped 1, skipped 1; bx 3; the other way skipped 1, skipped 1, LDM 3, VLDR 2
    "loads": ("""
        sub r3, sp, #16
        cmp r0, #0
        ittee eq
        ldreq r1, [r3]
        moveq r2, #1
        ldmne.w r3, {r1, r2}
        vldrne s0, [r3]
        bx lr
    """, 10, 12),
    # push 2, cmp 1, it 0; pop to the PC 4; the other way skipped 1, then pop to the PC 4
    "return": ("""
        push {lr}
        cmp r0, #0
        it eq
        popeq {pc}
        pop {pc}
    """, 7, 8),
    # cmp 1, it 0; branch 1, refill 1; the other way skipped 1, add 1; bx 3
    "branch": ("""
        cmp r0, #0
        it eq
        beq.n 1f
        adds r0, #1
    1:  bx lr
    """, 6, 6),
    # vmov 1, cmp 1, it 0; VDIV 1, and 15 later VADD 1 can use it: 14 wait; the other way skipped 1, VADD 1; bx 3
    "division": ("""
        vmov.f32 s1, #1.0
        cmp r0, #0
        it eq
        vdiveq.f32 s0, s1, s1
        vadd.f32 s2, s0, s1
        bx lr
    """, 21, 7),
    # vmov 1, then 1 for its result and VDIV 1, of 14 the FPU is busy 13 more, cmp 1, it 0; VMOV waits 12 and takes 1,
    # VADD 1; the other way skipped 1, VADD waits 11 and takes 1; bx 3
    "under a division": ("""
        vmov.f32 s1, #1.0
        vdiv.f32 s0, s1, s1
        cmp r0, #0
        it eq
        vmoveq.f32 s2, s1
        vadd.f32 s3, s1, s1
        bx lr
    """, 21, 20),
    # sub 1, cmp 1, it 0; SUB 1, then 1 for the address and LDR 2; the other way skipped 1, LDR 2; bx 3
    "address": ("""
        sub r3, sp, #16
        cmp r0, #0
        it eq
        subeq r3, #4
        ldr r1, [r3]
        bx lr
    """, 9, 8),
    # cmp 1, it 0; STR 1, CMP 1 with another answer, so that 1 is skipped; the other way skipped 3; bx 3
    "a comparison inside": ("""
        cmp r0, #0
        ittt eq
        streq r0, [sp, #-4]
        cmpeq sp, #1
        ldreq r1, [sp]
        bx lr
    """, 7, 7),
}  # fmt: skip


def program(work: str) -> str:
    return f"""
        .syntax unified
        .cpu cortex-m4
        .fpu fpv4-sp-d16
        .thumb
        .text
        .global main
        .thumb_func
    main:
        bx lr
        .section .fast, "ax", %progbits
        .balign 16
        .global work
        .thumb_func
        .type work, %function
    work:
        {work}
        .size work, . - work
        .ltorg
    """


@pytest.mark.parametrize(("work", "where_zero", "elsewhere"), COUNTED.values(), ids=COUNTED)
def test_what_is_skipped_takes_a_cycle_and_leaves_nothing(
    build: Build, block_hook: AccountingFactory, work: str, where_zero: int, elsewhere: int
) -> None:
    elf = build(program(work), "-Wl,--section-start=.fast=0x1fff4000")
    for accounting in (block_hook, InstructionAccounting):
        board = VirtualK64F(elf, accounting=accounting, profile=TWO)
        # Each way behind the other: what one has left must not show in the next.
        counted = [board.call("work", argument).cycles for argument in (0, 1, 1, 0)]
        assert counted == [where_zero, elsewhere, elsewhere, where_zero]


CLOCK = """
        ldr r3, =0xE0001004
        sub r2, sp, #16
        ldr r1, [r3]
        cmp r0, #0
        itte eq
        ldmeq.w r2, {r1, r12}
        ldreq r1, [r3]
        ldmne.w r2, {r1, r12}
        ldr r1, [r3]
        bx lr
"""


def test_a_clock_that_is_read_behind_what_was_skipped_in_the_same_block_knows_it(
    build: Build, block_hook: AccountingFactory
) -> None:
    elf = build(program(CLOCK), "-Wl,--section-start=.fast=0x1fff4000")
    found = []
    for accounting in (block_hook, InstructionAccounting):
        board = VirtualK64F(elf, accounting=accounting, profile=TWO)
        for argument in (0, 1):
            board.call("work", argument)
        found.append([(each.at, each.instructions) for each in board.cycle_counter.readings])
    assert found[0] == found[1]
    first, second, third, *other = (at for at, _ in found[0])
    # LDR 2, cmp 1, it 0, LDM 3; LDR 2, skipped 1; where it is not zero skipped 1, skipped 1, LDM 3
    assert (second - first, third - second, other[1] - other[0]) == (6, 3, 8)


def test_executions_are_priced_again_with_what_was_skipped(build: Build, block_hook: AccountingFactory) -> None:
    elf = build(program(COUNTED["loads"][0]), "-Wl,--section-start=.fast=0x1fff4000")
    board = VirtualK64F(elf, accounting=block_hook, profile=TWO)
    ranges = []
    for argument in (0, 1):
        before = board.processor.accounting.snapshot(0)
        cycles = board.call("work", argument).cycles
        executed = between(before, board.processor.accounting.snapshot(0))
        assert executed is not None
        band = cycle_range(board.processor.profile, cycles, executed)
        assert band is not None
        ranges.append({each.row: (each.low, each.high) for each in band.rows})
    # Only where it is not zero the VLDR runs, whose row is uncertain; what is skipped is not.
    assert "fp_load" not in ranges[0]
    assert not any("it_skipped" in each for each in ranges)
    assert ranges[0]["it_folded"] == (10, 11)


REWRITTEN = """
        push {r4, lr}
        movs r4, #6
        ldr r3, =patched
        bic r3, #1
        sub r1, sp, #16
    again:
        cmp r0, #0
        it eq
    patched:
        ldreq r1, [r1]
        sub r1, sp, #16
        eor r0, #1
        movw r2, #0x4609
        cmp r4, #3
        it eq
        strheq r2, [r3]
        isb
        subs r4, #1
        bne again
        pop {r4, pc}
"""


def test_an_it_block_that_is_written_over_is_counted_as_what_it_becomes(
    build: Build, block_hook: AccountingFactory
) -> None:
    elf = build(program(REWRITTEN), "-Wl,--section-start=.fast=0x1fff4000")
    # 8 before the turns, 10 each, 1 less in the last, and for LDR 2, 2 and then as MOV 1, three times skipped 1; pop 5.
    expected = 8 + 6 * 10 - 1 + (2 + 2 + 1 + 3 * 1) + 5
    for accounting in (block_hook, InstructionAccounting):
        for argument in (0, 1):
            assert VirtualK64F(elf, accounting=accounting, profile=TWO).call("work", argument).cycles == expected


def test_ways_through_it_blocks_without_number_are_forgotten_and_counted(
    build: Build, block_hook: AccountingFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = {BlockAccounting: python_accounting, NativeBlockAccounting: native_accounting}[block_hook]
    monkeypatch.setattr(module, "BLOCKS_KEPT", 20)
    chosen = "".join(f"lsls r2, r0, #{bit}\n itt mi\n ldrmi r3, [r1]\n strmi r0, [r1]\n" for bit in range(24, 32))
    # 8 bits have 256 ways.
    elf = build(program(f"sub r1, sp, #16\n again: {chosen} subs r0, #1\n bne.w again\n bx lr"))
    boards = [VirtualK64F(elf, accounting=each, profile=TWO) for each in (block_hook, InstructionAccounting)]
    known = []
    for _ in range(2):
        by_block, by_instruction = (board.call("work", 255) for board in boards)
        assert (by_block.cycles, by_block.instructions) == (by_instruction.cycles, by_instruction.instructions)
        snapshot = boards[0].processor.accounting.snapshot(0)
        assert snapshot is not None
        known.append(snapshot.entered)
    assert known[0] is not known[1]
    assert len(known[1]) < 20


def test_version_1_prices_as_executed_what_is_skipped(build: Build, block_hook: AccountingFactory) -> None:
    elf = build(program(COUNTED["loads"][0]), "-Wl,--section-start=.fast=0x1fff4000")
    for accounting in (block_hook, InstructionAccounting):
        board = VirtualK64F(elf, accounting=accounting, profile="cortex-m4-trm/1")
        assert [board.call("work", argument).cycles for argument in (0, 1)] == [1 + 1 + 1 + 2 + 1 + 3 + 2 + 3] * 2
