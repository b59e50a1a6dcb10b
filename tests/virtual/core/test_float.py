"""Arithmetic of the FPU: results and FPSCR as Unicorn and the manual have them, to the bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from unicorn import UC_ARCH_ARM, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn.arm_const import UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_CPU_ARM_CORTEX_M4

from .inner_library import inner_library

Words = NDArray[np.uint32]

IOC, DZC, OFC, UFC, IXC, IDC = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 4, 1 << 7
FLAGS, FZ, DN, AHP = 0xF << 28, 1 << 24, 1 << 25, 1 << 26
NEAREST, UPWARD, DOWNWARD, TOWARDS_ZERO = ROUNDINGS = [mode << 22 for mode in range(4)]
MODES = [rounding | fz | dn | ahp for rounding in ROUNDINGS for fz in (0, FZ) for dn in (0, DN) for ahp in (0, AHP)]

ROWS = 8_000  # of each operation, in random modes
ROWS_OF_MODE = 100_000  # of each operation and mode, in CI


@dataclass(frozen=True)
class Operation:
    """An instruction that reads s1 and s2 and writes s0, and the function of the core that it calls.

    `call` gets the function, operands a (s1), b (s2) and addend (s0), and a pointer to FPSCR. `operands` is "float",
    "half" or "integer"; `mask` has the bits of the result that count. `nearest`: it disregards the rounding mode, which
    Unicorn 2.1.4 does not.
    """

    name: str
    code: int
    function: str
    call: Callable[[Any, int, int, int, Any], int]
    operands: str = "float"
    mask: int = 0xFFFF_FFFF
    nearest: bool = False

    @property
    def modes(self) -> list[int]:
        """Values of FPSCR's mode bits that may matter to it."""
        return MODES if "half" in self.name else [mode for mode in MODES if not mode & AHP]


def _to_fixed(code: int, bits: int, fraction: int, signed: bool, truncates: bool = True) -> Operation:
    return Operation(
        f"float to {'s' if signed else 'u'}{bits} #{fraction}{'' if truncates else ' rounded'}",
        code,
        "float_to_fixed",
        lambda function, a, _b, _c, fpscr: function(a, bits, fraction, signed, truncates, fpscr),
    )


def _from_fixed(code: int, bits: int, fraction: int, signed: bool, nearest: bool = True) -> Operation:
    return Operation(
        f"{'s' if signed else 'u'}{bits} #{fraction} to float{'' if nearest else ' rounded'}",
        code,
        "float_from_fixed",
        lambda function, a, _b, _c, fpscr: function(a, bits, fraction, signed, nearest, fpscr),
        "integer",
        nearest=nearest,
    )


def _fixed_code(code: int, bits: int, fraction: int, signed: bool) -> int:
    """Return the encoding of a conversion between floating point and fixed point in s0."""
    size = bits - fraction
    return code | (not signed) << 16 | (bits == 32) << 7 | (size & 1) << 5 | size >> 1


