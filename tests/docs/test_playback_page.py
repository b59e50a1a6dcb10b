"""The page about recordings: its rig is read as it says, and its table has every key."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

from hiltest.rig.recorded_motion import PlaybackFile, PlayedSensor
from hiltest.rig.rig_file import load_rig

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "playback.md").read_text(encoding="utf-8")


def test_the_rigs_table_is_read_beside_that_of_nxps_fusion(tmp_path: Path) -> None:
    (table,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
    rig = (ROOT / "hil" / "rigs" / "nxp-fusion-agm01.toml").read_text(encoding="utf-8")
    (tmp_path / "field.toml").write_text(f"{rig}\n{table}", encoding="utf-8")
    world = load_rig(tmp_path / "field.toml").world
    assert world is not None
    assert world.playback is not None
    assert world.playback.accelerometer.signed_axes == ((0, -1), (1, 1), (2, 1))


def test_the_table_has_every_key() -> None:
    named = set(re.findall(r"`([\w.]+)`", "".join(re.findall(r"^\| (.*?) \|", PAGE, re.M))))
    sensors = {"magnetometer", "accelerometer", "gyroscope"}
    of_a_sensor = {f"magnetometer.{field.name}" for field in fields(PlayedSensor)}
    assert named >= {field.name for field in fields(PlaybackFile)} - sensors | of_a_sensor
