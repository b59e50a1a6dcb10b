"""The golden clouds are what their generator says, and it is independent of what they judge."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

CLOUDS = Path(__file__).parents[2] / "fixtures" / "clouds"


def test_the_generator_writes_the_same_clouds_again(tmp_path: Path) -> None:
    # None in place of a module makes its import an error: the generator uses none of the fits that it is to check.
    without_fits = (
        "import runpy, sys; sys.modules['hiltest.calibration'] = None; runpy.run_path(sys.argv[2], None, '__main__')"
    )
    subprocess.run([sys.executable, "-c", without_fits, str(tmp_path), str(CLOUDS / "generate.py")], check=True)
    written = {path.name: json.loads(path.read_text()) for path in tmp_path.glob("*.json")}
    assert written == {path.name: json.loads(path.read_text()) for path in CLOUDS.glob("*.json")}


def test_the_clouds_cover_every_way_a_direct_fit_ends() -> None:
    ends = {json.loads(path.read_text())["direct"]["status"] for path in CLOUDS.glob("*.json")}
    assert ends == {"ELLIPSOID", "NOT_AN_ELLIPSOID", "POOR_COVERAGE", "SINGULAR"}


def test_the_clouds_cover_both_ways_a_corrected_fit_ends() -> None:
    """With its two steps, once where they matter by a fiftieth, and as the fit of `direct` if that is an ellipsoid."""
    goldens = [json.loads(path.read_text()) for path in CLOUDS.glob("*.json")]
    assert {golden["corrected"]["iterations"] for golden in goldens if golden["direct"]["status"] == "ELLIPSOID"} == {
        0,
        2,
    }
    moved = [
        abs(corrected - direct) / max(golden["direct"]["soft_iron"])
        for golden in goldens
        for corrected, direct in zip(golden["corrected"]["soft_iron"], golden["direct"]["soft_iron"], strict=True)
    ]
    assert max(moved) > 0.02
