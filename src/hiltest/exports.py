"""Names that a package exports and imports when they are first used, since importing them all takes its time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def when_used(package: str, modules: Mapping[str, str]) -> Callable[[str], object]:
    """Return the ``__getattr__`` of a package (PEP 562).

    Parameters
    ----------
    package
        Its ``__name__``.
    modules
        Module, inside the package, of each exported name; the name itself where the module is what is exported.
    """

    def exported(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = import_module(f"{package}.{modules[name]}")
        value: object = module if modules[name] == name else getattr(module, name)
        setattr(sys.modules[package], name, value)
        return value

    return exported
