"""The firmware's moments of two points a word, in whole numbers: the model that its kernel is held against.

`packed_sums` takes any axes before those of the points: many clouds of as many points at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .direct_stream import MONOMIALS

#: The six products, and the two factors that each sum of a higher degree is formed of.
PRODUCTS = ("xx", "yy", "zz", "xy", "xz", "yz")
FACTORS: dict[str, tuple[str, str]] = {
    "xxx": ("xx", "x"),
    "xxy": ("xx", "y"),
    "xxz": ("xx", "z"),
    "xyy": ("yy", "x"),
    "xyz": ("yz", "x"),
    "xzz": ("xz", "z"),
    "yyy": ("yy", "y"),
    "yyz": ("yy", "z"),
    "yzz": ("yz", "z"),
    "zzz": ("zz", "z"),
    "xxxx": ("xx", "xx"),
    "xxxy": ("xx", "xy"),
    "xxxz": ("xx", "xz"),
    "xxyy": ("xy", "xy"),
    "xxyz": ("xy", "xz"),
    "xxzz": ("xz", "xz"),
    "xyyy": ("yy", "xy"),
    "xyyz": ("yy", "xz"),
    "xyzz": ("xz", "yz"),
    "xzzz": ("zz", "xz"),
    "yyyy": ("yy", "yy"),
    "yyyz": ("yy", "yz"),
    "yyzz": ("yz", "yz"),
    "yzzz": ("zz", "yz"),
    "zzzz": ("zz", "zz"),
}
#: Points that the kernel sums at once, and its largest K.
BLOCK_POINTS = 100
LARGEST_SHIFT = 8
_INT32 = 1 << 31
_LARGEST_COORDINATE = 32767


@dataclass(frozen=True)
class PackedSums:
    """What the kernel answers for one block.

    Attributes
    ----------
    sums : ndarray of float32, shape (..., 34)
        Moments about the anchor [counts^degree], in the order of `MONOMIALS`.
    overflowed : ndarray of bool, shape (...)
        Whether some sum has wrapped on its way.
    """

    sums: NDArray[np.float32]
    overflowed: NDArray[np.bool_]


def packed_sums(points_counts: ArrayLike, anchor: ArrayLike, shift: int) -> PackedSums:
    """Sum the moments of one block as the kernel does.

    Parameters
    ----------
    points_counts : array_like of int, shape (..., n, 3)
        [counts], body frame.
    anchor : array_like of int, shape (..., 3)
        [counts].
    shift : int
        K of packed_moments.h: how far coordinates are shifted before they are multiplied.
    """
    offset = np.asarray(points_counts, dtype=np.int64) - np.asarray(anchor, dtype=np.int64)[..., None, :]
    x, y, z = np.moveaxis(_int16(offset), -1, 0)
    scaled = {"x": _int16(x << shift), "y": _int16(y << shift), "z": _int16(z << shift)}
    words = {"x": x, "y": y, "z": z}
    words |= {name: (scaled[name[0]] * scaled[name[1]] + 0x8000 + shift) >> 16 for name in PRODUCTS}
    scale = np.float32(2.0 ** (16 - 2 * shift))
    sums, overflowed = [], np.zeros(offset.shape[:-2], dtype=bool)
    for name in MONOMIALS:
        if len(name) <= 2:
            terms = words[name]
        else:
            one, other = FACTORS[name]
            terms = words[one] * words[other]
        total, wrapped = _accumulated(terms)
        overflowed |= wrapped
        power = {1: 0, 2: 1, 3: 1, 4: 2}[len(name)]
        sums.append(total.astype(np.float32) * scale**power)
    return PackedSums(np.stack(sums, axis=-1), overflowed)


def _int16(values: NDArray[np.int64]) -> NDArray[np.int64]:
    return values.astype(np.int16).astype(np.int64)


def _accumulated(terms: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Add two points at a time to an int32; say whether it wrapped on the way."""
    totals = np.cumsum(terms, axis=-1)
    after_pairs = np.concatenate([totals[..., 1::2], totals[..., -1:]], axis=-1)
    wrapped = np.any((after_pairs < -_INT32) | (after_pairs >= _INT32), axis=-1)
    return totals[..., -1].astype(np.int32), np.asarray(wrapped)


def largest_shift(farthest: int) -> int:
    """Return the K that the firmware begins with, for the largest coordinate about the anchor [counts].

    Notes
    -----
    Coordinates fill 16 bits to 1/1.3125 at most: with more, the fourth powers of 100 points on a sphere overflow.
    """
    room = farthest + (farthest >> 2) + (farthest >> 4)
    return min(max(15 - room.bit_length(), 0), LARGEST_SHIFT)


def packed_moments(points_counts: ArrayLike, anchor: ArrayLike) -> tuple[NDArray[np.float32], list[int]] | None:
    """Sum the moments of one cloud as the firmware's `direct-fast` does.

    Parameters
    ----------
    points_counts : array_like of int, shape (n, 3)
        [counts], body frame, n >= 2.
    anchor : array_like of int, shape (3,)
        [counts].

    Returns
    -------
    sums : ndarray of float32, shape (34,)
        See `PackedSums`.
    shifts : list of int
        The K of each block.
    or None
        When the firmware sums them one at a time, without this kernel.
    """
    points = np.asarray(points_counts, dtype=np.int64)
    farthest = int(np.abs(points - np.asarray(anchor)).max())
    if farthest > _LARGEST_COORDINATE:
        return None
    shift = largest_shift(farthest)
    total, shifts = np.zeros(0, dtype=np.float32), list[int]()
    for block in _blocks(points):
        answer = packed_sums(block, anchor, shift)
        if answer.overflowed and shift > 0:
            shift -= 1
            answer = packed_sums(block, anchor, shift)
        if answer.overflowed:
            return None
        total = total + answer.sums if shifts else answer.sums
        shifts.append(shift)
    return total, shifts


def _blocks(points: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Cut points as the firmware does; a block is never a single point."""
    while len(points):
        count = BLOCK_POINTS - 2 if len(points) == BLOCK_POINTS + 1 else BLOCK_POINTS
        yield points[:count]
        points = points[count:]
