"""Logs of rates from all sorts of files: what they mean is found, and what is wrong is refused by row."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hiltest.calibration.allan import allan_curve
from hiltest.calibration.rest import first_motion
from hiltest.commands.options import RATE_UNITS
from hiltest.errors import CalibrationError, ConfigError
from hiltest.interfaces.sensor_files.columns import seconds_of
from hiltest.log_fitting import read_imu_log
from hiltest.log_fitting.rate_log import RateLog, check_rest, read_rate_log
from hiltest.measurement.units import DEGREES_PER_SECOND, RATE_WORDS, RateUnit


def written(folder: Path, *lines: str) -> Path:
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_log_of_hiltest_s_own(tmp_path: Path) -> None:
    log = read_rate_log(
        written(
            tmp_path,
            "# hiltest log",
            "time_s,gyroscope_x_dps,gyroscope_y_dps,gyroscope_z_dps,temperature_degc",
            "0.5,1.5,-2,1,25",
            "0.505,1.25,-2,1,25",
            "0.51,1,-2.5,1,26",
        )
    )
    assert (log.unit, log.columns) == (RateUnit.DPS, ("gyroscope_x_dps", "gyroscope_y_dps", "gyroscope_z_dps"))
    assert log.rates.tolist() == [[1.5, -2.0, 1.0], [1.25, -2.0, 1.0], [1.0, -2.5, 1.0]]
    assert (log.rate_hz, log.rows, log.gaps) == (pytest.approx(200.0), 3, 0)


def test_rows_of_other_sensors_are_passed_over(tmp_path: Path) -> None:
    log = read_rate_log(
        written(
            tmp_path,
            "time_s,gyroscope_x_dps,gyroscope_y_dps,gyroscope_z_dps,magnetometer_x_uT",
            "0.0,1,2,3,",
            "0.003,,,,25.5",
            "0.005,4,5,6,",
        )
    )
    assert log.rates.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert log.rate_hz == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("header", "row", "factor"),
    [
        ("time,gx [deg/s],gy [deg/s],gz [deg/s]", "{t},1,2,3", 1.0),
        ("timestamp_ms;gyro.x (rad/s);gyro.y (rad/s);gyro.z (rad/s)", "{ms};1;2;3", 180.0 / np.pi),
        ("t\trate_x_mdps\trate_y_mdps\trate_z_mdps", "{t}\t1\t2\t3", 1e-3),
        ("Time [us],Gyroscope X (deg/h),Gyroscope Y (deg/h),Gyroscope Z (deg/h)", "{us},1,2,3", 1.0 / 3600.0),
    ],
)
def test_foreign_headers_are_understood(tmp_path: Path, header: str, row: str, factor: float) -> None:
    rows = [row.format(t=0.01 * k, ms=10.0 * k, us=10_000 * k) for k in range(5)]
    columns = "2,3,4" if "gx" in header else None
    log = read_rate_log(written(tmp_path, header, *rows), columns=columns)
    assert log.rates[0] == pytest.approx(factor * np.array([1.0, 2.0, 3.0]))
    assert log.rate_hz == pytest.approx(100.0)


def test_columns_units_and_rate_can_be_said(tmp_path: Path) -> None:
    path = written(tmp_path, "7 1 100", "8 2 200", "9 3 300")
    log = read_rate_log(path, columns="3,2", unit=RateUnit.COUNTS, rate_hz=50.0)
    assert (log.rates.tolist(), log.is_in_degrees) == ([[100.0, 1.0], [200.0, 2.0], [300.0, 3.0]], False)
    assert log.rate_hz == 50.0
    assert read_rate_log(path, columns="2", unit=RateUnit.DPS, time="1").rate_hz == 1000.0


def test_of_a_log_with_gaps_the_longest_part_is_taken(tmp_path: Path) -> None:
    times = [0.0, 0.01, 0.02, 1.0, 1.01, 1.02, 1.03, 1.04, 3.0, 3.01]
    lines = [f"{time},{index}" for index, time in enumerate(times)]
    log = read_rate_log(written(tmp_path, "time_s,gyro_z_dps", *lines), columns="gyro_z_dps")
    assert (log.rates[:, 0].tolist(), log.rows, log.gaps) == ([3.0, 4.0, 5.0, 6.0, 7.0], 10, 2)
    assert (log.rate_hz, log.start_s) == (pytest.approx(100.0), 1.0)


def test_stamps_in_bursts_are_a_rate_with_jitter_and_a_lost_burst_is_a_gap(tmp_path: Path) -> None:
    """Three samples of 100 Hz a packet: stamped as it arrives, up to 2 ms late."""
    number = np.arange(6000)
    late_s = np.random.default_rng(3).uniform(0.0, 0.002, 2000).repeat(3)
    time_s = 0.03 * (number // 3) + 1e-4 * (number % 3) + late_s
    stamps = [f"{time:.6f},{index}" for index, time in zip(number, time_s, strict=True)]
    whole = read_rate_log(written(tmp_path, "time_s,gyro_z_dps", *stamps), columns="gyro_z_dps")
    assert (whole.gaps, len(whole.rates)) == (0, 6000)
    # 2 ms of scatter over 2000 packets: a rate known to 1e-6 of itself.
    assert whole.rate_hz == pytest.approx(100.0, rel=1e-5)
    assert 0.009 < whole.jitter_s < 0.013  # the burst's 20 ms, half to each side, and its delay
    lost = read_rate_log(written(tmp_path, "time_s,gyro_z_dps", *stamps[:3000], *stamps[3003:]), columns="gyro_z_dps")
    # The lost burst is a pause of 30 ms in a minute, and is passed over.
    assert (lost.gaps, len(lost.rates), lost.rates[0, 0]) == (1, 5997, 0.0)
    assert lost.instant_s(5996) - lost.instant_s(0) == pytest.approx(59.99, abs=0.001)
    assert lost.rate_hz == pytest.approx(100.0, rel=1e-4)
    same = [f"{0.03 * (index // 3):.2f},{index}" for index in number]
    assert read_rate_log(written(tmp_path, "time_s,gyro_z_dps", *same), columns="2").rate_hz == pytest.approx(100.0)


def test_short_pauses_are_passed_over_and_the_noise_stays(tmp_path: Path) -> None:
    """A pause of 3 ms after every 40 samples at 1 kHz, as a card that is written makes it."""
    number = np.arange(8000)
    noise = np.random.default_rng(5).normal(0.0, 0.1, 8000)
    stamps = [f"{index + 3 * (index // 40)},{rate:.5f}" for index, rate in zip(number, noise, strict=True)]
    log = read_rate_log(written(tmp_path, "time_ms,gyro_z_dps", *stamps), columns="gyro_z_dps")
    assert (log.gaps, len(log.rates), log.rate_hz) == (199, 8000, pytest.approx(1000.0))
    # White noise of 0.1 deg/s at 1 kHz; the estimate of 8000 samples has an uncertainty of about 2 %.
    walk = allan_curve(log.rates, rate_hz=log.rate_hz).readings[0].angle_random_walk
    assert walk is not None
    assert walk.value == pytest.approx(0.1 / math.sqrt(1000.0), rel=0.1)


def test_a_part_is_taken_by_its_instants(tmp_path: Path) -> None:
    lines = [f"{7.0 + 0.01 * index:.2f},{index}" for index in range(100)]
    path = written(tmp_path, "time_s,gyro_z_dps", *lines)
    part = read_rate_log(path, columns="gyro_z_dps", first_s=0.205, last_s=0.305)
    assert (part.rates[:, 0].tolist(), part.start_s) == (list(range(21, 31)), pytest.approx(0.21))
    with pytest.raises(CalibrationError, match="0 samples"):
        read_rate_log(path, columns="gyro_z_dps", first_s=5.0)


def test_both_commands_take_the_same_columns_for_a_gyroscope(tmp_path: Path) -> None:
    for names in (
        "gx_dps,gy_dps,gz_dps",
        "wx,wy,wz",
        "angular_rate_x,angular_rate_y,angular_rate_z",
        "Gyro X (deg/s),Gyro Y (deg/s),Gyro Z (deg/s)",
    ):
        rows = [f"{0.01 * index},0,0,1,{index},2,3,30,0,0" for index in range(10)]
        path = written(tmp_path, f"time_s,ax,ay,az,{names},calibrated_x,calibrated_y,calibrated_z", *rows)
        log, imu = read_rate_log(path, unit=RateUnit.DPS), read_imu_log(path)
        assert imu.rate is not None
        assert log.rates.tolist() == imu.rate.tolist()


@pytest.mark.parametrize(("size", "seconds"), [(5.0, 1.0), (20.0, 0.05), (0.6, 2.0)])
def test_a_log_that_moved_is_refused_with_the_instant(size: float, seconds: float) -> None:
    rates = np.random.default_rng(4).normal(0.0, 0.2, (60_000, 3)) + np.linspace(0.0, 1.0, 60_000)[:, None]
    log = RateLog(Path("rest.csv"), ("x", "y", "z"), rates, RateUnit.DPS, 100.0, 60_000, 0, start_s=10.0)
    check_rest(log)
    rates[40_033 : 40_033 + round(100 * seconds), 1] += size
    with pytest.raises(CalibrationError, match=r"rest.csv: it moved (\S+) s after the first row: y changed") as refused:
        check_rest(log)
    at_s, first_s, last_s = map(float, re.findall(r"moved (\S+) s.* --from (\S+) --to (\S+)", str(refused.value))[0])
    # A short move to the window of 0.1 s, one that only a second shows to that.
    assert 410.33 - (0.1 if size > 1.0 else 1.0) <= at_s <= 410.4
    assert (first_s, 408.0 < last_s <= at_s) == (10.0, True)
    check_rest(replace(log, rates=rates[: round(100 * (last_s - 10.0))]))


def _noise_of(kind: str, seed: int) -> RateLog:
    """Return 40 s at 100 Hz: 10 mdps/rtHz of noise, at rest or carried in the hand all the time."""
    random = np.random.default_rng(seed)
    rates = random.normal(0.0, 0.010 * np.sqrt(50.0), (4000, 3))
    if kind != "rest":
        size_dps = {"calm": 8.0, "walk": 60.0}[kind]
        phase = 2.0 * np.pi * np.cumsum(random.normal(0.9, 0.1, 4000)) / 100.0
        swing = np.column_stack([np.sin(phase), 0.7 * np.sin(2.0 * phase), 0.5 * np.sin(phase / 2.0)])
        rates += size_dps * swing + random.normal(0.0, size_dps / 6.0, (4000, 3))
    return RateLog(Path("gyro.csv"), ("x", "y", "z"), rates, RateUnit.DPS, 100.0, 4000, 0)


def test_a_hundred_logs_at_rest_are_accepted_and_two_hundred_that_move_all_the_time_are_refused() -> None:
    for seed in range(100):
        check_rest(_noise_of("rest", seed))
        for kind in ("walk", "calm"):
            with pytest.raises(CalibrationError, match=r"moved"):
                check_rest(_noise_of(kind, seed))


def test_the_largest_noise_of_a_sensor_is_a_matter_of_its_data_sheet() -> None:
    log = _noise_of("rest", 1)
    with pytest.raises(CalibrationError, match=r"above 7: .*--noise"):
        check_rest(log, noise_mdps=7.0)
    check_rest(replace(log, rates=15.0 * log.rates), noise_mdps=250.0)


@pytest.mark.parametrize("step", [0.02, 0.5, 4.0])
def test_noise_drift_and_rounding_are_no_motion(step: float) -> None:
    """Noise of 0.2 deg/s, and a bias that rises by 1 deg/s within minutes of switching on, however coarsely rounded."""
    for seed in range(5):
        drift = 1.0 - np.exp(-np.arange(60_000) / 10_000.0)
        rates = np.random.default_rng(seed).normal(0.0, 0.2, (60_000, 1)) + drift[:, None]
        assert first_motion(np.round(rates / step), rate_hz=100.0) is None


HEADER = "time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps"


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ([], "the file is empty"),
        ([HEADER], "no row has numbers in the columns gyro_x_dps, gyro_y_dps, gyro_z_dps"),
        ([HEADER, "0,1,2,3", "0.1,1,2", "0.2,1,2,3"], r":3: 3 cells where the table has 4 columns"),
        ([HEADER, "0,1,2,3", "0.1,1,x,3"], r":3: column gyro_y_dps: 'x' is not a number"),
        ([HEADER, "0,1,2,3", "0.1,1,nan,3"], r":3: column gyro_y_dps: 'nan' is not a number"),
        ([HEADER, "0,1,2,3", "0.1,1,,3"], r":3: column gyro_y_dps: '' is not a number"),
        ([HEADER, "0,1,2,3", "0.1,1,1e12,3"], r":3: column gyro_y_dps: '1e12' is no reading of a gyroscope"),
        ([HEADER, "0,1,2,1_000"], r":2: column gyro_z_dps: '1_000' is not a number"),
        ([HEADER, "0,1,2,3", "0.0,1,2,3"], r"samples are 0 s apart by the column of time"),
        ([HEADER, "0.2,1,2,3", "0.1,1,2,3"], r":3: the time 0.1 is before the one above it, 0.2"),
        ([HEADER, "0,1,2,3", "soon,1,2,3"], r":3: column time_s: 'soon' is not a number"),
        ([HEADER.replace(",", ";"), "0;1;2;3", "0,1;1;2;3"], r":3: column time_s: '0,1' .* need a point, not a comma"),
        ([HEADER, "0,1,2,3\0"], r":2: a zero byte"),
        (["time_s,mag_x,mag_y,mag_z", "0,1,2,3"], r"cannot tell which columns are the gyroscope"),
        (["0,1,2,3"], r"cannot tell which columns are the gyroscope \(without a header\); name them with --columns"),
        (["time_s,gyro_x,gyro_y,gyro_z", "0,1,2,3"], r"name no unit; set it: --unit deg/s or"),
        (["time_s,gyro_x_dps,gyro_y_mdps,gyro_z_dps", "0,1,2,3"], r"name different units"),
        (["gyro_x_dps,gyro_y_dps,gyro_z_dps", "1,2,3"], r"no columns of time.*--rate HZ"),
        ([HEADER, "-1e300,1,2,3", "1e300,1,2,4"], r":2: column time_s: '-1e300' is no time"),
        ([HEADER, "0,1,2,3", "1e15,1,2,4"], r"samples are 1e\+15 s apart by the column of time; give --rate, or name"),
        ([HEADER, "0,1,2,3", "5e-324,1,2,4"], r"samples are 4.94066e-324 s apart by the column of time"),
    ],
)
def test_what_is_wrong_is_refused_by_row(tmp_path: Path, lines: list[str], complaint: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(ConfigError, match=f"log.csv.*{complaint}" if lines else complaint):
        read_rate_log(path)


@pytest.mark.parametrize(
    ("columns", "complaint"),
    [
        ("1,2,3,4", "give one or two or three"),
        ("2,2", "a column is named twice"),
        ("2,9", "no column '9'"),
        ("1,2", "is given as time and as a rate"),
    ],
)
def test_columns_that_cannot_be_are_refused(tmp_path: Path, columns: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        read_rate_log(written(tmp_path, HEADER, "0,1,2,3"), columns=columns)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nosuch\.csv"):
        read_rate_log(tmp_path / "nosuch.csv")


def test_every_unit_of_a_rate_can_be_said_and_has_its_scale() -> None:
    assert {RATE_WORDS[word] for word in RATE_UNITS} == set(RateUnit) == set(DEGREES_PER_SECOND)
    assert all(RATE_WORDS[unit] is unit for unit in RateUnit), "what messages and files say is read again"


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        ("time", math.nan),
        ("Time_s", 1.0),
        ("seconds", 1.0),
        ("t [sec]", 1.0),
        ("timestamp.ms", 1e-3),
        ("t(us)", 1e-6),
        ("time_\N{MICRO SIGN}s", 1e-6),
        ("time_\N{GREEK SMALL LETTER MU}s", 1e-6),
        ("Timestamp (NS)", 1e-9),
        ("temperature", None),
        ("time_of_flight", None),
        ("gyro_t", None),
        ("", None),
    ],
)
def test_a_column_of_time_is_known_by_its_name(header: str, seconds: float | None) -> None:
    assert seconds_of(header) == (None if seconds is None else pytest.approx(seconds, nan_ok=True))


def test_a_text_above_and_a_cut_line_below_are_skipped_and_said(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["Logger: 7", HEADER, *(f"{n / 100},1,2,{n}" for n in range(20)), "0.2,1"]))
    log = read_rate_log(path)
    assert (len(log.rates), len(log.notes)) == (20, 2)


def test_a_clock_goes_on_over_midnight(tmp_path: Path) -> None:
    clocks = [f"{'23:59:59' if row < 50 else '00:00:00'}.{row % 50 * 20:03d}" for row in range(100)]
    log = read_rate_log(written(tmp_path, "time,gx_dps,gy_dps,gz_dps", *(f"{clock},1,2,3" for clock in clocks)))
    assert (log.rate_hz, log.rows, log.gaps) == (pytest.approx(50.0), 100, 0)
    with pytest.raises(ConfigError, match=r"log\.csv:4: the time 43200 is before the one above it, 43201"):
        read_rate_log(written(tmp_path, "time,gx_dps,gy_dps,gz_dps", *(f"12:00:0{n},1,2,3" for n in (0, 1, 0))))
