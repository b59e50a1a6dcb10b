"""What the page about gravity says of bounds, statuses and rigs is what there is."""

from __future__ import annotations

import re
from pathlib import Path

from hiltest.calibration import FitStatus
from hiltest.measurement import identify

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "against-gravity.md").read_text(encoding="utf-8")


def test_statuses_are_those_that_end_without_a_calibration() -> None:
    named = set(re.findall(r"`([A-Z]{3}[A-Z_]+)`", PAGE))
    assert named == {"SINGULAR", "TOO_FEW_POINTS", "HORIZONTAL_FIELD", "MIRRORED", "POOR_COVERAGE"}
    assert named <= set(FitStatus.__members__)


def test_the_rig_and_the_measurements_that_it_names_are_there() -> None:
    (rig,) = re.findall(r"\$ hiltest run --rig (\S+)", PAGE)
    assert (ROOT / "hil" / "rigs" / f"{rig}.toml").exists()
    named = re.findall(r"`(fit\.joint\.\w+)`", PAGE)
    assert named
    assert [name for name in named if identify(name).kind is None] == []
