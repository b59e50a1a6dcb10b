"""Fields of decoded instructions: what each form of each operation says that the core shall do.

The instructions are assembled; the fields beside them are written by hand from the manual's pseudocode. A field that is
not named must have its neutral value.
"""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from .decoder import decode, fields, operation_name

ADDRESS = 0x1002
NEXT = 0x1006  # the PC as an operand
LITERALS = 0x1004  # Align(PC, 4)
SLOT = 16  # bytes from one instruction to the next in the assembled code
EQUAL = 0
IT_EQUAL = 0x08  # ITSTATE of a block of one instruction with condition EQ

LSL, LSR, ASR, ROR, RRX = range(5)
WRITES_BACK, POST, BEFORE = 1, 2, 4
NEUTRAL = {
    "condition": 14, "d": 0, "n": 0, "m": 0, "a": 0, "shift": 0, "amount": 0, "mode": 0, "words": 0,
    "sets_flags": False, "carry": 2, "immediate": 0,
}  # fmt: skip


def _below(offset: int) -> int:
    return 2**32 - offset


def _is(operation: str, **expected: Any) -> tuple[str, dict[str, Any]]:
    return operation, NEUTRAL | expected


def _sets(operation: str, **expected: Any) -> tuple[str, dict[str, Any]]:
    return _is(operation, sets_flags=True, **expected)