BINARY = {"add": 0xEE30_0A81, "subtract": 0xEE30_0AC1, "multiply": 0xEE20_0A81, "divide": 0xEE80_0A81}
ARITHMETIC = [
    *(
        Operation(name, code, f"float_{name}", lambda function, a, b, _c, fpscr: function(a, b, fpscr))
        for name, code in BINARY.items()
    ),
    Operation("square root", 0xEEB1_0AE0, "float_square_root", lambda function, a, _b, _c, fpscr: function(a, fpscr)),
    Operation(
        "multiply and add", 0xEEA0_0A81, "float_multiply_add", lambda function, a, b, c, fpscr: function(c, a, b, fpscr)
    ),
]
COMPARISONS = [
    Operation("compare", 0xEEF4_0A41, "float_compare", lambda function, a, b, _c, fpscr: function(a, b, False, fpscr)),
    Operation(
        "compare, signaling",
        0xEEF4_0AC1,
        "float_compare",
        lambda function, a, b, _c, fpscr: function(a, b, True, fpscr),
    ),
]
CONVERSIONS = [
    Operation(
        "to half", 0xEEB3_0A60, "float_to_half", lambda function, a, _b, _c, fpscr: function(a, fpscr), mask=0xFFFF
    ),
    Operation(
        "from half",
        0xEEB2_0A60,
        "float_from_half",
        lambda function, a, _b, _c, fpscr: function(a & 0xFFFF, fpscr),
        "half",
    ),
    _to_fixed(0xEEBD_0AE0, 32, 0, True),
    _to_fixed(0xEEBC_0AE0, 32, 0, False),
    _to_fixed(0xEEBD_0A60, 32, 0, True, truncates=False),
    _to_fixed(0xEEBC_0A60, 32, 0, False, truncates=False),
    _from_fixed(0xEEB8_0AE0, 32, 0, True, nearest=False),
    _from_fixed(0xEEB8_0A60, 32, 0, False, nearest=False),
    *(
        _to_fixed(_fixed_code(0xEEBE_0A40, bits, fraction, signed), bits, fraction, signed)
        for signed in (False, True)
        for bits, fraction in ((32, 1), (32, 13), (32, 32), (16, 0), (16, 7), (16, 16))
    ),
    *(
        _from_fixed(_fixed_code(0xEEBA_0A40, bits, fraction, signed), bits, fraction, signed)
        for signed in (False, True)
        for bits, fraction in ((32, 9), (32, 32), (16, 0), (16, 7), (16, 16))
    ),
]
OPERATIONS = ARITHMETIC + COMPARISONS + CONVERSIONS

SPECIAL = np.array(
    [
        0,
        1,
        2,
        3,
        0x400000,
        0x7FFFFE,
        0x7FFFFF,
        0x800000,
        0x800001,
        0x800002,
        0xFFFFFF,
        0x1000000,  # around the tiniest
        0x33800000,
        0x34000000,
        0x34000001,
        0x3EFFFFFF,
        0x3F000000,
        0x3F000001,
        0x3F7FFFFF,
        0x3F800000,
        0x3F800001,
        0x3FC00000,
        0x3FFFFFFF,
        0x40000000,
        0x40200000,
        0x4B000000,
        0x4B7FFFFF,
        0x4B800000,  # halves, 2^23 and around
        0x46FFFE00,
        0x46FFFF00,
        0x47000000,
        0x477FFF00,
        0x477FFF80,
        0x47800000,  # limits of 16 bits
        0x4EFFFFFF,
        0x4F000000,
        0x4F000001,
        0x4F7FFFFF,
        0x4F800000,
        0x4F800001,  # of 32 bits
        0x33000000,
        0x33000001,
        0x33C00000,
        0x387FC000,
        0x387FE000,
        0x387FF000,
        0x38800000,  # tiny halves
        0x477FE000,
        0x477FEFFF,
        0x477FF000,
        0x47FFE000,
        0x47FFEFFF,
        0x47FFF000,
        0x48000000,  # large halves
        0x1F800000,
        0x20000000,
        0x5F800000,
        0x5F7FFFFF,
        0x7EFFFFFF,
        0x7F000000,
        0x7F7FFFFE,
        0x7F7FFFFF,  # squares, largest
        0x7F800000,
        0x7F800001,
        0x7FA12345,
        0x7FBFFFFF,
        0x7FC00000,
        0x7FC00001,
        0x7FE54321,
        0x7FFFFFFF,
    ],  # infinity, NaNs
    dtype=np.uint32,
)


