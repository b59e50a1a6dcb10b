"""The golden sequence of the fusion filter: both forms against a third, in decimals and without quaternions."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hiltest.boards import default_firmware
from hiltest.orientation.fusion import FusionNoise, triad
from hiltest.orientation.quaternions import from_ned_axes
from hiltest.virtual.board.k64f import VirtualK64F

from .filters import FilterMaker, Firmware, OnBoard, Reference
from .fusion_matrices import FusionStatus, angle_between_deg

FOLDER = Path(__file__).parents[2] / "fixtures" / "fusion"
GOLDEN = json.loads((FOLDER / "sequence.json").read_text(encoding="utf-8"))


def test_every_step_of_the_golden_sequence(either: FilterMaker):
    result = either(FusionNoise(**GOLDEN["noise"]), triad(GOLDEN["start"]["gravity_g"], GOLDEN["start"]["field"]))
    exact = either is Reference
    for count, step in enumerate(GOLDEN["steps"], start=1):
        if step["step"] == "predict":
            status = result.predict(step["rate_dps"], step["dt_s"])
        else:
            status = result.update(step["gravity_g"], step["field"])
        assert status is FusionStatus.OK
        expected = from_ned_axes(np.array(step["rotation_ned_from_body"]))
        # Roundings of 6e-8 in each of some ten operations a step, 2e-6 radians at most; of float64, 1e-16.
        assert angle_between_deg(result.attitude, expected) < (1e-12 * count if exact else math.degrees(2e-6 * count))
        assert result.sigmas_deg == pytest.approx(step["sigmas_deg"], rel=1e-12 if exact else 1e-5)


def test_the_board_computes_it_bit_by_bit_as_this_machine_does(firmware: FilterMaker):
    noise, first = FusionNoise(**GOLDEN["noise"]), triad(GOLDEN["start"]["gravity_g"], GOLDEN["start"]["field"])
    place, board = firmware(noise, first), OnBoard(VirtualK64F(default_firmware()), noise, first)
    assert isinstance(place, Firmware)
    for step in GOLDEN["steps"]:
        for item in (place, board):
            if step["step"] == "predict":
                assert item.predict(step["rate_dps"], step["dt_s"]) is FusionStatus.OK
            else:
                assert item.update(step["gravity_g"], step["field"]) is FusionStatus.OK
        assert board.raw == place.raw
    assert board.update((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)) is FusionStatus.NO_ATTITUDE
    assert board.predict((0.0, 0.0, 0.0), -1.0) is FusionStatus.BAD_STEP
    assert board.update((0.0, 0.0, 2.0), (1.0, 0.0, 0.0)) is FusionStatus.ACCELERATED
    assert board.raw == place.raw


def test_the_golden_sequence_is_what_its_generator_writes(tmp_path: Path):
    subprocess.run([sys.executable, str(FOLDER / "generate.py"), str(tmp_path)], check=True)
    assert (tmp_path / "sequence.json").read_bytes() == (FOLDER / "sequence.json").read_bytes()
