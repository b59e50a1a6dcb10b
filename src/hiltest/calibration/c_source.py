"""Numbers and words in the syntax of C."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike


def c_float(value: float) -> str:
    """Return a literal of type float with full precision."""
    return f"{np.format_float_scientific(np.float32(value), unique=True, trim='0')}f"


def comment_text(text: str) -> str:
    """Return a text that can neither end a comment nor form a trigraph in it."""
    return re.sub(r"[^\w.+-]", "_", text, flags=re.ASCII)


def c_constant(name: str, values: ArrayLike, unit: str) -> str:
    """Return a constant of type float in the shape of its values, by rows, followed by its unit."""
    numbers = np.asarray(values)
    shape = "".join(f"[{size}]" for size in numbers.shape)
    return f"static const float {name}{shape} = {_literal(numbers)}; /* {unit} */"


def _literal(values: np.ndarray) -> str:
    if values.ndim == 2:
        return "{\n" + "".join(f"    {_literal(row)},\n" for row in values) + "}"
    if values.ndim:
        return "{" + ", ".join(map(_literal, values)) + "}"
    return c_float(float(values))