def random_floats(random: np.random.Generator, count: int) -> Words:
    """Return bit patterns, of which many are special, near a limit, or of few significant bits."""
    any_bits = random.integers(0, 1 << 32, count, np.uint32)
    sign = any_bits & np.uint32(1 << 31)
    special = random.choice(SPECIAL, count)
    near = special + random.integers(-3, 4, count).astype(np.uint32) & np.uint32(0x7FFF_FFFF)
    # Mantissas that end in zeros or ones meet halfway cases; exponents near 1 are what conversions and sums differ at.
    length = random.integers(0, 24, count).astype(np.uint32)
    zeros = any_bits >> length << length
    ones = any_bits | (np.uint32(1) << length) - np.uint32(1)
    moderate = zeros & np.uint32(0x7FFFFF) | random.integers(90, 165, count).astype(np.uint32) << np.uint32(23)
    subnormal = any_bits & np.uint32(0x7FFFFF)
    tiny = subnormal | random.integers(0, 30, count).astype(np.uint32) << np.uint32(23)
    huge = subnormal | random.integers(230, 255, count).astype(np.uint32) << np.uint32(23)
    kinds = np.stack([special, near, any_bits, zeros, ones, moderate, moderate, subnormal, tiny, huge])
    chosen = kinds[random.integers(0, len(kinds), count), np.arange(count)]
    return chosen & np.uint32(0x7FFF_FFFF) | sign


def random_operands(random: np.random.Generator, count: int, kind: str) -> tuple[Words, Words, Words]:
    """Return operands a, b and addend."""
    if kind == "integer":
        shift = random.integers(0, 32, count).astype(np.uint32)
        integers = random.integers(-(1 << 31), 1 << 31, count, np.int32) >> shift.view(np.int32)
        near_powers = (np.uint32(1) << shift) + random.integers(-2, 3, count).astype(np.uint32)
        a = np.where(random.random(count) < 0.3, near_powers, integers.view(np.uint32))
        return a, a, a
    if kind == "half":
        a = random.integers(0, 1 << 16, count).astype(np.uint32)
        return a, a, a
    a, b, c = (random_floats(random, count) for _ in range(3))
    # Neighbours, whose difference cancels out; and addends that a product nearly cancels out, or doubles.
    nearly_a = a + random.integers(-2, 3, count).astype(np.uint32)
    b = np.where(random.random(count) < 0.15, nearly_a ^ random.choice(np.uint32([0, 1 << 31]), count), b)
    with np.errstate(all="ignore"):
        product = (a.view(np.float32) * b.view(np.float32)).view(np.uint32)
    exponents_away = random.integers(-26, 27, count).astype(np.uint32) << np.uint32(23)
    signs = random.choice(np.uint32([0, 1 << 31]), count)
    nearly_product = product + random.integers(-2, 3, count).astype(np.uint32) ^ signs
    kinds = np.stack([nearly_product, product + exponents_away ^ signs, c, c, c])
    return a, b, kinds[random.integers(0, len(kinds), count), np.arange(count)]


def random_status(random: np.random.Generator, modes: Words) -> Words:
    """Return FPSCR with modes, and often with flags and cumulative exceptions that are set already."""
    count = len(modes)
    before = random.integers(0, 1 << 32, count, np.uint32) & np.uint32(FLAGS | IOC | DZC | OFC | UFC | IXC | IDC)
    return modes | random.choice(np.uint32([0, IXC]), count) | np.where(random.random(count) < 0.2, before, 0)