SHORT = {
    "lsls r1, r2, #3": _sets("MOV_XS", d=1, m=2, shift=LSL, amount=3),
    "movs r1, r2": _sets("MOV_RS", d=1, m=2),
    "lsrs r1, r2, #32": _sets("MOV_XS", d=1, m=2, shift=LSR, amount=32),
    "asrs r1, r2, #32": _sets("MOV_XS", d=1, m=2, shift=ASR, amount=32),
    "adds r1, r2, r3": _sets("ADD_RS", d=1, n=2, m=3),
    "subs r1, r2, r3": _sets("SUB_RS", d=1, n=2, m=3),
    "adds r1, r2, #7": _sets("ADD_IS", d=1, n=2, immediate=7),
    "subs r1, r2, #7": _sets("SUB_IS", d=1, n=2, immediate=7),
    "movs r4, #255": _sets("MOV_IS", d=4, immediate=255),
    "cmp r4, #200": _sets("CMP_IS", n=4, immediate=200),
    "adds r4, #200": _sets("ADD_IS", d=4, n=4, immediate=200),
    "subs r4, #200": _sets("SUB_IS", d=4, n=4, immediate=200),
    "ands r1, r2": _sets("AND_RS", d=1, n=1, m=2),
    "eors r1, r2": _sets("EOR_RS", d=1, n=1, m=2),
    "lsls r1, r2": _sets("SHIFT", d=1, n=1, m=2, shift=LSL),
    "lsrs r1, r2": _sets("SHIFT", d=1, n=1, m=2, shift=LSR),
    "asrs r1, r2": _sets("SHIFT", d=1, n=1, m=2, shift=ASR),
    "adcs r1, r2": _sets("ADC_RS", d=1, n=1, m=2),
    "sbcs r1, r2": _sets("SBC_RS", d=1, n=1, m=2),
    "rors r1, r2": _sets("SHIFT", d=1, n=1, m=2, shift=ROR),
    "tst r1, r2": _sets("TST_RS", n=1, m=2),
    "negs r1, r2": _sets("RSB_IS", d=1, n=2),
    "cmp r1, r2": _sets("CMP_RS", n=1, m=2),
    "cmn r1, r2": _sets("CMN_RS", n=1, m=2),
    "orrs r1, r2": _sets("ORR_RS", d=1, n=1, m=2),
    "muls r1, r2, r1": _sets("MUL", d=1, n=2, m=1),
    "bics r1, r2": _sets("BIC_RS", d=1, n=1, m=2),
    "mvns r1, r2": _sets("MVN_RS", d=1, m=2),
    "add r9, r10": _is("ADD_R", d=9, n=9, m=10),
    "add r9, pc": _is("ADD_I", d=9, n=9, immediate=NEXT),
    "add sp, r1": _is("ADD_R", d=13, n=13, m=1),
    "add r1, sp, r1": _is("ADD_R", d=1, n=1, m=13),
    "add pc, r3": _is("ADD_PC", d=15, n=15, m=3),
    "cmp r9, r10": _sets("CMP_RS", n=9, m=10),
    "mov r9, r10": _is("MOV_R", d=9, m=10),
    "mov r9, pc": _is("MOV_I", d=9, immediate=NEXT),
    "mov pc, r9": _is("MOV_PC", d=15, m=9),
    "mov pc, pc": _is("B", d=15, immediate=NEXT),
    "bx lr": _is("BX", m=14),
    "blx r9": _is("BLX", m=9),
    "ldr r1, [pc, #20]": _is("LDR_L", d=1, n=15, immediate=LITERALS + 20),
    "str r1, [r2, r3]": _is("STR_R", d=1, n=2, m=3),
    "strh r1, [r2, r3]": _is("STRH_R", d=1, n=2, m=3),
    "strb r1, [r2, r3]": _is("STRB_R", d=1, n=2, m=3),
    "ldrsb r1, [r2, r3]": _is("LDRSB_R", d=1, n=2, m=3),
    "ldr r1, [r2, r3]": _is("LDR_R", d=1, n=2, m=3),
    "ldrh r1, [r2, r3]": _is("LDRH_R", d=1, n=2, m=3),
    "ldrb r1, [r2, r3]": _is("LDRB_R", d=1, n=2, m=3),
    "ldrsh r1, [r2, r3]": _is("LDRSH_R", d=1, n=2, m=3),
    "str r1, [r2, #124]": _is("STR_I", d=1, n=2, immediate=124),
    "ldr r1, [r2, #124]": _is("LDR_I", d=1, n=2, immediate=124),
    "strb r1, [r2, #31]": _is("STRB_I", d=1, n=2, immediate=31),
    "ldrb r1, [r2, #31]": _is("LDRB_I", d=1, n=2, immediate=31),
    "strh r1, [r2, #62]": _is("STRH_I", d=1, n=2, immediate=62),
    "ldrh r1, [r2, #62]": _is("LDRH_I", d=1, n=2, immediate=62),
    "str r1, [sp, #1020]": _is("STR_I", d=1, n=13, immediate=1020),
    "ldr r1, [sp, #1020]": _is("LDR_I", d=1, n=13, immediate=1020),
    "add r1, pc, #1020": _is("MOV_I", d=1, immediate=LITERALS + 1020),
    "add r1, sp, #1020": _is("ADD_I", d=1, n=13, immediate=1020),
    "add sp, #508": _is("ADD_I", d=13, n=13, immediate=508),
    "sub sp, #508": _is("SUB_I", d=13, n=13, immediate=508),
    "cbz r1, .+130": _is("CBZ", n=1, immediate=ADDRESS + 130),
    "cbnz r1, .+4": _is("CBNZ", n=1, immediate=ADDRESS + 4),
    "sxth r1, r2": _is("SXTAH", d=1, n=15, m=2),
    "sxtb r1, r2": _is("SXTAB", d=1, n=15, m=2),
    "uxth r1, r2": _is("UXTAH", d=1, n=15, m=2),
    "uxtb r1, r2": _is("UXTAB", d=1, n=15, m=2),
    "push {r1, r7, lr}": _is("STM", n=13, immediate=0x4082, mode=WRITES_BACK | BEFORE, words=3),
    "pop {r1, pc}": _is("LDM", n=13, immediate=0x8002, mode=WRITES_BACK, words=2),
    "cpsid i": _is("CPS", amount=2, immediate=1),
    "cpsie f": _is("CPS", amount=1),
    "rev r1, r2": _is("REV", d=1, m=2),
    "rev16 r1, r2": _is("REV16", d=1, m=2),
    "revsh r1, r2": _is("REVSH", d=1, m=2),
    "bkpt 171": _is("BKPT", immediate=171),
    "nop": _is("NOP"),
    "yield": _is("YIELD"),
    "wfe": _is("WFE"),
    "wfi": _is("WFI"),
    "sev": _is("SEV"),
    ".short 0xbf50": _is("NOP"),
    ".short 0xbf06": _is("IT", immediate=0x06),
    "stmia r3!, {r1, r2}": _is("STM", n=3, immediate=6, mode=WRITES_BACK, words=2),
    "ldmia r3!, {r1, r2}": _is("LDM", n=3, immediate=6, mode=WRITES_BACK, words=2),
    "ldmia r3, {r1, r3}": _is("LDM", n=3, immediate=10, words=2),
    "beq .-252": _is("B", condition=EQUAL, immediate=ADDRESS - 252),
    "b .+2046": _is("B", immediate=ADDRESS + 2046),
    "b .": _is("B", immediate=ADDRESS),
    "svc 171": _is("SVC", immediate=171),
    "udf 1": _is("UNDEFINED"),
}

