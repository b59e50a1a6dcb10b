"""What an operation on intervals answers holds for every word that they have."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hiltest.virtual.waits import intervals as of
from hiltest.virtual.waits.intervals import MASK, Value

EDGES = st.sampled_from([0, 1, 0xFF, 0xFFFF, 0xFFFFFF, 0x7FFFFFFF, 0x80000000, MASK])
WORDS = EDGES | st.integers(0, MASK)


@st.composite
def members(draw: st.DrawFn) -> tuple[Value, int]:
    """An interval, and one of its words."""
    width = draw(st.just(0) | st.integers(0, 300) | WORDS)
    value = Value(draw(WORDS), width)
    return value, value.low + draw(st.integers(0, width)) & MASK


def has(value: Value, word: int) -> bool:
    return (word - value.low & MASK) <= value.width


def signed(word: int) -> int:
    return (word ^ 0x80000000) - 0x80000000


BINARY: dict[str, tuple[Callable[[Value, Value], Value], Callable[[int, int], int]]] = {
    "add": (of.add, lambda a, b: a + b), "subtract": (of.subtract, lambda a, b: a - b),
    "and": (of.conjunction, lambda a, b: a & b), "or": (of.disjunction, lambda a, b: a | b),
    "xor": (of.difference, lambda a, b: a ^ b), "multiply": (of.product, lambda a, b: a * b),
    "divide": (of.quotient, lambda a, b: a // b if b else 0),
    "carry of a sum": (of.carry_of_sum, lambda a, b: a + b > MASK),
    "carry of a difference": (of.carry_of_difference, lambda a, b: a >= b),
    "overflow of a sum": (of.overflow_of_sum, lambda a, b: signed(a) + signed(b) != signed(a + b & MASK)),
    "overflow of a difference": (of.overflow_of_difference, lambda a, b: signed(a) - signed(b) != signed(a - b & MASK)),
}  # fmt: skip
UNARY: dict[str, tuple[Callable[[Value], Value], Callable[[int], int]]] = {
    "left": (lambda v: of.shifted_left(v, 3), lambda a: a << 3),
    "right": (lambda v: of.shifted_right(v, 5), lambda a: a >> 5),
    "all right": (lambda v: of.shifted_right(v, 32), lambda a: 0),
    "arithmetic": (lambda v: of.shifted_arithmetically(v, 4), lambda a: signed(a) >> 4),
    "byte": (lambda v: of.extended(v, 8, signed=False), lambda a: a & 0xFF),
    "signed byte": (lambda v: of.extended(v, 8, signed=True), lambda a: (a & 0xFF ^ 0x80) - 0x80),
    "signed half": (lambda v: of.extended(v, 16, signed=True), lambda a: (a & 0xFFFF ^ 0x8000) - 0x8000),
    "zero": (of.zero, lambda a: a == 0), "negative": (of.negative, lambda a: a >> 31),
}  # fmt: skip


@pytest.mark.parametrize("operation", BINARY)
@given(first=members(), second=members())
@example(first=(Value(1), 1), second=(Value(0x80000000, 0x80000000), 0x80000001))  # around the wrap, by one
def test_of_two(operation: str, first: tuple[Value, int], second: tuple[Value, int]) -> None:
    compute, exact = BINARY[operation]
    assert has(compute(first[0], second[0]), int(exact(first[1], second[1])) & MASK)


@pytest.mark.parametrize("operation", UNARY)
@given(one=members())
def test_of_one(operation: str, one: tuple[Value, int]) -> None:
    compute, exact = UNARY[operation]
    assert has(compute(one[0]), int(exact(one[1])) & MASK)


@given(begun=WORDS, steps=st.lists(st.integers(-5, 5), max_size=5))
def test_what_is_added_to_a_place_is_known(begun: int, steps: list[int]) -> None:
    value = Value(begun, base=3)
    for step in steps:
        value = of.add(value, Value(step)) if step >= 0 else of.subtract(value, Value(-step))
    assert (value.base, value.offset & MASK, value.low) == (3, sum(steps) & MASK, begun + sum(steps) & MASK)


def test_what_depends_on_an_earlier_turn_stays_so_until_it_does_not_matter() -> None:
    stale = Value(0, MASK, stale=True)
    assert of.add(stale, Value(3)).stale
    assert of.conjunction(stale, Value(0xFF)) == Value(0, 0xFF, stale=True)
    assert of.carry_of_difference(of.conjunction(stale, Value(0xFF)), Value(0x100)) == of.FALSE
