"""Reading logs: columns, units and time as loggers write them; what is no log is refused where it stands."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from hiltest.errors import ConfigError
from hiltest.log_fitting import (
    AccelerationUnit,
    LogColumns,
    RateUnit,
    labelled_intervals,
    listed_intervals,
    read_imu_log,
)

from .recording import RATE_HZ, six_faces_and_turns, write


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write(tmp_path / "log.csv", *six_faces_and_turns().readings())


def text(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "units"),
    [
        ("t,ax,ay,az,gx,gy,gz", ("counts", "counts")),
        (
            "time (s),Acc X (m/s^2),Acc Y (m/s^2),Acc Z (m/s^2),Gyro X (deg/s),Gyro Y (deg/s),Gyro Z (deg/s)",
            ("m/s2", "deg/s"),
        ),
        ("t_s,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps", ("g", "deg/s")),
        ("seconds,ax_g,ay_g,az_g,gx_mdps,gy_mdps,gz_mdps", ("g", "mdps")),
        ("timestamp_s,accel_x_mg,accel_y_mg,accel_z_mg,gyr_x_rad/s,gyr_y_rad/s,gyr_z_rad/s", ("mg", "rad/s")),
    ],
)
def test_headers_say_which_columns_are_what(tmp_path: Path, header: str, units: tuple[str, str]) -> None:
    rows = [f"{0.01 * n:.2f},1,2,3,4,5,{n}" for n in range(20)]
    log = read_imu_log(text(tmp_path / "log.csv", header, *rows))
    assert (log.acceleration_unit, log.rate_unit) == units
    assert log.acceleration.tolist() == [[1, 2, 3]] * 20
    assert log.rate is not None
    assert log.rate[:, 2].tolist() == list(range(20))
    assert log.period_s == pytest.approx(0.01)


def test_time_may_be_in_milliseconds_or_only_a_rate(tmp_path: Path) -> None:
    rows = [f"{10 * n},1,2,3" for n in range(20)]
    log = text(tmp_path / "log.csv", "time_ms,ax,ay,az", *rows)
    assert read_imu_log(log).period_s == pytest.approx(0.01)
    assert read_imu_log(log, rate_hz=50.0).period_s == pytest.approx(0.02)
    assert read_imu_log(log).rate is None


@pytest.mark.parametrize(("unit", "ticks"), [("s", 1), ("ms", 1_000), ("us", 1_000_000), ("ns", 1_000_000_000)])
def test_time_may_be_that_of_the_calendar(tmp_path: Path, unit: str, ticks: int) -> None:
    rows = [f"{(1_760_000_000 * 100 + n) * ticks / 100:.2f},1,2,3" for n in range(20)]
    log = read_imu_log(text(tmp_path / "log.csv", f"timestamp_{unit},ax,ay,az", *rows))
    # A float64 of nanoseconds since 1970 is a multiple of 256 of them.
    assert log.period_s == pytest.approx(0.01, abs=1e-6)


def test_rows_of_one_sensor_each_are_joined_at_the_gyroscopes_times(tmp_path: Path) -> None:
    """As `hiltest log` writes several sensors: here the accelerometer half as often, and between the gyroscope's."""
    rows = [
        "0.0,,,,1,10,-5,,7",
        *(
            line
            for n in range(20)
            for line in (
                f"{0.01 * n + 0.005:.3f},{n},{2 * n},0.5,,,,,7",
                f"{0.01 * n + 0.005:.3f},,,,,,,30.5,7",
                *([f"{0.01 * n + 0.01:.3f},,,,{1 + n},{10 - n},-5,,7"] if n % 2 else []),
            )
        ),
    ]
    header = "time_s,gyroscope_x_dps,gyroscope_y_dps,gyroscope_z_dps,acc_x_g,acc_y_g,acc_z_g,magnetometer_x_uT,label"
    log = read_imu_log(text(tmp_path / "log.csv", header, *rows), columns=LogColumns(labels="label"))
    assert log.rate is not None
    assert log.labels == ("7",) * 20
    assert log.rate.tolist() == [[n, 2 * n, 0.5] for n in range(20)]
    assert log.time_s == pytest.approx([0.01 * n + 0.005 for n in range(20)])
    # On the line through (0.02 k, 1 + 2 k - 1), but for the first piece, from 1 to 2.
    expected = [1.25, 1.75, *(0.5 + n for n in range(2, 20))]
    assert log.acceleration[:, 0] == pytest.approx(expected)
    assert log.acceleration[:, 2].tolist() == [-5.0] * 20


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["0,1,2,3,,,", "0.01,,,,4,5,6", "0.02,1,2,3,4,5,6"], ":4: both sensors in a row, and before rows of one each"),
        (
            ["0,1,2,3,4,5,6", "0.01,,,,4,5,6"],
            ":3: column ax_g: a number is missing, and a turn cannot be integrated over a gap",
        ),
        (["0,1,2,3,,,", "0.01,,,,4,,6"], ":3: column gy_dps: a number is missing"),
        (["0,1,2,3,,,", "0.01,,,,4,5,6", "0.005,1,2,3,,,"], ":4: column t_s: time 0.005 is not after 0.01"),
        (["0,1,2,3,,,", "0.01,1,2,3,,,"], "no two at different times among those of the accelerometer"),
        (["0,,,,4,5,6", "0.01,,,,4,5,6"], "no two at different times among those of the accelerometer"),
    ],
)
def test_rows_that_are_not_one_sensor_each_throughout_are_refused(
    tmp_path: Path, rows: list[str], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        read_imu_log(text(tmp_path / "log.csv", "t_s,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps", *rows))


def test_two_packed_tables_without_a_header_are_one_log(tmp_path: Path) -> None:
    for name, first in (("acc", 1), ("gyro", 100)):
        rows = "".join(f"   {0.01 * n:.7e}   {first}.0   2.0   {n}.0\n" for n in range(20))
        (tmp_path / f"{name}.mat.gz").write_bytes(gzip.compress(rows.encode()))
    log = read_imu_log(
        tmp_path / "acc.mat.gz",
        tmp_path / "gyro.mat.gz",
        acceleration_unit=AccelerationUnit.MS2,
        rate_unit=RateUnit.RAD_S,
    )
    assert log.acceleration[3].tolist() == [1, 2, 3]
    assert log.rate is not None
    assert log.rate[3].tolist() == [100, 2, 3]
    assert (log.acceleration_unit, log.rate_unit) == ("m/s2", "rad/s")


def test_what_was_written_comes_back(log: Path) -> None:
    read = read_imu_log(log)
    acceleration, rate = six_faces_and_turns().readings()
    assert np.allclose(read.acceleration, acceleration, atol=1e-8)
    assert read.rate is not None
    assert np.allclose(read.rate, rate, atol=1e-6)
    assert read.period_s == pytest.approx(1.0 / RATE_HZ)


HEADER = "t,ax,ay,az,gx,gy,gz"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([HEADER, "0,1,2,3,4,5,6", "0.01,1,two,3,4,5,6"], r"log.csv:3: column ay: 'two' is not a number"),
        (
            [HEADER, "0,1,2,3,4,5,6", "0.01,1,,3,4,5,6"],
            r"log.csv:3: column ay: a number is missing.* cut the log there",
        ),
        ([HEADER, "0,1,2,3,4,5,6", "0.01,1,2,3,4,nan,6"], r"log.csv:3: column gy: a number is missing"),
        ([HEADER, "0,1,2,3,4,5,6", "0.01,1,2,3,4,inf,6"], r"log.csv:3: column gy: a number is missing"),
        ([HEADER, "0,1,2,3,4,5,6", "0.01,1,2,3,4,1e300,6"], r"log.csv:3: column gy: '1e300' is no reading of an IMU"),
        ([HEADER, "0,1,2,3,4,5,6", "0.01,1,2,3"], r"log.csv:3: 4 cells where the table has 7 columns"),
        ([HEADER, "0,1,2,3,4,5,6", "0,1,2,3,4,5,7"], r"log.csv:3: column t: time 0 is not after 0"),
        (["t_s,ax,ay,az", "0,1,2,3", "10,1,2,3"], r"samples are 10 s apart by column t_s; give --rate"),
        ([HEADER, "0,1,2,3,4,5,6"], "1 rows of numbers are too few for a log"),
        ([HEADER], "0 rows of numbers are too few for a log"),
        (["ax,ay,az", "1,2,3"], "no columns of time; give --rate in Hz, or --time"),
        (["t,mx,my,mz", "0,1,2,3"], "cannot tell which columns are the accelerometer: .*--accelerometer-columns"),
        (["t,acc1_x,acc1_y,acc1_z,acc2_x,acc2_y,acc2_z", "0,1,2,3,4,5,6"], "more than one accelerometer: choose with"),
        (["t,ax,ay,az", "5e-324,1,2,3", "1e-323,1,2,3"], "samples are 4.94066e-324 s apart by column t"),
        (["t,ax,ay,az", "1e30,1,2,3"], ":2: column t: '1e30' is no time"),
        (["t_s,ax_g,ay_g,az_mg", "0,1,2,3"], "g and mg is no unit that can be read here"),
    ],
)
def test_what_is_no_log_is_refused_where_it_stands(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_imu_log(text(tmp_path / "log.csv", *lines))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (gzip.compress(b"0 1 2 3\n" * 5000)[:-9], "."),
        (b"\x1f\x8b not packed", "."),
        (gzip.compress(b"\x00\x01\x02\n"), "zero byte"),
    ],
    ids=["nothing", "cut short", "no gzip", "binary"],
)
def test_packed_files_that_are_none_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "log.gz"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        read_imu_log(path, rate_hz=100.0)