IMMEDIATE = {
    "ands.w r1, r2, #0x80000000": _sets("AND_IS", d=1, n=2, immediate=0x80000000, carry=1),
    "ands.w r1, r2, #0x7f800000": _sets("AND_IS", d=1, n=2, immediate=0x7F800000, carry=0),
    "bic.w r1, r2, #0x00ab00ab": _is("BIC_I", d=1, n=2, immediate=0x00AB00AB),
    "orr.w r1, r2, #0xab00ab00": _is("ORR_I", d=1, n=2, immediate=0xAB00AB00),
    "orn r1, r2, #0xabababab": _is("ORN_I", d=1, n=2, immediate=0xABABABAB),
    "mov.w r1, #255": _is("MOV_I", d=1, immediate=255),
    "movs.w r1, #0x1fe": _sets("MOV_IS", d=1, immediate=0x1FE, carry=0),
    "mvns.w r1, #0xff0": _sets("MVN_IS", d=1, immediate=0xFF0, carry=0),
    "eor.w r9, r10, #1": _is("EOR_I", d=9, n=10, immediate=1),
    "tst.w r9, #0xf0000000": _sets("TST_IS", n=9, immediate=0xF0000000, carry=1),
    "teq r9, #1": _sets("TEQ_IS", n=9, immediate=1),
    "cmn.w r9, #1": _sets("CMN_IS", n=9, immediate=1),
    "cmp.w r9, #1": _sets("CMP_IS", n=9, immediate=1),
    "add.w r9, r10, #1": _is("ADD_I", d=9, n=10, immediate=1),
    "adcs.w r9, r10, #1": _sets("ADC_IS", d=9, n=10, immediate=1),
    "sbc.w r9, r10, #1": _is("SBC_I", d=9, n=10, immediate=1),
    "subs.w r9, r10, #1": _sets("SUB_IS", d=9, n=10, immediate=1),
    "rsb.w r9, r10, #1": _is("RSB_I", d=9, n=10, immediate=1),
    "addw r9, r10, #4095": _is("ADD_I", d=9, n=10, immediate=4095),
    "subw r9, r10, #4095": _is("SUB_I", d=9, n=10, immediate=4095),
    "addw r9, pc, #4095": _is("MOV_I", d=9, immediate=LITERALS + 4095),
    "subw r9, pc, #4095": _is("MOV_I", d=9, immediate=LITERALS - 4095),
    "movw r9, #0xabcd": _is("MOV_I", d=9, immediate=0xABCD),
    "movt r9, #0xabcd": _is("MOVT", d=9, immediate=0xABCD),
    "ssat r1, #32, r2, asr #31": _is("SSAT", d=1, n=2, immediate=32, shift=ASR, amount=31),
    "ssat r1, #1, r2": _is("SSAT", d=1, n=2, immediate=1),
    "usat r1, #31, r2, lsl #5": _is("USAT", d=1, n=2, immediate=31, amount=5),
    "ssat16 r1, #16, r2": _is("SSAT16", d=1, n=2, immediate=16),
    "usat16 r1, #15, r2": _is("USAT16", d=1, n=2, immediate=15),
    "sbfx r1, r2, #31, #1": _is("SBFX", d=1, n=2, amount=31, immediate=1),
    "ubfx r1, r2, #0, #32": _is("UBFX", d=1, n=2, immediate=32),
    "bfi r1, r2, #4, #8": _is("BFI", d=1, n=2, amount=4, immediate=0xFF0),
    "bfc r1, #0, #32": _is("BFC", d=1, immediate=0xFFFFFFFF),
}

