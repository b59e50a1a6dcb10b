"""A small rig for tests that need the plugin and no particular board."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

import hiltest
from hiltest.session.settings import OPTIONS
from hiltest.virtual.core.c_library import SOURCES

# pytester forgets what a run in this process has imported. numpy and pydantic cannot be imported twice in one process,
# and all else takes longer than such a run: so it is here before.
_NO_MODULES = ("__main__", *(library.stem for library in SOURCES))  # one runs the program, the others are C alone
for module in pkgutil.walk_packages(hiltest.__path__, "hiltest."):
    if not module.name.endswith(_NO_MODULES):
        import_module(module.name)

_RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"


@pytest.fixture(autouse=True)
def _no_settings_from_outside(
    monkeypatch: pytest.MonkeyPatch, default_rig: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    for option in OPTIONS:
        monkeypatch.delenv(option.variable, raising=False)
    # Without limits: those of the default rig are for its suites, and one that nothing meets is not silent.
    path = tmp_path_factory.mktemp("rig") / "no-limits.toml"
    path.write_text(default_rig[: default_rig.index("[limits]")], encoding="utf-8")
    monkeypatch.setenv("HIL_RIG", str(path))


@pytest.fixture
def default_rig() -> str:
    """Text of the default rig file."""
    return _RIG.read_text(encoding="utf-8")