def test_logs_of_two_sensors_are_joined_by_time(tmp_path: Path) -> None:
    first = text(tmp_path / "a.txt", *[f"{0.01 * n:.2f} {n} 2 3" for n in range(20)])
    second = text(tmp_path / "b.txt", *[f"{0.05 + 0.004 * n:.3f} 4 5 {n}" for n in range(60)])
    log = read_imu_log(first, second)
    assert log.rate is not None
    # Of the gyroscope's samples from 0.05 to 0.286 s, those until 0.19 s, the accelerometer's last.
    np.testing.assert_allclose(log.time_s, 0.05 + 0.004 * np.arange(36), atol=1e-12)
    np.testing.assert_allclose(log.acceleration[:, 0], 100.0 * log.time_s, atol=1e-9)
    assert log.rate[:, 2].tolist() == list(range(36))
    assert any("at 36 of 60 samples" in note for note in log.notes)
    later = text(tmp_path / "c.txt", *[f"{0.01 * n + 7.05:.2f} 1 2 3" for n in range(20)])
    with pytest.raises(ConfigError, match="have no time in common"):
        read_imu_log(first, later)
    with pytest.raises(ConfigError, match=r"20 rows and .* 60; leave out --rate"):
        read_imu_log(first, second, rate_hz=100.0)