REGISTERS = {
    "and.w r9, r10, r11": _is("AND_R", d=9, n=10, m=11),
    "ands.w r9, r10, r11, lsr #32": _sets("AND_XS", d=9, n=10, m=11, shift=LSR, amount=32),
    "bics.w r9, r10, r11": _sets("BIC_RS", d=9, n=10, m=11),
    "orr.w r9, r10, r11, ror #1": _is("ORR_X", d=9, n=10, m=11, shift=ROR, amount=1),
    "orn r9, r10, r11, rrx": _is("ORN_X", d=9, n=10, m=11, shift=RRX, amount=1),
    "mov.w r9, r10": _is("MOV_R", d=9, m=10),
    "lsl.w r9, r10, #31": _is("MOV_X", d=9, m=10, amount=31),
    "asrs.w r9, r10, #32": _sets("MOV_XS", d=9, m=10, shift=ASR, amount=32),
    "rrxs r9, r10": _sets("MOV_XS", d=9, m=10, shift=RRX, amount=1),
    "mvn.w r9, r10, lsl #1": _is("MVN_X", d=9, m=10, amount=1),
    "eors.w r9, r10, r11, lsl #1": _sets("EOR_XS", d=9, n=10, m=11, amount=1),
    "tst.w r9, r10": _sets("TST_RS", n=9, m=10),
    "teq r9, r10, lsl #2": _sets("TEQ_XS", n=9, m=10, amount=2),
    "cmn.w r9, r10, asr #2": _sets("CMN_XS", n=9, m=10, shift=ASR, amount=2),
    "cmp.w r9, r10, asr #2": _sets("CMP_XS", n=9, m=10, shift=ASR, amount=2),
    "add.w r9, sp, r10, lsl #3": _is("ADD_X", d=9, n=13, m=10, amount=3),
    "adc.w r9, r10, r11": _is("ADC_R", d=9, n=10, m=11),
    "sbcs.w r9, r10, r11": _sets("SBC_RS", d=9, n=10, m=11),
    "sub.w r9, r10, r11, lsl #3": _is("SUB_X", d=9, n=10, m=11, amount=3),
    "rsbs r9, r10, r11": _sets("RSB_RS", d=9, n=10, m=11),
    "pkhbt r1, r2, r3, lsl #31": _is("PKHBT", d=1, n=2, m=3, amount=31),
    "pkhtb r1, r2, r3, asr #32": _is("PKHTB", d=1, n=2, m=3, shift=ASR, amount=32),
    "lsl.w r9, r10, r11": _is("SHIFT", d=9, n=10, m=11),
    "rors.w r9, r10, r11": _sets("SHIFT", d=9, n=10, m=11, shift=ROR),
    "sxtab r1, r2, r3, ror #24": _is("SXTAB", d=1, n=2, m=3, amount=24),
    "uxtah r1, r2, r3": _is("UXTAH", d=1, n=2, m=3),
    "uxth.w r1, r3, ror #8": _is("UXTAH", d=1, n=15, m=3, amount=8),
    "sxtb16 r1, r3, ror #16": _is("SXTAB16", d=1, n=15, m=3, amount=16),
    "uxtab16 r1, r2, r3": _is("UXTAB16", d=1, n=2, m=3),
    "sadd16 r1, r2, r3": _is("SADD16", d=1, n=2, m=3),
    "qasx r1, r2, r3": _is("QASX", d=1, n=2, m=3),
    "shsax r1, r2, r3": _is("SHSAX", d=1, n=2, m=3),
    "usub16 r1, r2, r3": _is("USUB16", d=1, n=2, m=3),
    "uqadd8 r1, r2, r3": _is("UQADD8", d=1, n=2, m=3),
    "uhsub8 r1, r2, r3": _is("UHSUB8", d=1, n=2, m=3),
    "qadd r1, r2, r3": _is("QADD", d=1, m=2, n=3),
    "qsub r1, r2, r3": _is("QSUB", d=1, m=2, n=3),
    "qdadd r1, r2, r3": _is("QDADD", d=1, m=2, n=3),
    "qdsub r1, r2, r3": _is("QDSUB", d=1, m=2, n=3),
    "rev.w r1, r2": _is("REV", d=1, m=2),
    "rev16.w r1, r2": _is("REV16", d=1, m=2),
    "revsh.w r1, r2": _is("REVSH", d=1, m=2),
    "rbit r1, r2": _is("RBIT", d=1, m=2),
    "clz r1, r2": _is("CLZ", d=1, m=2),
    "sel r1, r2, r3": _is("SEL", d=1, n=2, m=3),
    "mul.w r1, r2, r3": _is("MUL", d=1, n=2, m=3),
    "mla r1, r2, r3, r4": _is("MLA", d=1, n=2, m=3, a=4),
    "mls r1, r2, r3, r4": _is("MLS", d=1, n=2, m=3, a=4),
    "smlabt r1, r2, r3, r4": _is("SMLA_HALVES", d=1, n=2, m=3, a=4, amount=1),
    "smultb r1, r2, r3": _is("SMLA_HALVES", d=1, n=2, m=3, a=15, amount=2),
    "smlad r1, r2, r3, r4": _is("SMLAD", d=1, n=2, m=3, a=4),
    "smuadx r1, r2, r3": _is("SMLAD", d=1, n=2, m=3, a=15, amount=1),
    "smlawt r1, r2, r3, r4": _is("SMLAW", d=1, n=2, m=3, a=4, amount=1),
    "smulwb r1, r2, r3": _is("SMLAW", d=1, n=2, m=3, a=15),
    "smlsdx r1, r2, r3, r4": _is("SMLSD", d=1, n=2, m=3, a=4, amount=1),
    "smmlar r1, r2, r3, r4": _is("SMMLA", d=1, n=2, m=3, a=4, amount=1),
    "smmul r1, r2, r3": _is("SMMLA", d=1, n=2, m=3, a=15),
    "smmls r1, r2, r3, r4": _is("SMMLS", d=1, n=2, m=3, a=4),
    "usada8 r1, r2, r3, r4": _is("USADA8", d=1, n=2, m=3, a=4),
    "usad8 r1, r2, r3": _is("USADA8", d=1, n=2, m=3, a=15),
    "smull r1, r2, r3, r4": _is("SMULL", d=1, a=2, n=3, m=4),
    "umull r1, r2, r3, r4": _is("UMULL", d=1, a=2, n=3, m=4),
    "smlal r1, r2, r3, r4": _is("SMLAL", d=1, a=2, n=3, m=4),
    "umlal r1, r2, r3, r4": _is("UMLAL", d=1, a=2, n=3, m=4),
    "umaal r1, r2, r3, r4": _is("UMAAL", d=1, a=2, n=3, m=4),
    "smlaltb r1, r2, r3, r4": _is("SMLAL_HALVES", d=1, a=2, n=3, m=4, amount=2),
    "smlaldx r1, r2, r3, r4": _is("SMLALD", d=1, a=2, n=3, m=4, amount=1),
    "smlsld r1, r2, r3, r4": _is("SMLSLD", d=1, a=2, n=3, m=4),
    "sdiv r1, r2, r3": _is("SDIV", d=1, n=2, m=3),
    "udiv r1, r2, r3": _is("UDIV", d=1, n=2, m=3),
}

