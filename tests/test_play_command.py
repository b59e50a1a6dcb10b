"""``hiltest play`` as it is typed: what firmware finds from a recording whose truth is known, and what is refused."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.command_files import run

from hiltest.orientation.angles import Pose, rotation_body_from_ned, wrap_180
from hiltest.orientation.motion_recording import STANDARD_GRAVITY_M_S2
from hiltest.world.earth_field import EarthField

from .orientation.filters import swaying_motion

pytestmark = pytest.mark.slow

RIGS = Path(__file__).parents[1] / "hil" / "rigs"
HARD_IRON_UT = (31.0, -12.5, 8.0)
FIELD = EarthField(45.0, 55.0)
# All attitudes alike; headings are compared where the board is not upside down.
POSES = [
    Pose(heading, math.degrees(math.asin(rise)), roll)
    for heading, rise, roll in np.random.default_rng(3).uniform((0, -1, -180), (360, 1, 180), (96, 3))
]
UPRIGHT = [n for n, pose in enumerate(POSES) if abs(pose.pitch_deg) < 60 and abs(pose.roll_deg) < 60]
RATE_HZ, HELD = 20, 5


def recording(path: Path, *, sensors: str = "mag") -> Path:
    """Write a table of a field and of gravity along the board's axes, each pose held for a quarter of a second."""
    columns = {
        "m": ("mx_uT,my_uT,mz_uT", FIELD.ned_ut, HARD_IRON_UT),
        "a": ("ax_g,ay_g,az_g", (0, 0, 1), (0, 0, 0)),
        "g": ("gx_dps,gy_dps,gz_dps", (0, 0, 0), (0, 0, 0)),
    }
    lines = [",".join(["t_s", *(columns[sensor][0] for sensor in sensors)])]
    for n in range(len(POSES) * HELD + 1):
        turned = rotation_body_from_ned(POSES[min(n // HELD, len(POSES) - 1)])
        vectors = [turned @ np.array(columns[sensor][1]) + columns[sensor][2] for sensor in sensors]
        lines.append(",".join([f"{n / RATE_HZ}", *(f"{each:.6f}" for vector in vectors for each in vector)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def rig(folder: Path, name: str = "virtual-k64f", keys: str = 'playback = "field.csv"') -> str:
    path = folder / "bench.toml"
    text = (RIGS / f"{name}.toml").read_text(encoding="utf-8")
    path.write_text(text.replace("[world]", f"[world]\n{keys}"), encoding="utf-8")
    return str(path)


def tables(said: str) -> tuple[Mapping[str, Sequence[str]], Mapping[str, Sequence[str]]]:
    """Return the rows of what was found, and of the headings, by their first cell."""
    _, found, headings = said.strip().split("\n\n")
    first, second = (
        {cells[0].strip(): cells[1:] for line in each.splitlines() if (cells := re.split(r" {2,}", line))}
        for each in (found, headings)
    )
    return first, second


def test_the_calibrators_find_the_hard_iron_and_the_headings_that_were_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording(tmp_path / "field.csv")
    assert run("play", "--rig", rig(tmp_path), "--every", "0.125") == 0
    output = capsys.readouterr()
    assert output.out.startswith("playing field.csv from 3.000 to 27.000 s of virtual time, nearest: magnetometer 481")
    found, headings = tables(output.out)
    assert found[""] == ["direct", "corrected", "iterative"]
    for name, true_ut in zip("xyz", HARD_IRON_UT, strict=True):
        # A count is 0.1 uT, of which 300 points leave a tenth; the printed one is rounded to 0.1.
        assert [float(each) for each in found[f"hard iron {name} [uT]"]] == pytest.approx([true_ut] * 3, abs=0.1)
    assert [float(each) for each in found["field strength [uT]"]] == pytest.approx([45.0] * 3, abs=0.1)
    assert all(float(each) < 0.5 for each in found["residual over the same 300 points [%]"])
    for n in UPRIGHT:
        answered = [float(each) for each in headings[f"{0.25 * n + 0.125:.2f} s"]]
        # Counts of 0.1 uT and 0.5 mg, across a horizontal field of 26 uT, and what is left of the hard iron.
        assert max(abs(wrap_180(each - POSES[n].heading_deg)) for each in answered) < 0.5
    assert output.err == ""


@pytest.mark.ci
def test_firmware_in_its_own_words_stands_beside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording(tmp_path / "field.csv")
    assert run("play", "--rig", rig(tmp_path, "text-compass"), "--every", "0.125") == 0
    output = capsys.readouterr()
    found, headings = tables(output.out)
    assert found[""][:2] == ["firmware", "calibrated"]
    assert [float(found[f"hard iron {name} [uT]"][0]) for name in "xyz"] == pytest.approx(HARD_IRON_UT, abs=0.5)
    for n in UPRIGHT:
        # Its last calibration, on the readings in the middle of a pose, beside what it said at the end of it, in time.
        assert abs(wrap_180(float(headings[f"{0.25 * n + 0.125:.2f} s"][1]) - POSES[n].heading_deg)) < 1.0
        if n >= 72:
            assert abs(wrap_180(float(headings[f"{0.25 * n + 0.25:.2f} s"][0]) - POSES[n].heading_deg)) < 1.0
    assert "field.csv: over at 27.000 s of virtual time; its last readings are held since" in output.err


@pytest.mark.parametrize(
    ("sensors", "remark", "shown"),
    [
        ("m", "no accelerometer and no gyroscope in it: simulated, at rest", "no headings: the recording has no accel"),
        ("ma", "no gyroscope in it: simulated, at rest", "heading [deg] at"),
    ],
)
def test_what_was_not_recorded_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], sensors: str, remark: str, shown: str
) -> None:
    recording(tmp_path / "field.csv", sensors=sensors)
    assert run("play", "--rig", rig(tmp_path)) == 0
    output = capsys.readouterr()
    assert remark in output.err
    assert shown in output.out


def archive(path: Path, *, rest_s: float = 4.0, bias_dps: float = 0.0) -> Path:
    """Write a motion with its truth: rest, and 10 s of turning by up to 100 deg/s."""
    motion, generator = swaying_motion(10.0, hz=200.0), np.random.default_rng(2)
    still = round(200 * rest_s)

    def held(values: np.ndarray, first: np.ndarray, noise: float = 0.0) -> np.ndarray:
        held_values = np.concatenate([np.tile(first, (still, 1)), values])
        return held_values + generator.normal(0.0, noise, held_values.shape)

    x, y, z, w = held(motion.attitudes[1:], motion.attitudes[0]).T
    np.savez(
        path,
        gyroscope_rad_s=np.radians(held(motion.rates_dps, np.zeros(3), 0.1) + bias_dps),
        accelerometer_m_s2=-STANDARD_GRAVITY_M_S2 * held(motion.gravity_g, motion.gravity_g[0], 0.002),
        magnetometer_ut=48.0 * held(motion.field, motion.field[0], 0.008),
        quaternion_enu=math.sqrt(0.5) * np.stack([x + y, -z - w, z - w, x - y], axis=1),
        movement=np.arange(still + len(motion.field)) >= still,
        sampling_rate_hz=np.array(200.0),
    )
    return path


def test_a_recording_with_true_attitudes_has_the_errors_of_the_filter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motion = archive(tmp_path / "trial.npz", bias_dps=1.5)
    assert run("play", "--rig", str(RIGS / "virtual-k64f.toml"), "--recording", str(motion)) == 0
    *_, table = capsys.readouterr().out.strip().split("\n\n")
    first, *rows = (re.split(r" {2,}", line.strip()) for line in table.splitlines())
    assert first == ["error of the attitude [deg rms]", "total", "heading", "inclination"]
    errors = {name: tuple(map(float, cells)) for name, *cells in rows}
    sources = ("attitude filter", "accelerometer and magnetometer", "gyroscope")
    assert [name for name in errors if name.endswith("motion")] == [f"{source}, motion" for source in sources]
    # Looks come up to 1.6 ms after a sample, and the nearest reading is up to 2.5 ms away: 0.2 degrees at 50 deg/s. The
    # mean of 16 readings of field, from which the gyroscope begins, has 0.25, and three of them are 0.75. The bias of
    # 1.5 deg/s, not subtracted, would turn its attitude by 15 degrees.
    assert errors["attitude filter, motion"][0] < 0.4
    assert errors["attitude filter, first seconds"][0] < 0.4
    assert errors["gyroscope, motion"][0] < 1.0
    assert all(math.hypot(*parts) == pytest.approx(total, abs=0.02) for total, *parts in errors.values())


def test_an_archive_without_a_rest_or_with_settings_of_a_table_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    archive(tmp_path / "field.npz", rest_s=1.5)
    assert run("play", "--rig", rig(tmp_path, keys='playback = "field.npz"')) == 4
    assert "a rest of 1.5 s before the motion; the filter needs a rest of 2 s" in capsys.readouterr().err
    assert run("play", "--rig", rig(tmp_path, keys='playback = { file = "field.npz", rate_hz = 100.0 }')) == 4
    assert "units, axes and times of an archive are fixed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sensors", "keys", "complaint"),
    [
        (["play"], "ag", 'playback = "field.csv"', "world.playback: field.csv has no magnetometer to calibrate"),
        (["play"], "mag", "", 'name one with --recording, or under [world], playback = "field.csv"'),
        (["play", "--every", "0.1"], "mag", 'playback = { file = "field.csv", rate_hz = 0.1 }', "more than 10000 head"),
        (["play", "--firmware", "none.elf"], "mag", 'playback = "field.csv"', "none.elf"),
        (["run"], "mag", 'playback = "field.csv"', "a run is not possible with a recording"),
        (["calibrate", "--out", "x.toml"], "mag", 'playback = "field.csv"', "a turntable is not possible with a rec"),
        (["log", "--seconds", "1", "--out", "x.csv"], "mag", 'playback = "none.csv"', "none.csv: No such file"),
    ],
)
def test_what_cannot_be_done_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    arguments: list[str],
    sensors: str,
    keys: str,
    complaint: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    recording(tmp_path / "field.csv", sensors=sensors)
    assert run(*arguments, "--rig", rig(tmp_path, keys=keys)) == 4
    output = capfd.readouterr()
    assert complaint in re.sub(r"\s+", " ", output.err + output.out)


def test_a_log_of_a_recording_is_that_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A log of the virtual world, played back and logged again, is the same file."""
    named = [f"--sensor={name}" for name in ("gyroscope", "magnetometer", "accelerometer")]
    assert run("log", "--seconds", "2", "--out", str(tmp_path / "field.csv"), *named) == 0
    again = tmp_path / "again.csv"
    assert run("log", "--seconds", "2", "--out", str(again), "--rig", rig(tmp_path), "--seed", "9", *named) == 0
    seed = (("seed 1,", ""), ("seed 9,", ""))
    texts = [path.read_text(encoding="utf-8") for path in (tmp_path / "field.csv", again)]
    for old, new in seed:
        texts = [text.replace(old, new) for text in texts]
    assert texts[0] == texts[1]
    assert "field.csv: over at" not in capsys.readouterr().err
