"""Readings of a real FXOS8700 and FXAS21002, played to NXP's Sensor Fusion as it is and to hiltest's own firmware."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltest.orientation.angles import wrap_180

from ..foreign_elf import foreign_elf
from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "nxp-fusion-agm01.toml"
WALL_LIMIT_S = 900  # a minute on an idle core
# The parts' x forward, y left, z up; the accelerometer shows +1 g on the axis that is up.
PLAYBACK = """
[world.playback]
file = "imu.csv"
resampling = "linear"
magnetometer.axes = "x -y -z"
accelerometer.axes = "-x y z"
gyroscope.axes = "x -y -z"
"""
# Its README: the middle of least and most, of who recorded it, in the body's axes; and by the gyroscope the turns
# between the stops on a table behind the tumble, counterclockwise.
BIAS_UT = (55.7, 43.2, 49.85)
STOPS_S, TURNS_DEG = (1.5, 6.0, 11.0), (-84.5, -86.2)
TURNED_S = 12.0


def recorded(tumble: Path, turns: Path) -> str:
    """Return the table of the tumble, and behind it that of the turns."""
    head, *rows = tumble.read_text(encoding="utf-8").splitlines()
    begin_s = float(rows[-1].split(",")[0]) + 0.033
    later = [line.split(",", 1) for line in turns.read_text(encoding="utf-8").splitlines()[1:]]
    rows += [f"{begin_s + float(at):.6f},{rest}" for at, rest in later if float(at) < TURNED_S]
    return "\n".join([head, *rows]) + "\n"


def test_both_find_what_was_recorded_and_agree(shared_data: Callable[[str], Path], tmp_path: Path) -> None:  # noqa: F811
    data, elf = shared_data("nxp_imu_fxos8700"), foreign_elf("nxp_sensor_fusion.elf")
    (tmp_path / "imu.csv").write_text(recorded(data / "imu.csv", data / "check_cal.csv"), encoding="utf-8")
    (tmp_path / "field.toml").write_text(RIG.read_text(encoding="utf-8") + PLAYBACK, encoding="utf-8")
    command = [sys.executable, "-m", "hiltest", "play", "--rig", "field.toml", "--firmware", str(elf), "--every", "0.5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WALL_LIMIT_S, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = {cells[0]: cells[1:] for line in done.stdout.splitlines() if len(cells := re.split(r" {2,}", line)) > 1}
    assert rows[""] == ["firmware", "calibrated", "direct", "corrected", "iterative"]
    found_ut = np.array([[float(item) for item in rows[f"hard iron {axis} [uT]"] if item != "-"] for axis in "xyz"])
    # Least and most of a tumble that did not see all of the sphere, at 5 % of residual: 2 uT of 44.
    assert np.abs(found_ut - np.array(BIAS_UT)[:, np.newaxis]).max() < 4.0
    assert np.abs(found_ut[:, :1] - found_ut[:, 1:]).max() < 3.0, "they have the same readings"
    said_percent, field_ut = float(rows["error of its fit, as it says [%]"][0]), float(rows["field strength [uT]"][0])
    assert said_percent == pytest.approx(5.2, abs=1.5), "the README's residual"
    assert field_ut == pytest.approx(44.0, abs=2.0)
    tumbled_s = 34.0
    stops = [[float(item) for item in rows[f"{tumbled_s + at:.2f} s"]] for at in STOPS_S]
    for before, after, turn_deg in zip(stops, stops[1:], TURNS_DEG, strict=False):
        turned = [wrap_180(one - other) for one, other in zip(after, before, strict=True)]
        # A residual of 5 % across a horizontal part of half the field is 6 degrees of each heading, of which a turn has
        # two. The first column has the firmware's filter in it.
        assert np.abs(np.array(turned[1:]) - turn_deg).max() < 12.0
    for stop in stops:
        assert max(abs(wrap_180(item - stop[1])) for item in stop[2:]) < 6.0, "their calibrations agree"