ACCESSES = {
    "ldr.w r1, [r2, #-4]!": _is("LDR_W", d=1, n=2, immediate=_below(4), mode=WRITES_BACK),
    "ldr.w r1, [r2], #4": _is("LDR_W", d=1, n=2, immediate=4, mode=WRITES_BACK | POST),
    "ldr.w pc, [r2], #4": _is("LDR_W", d=15, n=2, immediate=4, mode=WRITES_BACK | POST),
    "ldr.w r1, [r2, #4095]": _is("LDR_I", d=1, n=2, immediate=4095),
    "ldr.w r1, [r2, #-255]": _is("LDR_I", d=1, n=2, immediate=_below(255)),
    "ldr.w r1, [r2, r3, lsl #3]": _is("LDR_R", d=1, n=2, m=3, amount=3),
    "ldr.w r1, [pc, #-4]": _is("LDR_L", d=1, n=15, immediate=LITERALS - 4),
    "ldr.w pc, [pc, #4]": _is("LDR_L", d=15, n=15, immediate=LITERALS + 4),
    "ldrt r1, [r2, #255]": _is("LDR_I", d=1, n=2, immediate=255),
    "ldrb.w r1, [r2, #1]!": _is("LDRB_W", d=1, n=2, immediate=1, mode=WRITES_BACK),
    "ldrb.w r1, [pc, #5]": _is("LDRB_L", d=1, n=15, immediate=LITERALS + 5),
    "ldrh.w r1, [r2], #-2": _is("LDRH_W", d=1, n=2, immediate=_below(2), mode=WRITES_BACK | POST),
    "ldrh.w r1, [pc, #6]": _is("LDRH_L", d=1, n=15, immediate=LITERALS + 6),
    "ldrsb.w r1, [r2, #4]": _is("LDRSB_I", d=1, n=2, immediate=4),
    "ldrsb.w r1, [r2, #4]!": _is("LDRSB_W", d=1, n=2, immediate=4, mode=WRITES_BACK),
    "ldrsb.w r1, [pc, #6]": _is("LDRSB_L", d=1, n=15, immediate=LITERALS + 6),
    "ldrsh.w r1, [r2, #4]": _is("LDRSH_I", d=1, n=2, immediate=4),
    "ldrsh.w r1, [r2, #4]!": _is("LDRSH_W", d=1, n=2, immediate=4, mode=WRITES_BACK),
    "ldrsh.w r1, [pc, #6]": _is("LDRSH_L", d=1, n=15, immediate=LITERALS + 6),
    "ldrsht r1, [r2, #4]": _is("LDRSH_I", d=1, n=2, immediate=4),
    "str.w r1, [r2, #-4]!": _is("STR_W", d=1, n=2, immediate=_below(4), mode=WRITES_BACK),
    "str.w r1, [r2, r3, lsl #2]": _is("STR_R", d=1, n=2, m=3, amount=2),
    "strb.w r1, [r2], #1": _is("STRB_W", d=1, n=2, immediate=1, mode=WRITES_BACK | POST),
    "strh.w r1, [r2, #2]!": _is("STRH_W", d=1, n=2, immediate=2, mode=WRITES_BACK),
    "strht r1, [r2, #2]": _is("STRH_I", d=1, n=2, immediate=2),
    "pld [r1, #8]": _is("NOP"),
    "pli [pc, #-8]": _is("NOP"),
    "ldrd r1, r2, [r3, #-1020]": _is("LDRD", d=1, a=2, n=3, immediate=_below(1020), words=2),
    "ldrd r1, r2, [r3, #8]!": _is("LDRD", d=1, a=2, n=3, immediate=8, mode=WRITES_BACK, words=2),
    "ldrd r1, r2, [pc, #8]": _is("LDRD", d=1, a=2, n=15, immediate=LITERALS + 8, words=2),
    "strd r1, r2, [r3], #8": _is("STRD", d=1, a=2, n=3, immediate=8, mode=WRITES_BACK | POST, words=2),
    "ldmia.w r3!, {r1, r9}": _is("LDM", n=3, immediate=0x202, mode=WRITES_BACK, words=2),
    "ldmdb r3, {r1, pc}": _is("LDM", n=3, immediate=0x8002, mode=BEFORE, words=2),
    "stmia.w r3, {r1, r9}": _is("STM", n=3, immediate=0x202, words=2),
    "stmdb r3!, {r1, r9, lr}": _is("STM", n=3, immediate=0x4202, mode=WRITES_BACK | BEFORE, words=3),
    "ldrex r1, [r2, #1020]": _is("LDREX", d=1, n=2, immediate=1020),
    "ldrexb r1, [r2]": _is("LDREXB", d=1, n=2),
    "ldrexh r1, [r2]": _is("LDREXH", d=1, n=2),
    "strex r1, r2, [r3, #4]": _is("STREX", d=1, a=2, n=3, immediate=4),
    "strexb r1, r2, [r3]": _is("STREXB", d=1, a=2, n=3),
    "strexh r1, r2, [r3]": _is("STREXH", d=1, a=2, n=3),
    "clrex": _is("CLREX"),
    "tbb [pc, r1]": _is("TBB", n=15, m=1, immediate=NEXT),
    "tbh [r2, r1, lsl #1]": _is("TBH", n=2, m=1, immediate=NEXT),
}

