"""Imports the package's modules unchanged, whereas pytest would rewrite their assertions.

pytest rewrites every module of a package that has a plugin, so that a failed assertion shows its values. The package's
assertions do not belong to tests, and rewriting its 340 modules takes 0.8 s per run if the result cannot be cached:
in a read-only installation, or with PYTHONDONTWRITEBYTECODE, as in many containers.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

_PACKAGE = __name__.partition(".")[0]
_SUITES = f"{_PACKAGE}.bench"


class _PlainFinder:
    """Finder of the package's modules that precedes pytest's, but not for suites that ship in the package."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Find a module of the package."""
        is_ours = name.startswith(f"{_PACKAGE}.") and not f"{name}.".startswith(f"{_SUITES}.")
        return PathFinder.find_spec(name, path, target) if is_ours else None


def import_plainly() -> None:
    """Let modules of the package that are imported from now on be imported unchanged."""
    if _PlainFinder not in sys.meta_path:
        sys.meta_path.insert(0, _PlainFinder)
