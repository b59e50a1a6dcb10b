"""Numbers and words as C source has them."""

from __future__ import annotations

import re

import numpy as np


def c_float(value: float) -> str:
    """Return a literal of type float, with as many digits as a float holds."""
    return f"{np.format_float_scientific(np.float32(value), unique=True, trim='0')}f"


def in_comment(text: str) -> str:
    """Return a text that can neither end a comment nor be a trigraph in it."""
    return re.sub(r"[^\w.+-]", "_", text, flags=re.ASCII)
