"""The golden sequence of the fusion filter: both forms against a third, in decimals and without quaternions."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hiltest.orientation.fusion import FusionNoise, FusionStatus, triad
from hiltest.orientation.quaternions import angle_between_deg, from_ned_axes

from .filters import FilterMaker, Reference

FOLDER = Path(__file__).parents[2] / "fixtures" / "fusion"
GOLDEN = json.loads((FOLDER / "sequence.json").read_text(encoding="utf-8"))


def test_every_step_of_the_golden_sequence(either: FilterMaker):
    found = either(FusionNoise(**GOLDEN["noise"]), triad(GOLDEN["start"]["gravity_g"], GOLDEN["start"]["field"]))
    exact = either is Reference
    for count, step in enumerate(GOLDEN["steps"], start=1):
        if step["step"] == "predict":
            status = found.predict(step["rate_dps"], step["dt_s"])
        else:
            status = found.update(step["gravity_g"], step["field"])
        assert status is FusionStatus.OK
        expected = from_ned_axes(np.array(step["rotation_ned_from_body"]))
        # Roundings of 6e-8 in each of some ten operations a step, 2e-6 radians at most; of float64, 1e-16.
        assert angle_between_deg(found.attitude, expected) < (1e-12 * count if exact else math.degrees(2e-6 * count))
        assert found.sigmas_deg == pytest.approx(step["sigmas_deg"], rel=1e-12 if exact else 1e-5)


def test_the_golden_sequence_is_what_its_generator_writes(tmp_path: Path):
    subprocess.run([sys.executable, str(FOLDER / "generate.py"), str(tmp_path)], check=True)
    assert (tmp_path / "sequence.json").read_bytes() == (FOLDER / "sequence.json").read_bytes()
