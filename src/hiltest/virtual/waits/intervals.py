"""Words of which only an interval is known, around the wrap of 32 bits."""

from __future__ import annotations

from typing import NamedTuple

MASK = 0xFFFFFFFF
_SIGN = 0x80000000

# A core register, a flag or a mask register, or address and size of something in RAM.
Place = int | str | tuple[int, int]


class Value(NamedTuple):
    """What a place holds in each of some turns.

    Attributes
    ----------
    low, width : int
        It is one of `low`, `low` + 1 ... `low` + `width`, modulo 2**32.
    base, offset : Place or None, int
        It is what that place held when the turn began, plus `offset`; nothing is known of that for None.
    stale : bool
        Whether it depends on what an earlier turn has left, of which nothing is known.
    """

    low: int
    width: int = 0
    base: Place | None = None
    offset: int = 0
    stale: bool = False

    @property
    def is_known(self) -> bool:
        """Whether it is one word."""
        return self.width == 0 and not self.stale

    @property
    def unsigned(self) -> tuple[int, int]:
        """The least and the greatest that it may be."""
        high = self.low + self.width
        return (self.low, high) if high <= MASK else (0, MASK)

    @property
    def signed(self) -> tuple[int, int]:
        """The same as a signed word."""
        low = (self.low ^ _SIGN) - _SIGN
        return (low, low + self.width) if low + self.width < _SIGN else (-_SIGN, _SIGN - 1)


FALSE, TRUE = Value(0), Value(1)


def anything(*sources: Value, most: int = MASK) -> Value:
    """Return what may be anything up to `most`."""
    return Value(0, most, stale=any(source.stale for source in sources))


def add(first: Value, second: Value) -> Value:
    """Add."""
    width = first.width + second.width
    stale = first.stale or second.stale
    if width > MASK:
        return anything(first, second)
    base, offset = None, 0
    if second.is_known:
        base, offset = first.base, first.offset + second.low
    elif first.is_known:
        base, offset = second.base, second.offset + first.low
    return Value(first.low + second.low & MASK, width, base, offset, stale)


def subtract(first: Value, second: Value) -> Value:
    """Subtract the second."""
    negative = Value(-(second.low + second.width) & MASK, second.width, stale=second.stale)
    return add(first, negative)


def conjunction(first: Value, second: Value) -> Value:
    """Return first AND second."""
    if first.is_known and not second.is_known:
        first, second = second, first
    if not second.is_known:
        return anything(first, second)
    mask = second.low
    low, high = first.unsigned
    if mask & mask + 1 == 0:  # ones in the lowest places alone
        if first.low + first.width <= mask:
            return first
        if low & ~mask == high & ~mask:
            return Value(low & mask, high - low, stale=first.stale)
    return Value(low & mask) if first.is_known else anything(first, most=mask)


def disjunction(first: Value, second: Value) -> Value:
    """Return first OR second."""
    if first.is_known and second.is_known:
        return Value(first.low | second.low)
    if second == FALSE or first == FALSE:
        return first if second == FALSE else second
    return anything(first, second)


def difference(first: Value, second: Value) -> Value:
    """Return first XOR second."""
    if first.is_known and second.is_known:
        return Value(first.low ^ second.low)
    return anything(first, second)


def product(first: Value, second: Value) -> Value:
    """Multiply."""
    if first.is_known:
        first, second = second, first
    low, high = first.unsigned
    if not second.is_known or high * second.low > MASK:
        return anything(first, second)
    return Value(low * second.low, (high - low) * second.low, stale=first.stale)


def quotient(first: Value, second: Value) -> Value:
    """Divide, unsigned; by zero it is zero."""
    if not second.is_known:
        return anything(first, second)
    if second.low == 0:
        return FALSE
    low, high = (bound // second.low for bound in first.unsigned)
    return Value(low, high - low, stale=first.stale)


def shifted_left(value: Value, places: int) -> Value:
    """Shift left."""
    if value.is_known:
        return Value(value.low << places & MASK)
    return product(value, Value(1 << places)) if places < 32 else FALSE


def shifted_right(value: Value, places: int) -> Value:
    """Shift right, zeros coming in."""
    return quotient(value, Value(1 << places)) if places < 32 else FALSE


def shifted_arithmetically(value: Value, places: int) -> Value:
    """Shift right, the sign coming in."""
    low, high = value.signed
    low, high = low >> places, high >> places
    return Value(low & MASK, high - low, stale=value.stale)


def extended(value: Value, bits: int, *, signed: bool) -> Value:
    """Take the lowest bits, with the sign of the highest of them or without."""
    kept = conjunction(value, Value((1 << bits) - 1))
    if not signed or kept.unsigned[1] < 1 << bits - 1:
        return kept
    if kept.is_known:
        return Value(kept.low - (1 << bits) & MASK)
    return anything(value)


# -- flags --------------------------------------------------------------------------------------


def _flag(is_set: bool | None, *sources: Value) -> Value:
    if is_set is None:
        return anything(*sources, most=1)
    return Value(int(is_set))  # it is so whatever a stale value is


def negative(value: Value) -> Value:
    """Return N of a result."""
    low, high = value.signed
    return _flag(True if high < 0 else False if low >= 0 else None, value)


def zero(value: Value) -> Value:
    """Return Z of a result."""
    may_be = -value.low & MASK <= value.width
    return _flag(False if not may_be else True if value.width == 0 else None, value)


def _beyond(low: int, high: int, least: int, most: int, *sources: Value) -> Value:
    """Say whether an exact result lies outside what a word holds."""
    if least <= low and high <= most:
        return _flag(False, *sources)
    return _flag(True if low > most or high < least else None, *sources)


def carry_of_sum(first: Value, second: Value) -> Value:
    """Return C of an addition."""
    (a, b), (c, d) = first.unsigned, second.unsigned
    return _beyond(a + c, b + d, 0, MASK, first, second)


def carry_of_difference(first: Value, second: Value) -> Value:
    """Return C of a subtraction: no borrow."""
    (a, b), (c, d) = first.unsigned, second.unsigned
    return _flag(True if a >= d else False if b < c else None, first, second)


def overflow_of_sum(first: Value, second: Value) -> Value:
    """Return V of an addition."""
    (a, b), (c, d) = first.signed, second.signed
    return _beyond(a + c, b + d, -_SIGN, _SIGN - 1, first, second)


def overflow_of_difference(first: Value, second: Value) -> Value:
    """Return V of a subtraction."""
    (a, b), (c, d) = first.signed, second.signed
    return _beyond(a - d, b - c, -_SIGN, _SIGN - 1, first, second)
