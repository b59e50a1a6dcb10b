"""Scales from a turntable, the bias from another log, and turns with a bias of their own."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.command_files import run

from hiltest.calibration.gyroscope import scale_error_percent
from hiltest.errors import CalibrationError, ConfigError
from hiltest.log_fitting import AccelerationUnit, ImuLog, RateUnit, found_intervals, listed_intervals, read_imu_log
from hiltest.log_fitting.imu_fit import ImuLogFit, fit_imu_log
from hiltest.log_fitting.imu_gyroscope import fit_gyroscope
from hiltest.log_fitting.imu_rate import rest_rate
from hiltest.log_fitting.rate_log import rest_bias

from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture
from .recording import GYROSCOPE, RATE_HZ, Reals, Sensor, six_faces_and_turns

RPM = 100.0 / 3.0
DPS = 6.0 * RPM
NO_ACCELERATION = np.empty((0, 3))
COUNTS = Sensor(16.0 * GYROSCOPE.response, 32768.0 + 16.0 * GYROSCOPE.bias, 0.8)


def rest(seconds: float) -> Reals:
    return np.zeros((round(seconds * RATE_HZ), 3))


def turntable(seconds: float, about: Reals, dps: float = DPS) -> Reals:
    """Eight seconds in which it gathers speed, the time at its rate with a waver of 0.15 %, and eight to a stop."""
    gathers = 1.0 - np.exp(-np.arange(round(8.0 * RATE_HZ)) / RATE_HZ / 1.2)
    waver = 1.0 + 0.0015 * np.sin(2.0 * np.pi * np.arange(round(seconds * RATE_HZ)) / RATE_HZ * RPM / 60.0)
    return np.outer(dps * np.concatenate([gathers, waver, gathers[::-1]]), about)


def log_of(truth: Reals, sensor: Sensor = GYROSCOPE, unit: RateUnit = RateUnit.DPS) -> ImuLog:
    readings = sensor.reading(truth, np.random.default_rng(1))
    return ImuLog(
        ("made up",), np.arange(len(truth)) / RATE_HZ, NO_ACCELERATION, readings, AccelerationUnit.COUNTS, unit
    )


def fitted(log: ImuLog, bias: Reals | None = None, rpm: float = RPM) -> ImuLogFit:
    intervals = found_intervals(log, rest_rate=rest_rate(log) if bias is None else bias)
    return fit_imu_log(log, intervals, bias=bias, rpm=rpm)


@pytest.mark.parametrize(("sensor", "unit"), [(GYROSCOPE, RateUnit.DPS), (COUNTS, RateUnit.COUNTS)])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_turntable_gives_the_scale_of_the_axis_along_it(sensor: Sensor, unit: RateUnit, sense: float) -> None:
    """Askew by two degrees, as it lies; longer turned than at rest."""
    about = np.array([np.sin(np.radians(2.0)), 0.0, np.cos(np.radians(2.0))])
    fit = fitted(log_of(np.vstack([rest(5.0), turntable(60.0, about, sense * DPS), rest(5.0)]), sensor, unit))
    (rate,) = fit.rates or ()
    truth = 1.0 / float(np.linalg.norm(sensor.response @ about))
    # The waver of 0.15 % over 33 revolutions, and 0.05 deg/s of noise over six thousand samples.
    assert rate.scale == pytest.approx(truth, rel=3e-4)
    assert rate.uncertainty / truth < 3e-4
    assert (rate.axis, rate.refused) == ("z", "")
    # Its rate from 13 to 73 s; within 1 % of it from 10.5 to 75.5 s.
    assert 10.5 < rate.start_s < 13.0 < 73.0 < rate.end_s < 75.5
    assert fit.gyroscope is not None
    assert np.abs(fit.gyroscope.bias - sensor.bias).max() < 0.02 * (16.0 if unit is RateUnit.COUNTS else 1.0)


def test_each_axis_that_lay_along_the_table_has_its_scale() -> None:
    parts = [part for about in np.eye(3) for part in (rest(5.0), turntable(20.0, about))]
    scales = fitted(log_of(np.vstack([*parts, rest(5.0)]))).scales
    assert sorted(scales) == ["x", "y", "z"]
    for axis, rate in enumerate(scales.values()):
        assert rate.scale is not None
        column = GYROSCOPE.response[:, "xyz".index(rate.axis)]
        # A third of the revolutions, and a table that still gains 0.05 % a second after what is cut off.
        assert rate.scale == pytest.approx(1.0 / float(np.linalg.norm(column)), rel=1e-3), axis


def test_of_a_log_that_never_rests_the_bias_comes_from_another() -> None:
    log = log_of(turntable(30.0, np.eye(3)[2])[800:-800])
    (rate,) = fitted(log, GYROSCOPE.bias).rates or ()
    assert rate.scale == pytest.approx(1.0 / float(np.linalg.norm(GYROSCOPE.response[:, 2])), rel=3e-4)
    assert fitted(log).rates == ()


@pytest.mark.parametrize(
    ("truth", "rpm", "complaint"),
    [
        (turntable(20.0, np.array([0.6, 0.0, 0.8])), RPM, "it lay 37 deg off its z axis"),
        (turntable(20.0, np.eye(3)[2]), 45.0, "it reads 203 deg/s where the table turns at 270"),
    ],
)
def test_a_rate_that_shows_no_scale_is_refused_with_the_reason(truth: Reals, rpm: float, complaint: str) -> None:
    (rate,) = fitted(log_of(np.vstack([rest(5.0), truth, rest(5.0)])), rpm=rpm).rates or ()
    assert (rate.scale, rate.refused.startswith(complaint)) == (None, True), rate.refused


def test_a_rate_beyond_the_range_of_the_sensor_is_refused() -> None:
    log = log_of(np.vstack([rest(5.0), turntable(20.0, np.eye(3)[2], 270.0), rest(5.0)]))
    clipped = replace(log, rate=np.clip(log.rate if log.rate is not None else 0.0, -250.0, 250.0))
    (rate,) = fitted(clipped, rpm=45.0).rates or ()
    assert rate.refused == "z reads 250 at most: the rate is beyond the sensor's range"


def test_a_log_at_rest_turns_at_no_rate() -> None:
    for seed in range(5):
        log = log_of(rest(60.0), replace(GYROSCOPE, noise=0.05 + 0.1 * seed))
        assert fitted(log).rates == ()


def test_a_turn_has_the_bias_of_the_rests_beside_it() -> None:
    """A bias that rises by 0.3 deg/s over the log: with one bias for all, turns of five seconds are off by a degree."""
    acceleration, rate = six_faces_and_turns().readings()
    drift = np.linspace(0.0, 0.3, len(rate))
    log = ImuLog(
        ("made up",),
        np.arange(len(rate)) / RATE_HZ,
        acceleration,
        rate + drift[:, None],
        AccelerationUnit.G,
        RateUnit.DPS,
    )
    result = found_intervals(log)
    listed = replace(result, found=False)
    fits = [fit_imu_log(log, item).gyroscope for item in (result, listed)]
    for fit in fits:
        assert fit is not None
        assert fit.fit is not None
        for turn in fit.turns:
            middle = np.interp(0.5 * (turn.start_s + turn.end_s), log.time_s, drift)
            # The means of two rests, 0.05 deg/s over 300 samples each, and a drift that is even between them.
            assert turn.bias == pytest.approx(GYROSCOPE.bias + middle, abs=0.02)
        assert max(turn.left_deg for turn in fit.turns) < 0.2  # as without the drift
    one = fit_gyroscope(log, listed, fit_imu_log(log, result).accelerometer.fit)
    assert one is not None
    assert max(turn.left_deg for turn in one.turns) > 0.8


def test_turns_in_the_hand_are_those_that_others_found(
    shared_data: Callable[[str], Path],  # noqa: F811
) -> None:
    """Portabiles IMU, three annotated turns: its owners' integrals; each bias from the rests beside the turn."""
    folder = shared_data("imucal_ferraris/README.md").parent
    log = read_imu_log(folder / "example_ferraris_session.csv", rate_hz=102.4, rate_unit=RateUnit.DPS)
    fit = fit_imu_log(log, listed_intervals(log, folder / "example_ferraris_session_list.json"))
    assert fit.gyroscope is not None
    along = [turn.integral[axis] for axis, turn in enumerate(fit.gyroscope.turns)]
    assert along == pytest.approx([-370.0, -353.7, -359.4], abs=0.06)  # to the tenth that is told
    assert len({turn.bias for turn in fit.gyroscope.turns}) == 3
    # The calibrated integrals are whole turns: three are met exactly.
    assert [turn.left_deg < 1e-6 for turn in fit.gyroscope.turns] == [True] * 3
    response = np.linalg.inv(fit.gyroscope.fit.matrix) if fit.gyroscope.fit else np.eye(3)
    scales = [scale_error_percent(response[:, axis], np.eye(3)[axis]) for axis in range(3)]
    assert scales == pytest.approx([2.8, -1.8, -0.2], abs=0.15)