def test_rows_that_are_written_twice_are_read_once(tmp_path: Path) -> None:
    rows = [f"{20 * n},1,2,{n}" for n in range(10)]
    log = read_imu_log(text(tmp_path / "log.csv", "t_ms,ax,ay,az", *(row for row in rows for _ in (0, 1))))
    assert log.acceleration[:, 2].tolist() == list(range(10))
    assert log.notes == ("10 rows that repeat the one before, with its time, were skipped.",)


def test_columns_can_be_named_or_numbered(tmp_path: Path) -> None:
    path = text(tmp_path / "log.csv", "n,u,v,w,p,q,r", *[f"{n},1,2,3,4,5,6" for n in range(10)])
    for names in ("u,v,w", "2,3,4"):
        log = read_imu_log(path, columns=LogColumns(names, "r,q,p"), rate_hz=100.0)
        assert log.acceleration[0].tolist() == [1, 2, 3]
        assert log.rate is not None
        assert log.rate[0].tolist() == [6, 5, 4]
    with pytest.raises(ConfigError, match="--gyroscope-columns: no column 'x'"):
        read_imu_log(path, columns=LogColumns("u,v,w", "x,y,z"), rate_hz=100.0)


def test_annotations_come_from_a_list_or_from_a_column(tmp_path: Path, log: Path) -> None:
    listed = tmp_path / "list.json"
    listed.write_text(json.dumps({"x_p": {"start": 10, "end": 20}, "x_rot": {"start": 30, "end": 40}}))
    intervals = listed_intervals(read_imu_log(log), listed)
    assert [(rest.name, rest.start, rest.end) for rest in intervals.rests] == [("x_p", 10, 20)]
    assert [(motion.name, motion.start, motion.end) for motion in intervals.motions] == [("x_rot", 30, 40)]
    rows = [f"{name},1,2,3" for name in ("up", "up", "left", "turn 1", "up")]
    labelled = read_imu_log(
        text(tmp_path / "labels.csv", "part,ax,ay,az", *rows), columns=LogColumns(labels="part"), rate_hz=100.0
    )
    intervals = labelled_intervals(labelled)
    assert [(rest.start, rest.end) for rest in intervals.rests] == [(0, 2), (2, 3), (4, 5)]
    assert [(motion.start, motion.end) for motion in intervals.motions] == [(3, 4)]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1, 2", "not JSON"),
        ("[1, 2]", "no list of intervals"),
        ("{}", "no list of intervals"),
        ('{"up": 3}', "up: needs start and end"),
        ('{"up": {"start": 1.5, "end": 3}}', "up: needs start and end"),
        ('{"up": {"start": 5, "end": 5}}', "up: samples 5 to 5 are not in a log"),
        ('{"up": {"start": -5, "end": 5}}', "up: samples -5 to 5 are not in a log"),
        ('{"up": {"start": 5, "end": 5000000}}', "up: samples 5 to 5000000 are not in a log"),
    ],
)
def test_a_list_of_intervals_that_is_none_is_refused(tmp_path: Path, log: Path, content: str, message: str) -> None:
    path = tmp_path / "list.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match=message):
        listed_intervals(read_imu_log(log), path)


