"""A small rig for tests that need the plugin and no particular board."""

from __future__ import annotations

from pathlib import Path

# pytester forgets what a run in this process has imported, and numpy and pydantic cannot be imported twice in
# one process: so they are here before it begins. Hypothesis' plugin imports hypothesis at the end of each run.
import hypothesis.internal.observability  # noqa: F401
import pytest

import hiltest.boards
import hiltest.report.render
import hiltest.rig.file  # noqa: F401

_RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"


@pytest.fixture(autouse=True)
def _no_settings_from_outside(
    monkeypatch: pytest.MonkeyPatch, default_rig: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    for name in ("FIRMWARE", "PORT", "OUT", "SEED", "POSES", "SUITE", "CALIBRATION", "BASELINE"):
        monkeypatch.delenv(f"HIL_{name}", raising=False)
    # Without limits: those of the default rig are for its suites, and one that nothing meets is not silent.
    path = tmp_path_factory.mktemp("rig") / "no-limits.toml"
    path.write_text(default_rig[: default_rig.index("[limits]")], encoding="utf-8")
    monkeypatch.setenv("HIL_RIG", str(path))


@pytest.fixture
def default_rig() -> str:
    """Text of the default rig file."""
    return _RIG.read_text(encoding="utf-8")
