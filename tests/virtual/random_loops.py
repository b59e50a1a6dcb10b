"""Programs of random loops: on counters, on flags, on nothing; most end, some never do."""

from __future__ import annotations

import random

HEAD = """
    function SysTick_Handler
    ldr r0, =ticks
    ldr r1, [r0]
    adds r1, #1
    str r1, [r0]
    bx lr
    .ltorg
    function main
    ldr r0, =0xE000EDFC
    mov r1, #1 << 24
    str r1, [r0]
    ldr r9, =0xE0001000
    movs r1, #1
    str r1, [r9]
    ldr r8, =0xE000E010
    ldr r1, =0x4004803C
    ldr r0, =0x00800001
    str r0, [r1]
    ldr r11, =0x40037000
    movs r0, #0
    str r0, [r11]
    ldr r0, ={timer}
    str r0, [r11, #0x100]
    movs r0, #1
    str r0, [r11, #0x108]
    ldr r0, ={reload}
    str r0, [r8, #4]
    str r0, [r8, #8]
    movs r0, #{control}
    str r0, [r8]
    ldr r10, =ticks
"""
TAIL = """
    b again
    .ltorg
    .bss
    .balign 4
ticks: .space 64
"""
CONDITIONS = ("eq", "ne", "hs", "lo", "mi", "pl", "hi", "ls", "ge", "lt", "gt", "le")


def random_program(seed: int) -> str:
    """Return the source of a program: some loops one behind the other, over and over."""
    chance = random.Random(seed)
    reload = chance.choice([200, 999, 5003, 60_001, 0xFFFFFF])
    head = HEAD.format(timer=chance.choice([77, 1234, 50_000]), reload=reload, control=chance.choice([5, 5, 7]))
    lines = [f"    ldr r{number}, ={chance.choice([0, 1, 5, 100, 5000, 1 << 20, 0xFFFFFF00])}" for number in range(8)]
    lines.append("again:")
    for loop in range(chance.randint(1, 4)):
        lines += _loop(chance, loop)
    return head + "\n".join(lines) + TAIL


def _loop(chance: random.Random, number: int) -> list[str]:
    read = chance.choice(
        [
            "ldr r0, [r8, #8]",
            "ldr r0, [r9, #4]",
            "ldr r0, [r11, #0x104]",
            "ldr r0, [r11, #0x10C]",
            "ldr r0, [r8]",
            "ldr r0, [r10]",
            "adds r0, #1",
            "subs r0, #7",
        ]
    )
    body = [read, *(_step(chance) for _ in range(chance.randint(0, 5)))]
    chance.shuffle(body)
    limit = chance.choice([3, 50, 1000, 4097, 30_000, 1 << 24])
    prepared = [f"    movs r0, #{chance.randrange(200)}", f"    ldr r7, ={limit}", "    ldr r6, [r9, #4]"]
    elapsed = "subs r5, r0, r6\n    cmp r5, r7"
    compared = chance.choice(["cmp r0, r7", elapsed, "tst r0, r7", "subs r4, #1", "cmp r4, r0"])
    stop = f"    {compared}\n    b{chance.choice(CONDITIONS)} loop_{number}"
    return [*prepared, f"loop_{number}:", *(f"    {step}" for step in body), stop, "    str r0, [r10, #4]"]


def _step(chance: random.Random) -> str:
    """Return an instruction, or some that belong together; r0 is what is waited for, r6 to r12 stay as they are."""
    low = [f"r{number}" for number in range(6)]
    one, other, third = (chance.choice(low) for _ in range(3))
    small = chance.randrange(32)
    condition = chance.choice(CONDITIONS)
    plain = [
        f"adds {one}, {other}, {third}",
        f"subs {one}, {other}, {third}",
        f"adds {one}, #{small}",
        f"mov {one}, {other}",
        f"subs {one}, #{small}",
        f"bic {one}, {other}, #0xFF000000",
        f"ands {one}, {other}",
        f"lsrs {one}, {other}, #3",
        f"uxth {one}, {other}",
        f"uxtb {one}, {other}",
        f"ubfx {one}, {other}, #4, #12",
        f"lsls {one}, {other}, #2",
        f"rsb {one}, {other}, #{small}",
        f"orr {one}, {other}, #{small}",
        f"eor {one}, {other}, {third}",
        f"cmp {one}, #{small}",
        f"asrs {one}, {other}, #2",
        f"mul {one}, {other}, {third}",
        f"mvn {one}, {other}",
        f"udiv {one}, {other}, r7",
        f"add {one}, {other}, {third}, lsl #1",
        "nop",
        f"sxtb {one}, {other}",
        f"str {one}, [r10, #8]",
        f"ldr {one}, [r10, #8]",
        f"strh {one}, [r10, #12]",
        f"ldrh {one}, [r10, #12]",
        f"push {{{one}, lr}}\n    pop {{{other}, lr}}",
        f"ldrd {one}, r12, [r10]",
        "cpsid i\n    cpsie i",
    ]
    skipped = f"it {condition}\n    mov{condition} {one}, {other}"
    both = f"cmp {one}, {other}\n    ite hs\n    subhs {third}, {one}, {other}\n    addlo {third}, {one}, r7"
    accesses = f"itt {condition}\n    ldr{condition} {one}, [r10, #8]\n    str{condition} {other}, [r10, #8]"
    counter = f"it {condition}\n    ldr{condition} {one}, [r9, #4]"
    return chance.choice([*plain, skipped, both, accesses, counter, f"it {condition}\n    udiv{condition} {one}, r7"])
