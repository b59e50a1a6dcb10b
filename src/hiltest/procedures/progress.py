"""Type of a progress report of long work."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

#: Called with what is being done, how many steps are done, and of how many.
Progress: TypeAlias = Callable[[str, int, int], None]


def silent(_what: str, _done: int, _of: int) -> None:
    """Say nothing."""