class Reference:
    """An emulator that applies one instruction to many rows of operands."""

    CODE, OPERANDS, RESULTS = 0x0000_0000, 0x2000_0000, 0x3000_0000
    ROWS = 1 << 16

    def __init__(self) -> None:
        self.emulator = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.emulator.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M4)
        self.emulator.mem_map(self.CODE, 0x1000)
        self.emulator.mem_map(self.OPERANDS, 16 * self.ROWS)
        self.emulator.mem_map(self.RESULTS, 8 * self.ROWS)

    def apply(self, code: int, operands: Words) -> Words:
        """Return rows of s0 and FPSCR for rows of s1, s2, s0 and FPSCR."""
        return np.concatenate(
            [self._apply(code, operands[first : first + self.ROWS]) for first in range(0, len(operands), self.ROWS)]
        )

    def _apply(self, code: int, operands: Words) -> Words:
        loop = [
            0x68C3,
            0xEEE1,
            0x3A10,  # ldr r3, [r0, #12]; vmsr fpscr, r3
            0xEDD0,
            0x0A00,
            0xED90,
            0x1A01,
            0xED90,
            0x0A02,  # vldr s1, [r0]; vldr s2, [r0, #4]; vldr s0, [r0, #8]
            code >> 16,
            code & 0xFFFF,
            0xEEF1,
            0x3A10,
            0xED81,
            0x0A00,
            0x604B,  # vmrs r3, fpscr; vstr s0, [r1]; str r3, [r1, #4]
            0x3010,
            0x3108,
            0x3A01,
            0xD1EB,  # adds r0, #16; adds r1, #8; subs r2, #1; bne
        ]
        end = self.CODE + 2 * len(loop)
        self.emulator.mem_write(self.CODE, np.array(loop, "<u2").tobytes())
        self.emulator.ctl_remove_cache(self.CODE, end)
        self.emulator.mem_write(self.OPERANDS, operands.astype("<u4").tobytes())
        self.emulator.reg_write(UC_ARM_REG_R0, self.OPERANDS)
        self.emulator.reg_write(UC_ARM_REG_R1, self.RESULTS)
        self.emulator.reg_write(UC_ARM_REG_R2, len(operands))
        self.emulator.emu_start(self.CODE | 1, end)
        return np.frombuffer(self.emulator.mem_read(self.RESULTS, 8 * len(operands)), "<u4").reshape(-1, 2)


@cache
def reference() -> Reference:
    return Reference()


def calculated(operation: Operation, operands: Words, prefix: str = "float") -> Words:
    """Return rows of the result and FPSCR as the core's function gives them."""
    ffi, core = inner_library()
    function = getattr(core, operation.function.replace("float", prefix, 1))
    fpscr = ffi.new("uint32_t *")
    call, rows = operation.call, []
    for a, b, c, status in operands.tolist():
        fpscr[0] = status
        rows.append((call(function, a, b, c, fpscr), fpscr[0]))
    return np.array(rows, np.uint32)


def in_registers(operation: Operation, operands: Words, results: Words) -> Words:
    """Return rows of s0 and FPSCR after an instruction whose function gave these results."""
    if operation.function == "float_compare":
        status = results[:, 1] & np.uint32(~FLAGS & 0xFFFF_FFFF) | results[:, 0]
        return np.stack([operands[:, 2], status], axis=1)
    return results & np.uint32([operation.mask, 0xFFFF_FFFF])


def random_rows(operation: Operation, seed: int, modes: Words) -> Words:
    """Return rows of s1, s2, s0 and FPSCR, which has these mode bits."""
    random = np.random.default_rng(seed)
    a, b, c = random_operands(random, len(modes), operation.operands)
    if "#" in operation.name:
        c = a  # fixed-point conversions are of s0 in place
    return np.stack([a, b, c, random_status(random, modes)], axis=1)


def differences(operation: Operation, operands: Words) -> list[str]:
    """Return the rows in which Unicorn and the core differ, as text: operands, FPSCR, Unicorn's results, the core's."""
    ours = in_registers(operation, operands, calculated(operation, operands))
    unused = np.uint32([0, 0, 0, TOWARDS_ZERO if operation.nearest else 0])  # mode bits that the core must disregard
    theirs = reference().apply(operation.code, operands & ~unused) & np.uint32([operation.mask, 0xFFFF_FFFF])
    theirs[:, 1] |= operands[:, 3] & unused[3]
    return [
        " ".join(f"{word:08x}" for word in row)
        for row in np.hstack([operands, theirs, ours])[np.any(ours != theirs, axis=1)]
    ]