def written(path: Path, readings: Reals, unit: str = "_dps") -> Path:
    columns = [np.arange(len(readings)) / RATE_HZ, *readings.T]
    header = f"time_s,gx{unit},gy{unit},gz{unit}"
    np.savetxt(path, np.column_stack(columns), fmt="%.9g", delimiter=",", header=header, comments="")
    return path


def test_the_bias_of_another_log_is_its_mean_in_the_unit_of_this_one(tmp_path: Path) -> None:
    still = GYROSCOPE.reading(rest(20.0), np.random.default_rng(2))
    path = written(tmp_path / "rest.csv", still)
    assert rest_bias(path, RateUnit.RAD_S) == pytest.approx(np.radians(still.mean(axis=0)), rel=1e-6)
    with pytest.raises(ConfigError, match=r"rest.csv is in deg/s and the log in counts: both must be in counts"):
        rest_bias(path, RateUnit.COUNTS)
    assert rest_bias(written(tmp_path / "c.csv", still, ""), RateUnit.COUNTS) == pytest.approx(still.mean(axis=0))
    still[1000:1100, 1] += 3.0
    with pytest.raises(CalibrationError, match=r"rest.csv: it moved (9.9|10.0) s after the first row: gy_dps"):
        rest_bias(written(tmp_path / "rest.csv", still), RateUnit.DPS)


