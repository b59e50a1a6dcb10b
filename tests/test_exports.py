"""Each package gives the names that it exports, and says which one it has not."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import hiltest

FOLDER = Path(hiltest.__file__).parent
PACKAGES = sorted(path.parent.name for path in FOLDER.glob("*/__init__.py"))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_gives_every_name_that_it_exports(package: str) -> None:
    room = import_module(f"hiltest.{package}")
    exported = {name: getattr(room, name) for name in getattr(room, "__all__", ())}
    assert [name for name, value in exported.items() if isinstance(value, ModuleType)] == []


def test_a_name_that_a_package_has_not_is_refused_by_name() -> None:
    with pytest.raises(ImportError, match=r"cannot import name 'Rigg' from 'hiltest\.rig'"):
        from hiltest.rig import Rigg  # type: ignore[attr-defined] # noqa: F401