def test_a_log_in_any_form_is_read_and_what_was_assumed_is_said(tmp_path: Path) -> None:
    raw = [f"12:00:0{n}.{k}00 -> Raw:0,0,8192,16,0,0,1,2,3" for n in range(3) for k in range(10)]
    read = read_imu_log(text(tmp_path / "raw.txt", *raw), rate_hz=100.0)
    assert read.acceleration[0].tolist() == [0.0, 0.0, 1.0]
    assert read.rate is not None
    assert read.rate[0].tolist() == [1.0, 0.0, 0.0]
    assert (read.acceleration_unit, read.rate_unit, len(read.notes)) == (AccelerationUnit.G, RateUnit.DPS, 2)
    lines = [f'{{"t": {n / 50}, "acc": [0, 0, 9.8], "gyr": [0, 0, {n}]}}' for n in range(20)]
    read = read_imu_log(text(tmp_path / "log.jsonl", *lines))
    assert "Are these m/s2? use --accelerometer-unit m/s2." in read.notes[-1]
    read = read_imu_log(tmp_path / "log.jsonl", acceleration_unit=AccelerationUnit.MS2)
    assert read.notes == ("Lists of three numbers in JSON were taken as x, y and z.",)


def test_a_clock_goes_on_over_midnight(tmp_path: Path) -> None:
    clocks = [f"{'23:59:59' if row < 50 else '00:00:00'}.{row % 50 * 20:03d}" for row in range(100)]
    log = text(tmp_path / "log.csv", "time,ax,ay,az", *(f"{clock},1,2,{row}" for row, clock in enumerate(clocks)))
    np.testing.assert_allclose(np.diff(read_imu_log(log).time_s), 0.02, atol=1e-9)
    back = text(tmp_path / "back.csv", "time,ax,ay,az", *(f"12:00:0{second},1,2,3" for second in (0, 1, 0)))
    with pytest.raises(ConfigError, match=r"back\.csv:4: column time: time 43200 is not after 43201"):
        read_imu_log(back)