CONTROL = {
    "bl .+16777216": _is("BL", immediate=ADDRESS + 16777216),
    "bl .-16777212": _is("BL", immediate=ADDRESS - 16777212 + 2**32),
    "b.w .-2": _is("B", immediate=ADDRESS - 2),
    "b.w .+8388608": _is("B", immediate=ADDRESS + 8388608),
    "bne.w .+1048574": _is("B", condition=1, immediate=ADDRESS + 1048574),
    "bne.w .-524288": _is("B", condition=1, immediate=ADDRESS - 524288 + 2**32),
    "mrs r1, control": _is("MRS", d=1, immediate=20),
    "mrs r1, basepri_max": _is("MRS", d=1, immediate=18),
    "msr apsr_nzcvq, r1": _is("MSR", n=1, amount=2),
    "msr apsr_nzcvqg, r1": _is("MSR", n=1, amount=3),
    "msr psp, r1": _is("MSR", n=1, amount=2, immediate=9),
    "nop.w": _is("NOP"),
    "sev.w": _is("SEV"),
    "wfe.w": _is("WFE"),
    "wfi.w": _is("WFI"),
    "yield.w": _is("YIELD"),
    "dbg #3": _is("NOP"),
    "dmb": _is("DMB"),
    "dsb": _is("DSB"),
    "isb": _is("ISB"),
    "udf.w #1": _is("UNDEFINED"),
    "mrc p15, 0, r1, c1, c0, 0": _is("NO_COPROCESSOR"),
    "mcrr p5, 0, r1, r2, c3": _is("NO_COPROCESSOR"),
    "cdp p0, 0, c1, c2, c3": _is("NO_COPROCESSOR"),
    "ldc p3, c1, [r2]": _is("NO_COPROCESSOR"),
    "stc2 p3, c1, [r2]": _is("NO_COPROCESSOR"),
}

