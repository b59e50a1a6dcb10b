"""The table of a recording in a rig: what its short form means, and what is said of a wrong one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.rig import Rig
from hiltest.rig.recorded_motion import PlaybackFile
from hiltest.rig.rig import conditions_sha256
from hiltest.rig.rig_file import load_rig

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"


def rig(folder: Path, keys: str) -> Rig:
    path = folder / "bench.toml"
    path.write_text(RIG.read_text(encoding="utf-8").replace("[world]", f"[world]\n{keys}"), encoding="utf-8")
    return load_rig(path)


def test_a_string_is_a_table_with_the_file_alone(tmp_path: Path) -> None:
    short, long = (rig(tmp_path, f"playback = {text}") for text in ('"field.csv"', '{ file = "field.csv" }'))
    assert short == long
    assert short.world is not None
    assert short.world.playback is not None
    assert short.world.playback.magnetometer.signed_axes == ((0, 1), (1, 1), (2, 1))


def test_a_recording_is_one_of_the_conditions_and_none_leaves_them_as_they_were(tmp_path: Path) -> None:
    tables = ("", 'playback = "a.csv"', 'playback = "b.csv"', 'motion_recordings = ["a.npz"]')
    digests = {conditions_sha256(rig(tmp_path, keys)) for keys in tables}
    assert len(digests) == 4
    assert conditions_sha256(load_rig(RIG)) in digests


def test_recorded_motions_are_named_one_by_one_or_by_a_pattern(tmp_path: Path) -> None:
    (tmp_path / "trials").mkdir()
    for name in ("b.npz", "a.npz", "a.csv"):
        (tmp_path / "trials" / name).touch()
    assert rig(tmp_path, "").motion_recordings() == {}
    named = rig(tmp_path, 'motion_recordings = ["trials/*.npz"]').motion_recordings()
    assert named == {f"trials/{name}.npz": tmp_path / "trials" / f"{name}.npz" for name in "ab"}
    with pytest.raises(ConfigError, match=r"bench.toml:\d+: world.motion_recordings: no file 'c.npz' in .*; correct"):
        rig(tmp_path, 'motion_recordings = ["c.npz"]').motion_recordings()
    with pytest.raises(ConfigError, match="names no recording: leave it out"):
        rig(tmp_path, "motion_recordings = []")


def test_a_recording_replaces_the_disturbances_of_a_world(tmp_path: Path) -> None:
    driving = load_rig(RIG.with_name("virtual-k64f-driving.toml"))
    playing = driving.playing(tmp_path / "trial.npz")
    assert driving.world is not None
    assert playing.world is not None
    assert playing.world.playback == PlaybackFile(str(tmp_path / "trial.npz"))
    assert len(driving.world.disturbances) == 3
    assert playing.world.disturbances == {}


@pytest.mark.parametrize(
    ("keys", "key", "complaint"),
    [
        ('file = ""', "file", "has no recording"),
        ('file = "x"\nstart_s = -1', "start_s", "must be 0 to 3600"),
        ('file = "x"\nresampling = "cubic"', "resampling", "input should be 'nearest' or 'linear'"),
        ('file = "x"\nrate_hz = 0', "rate_hz", "must be 0.01 to 100000"),
        ('file = "x"\nrate_hz = 10\ntime = "t"', "rate_hz", "excludes time: leave one of them out"),
        ('file = "x"\nspeed = 2', "speed", "unknown key 'speed'; known keys: accelerometer, file"),
        ('file = "x"\nmagnetometer.axes = "x y y"', "magnetometer.axes", "must be x, y and z in any order"),
        ('file = "x"\ngyroscope.axes = "x y"', "gyroscope.axes", "must be x, y and z in any order"),
        ('file = "x"\naccelerometer.unit = "uT"', "accelerometer", "unit 'uT' is none of g, mg, m/s2"),
        ('file = "x"\nmagnetometer.unit = "0 uT"', "magnetometer", "unit '0 uT' is none of uT, nT"),
        ('file = "x"\nmagnetometer.unit = "1..2 uT"', "magnetometer", "unit '1..2 uT' is none of uT, nT"),
        ('file = "x"\nmagnetometer.columns = ["a", "b"]', "magnetometer.columns", "columns"),
    ],
)
def test_a_mistake_is_refused_with_file_line_and_key(tmp_path: Path, keys: str, key: str, complaint: str) -> None:
    path = tmp_path / "bench.toml"
    text = f"{RIG.read_text(encoding='utf-8')}\n[world.playback]\n{keys}\n"
    path.write_text(text, encoding="utf-8")
    first = len(text.splitlines()) - len(keys.splitlines()) + 1
    with pytest.raises(ConfigError, match=re.escape(complaint)) as refused:
        load_rig(path)
    line = re.match(re.escape(f"{path}:") + r"(\d+): ", str(refused.value))
    assert line, str(refused.value)
    assert first - 1 <= int(line[1]) <= first + len(keys.splitlines()) - 1
    assert f"world.playback.{key}" in str(refused.value) or f"unknown key '{key}'" in str(refused.value)


def test_a_board_on_a_port_plays_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    real = RIG.with_name("frdm-k64f.toml").read_text(encoding="utf-8")
    path.write_text(f'{real}\n[world]\nplayback = "field.csv"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="world"):
        load_rig(path)
