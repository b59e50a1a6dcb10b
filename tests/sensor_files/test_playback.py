"""A rig's recording in virtual time: tables, streams of packets, readings that cannot be, and files that are none."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import ConfigError
from hiltest.interfaces.packets import MainPacket, encode
from hiltest.interfaces.sensor_files.recorded_motion import START_S, load_playback
from hiltest.rig.rig_file import load_rig
from hiltest.world.recorded_motion import Playback, Sensed

from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture

RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
HEADER = "t_s,mx_uT,my_uT,mz_uT,ax_g,ay_g,az_g"
ROWS = ("7,20,1,40,0,0,1", "8,21,2,41,0,0,1")
NED, ANDROID = 0x00, 0x10


def played(folder: Path, keys: str = 'playback = "field.csv"') -> Playback:
    rig = folder / "bench.toml"
    rig.write_text(RIG.read_text(encoding="utf-8").replace("[world]", f"[world]\n{keys}"), encoding="utf-8")
    playback = load_playback(load_rig(rig))
    assert playback is not None
    return playback


def table(folder: Path, *lines: str) -> Path:
    path = folder / "field.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def stream(folder: Path, *packets: MainPacket) -> Path:
    path = folder / "field.csv"
    path.write_bytes(b"".join(map(encode, packets)))
    return path


def packet(number: int, *, field: tuple[int, int, int] = (200, -10, 400), flags: int = NED) -> MainPacket:
    return MainPacket(number, 25_000 * number, (0, 0, 8192), field, (20, -40, 0), (30_000, 0, 0, 0), flags | 7, 5)


def test_a_rig_without_a_recording_plays_none() -> None:
    assert load_playback(load_rig(RIG)) is None


def test_a_table_begins_when_firmware_has_started_or_when_the_rig_says(tmp_path: Path) -> None:
    table(tmp_path, HEADER, *ROWS)
    assert played(tmp_path).tracks[Sensed.MAGNETOMETER].times_s.tolist() == [START_S, START_S + 1.0]
    later = played(tmp_path, 'playback = { file = "field.csv", start_s = 5.5 }')
    assert (later.begins_s, later.ends_s) == (5.5, 6.5)


def test_a_log_of_a_virtual_board_is_played_at_its_own_times(tmp_path: Path) -> None:
    comment = "# hiltest log: virtual FRDM-K64F, seed 1, clock began 0.250000000 s after power-on, body frame"
    table(tmp_path, comment, HEADER, *ROWS)
    assert played(tmp_path).begins_s == 7.25
    assert played(tmp_path, 'playback = { file = "field.csv", start_s = 2 }').begins_s == 2.0


def test_packets_are_played_in_their_units_without_what_their_algorithm_left_out(tmp_path: Path) -> None:
    packets = [packet(number, field=(0, 0, 0) if number == 2 else (200, -10, 400 + number)) for number in range(4)]
    stream(tmp_path, *packets)
    result = played(tmp_path)
    assert result.tracks[Sensed.MAGNETOMETER].readings.tolist() == [[20, -1, 40], [20, -1, 40.1], [20, -1, 40.3]]
    assert result.tracks[Sensed.ACCELEROMETER].readings.tolist() == [[0, 0, 1]] * 4
    assert result.tracks[Sensed.GYROSCOPE].readings.tolist() == [[1, -2, 0]] * 4
    assert result.tracks[Sensed.GYROSCOPE].times_s == pytest.approx(START_S + 0.025 * np.arange(4))


def test_a_stream_by_nxps_encoder_has_every_integer_that_went_into_it(
    shared_data: Callable[[str], Path],  # noqa: F811 (the fixture)
    tmp_path: Path,
) -> None:
    (tmp_path / "field.csv").write_bytes(shared_data("nxp_packets/imu.bin").read_bytes())
    tracks = played(tmp_path).tracks
    went_in = np.loadtxt(shared_data("nxp_packets/imu.truth.csv"), delimiter=",", skiprows=1)
    places = {Sensed.ACCELEROMETER: (8192, 2), Sensed.MAGNETOMETER: (10, 5), Sensed.GYROSCOPE: (20, 8)}
    for sensed, (steps, first) in places.items():
        assert (np.rint(steps * tracks[sensed].readings) == went_in[:, first : first + 3]).all()


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda folder: stream(folder, *(packet(n, flags=ANDROID) for n in range(2))), "not in the frame NED; say"),
        (lambda folder: stream(folder, packet(4), packet(2)), "clock goes back in it, or stands; cut the reco"),
        (lambda folder: (folder / "field.csv").write_bytes(bytes(100)), "neither a text table nor packets"),
        (
            lambda folder: table(folder, HEADER, "0,20,1,40,0,0,9.8", "1,20,1,40,0,0,9.8"),
            "its accelerometer reads 9.8 g in the median, and 0.3 to 3 is what one can: say the right unit with wo",
        ),
        (lambda folder: table(folder, HEADER, "0,20000,1,40000,0,0,1"), "its magnetometer reads 4.472e+04 uT"),
        (lambda folder: (folder / "field.csv").mkdir(), "a folder; give a recording"),
        (lambda folder: os.mkfifo(folder / "field.csv"), "not a regular file; give a recording"),
        (lambda folder: (folder / "field.csv").symlink_to("/dev/zero"), "not a regular file; give a recording"),
        (lambda folder: None, "No such file"),
    ],
)
def test_what_is_no_recording_is_refused_with_the_rigs_line(
    tmp_path: Path, make: Callable[[Path], object], complaint: str
) -> None:
    make(tmp_path)
    where = RIG.read_text(encoding="utf-8").splitlines().index("[world]") + 2
    with pytest.raises(ConfigError, match=re.escape(complaint)) as refused:
        played(tmp_path)
    assert str(refused.value).startswith(f"{tmp_path / 'bench.toml'}:{where}: world.playback: {tmp_path / 'field.csv'}")


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "field.csv").open("wb") as file:
        file.truncate(64 << 30)
    with pytest.raises(ConfigError, match="larger than"):
        played(tmp_path)


def test_what_was_assumed_of_the_file_is_said_when_it_is_played(tmp_path: Path) -> None:
    table(tmp_path, "Logger: 7", HEADER, *ROWS)
    assert played(tmp_path).remarks()[0].startswith("field.csv: Line 1, above the table and no part of it, was skipped")


def test_a_table_in_utf_16_is_no_stream_of_packets(tmp_path: Path) -> None:
    (tmp_path / "field.csv").write_text("\n".join([HEADER, *ROWS]), encoding="utf-16")
    assert played(tmp_path).tracks.keys() == {Sensed.MAGNETOMETER, Sensed.ACCELEROMETER}