FLOATS = {
    "vadd.f32 s1, s2, s31": _is("VADD", d=1, n=2, m=31),
    "vsub.f32 s1, s2, s3": _is("VSUB", d=1, n=2, m=3),
    "vmul.f32 s1, s2, s3": _is("VMUL", d=1, n=2, m=3),
    "vnmul.f32 s1, s2, s3": _is("VNMUL", d=1, n=2, m=3),
    "vdiv.f32 s1, s2, s3": _is("VDIV", d=1, n=2, m=3),
    "vmla.f32 s1, s2, s3": _is("VMLA", d=1, n=2, m=3),
    "vmls.f32 s1, s2, s3": _is("VMLS", d=1, n=2, m=3),
    "vnmla.f32 s1, s2, s3": _is("VNMLA", d=1, n=2, m=3),
    "vnmls.f32 s1, s2, s3": _is("VNMLS", d=1, n=2, m=3),
    "vfma.f32 s1, s2, s3": _is("VFMA", d=1, n=2, m=3),
    "vfms.f32 s1, s2, s3": _is("VFMS", d=1, n=2, m=3),
    "vfnma.f32 s1, s2, s3": _is("VFNMA", d=1, n=2, m=3),
    "vfnms.f32 s1, s2, s3": _is("VFNMS", d=1, n=2, m=3),
    "vabs.f32 s1, s2": _is("VABS", d=1, m=2),
    "vneg.f32 s1, s2": _is("VNEG", d=1, m=2),
    "vsqrt.f32 s1, s2": _is("VSQRT", d=1, m=2),
    "vmov.f32 s1, s2": _is("VMOV", d=1, m=2),
    "vmov.f32 s1, #1.0": _is("VMOV_I", d=1, immediate=0x3F800000),
    "vmov.f32 s1, #-31.0": _is("VMOV_I", d=1, immediate=0xC1F80000),
    "vmov.f32 s1, #0.125": _is("VMOV_I", d=1, immediate=0x3E000000),
    "vcmp.f32 s1, s2": _is("VCMP", d=1, m=2),
    "vcmpe.f32 s1, s2": _is("VCMP", d=1, m=2, amount=1),
    "vcmp.f32 s1, #0": _is("VCMP_ZERO", d=1),
    "vcmpe.f32 s1, #0": _is("VCMP_ZERO", d=1, amount=1),
    "vcvt.s32.f32 s1, s2": _is("VCVT_TO_INTEGER", d=1, m=2, amount=1),
    "vcvt.u32.f32 s1, s2": _is("VCVT_TO_INTEGER", d=1, m=2),
    "vcvtr.s32.f32 s1, s2": _is("VCVT_TO_INTEGER", d=1, m=2, amount=3),
    "vcvtr.u32.f32 s1, s2": _is("VCVT_TO_INTEGER", d=1, m=2, amount=2),
    "vcvt.f32.s32 s1, s2": _is("VCVT_FROM_INTEGER", d=1, m=2, amount=1),
    "vcvt.f32.u32 s1, s2": _is("VCVT_FROM_INTEGER", d=1, m=2),
    "vcvt.s16.f32 s1, s1, #16": _is("VCVT_TO_FIXED", d=1, amount=1, immediate=16),
    "vcvt.u32.f32 s1, s1, #1": _is("VCVT_TO_FIXED", d=1, amount=2, immediate=1),
    "vcvt.f32.s32 s1, s1, #32": _is("VCVT_FROM_FIXED", d=1, amount=3, immediate=32),
    "vcvt.f32.u16 s1, s1, #9": _is("VCVT_FROM_FIXED", d=1, immediate=9),
    "vcvtb.f16.f32 s1, s2": _is("VCVT_TO_HALF", d=1, m=2),
    "vcvtt.f16.f32 s1, s2": _is("VCVT_TO_HALF", d=1, m=2, amount=1),
    "vcvtt.f32.f16 s1, s2": _is("VCVT_FROM_HALF", d=1, m=2, amount=1),
    "vmov s3, r1": _is("VMOV_FROM_CORE", d=1, n=3),
    "vmov r1, s3": _is("VMOV_TO_CORE", d=1, n=3),
    ".inst.w 0xee231b10": _is("VMOV_FROM_CORE", d=1, n=7),  # vmov.32 d3[1], r1
    ".inst.w 0xee131b10": _is("VMOV_TO_CORE", d=1, n=6),  # vmov.32 r1, d3[0]
    "vmov s3, s4, r1, r2": _is("VMOV_PAIR_FROM_CORE", d=1, a=2, m=3),
    "vmov r1, r2, s3, s4": _is("VMOV_PAIR_TO_CORE", d=1, a=2, m=3),
    "vmov d3, r1, r2": _is("VMOV_PAIR_FROM_CORE", d=1, a=2, m=6),
    "vmov r1, r2, d3": _is("VMOV_PAIR_TO_CORE", d=1, a=2, m=6),
    "vmrs r1, fpscr": _is("VMRS", d=1),
    "vmrs apsr_nzcv, fpscr": _is("VMRS", d=15),
    "vmsr fpscr, r1": _is("VMSR", d=1),
    "vldr s1, [r2, #-1020]": _is("VLDR", d=1, n=2, immediate=_below(1020), words=1),
    "vldr d3, [r2, #8]": _is("VLDR", d=6, n=2, immediate=8, words=2),
    "vldr s1, [pc, #8]": _is("VLDR", d=1, n=15, immediate=LITERALS + 8, words=1),
    "vstr s1, [r2, #8]": _is("VSTR", d=1, n=2, immediate=8, words=1),
    "vstr d3, [r2]": _is("VSTR", d=6, n=2, words=2),
    "vldmia r1!, {s3-s5}": _is("VLDM", d=3, n=1, words=3, immediate=12, mode=WRITES_BACK),
    "vldmdb r1!, {d1-d2}": _is("VLDM", d=2, n=1, words=4, immediate=16, mode=WRITES_BACK | BEFORE),
    "vstmia r1, {s0-s31}": _is("VSTM", d=0, n=1, words=32, immediate=128),
    "vpush {s16-s17}": _is("VSTM", d=16, n=13, words=2, immediate=8, mode=WRITES_BACK | BEFORE),
    "fldmiax r1!, {d1-d2}": _is("VLDM", d=2, n=1, words=4, immediate=20, mode=WRITES_BACK),
}