def test_the_command_writes_scale_and_bias(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    random = np.random.default_rng(3)
    spin = written(tmp_path / "spin.csv", GYROSCOPE.reading(turntable(20.0, np.eye(3)[2])[800:-800], random))
    still = written(tmp_path / "rest.csv", GYROSCOPE.reading(rest(20.0), random))
    header = tmp_path / "gyroscope.h"
    options = ["--rate-rpm", "33.333", "--bias-from", str(still), "--export-header", str(header)]
    assert run("fit", "imu", str(spin), *options) == 0
    output = capsys.readouterr().out
    assert "no accelerometer in the log" in output
    assert "scale of z: 0.985" in output
    assert "gyroscope_scale_z = 9.85" in header.read_text()
    assert "accelerometer_gain" not in header.read_text()
    assert run("fit", "imu", str(spin), *options[:4], "--json") == 0
    (rate,) = json.loads(capsys.readouterr().out)["gyroscope"]["rates"]
    assert rate["scale"] == pytest.approx(1.0 / float(np.linalg.norm(GYROSCOPE.response[:, 2])), rel=5e-4)
    assert run("fit", "imu", str(still), "--rate-rpm", "33.333") == 1
    assert "no steady revolution" in capsys.readouterr().out
    assert run("fit", "imu", str(spin)) == 4  # without a rate it is a log of both sensors
    assert "cannot tell which columns are the accelerometer" in capsys.readouterr().err