@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda operation: operation.name)
def test_results_and_fpscr_are_those_of_unicorn_in_random_modes(operation: Operation) -> None:
    modes = np.random.default_rng(len(operation.name)).choice(np.uint32(operation.modes), ROWS)
    assert differences(operation, random_rows(operation, operation.code & 0xFFFF, modes)) == []


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda operation: operation.name)
def test_results_and_fpscr_are_those_of_unicorn_in_every_mode(operation: Operation) -> None:
    for mode in operation.modes:
        modes = np.full(ROWS_OF_MODE, mode, np.uint32)
        assert differences(operation, random_rows(operation, operation.code + mode, modes)) == [], hex(mode)


@pytest.mark.parametrize("operation", ARITHMETIC, ids=lambda operation: operation.name)
def test_the_host_calculates_the_same_as_the_general_implementation(operation: Operation) -> None:
    operands = random_rows(operation, 3, np.full(ROWS, NEAREST, np.uint32))
    operands[:, 3] |= IXC  # without it the host is not asked
    fast, general = (calculated(operation, operands, prefix) for prefix in ("float", "general"))
    assert fast.tolist() == general.tolist()


HALF, ONE, LARGEST, INFINITY, DEFAULT_NAN = 0x3F00_0000, 0x3F80_0000, 0x7F7F_FFFF, 0x7F80_0000, 0x7FC0_0000
SMALLEST_NORMAL, LARGEST_SUBNORMAL, MINUS = 0x0080_0000, 0x007F_FFFF, 1 << 31


