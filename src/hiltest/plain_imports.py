"""Imports the package's modules as they are, where pytest would rewrite their assertions.

pytest rewrites every module of a package that has a plugin, so that a failed assertion shows its values. The package
asserts nothing of a test's, and rewriting its 340 modules takes 0.8 s of each run wherever the result cannot be kept:
in an installation that is read-only, or with PYTHONDONTWRITEBYTECODE, as in many containers.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

_PACKAGE = __name__.partition(".")[0]
_SUITES = f"{_PACKAGE}.bench"


class _PlainFinder:
    """Finder of the package's modules that comes before pytest's; suites that ship in the package are left to it."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Find a module of the package."""
        is_ours = name.startswith(f"{_PACKAGE}.") and not f"{name}.".startswith(f"{_SUITES}.")
        return PathFinder.find_spec(name, path, target) if is_ours else None


def import_plainly() -> None:
    """Have the modules of the package that are imported from now on imported as they are."""
    if _PlainFinder not in sys.meta_path:
        sys.meta_path.insert(0, _PlainFinder)
