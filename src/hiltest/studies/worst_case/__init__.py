"""Worst case of a function: a search for the input with the most cycles, and a file with that input."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.studies.worst_case.worst_input import WorstCase, load_worst_case

__all__ = ["WorstCase", "load_worst_case"]

__getattr__ = when_used(__name__, dict.fromkeys(__all__, "worst_input"))