@pytest.mark.parametrize(
    ("rule", "function", "arguments", "mode", "result", "exceptions"),
    [
        ("a signaling NaN comes before a quiet one", "add", (0x7FC00001, 0x7FA00002), 0, 0x7FE00002, IOC),
        ("of two quiet NaNs the first", "add", (0xFFC00001, 0x7FC00002), 0, 0xFFC00001, 0),
        ("the subtrahend keeps its sign", "subtract", (ONE, 0x7FC00003), 0, 0x7FC00003, 0),
        ("the addend comes first", "multiply_add", (0x7F800001, 0x7F800002, 0x7F800003), 0, 0x7FC00001, IOC),
        ("invalid product, quiet addend", "multiply_add", (0x7FC00009, INFINITY, 0), 0, DEFAULT_NAN, IOC),
        ("invalid product, signaling addend", "multiply_add", (0x7F800009, INFINITY, 0), 0, 0x7FC00009, IOC),
        ("default NaN", "add", (0xFFC12345, ONE), DN, DEFAULT_NAN, 0),
        ("default NaN of a signaling one", "square_root", (0xFF812345,), DN, DEFAULT_NAN, IOC),
        ("an operand is flushed with its sign", "multiply", (MINUS | 1, ONE), FZ, MINUS, IDC),
        ("a flushed divisor is zero", "divide", (ONE, LARGEST_SUBNORMAL), FZ, INFINITY, IDC | DZC),
        ("a flushed operand of a root is zero", "square_root", (MINUS | 1,), FZ, MINUS, IDC),
        ("flushed operands are equal", "compare", (1, MINUS | 2, False), FZ, 6 << 28, IDC),
        ("a result is flushed", "multiply", (SMALLEST_NORMAL, HALF), FZ, 0, UFC),
        ("it is tiny before rounding", "multiply", (0x00FFFFFF, MINUS | HALF), FZ, MINUS, UFC),
        ("it is tiny before rounding too", "multiply", (0x00FFFFFF, HALF), 0, SMALLEST_NORMAL, UFC | IXC),
        ("an exact tiny result is no underflow", "multiply", (SMALLEST_NORMAL, HALF), 0, 0x00400000, 0),
        ("overflow to infinity", "add", (LARGEST, LARGEST), UPWARD, INFINITY, OFC | IXC),
        ("overflow to the largest number", "add", (LARGEST, LARGEST), DOWNWARD, LARGEST, OFC | IXC),
        ("an exact difference of zero", "subtract", (ONE, ONE), TOWARDS_ZERO, 0, 0),
        ("it is negative if rounded downward", "subtract", (ONE, ONE), DOWNWARD, MINUS, 0),
        ("a zero sum keeps a common sign", "add", (MINUS, MINUS), UPWARD, MINUS, 0),
        ("division of zero by zero", "divide", (0, MINUS), 0, DEFAULT_NAN, IOC),
        ("division of infinity by zero", "divide", (INFINITY, MINUS), 0, MINUS | INFINITY, 0),
        ("root of a negative number", "square_root", (MINUS | 1,), 0, DEFAULT_NAN, IOC),
        ("a fused tie goes to even", "multiply_add", (0, 0x45800800, 0x45800800), IXC, 0x4B801000, IXC),
        ("just above it", "multiply_add", (0x21800000, 0x45800800, 0x45800800), IXC, 0x4B801001, IXC),
        ("just below another", "multiply_add", (0xA1800000, 0x45800800, 0x45801800), IXC, 0x4B802001, IXC),
        ("a quiet NaN is unordered", "compare", (ONE, 0x7FC00000, False), 0, 3 << 28, 0),
        ("VCMPE signals it", "compare", (ONE, 0x7FC00000, True), 0, 3 << 28, IOC),
        ("a NaN as an integer", "to_fixed", (0x7FC00000, 32, 0, True, True), 0, 0, IOC),
        ("saturation is not inexact", "to_fixed", (0xC73504C0, 16, 0, True, True), 0, 0xFFFF8000, IOC),
        ("unsigned 16 bits are extended by zeros", "to_fixed", (0x47FFFF80, 16, 0, False, True), 0, 0xFFFF, IOC),
        ("-0.5 truncated", "to_fixed", (0xBF000000, 32, 0, False, True), DOWNWARD, 0, IXC),
        ("-0.5 rounded downward", "to_fixed", (0xBF000000, 32, 0, False, False), DOWNWARD, 0, IOC),
        ("fixed point is rounded to nearest", "from_fixed", (0x01000001, 32, 9, False, True), UPWARD, 0x47000000, IXC),
        ("an integer by FPSCR", "from_fixed", (0x01000001, 32, 0, False, False), UPWARD, 0x4B800001, IXC),
        ("a tiny half is not flushed", "to_half", (0x33800000,), FZ, 0x0001, 0),
        ("nor is it as an operand", "from_half", (0x8001,), FZ, 0xB3800000, 0),
        ("a single-precision operand is", "to_half", (MINUS | 1,), FZ, 0x8000, IDC),
        ("a NaN keeps the upper bits of its fraction", "to_half", (0xFF812345,), 0, 0xFE09, IOC),
        ("the alternative format has no infinity", "to_half", (MINUS | INFINITY,), AHP, 0xFFFF, IOC),
        ("nor NaNs", "to_half", (0xFFC00001,), AHP, 0x8000, IOC),
        ("but one exponent more", "to_half", (0x47800000,), AHP, 0x7C00, 0),
        ("whose numbers come back", "from_half", (0x7FFF,), AHP, 0x47FFE000, 0),
        ("beyond them it saturates, not inexact", "to_half", (0x48000001,), AHP, 0x7FFF, IOC),
    ],
)
def test_the_manual_rules(
    rule: str, function: str, arguments: tuple[int, ...], mode: int, result: int, exceptions: int
) -> None:
    """The pseudocode of DDI 0403E, A2.5."""
    ffi, core = inner_library()
    fpscr = ffi.new("uint32_t *", mode)
    assert hex(getattr(core, f"float_{function}")(*arguments, fpscr)) == hex(result), rule
    assert hex(fpscr[0]) == hex(mode | exceptions), rule
