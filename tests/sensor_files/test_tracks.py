"""Tables of readings: columns, units, axes and times as loggers write them; what is none is refused where it stands."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltest.errors import ConfigError
from hiltest.interfaces.sensor_files.tracks import read_table
from hiltest.rig.recorded_motion import PlaybackFile, PlayedSensor
from hiltest.world.recorded_motion import Sensed

MAGNETOMETER, ACCELEROMETER, GYROSCOPE = Sensed


def table(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def given(**keys: Any) -> PlaybackFile:
    return PlaybackFile("field.csv", **keys)


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        ("t_s,mx_uT,my_uT,mz_uT,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps", (1.0, 1.0, 1.0)),
        (
            "time_ms,mag_x_nT,mag_y_nT,mag_z_nT,acc_x_mg,acc_y_mg,acc_z_mg,gyro_x_mdps,gyro_y_mdps,gyro_z_mdps",
            (1e-3, 1e-3, 1e-3),
        ),
        (
            "timestamp [us],Magnetometer X (gauss),Magnetometer Y (gauss),Magnetometer Z (gauss),Accel X (m/s^2),"
            "Accel Y (m/s^2),Accel Z (m/s^2),Gyro X (rad/s),Gyro Y (rad/s),Gyro Z (rad/s)",
            (100.0, 1 / 9.80665, math.degrees(1.0)),
        ),
    ],
)
def test_headers_say_which_columns_are_what_and_in_what_unit(
    tmp_path: Path, header: str, factors: tuple[float, ...]
) -> None:
    ticks = {"t_s": 1, "time_ms": 1_000, "timestamp [us]": 1_000_000}[header.split(",")[0]]
    rows = [f"{n * ticks / 50},1,2,3,4,5,6,7,8,{n}" for n in range(5)]
    tracks = read_table(table(tmp_path / "field.csv", header, *rows), given()).tracks
    for sensed, factor, first in zip(Sensed, factors, ((1, 2, 3), (4, 5, 6), (7, 8, 0)), strict=True):
        assert tracks[sensed].times_s == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])
        assert tracks[sensed].readings[0] == pytest.approx([factor * item for item in first])


def test_the_rig_names_columns_units_axes_and_rate_of_a_table_without_a_header(tmp_path: Path) -> None:
    sensor = PlayedSensor(("2", "3", "4"), "0.1 uT", "-y x z")
    path = table(tmp_path / "field.csv", "9,10,20,30", "9,40,50,60")
    tracks = read_table(path, given(rate_hz=4.0, magnetometer=sensor)).tracks
    assert tracks.keys() == {MAGNETOMETER}
    assert tracks[MAGNETOMETER].times_s.tolist() == [0.0, 0.25]
    assert tracks[MAGNETOMETER].readings == pytest.approx(np.array([[-2.0, 1.0, 3.0], [-5.0, 4.0, 6.0]]))


def test_rows_of_single_sensors_leave_the_cells_of_others_empty(tmp_path: Path) -> None:
    path = table(
        tmp_path / "field.csv", "t_s,mx_uT,my_uT,mz_uT,ax_g,ay_g,az_g", "0,1,2,3,,,", "0,,,,0,0,1", "0.5,4,5,6,,,"
    )
    tracks = read_table(path, given()).tracks
    assert (tracks[MAGNETOMETER].times_s.tolist(), tracks[ACCELEROMETER].times_s.tolist()) == ([0.0, 0.5], [0.0])


HEADER = "t_s,mx_uT,my_uT,mz_uT"


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ([], "the file is empty"),
        ([HEADER], "no row has a reading"),
        ([HEADER, "0,1,2,3", "1,1,nan,3"], ":3: column my_uT: no number; leave all three axes empty, or none"),
        ([HEADER, "0,1,2,3", "1,1,,3"], ":3: column my_uT: no number"),
        ([HEADER, "0,1,2,3", "1,1,inf,3"], ":3: column my_uT: no number"),
        ([HEADER, "0,1,2,3", "1,1,2,x"], ":3: column mz_uT: 'x' is not a number"),
        ([HEADER, "0,1,2,3", "1,1,2,1e99"], ":3: column mz_uT: '1e99' is no reading of a sensor"),
        ([HEADER, "0,1,2,3", "nan,1,2,3"], ":3: column t_s: no number: every row needs its time"),
        ([HEADER, "0,1,2,3", "2,1,2,3", "1,1,2,3"], ":4: time 1 s is not behind 2 s; cut the recording there"),
        ([HEADER, "0,1,2,3", "0,1,2,3"], ":3: time 0 s is not behind 0 s"),
        ([HEADER, "0,1,2,3", "1,1,2"], ":3: 3 cells where the table has 4 columns"),
        (["t_s,temperature", "0,1"], "no columns of a magnetometer, an accelerometer or a gyroscope among t_s, temp"),
        (["t_s,mx_uT,my_uT,ax_g,ay_g,az_g", "0,1,2,0,0,1"], "columns mx_uT, my_uT are not x, y and z of one magneto"),
        (["t_s,mx,my,mz", "0,1,2,3"], "do not say their unit; say it with world.playback.magnetometer.unit, a factor"),
        (["t_s,mx_g,my_g,mz_g", "0,1,2,3"], "are in g, which is no unit of a magnetometer that is known"),
        (["mx_uT,my_uT,mz_uT", "1,2,3"], "no columns of time; name one with world.playback.time, or give world.playba"),
        (["t_s,time_ms,mx_uT,my_uT,mz_uT", "0,0,1,2,3"], "2 columns of time; name one with world.playback.time"),
        (
            ["t_s,mag1_x_uT,mag1_y_uT,mag1_z_uT,mag2_x_uT,mag2_y_uT,mag2_z_uT", "0,1,2,3,4,5,6"],
            "more than one magnetometer: choose with world.playback.magnetometer.columns = ['mag1_x_uT'",
        ),
        (["time_s,type,number,field_x_uT", "0,1,2,3"], "a table by hiltest decode, whose field is the firmware's cali"),
    ],
)
def test_what_is_no_recording_is_refused_where_it_stands(tmp_path: Path, lines: list[str], complaint: str) -> None:
    path = table(tmp_path / "field.csv", *lines)
    if not lines:
        path.write_bytes(b"")
    with pytest.raises(ConfigError, match=re.escape(complaint)) as refused:
        read_table(path, given())
    assert str(path) in str(refused.value)


def test_a_table_that_does_not_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hiltest.interfaces.sensor_files.tracks.MAX_ROWS", 3)
    path = table(tmp_path / "field.csv", HEADER, *(f"{n},1,2,3" for n in range(4)))
    with pytest.raises(ConfigError, match="more than 3 rows; cut the file"):
        read_table(path, given())


def test_a_clock_goes_on_over_midnight(tmp_path: Path) -> None:
    rows = ["23:59:59.980,1,2,3", "00:00:00.000,4,5,6", "00:00:00.020,7,8,9"]
    tracks = read_table(table(tmp_path / "field.csv", "time,mx_uT,my_uT,mz_uT", *rows), given()).tracks
    np.testing.assert_allclose(np.diff(tracks[MAGNETOMETER].times_s), 0.02, atol=1e-9)
    rows[1:1] = ["00:00:00.010,4,5,6", "23:59:59.990,4,5,6"]  # a late row of the day before
    with pytest.raises(ConfigError, match=r"late\.csv:4: .*time"):
        read_table(table(tmp_path / "late.csv", "time,mx_uT,my_uT,mz_uT", *rows), given())
