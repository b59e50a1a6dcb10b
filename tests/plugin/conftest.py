"""A small rig for tests that need the plugin and no particular board."""

from __future__ import annotations

from pathlib import Path

import pytest

# pytester forgets what a run in this process has imported, and numpy and pydantic cannot be imported
# twice in one process: so they are here before it begins.
import hiltest.report.render
import hiltest.rig_file  # noqa: F401

_RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"


@pytest.fixture(autouse=True)
def _no_settings_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RIG", "FIRMWARE", "PORT", "OUT", "SEED", "POSES"):
        monkeypatch.delenv(f"HIL_{name}", raising=False)


@pytest.fixture
def default_rig() -> str:
    """Text of the default rig file."""
    return _RIG.read_text(encoding="utf-8")
