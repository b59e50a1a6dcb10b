"""Code that Hypothesis puts together takes the cycles that the cycle model in Python gives, by moved rows too."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hiltest.virtual.counts.cycle_range import cycle_range, moves
from hiltest.virtual.model.profile_file import load_profile
from hiltest.virtual.model.timing import moved

from .conftest import Build
from .oracle import priced, stepped

PLACES = 700  # halfwords that are written over
FRAME = f"""
    .syntax unified
    .thumb
    .cpu cortex-m4
    .text
    .thumb_func
    .global main
main:
    bx lr
    .section .fast, "ax", %progbits
    .balign 16
    .thumb_func
    .global work
    .type work, %function
work:
    .rept {PLACES}
    .hword 0xbf00
    .endr
    .size work, . - work
"""
# r7 holds an address; r5 and r6 may become others near it. Encodings of the ARMv7-M manual, as halfwords.
BASE = (0xF240, 0x0700, 0xF2C2, 0x0700)  # movw r7, #0; movt r7, #0x2000
END = (0x4770,)  # bx lr
PIECES = {
    "nop": (0xBF00,), "adds r0, #1": (0x3001,), "muls r0, r1": (0x4348,), "cmp r0, #3": (0x2803,),
    "eor.w": (0xEA81, 0x0002), "umaal": (0xFBE2, 0x0163),
    "udiv": (0xFBB0, 0xF1F7), "add r5, r7, #8": (0xF107, 0x0508), "mov r6, r7": (0x463E,),
    "ldr r0, [r7]": (0x6838,), "ldr r1, [r7, #4]": (0x6879,), "ldr.w r2, [r7, #8]": (0xF8D7, 0x2008),
    "ldr r5, [r7] and again its base": (0x463D, 0x682B), "str r0, [r7, #4]": (0x6078,),
    "str.w r1, [r7, #8]": (0xF8C7, 0x1008), "ldmia r6, {r0, r1}": (0x463E, 0xCE03), "ldrd": (0xE9D7, 0x0100),
    "add r5, r7, #8; ldr r0, [r5]": (0xF107, 0x0508, 0x6828),
    "vadd": (0xEE31, 0x1A82), "vadd chain": (0xEE30, 0x0A20), "vmul": (0xEE21, 0x1A82), "vmla": (0xEE00, 0x0A81),
    "vdiv": (0xEE80, 0x0A81), "vldr": (0xED97, 0x0A00), "vstr": (0xED87, 0x0A01), "vmov r0, s0": (0xEE10, 0x0A10),
    "vmov r0, r1, d0": (0xEC51, 0x0B10), "it eq; moveq": (0xBF08, 0x4608),
    "ite ne; ldrne; addeq": (0xBF14, 0x6838, 0x3001),
    "itet lt; strlt; udivge; vldrlt": (0xBFB6, 0x6078, 0xFBB0, 0xF1F7, 0xED97, 0x0A00),
    "ittee hs; vdivhs; vaddhs; vmovlo; vaddlo": (
        0xBF27, 0xEE80, 0x0A81, 0xEE30, 0x0A20, 0xEE10, 0x0A10, 0xEE31, 0x1A82,
    ),
    "mov r6, r7; itt ne; ldmne r6; strne": (0x463E, 0xBF1C, 0xCE03, 0x60B9),
    "ittt eq; ldreq; cmpeq; ldreq": (0xBF02, 0x6838, 0x2803, 0x6879),
    "ite mi; vmovmi; vaddpl; vmul": (0xBF4C, 0xEEF0, 0x0A41, 0xEE31, 0x1A82, 0xEE60, 0x1A81),
    "push; it eq; popeq; mov sp, r6": (0x466E, 0xB403, 0xBF08, 0xBC03, 0x46B5),
    "add r5, r7, #8; it hi; addhi r5; ldr": (0xF107, 0x0508, 0xBF88, 0x3504, 0x6828),
    "ite gt; vmulgt; vstrle": (0xBFCC, 0xEE60, 0x1A81, 0xED87, 0x0A01),
    "vsqrt; it ge; vmovge; vadd": (0xEEB1, 0x2AE2, 0xBFA8, 0xEEB0, 0x3A63, 0xEE32, 0x4A03),
    "vmov.f32; it vs; vmovvs": (0xEEF0, 0x4A45, 0xBF68, 0xEEF0, 0x5A64, 0xBF00, 0xEE75, 0x5A86),
    "it eq; beq past a load": (0xBF08, 0xF000, 0xB801, 0x6838, 0xBF00),
    "ittt lo; a multiple, its base": (0x463E, 0xBF3E, 0x3604, 0xE896, 0x0003, 0x4348),
}  # fmt: skip
SKIPS = (0xD000, 0xD100, 0xD200, 0xDB00)  # beq, bne, bhs, blt
WIDE_SKIPS = (0xF000, 0xF040, 0xF080, 0xF2C0)


@st.composite
def programs(draw: st.DrawFn) -> bytes:
    """Draw a function: pieces, some of them jumped over where a condition holds, in a loop of three turns."""
    body: list[int] = []
    for name in draw(st.lists(st.sampled_from(sorted(PIECES)), min_size=1, max_size=60)):
        piece = PIECES[name]
        if draw(st.integers(0, 5)) == 0:
            kind = draw(st.integers(0, 3))
            if draw(st.booleans()):
                body.append(SKIPS[kind] | len(piece) - 1)
            else:
                body += [WIDE_SKIPS[kind], 0x8000 | len(piece)]
        body += piece
    first = [*BASE, 0x2403, *[0xBF00] * draw(st.integers(0, 1))]  # movs r4, #3
    back = -(len(body) + 1 + 2)  # from behind the branch, in halfwords
    loop = [*body, 0x3C01, 0xF040 | 0x0400 | 0x3F, 0x8000 | 0x2800 | (back & 0x7FF)]  # subs r4, #1; bne.w
    halfwords = [*first, *loop, *END]
    assert len(halfwords) <= PLACES
    return struct.pack(f"<{len(halfwords)}H", *halfwords)


def patched(elf: bytes, code: bytes) -> bytes:
    begin = elf.index(b"\x00\xbf" * PLACES)
    return elf[:begin] + code + elf[begin + len(code) :]


@pytest.fixture
def frame(build: Build) -> bytes:
    return Path(build(FRAME, "-Wl,--section-start=.fast=0x1fff4000")).read_bytes()


@pytest.mark.parametrize("profile", ["cortex-m4-trm/1", "cortex-m4-trm/2"])
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(code=programs())
def test_generated_code_takes_what_its_instructions_take(frame: bytes, profile: str, code: bytes) -> None:
    prices = load_profile(profile)
    result, steps = stepped(patched(frame, code), "work", profile=prices)
    assert result.executed
    band = cycle_range(prices, result.cycles, [result.executed])
    assert band
    effects = {effect.row: (effect.low, effect.high) for effect in band.rows}
    for move in moves(prices):
        counted = tuple(priced(steps, moved(prices, values)) for values in (move.low, move.high))
        assert effects.get(move.row, (result.cycles, result.cycles)) == counted, move.row
