"""A buffer of other numbers than the function takes is refused, by the types in the debug information."""

from __future__ import annotations

from array import array

import numpy as np
import pytest

from hiltest.errors import ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.buffers import Structure

SOURCE = """
#include <stdint.h>
typedef struct { float x, y; } pair_t;
struct tagged { float value[2]; const int16_t *more; struct { uint8_t flags; } inner; };
enum colour { RED, GREEN };
int main(void) { return 0; }
int dot(const int16_t *a, int n) { int s = 0; while (n--) s += a[n]; return s; }
float first(const pair_t *const p) { return p->x; }
float matrix(const float m[3][3]) { return m[1][0]; }
int tag(struct tagged *t) { return t->inner.flags; }
int any(const void *p) { return *(const char *)p; }
int look(const union { int i; float f; } *u) { return u->i; }
int bytes(volatile uint8_t *p) { return p[1]; }
int paint(enum colour *c) { return *c; }
double wide(const double *p) { return *p; }
"""


@pytest.fixture
def board(build_c) -> VirtualK64F:
    return VirtualK64F(build_c(SOURCE, "-fno-short-enums"))


@pytest.mark.parametrize(
    ("function", "arguments", "answer"),
    [
        ("dot", (np.array([1, 2], np.int16), 2), 3),
        ("dot", (np.array([1, 2], np.uint16), 2), 3),  # as tables in hexadecimal have it
        ("dot", (array("h", [1, 2]), 2), 3),
        ("dot", (bytes([1, 0, 2, 0]), 2), 3),
        ("dot", (0x20000000, 0), 0),
        ("first", (np.array([2.5, 1], np.float32),), 2.5),
        ("first", (np.array([2.5 + 1j], np.complex64),), 2.5),
        ("first", (Structure(np.array([2.5, 1], np.float32)),), 2.5),
        ("matrix", (np.arange(9, dtype=np.float32).reshape(3, 3),), 3.0),
        ("tag", (np.zeros(16, np.uint8),), 0),
        ("any", (np.array([7], np.int64),), 7),
        ("look", (np.array([7], np.float64),), 0),
        ("bytes", (np.array([1, 2], np.int8),), 2),
        ("bytes", (np.array([False, True]),), 1),
        ("paint", (np.array([1], np.int32),), 1),
        ("wide", (np.array([0.5]),), 0.5),
    ],
)
def test_numbers_that_lie_as_the_function_has_them_are_passed(board, function, arguments, answer):
    assert board.call(function, *arguments).value == answer


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        ("dot", np.zeros(2), r"argument 1 of dot is const int16_t \*, not an array of float64: pass 16-bit integers"),
        ("dot", np.zeros(2, np.int32), r"const int16_t \*, not an array of int32: pass 16-bit integers"),
        ("dot", np.zeros(2, np.float16), r"const int16_t \*, not an array of float16"),
        ("first", np.zeros(2), r"const pair_t \* const, not an array of float64: pass float32"),
        ("matrix", np.zeros((3, 3), np.int32), r"const float\[\] \*, not an array of int32: pass float32"),
        ("tag", np.zeros(16, np.int16), r"struct tagged \*, not an array of int16: pass 32-bit .* or 8-bit .* or f"),
        ("bytes", np.zeros(2, np.uint16), r"volatile uint8_t \*, not an array of uint16: pass 8-bit integers,"),
        ("paint", np.zeros(2, np.float32), r"enum colour \*, not an array of float32"),
        ("wide", np.zeros(2, np.float32), r"const double \*, not an array of float32: pass float64"),
    ],
)
def test_other_numbers_are_refused_with_both_types(board, function, arguments, message):
    with pytest.raises(ConfigError, match=message):
        board.call(function, *(arguments, 2)[: len(board.image.signature(function).parameters)])