IN_IT_BLOCK = {
    "lsleq r1, r2, #3": _is("MOV_X", condition=EQUAL, d=1, m=2, amount=3),
    "moveq r1, #3": _is("MOV_I", condition=EQUAL, d=1, immediate=3),
    "addeq r1, r2, r3": _is("ADD_R", condition=EQUAL, d=1, n=2, m=3),
    "addeq r1, #3": _is("ADD_I", condition=EQUAL, d=1, n=1, immediate=3),
    "andeq r1, r2": _is("AND_R", condition=EQUAL, d=1, n=1, m=2),
    "roreq r1, r2": _is("SHIFT", condition=EQUAL, d=1, n=1, m=2, shift=ROR),
    "muleq r1, r2, r1": _is("MUL", condition=EQUAL, d=1, n=2, m=1),
    "rsbeq r1, r2, #0": _is("RSB_I", condition=EQUAL, d=1, n=2),
    "mvneq r1, r2": _is("MVN_R", condition=EQUAL, d=1, m=2),
    "cmpeq r1, #3": _sets("CMP_IS", condition=EQUAL, n=1, immediate=3),
    "cmneq r1, r2": _sets("CMN_RS", condition=EQUAL, n=1, m=2),
    "tsteq r1, r2": _sets("TST_RS", condition=EQUAL, n=1, m=2),
    "addseq.w r1, r2, #3": _sets("ADD_IS", condition=EQUAL, d=1, n=2, immediate=3),
    "ldreq r1, [r2]": _is("LDR_I", condition=EQUAL, d=1, n=2),
    "bxeq lr": _is("BX", condition=EQUAL, m=14),
    "beq.w .+8": _is("B", condition=EQUAL, immediate=ADDRESS + 8),
    "vaddeq.f32 s1, s2, s3": _is("VADD", condition=EQUAL, d=1, n=2, m=3),
}

GROUPS = {
    "two bytes": SHORT, "immediate": IMMEDIATE, "registers": REGISTERS, "accesses": ACCESSES, "control": CONTROL,
    "floating point": FLOATS,
}  # fmt: skip


def _assemble(assembler: str, lines: list[str], folder: Path) -> list[tuple[int, int, int]]:
    """Return three halfwords from where each line begins."""
    source, code, image = folder / "code.s", folder / "code.o", folder / "code.bin"
    header = ".syntax unified\n.thumb\n.cpu cortex-m4\n.fpu fpv4-sp-d16\n.text\n"
    text = "".join(f".org {SLOT * place}\n{line}\n" for place, line in enumerate(lines))
    source.write_text(f"{header}{text}.org {SLOT * len(lines)}\n")
    objcopy = assembler.removesuffix("as") + "objcopy"
    subprocess.run([assembler, str(source), "-o", str(code)], check=True, timeout=60)
    subprocess.run([objcopy, "-O", "binary", "-j", ".text", str(code), str(image)], check=True, timeout=60)
    return [struct.unpack_from("<3H", image.read_bytes(), SLOT * place) for place in range(len(lines))]


def _differences(decoded: Any, operation: str, values: dict[str, Any]) -> list[str]:
    actual = {name: value for name, value in fields(decoded).items() if name in NEUTRAL}
    names = [] if operation_name(decoded) == operation else [operation_name(decoded)]
    return names + [f"{name}={value}" for name, value in actual.items() if value != values[name]]


@pytest.mark.parametrize("group", GROUPS)
def test_fields_are_those_of_the_pseudocode(group: str, require_tool: Callable[[str], str], tmp_path: Path) -> None:
    lines = list(GROUPS[group])
    assembled = _assemble(require_tool("arm-none-eabi-as"), lines, tmp_path)
    differences = {
        line: _differences(decode(ADDRESS, *halfwords[:2]), *GROUPS[group][line])
        for line, halfwords in zip(lines, assembled, strict=True)
    }
    assert {line: names for line, names in differences.items() if names} == {}


def test_fields_in_an_it_block_have_its_condition_and_set_no_flags(
    require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    lines = [f"it eq\n{line}" for line in IN_IT_BLOCK]
    assembled = _assemble(require_tool("arm-none-eabi-as"), lines, tmp_path)
    differences = {}
    for (line, expected), (it, first, second) in zip(IN_IT_BLOCK.items(), assembled, strict=True):
        assert it == 0xBF08
        differences[line] = _differences(decode(ADDRESS, first, second, IT_EQUAL), *expected)
    assert {line: names for line, names in differences.items() if names} == {}


def test_breakpoint_in_an_it_block_is_unconditional() -> None:
    assert decode(ADDRESS, 0xBE01, 0, IT_EQUAL).condition == 14


def test_it_inside_an_it_block_begins_a_block_whatever_the_condition() -> None:
    decoded = decode(ADDRESS, 0xBF08, 0, IT_EQUAL)
    assert (operation_name(decoded), decoded.condition, decoded.immediate) == ("IT", 14, 0x08)


def test_conditional_branch_inside_an_it_block_is_undefined() -> None:
    assert operation_name(decode(ADDRESS, 0xD000, 0, IT_EQUAL)) == "UNDEFINED"


def test_condition_15_of_an_it_block_is_always() -> None:
    assert decode(ADDRESS, 0x0000, 0, 0xF8).condition == 14
