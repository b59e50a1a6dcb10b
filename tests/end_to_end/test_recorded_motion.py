"""The filter on recorded motions that a rig names: a row for each, means by phase, and skipped without the key."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltest.judge.motions import simulated_motion
from hiltest.measurement import KINDS, identify
from hiltest.orientation.motion_recording import MotionRecording

from ..interfaces.conftest import shared_data  # noqa: F401 (a fixture)
from .conftest import RIGS, Finished, Run

FULL, ONE_TEST = ("--rig", "bench.toml", "--suite", "full"), ("--", "-k", "recorded_motion")
COLUMNS = ("total", "heading", "inclination", "first_seconds", "rest", "translation", "disturbed_field")


def rig_with(folder: Path, *recordings: str) -> None:
    """Write the default rig with recordings."""
    text = (RIGS / "virtual-k64f.toml").read_text(encoding="utf-8")
    names = ", ".join(f'"{name}"' for name in recordings)
    keys = f"[world]\nmotion_recordings = [{names}]" if recordings else "[world]"
    (folder / "bench.toml").write_text(text.replace("[world]", keys), encoding="utf-8")


def write_archive(file: Path, motion: MotionRecording) -> None:
    """Write a motion in the layout of BROAD."""
    x, y, z, w = motion.truth.T
    np.savez(
        file,
        gyroscope_rad_s=motion.gyroscope_rad_s,
        accelerometer_m_s2=motion.acceleration_m_s2,
        magnetometer_ut=motion.field_ut,
        quaternion_enu=math.sqrt(0.5) * np.stack([x + y, -z - w, z - w, x - y], axis=1),
        movement=motion.movement,
        sampling_rate_hz=np.array(motion.rate_hz),
    )


def beginning(motion: MotionRecording, seconds: float) -> MotionRecording:
    """Return the first seconds of a motion."""
    count = round(seconds * motion.rate_hz)
    names = ("gyroscope_rad_s", "acceleration_m_s2", "field_ut", "truth", "movement")
    return replace(motion, **{name: getattr(motion, name)[:count] for name in names})


def shaken(motion: MotionRecording) -> MotionRecording:
    """Return a motion without rest after 6 s, shaken to and fro by 3 cm, and later with a magnet nearby."""
    times_s = np.arange(len(motion.truth)) / motion.rate_hz
    to_body = Rotation.from_quat(motion.truth).inv()
    north, east = np.zeros((2, len(times_s), 3))
    north[:, 0] = np.where((times_s >= 15.0) & (times_s < 25.0), 3.0 * np.sin(2 * math.pi * 1.5 * times_s), 0.0)
    east[:, 1] = np.where((times_s >= 28.0) & (times_s < 33.0), 30.0, 0.0)
    return replace(
        motion,
        acceleration_m_s2=motion.acceleration_m_s2 + to_body.apply(north),
        field_ut=motion.field_ut + to_body.apply(east),
        movement=times_s >= 6.0,
    )


def rows_of(run: Finished) -> dict[str, list[Any]]:
    """Return the errors by recording, in the order of `COLUMNS`."""
    (table,) = (table for table in run.record["tables"] if table["name"] == "fusion.recordings")
    return {str(name): errors for name, *errors in table["rows"]}


def test_each_recording_has_a_row_and_each_phase_its_mean_also_in_a_replay(run_in: Run, tmp_path: Path) -> None:
    motion = beginning(simulated_motion(), 40.0)
    (tmp_path / "motions").mkdir()
    write_archive(tmp_path / "motions" / "turned.npz", motion)
    write_archive(tmp_path / "motions" / "shaken.npz", shaken(motion))
    rig_with(tmp_path, "motions/*.npz")
    run = run_in(tmp_path, *FULL, "--record", "run.rec", *ONE_TEST)
    assert run.code == 0, run.output
    rows = rows_of(run)
    assert list(rows) == ["motions/shaken.npz", "motions/turned.npz"]
    for name, *errors in zip(COLUMNS, *rows.values(), strict=True):
        present = [error for error in errors if error is not None]
        kind = f"motion.{name}" if name in COLUMNS[:3] else f"{name}.total"
        assert run.value(f"fusion.recorded.{kind}") == pytest.approx(np.mean(present)), name
    kinds = [identify(name).kind for name in run.measured if name.startswith("fusion.recorded.")]
    assert {kind and kind.name for kind in kinds} == {name for name in KINDS if name.startswith("fusion.recorded.")}
    turned, shaken_row = (dict(zip(COLUMNS, rows[f"motions/{name}.npz"], strict=True)) for name in ("turned", "shaken"))
    assert [name for name, error in turned.items() if error is None] == ["translation", "disturbed_field"]
    assert [name for name, error in shaken_row.items() if error is None] == ["rest"]
    # The nearest reading is up to 5 ms away, 0.45 degrees at 90 deg/s, and the mean of 16 readings of the field, from
    # which the filter starts, errs by 0.25. The gyroscope's bias of 2.9 deg/s, not subtracted, would tilt it by 3 s
    # times that. The accelerometer alone tilts by 17 degrees while it is shaken, and a compass turns by 53 beside the
    # magnet.
    assert all(error < 1.0 for errors in rows.values() for error in errors if error is not None)
    shutil.move(tmp_path / "motions", tmp_path / "elsewhere")
    (tmp_path / "again").mkdir()
    again = run_in(tmp_path / "again", "--replay", str(tmp_path / "run.rec"), *ONE_TEST)
    assert again.code == 0, again.output
    assert rows_of(again) == rows


def test_a_rig_without_recordings_measures_nothing(run_in: Run, tmp_path: Path) -> None:
    rig_with(tmp_path)
    run = run_in(tmp_path, *FULL, *ONE_TEST)
    assert run.code == 0
    assert "1 skipped" in run.output
    assert not any(name.startswith("fusion.recorded") for name in run.measured)


@pytest.mark.ci
def test_trials_of_the_benchmark_have_the_errors_of_the_page(
    run_in: Run,
    tmp_path: Path,
    shared_data: Callable[[str], Path],  # noqa: F811 (the fixture)
) -> None:
    names = ("05_undisturbed_slow_rotation_with_breaks_B", "30_disturbed_stationary_magnet_C")
    rig_with(tmp_path, *(str(shared_data(f"broad/{name}.npz")) for name in names))
    run = run_in(tmp_path, *FULL, *ONE_TEST)
    assert run.code == 0, run.output
    slow, magnet = rows_of(run).values()
    # As docs/fusion.md has them: 6 ms more or less until the recording begins change them by at most 0.19 degrees.
    assert slow[:3] == pytest.approx([0.95, 0.86, 0.42], abs=0.2)
    assert magnet[:3] == pytest.approx([2.46, 1.40, 2.02], abs=0.2)
    assert magnet[6] == pytest.approx(3.12, abs=0.25)
    assert slow[6] is None
    assert run.value("fusion.recorded.motion.total") == pytest.approx((slow[0] + magnet[0]) / 2.0)
    assert run.value("fusion.recorded.disturbed_field.total") == pytest.approx(magnet[6])
    assert run.value("fusion.recorded.first_seconds.total") < 1.1
