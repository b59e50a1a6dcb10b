"""Type of a progress report of long work."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

#: Callback with the current task, the number of completed steps, and their total.
Progress: TypeAlias = Callable[[str, int, int], None]


def silent(_task: str, _done: int, _of: int) -> None:
    """Ignore a progress report."""
