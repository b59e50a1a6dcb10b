"""What is found in a log of an IMU, what it is worth, and what is refused."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hiltest.calibration.acceptance import Acceptance
from hiltest.calibration.quality import sphere_directions
from hiltest.calibration.still_pose import Face
from hiltest.log_fitting import AccelerationUnit, ImuLog, RateUnit, found_intervals, read_imu_log
from hiltest.log_fitting.imu_fit import ImuLogFit, fit_imu_log, imu_fit_document, print_fit

from .recording import (
    ACCELEROMETER,
    FACES,
    GYROSCOPE,
    RATE_HZ,
    Reals,
    Recording,
    Sensor,
    many_poses,
    six_faces_and_turns,
)

G, DPS = (AccelerationUnit.G, RateUnit.DPS)
COUNTS = (AccelerationUnit.COUNTS, RateUnit.COUNTS)


def log_of(acceleration: Reals, rate: Reals | None, units: tuple[AccelerationUnit, RateUnit] = (G, DPS)) -> ImuLog:
    return ImuLog(("made up",), np.arange(len(acceleration)) / RATE_HZ, acceleration, rate, *units)


def test_an_accelerometer_alone_with_two_late_rests_is_refused_without_warnings() -> None:
    """Warnings are errors in these tests."""
    acceleration = np.random.default_rng(1).normal(0.0, 5.0, (1500, 3))
    for first, up in ((300, (0.0, 0.0, 9.8)), (900, (9.8, 0.0, 0.0))):
        acceleration[first : first + 300] = np.random.default_rng(2).normal(0.0, 0.01, (300, 3)) + up
    log = log_of(acceleration, None, (AccelerationUnit.MS2, RateUnit.DPS))
    fit = fit_imu_log(log, found_intervals(log))
    assert (len(fit.intervals.rests), fit.accelerometer.verdict) == (2, Acceptance.REFUSED)


def fitted(
    recording: Recording,
    accelerometer: Sensor = ACCELEROMETER,
    gyroscope: Sensor = GYROSCOPE,
    units: tuple[AccelerationUnit, RateUnit] = (G, DPS),
    **options: float,
) -> ImuLogFit:
    log = log_of(*recording.readings(accelerometer, gyroscope), units)
    return fit_imu_log(log, found_intervals(log), **options)


def errors(fit: ImuLogFit, accelerometer: Sensor = ACCELEROMETER, gyroscope: Sensor = GYROSCOPE) -> tuple[float, float]:
    """Return the largest element by which each calibration, behind its sensor, differs from the identity."""
    assert fit.accelerometer.fit is not None, fit.accelerometer.refused
    assert fit.gyroscope is not None
    assert fit.gyroscope.fit is not None, fit.gyroscope.refused
    remainder = (fit.accelerometer.fit.gain @ accelerometer.response, fit.gyroscope.fit.matrix @ gyroscope.response)
    return tuple(float(np.abs(item - np.eye(3)).max()) for item in remainder)  # type: ignore[return-value]


def test_rests_are_found_where_they_are() -> None:
    recording = Recording().rest(3.0).lay([0, 1, 0], 1.5).rest(4.0).turn(360.0, 6.0).rest(2.0)
    log = log_of(*recording.readings())
    rests = found_intervals(log).rests
    expected = [(0, 300), (450, 850), (1450, 1650)]
    # A move begins and ends slowly: up to a third of a second of it is not told from noise.
    assert [(rest.start, rest.end) for rest in rests] == [
        (pytest.approx(start, abs=35), pytest.approx(end, abs=35)) for start, end in expected
    ]


def test_six_faces_and_three_turns_calibrate_both_sensors() -> None:
    fit = fitted(six_faces_and_turns())
    assert fit.accelerometer.method == "six-position"
    assert len(fit.accelerometer.faces) == 6
    accelerometer_error, gyroscope_error = errors(fit)
    # Noise of 1.5 mg over 300 samples and six faces is 0.06 mg; a rest that holds 0.3 s of a slow start, 1 mg.
    assert accelerometer_error < 0.001
    assert np.abs(fit.accelerometer.fit.offset - ACCELEROMETER.bias).max() < 0.001  # type: ignore[union-attr]
    # 0.05 deg/s over 5 s of samples: 0.01 degrees of 360, and 0.003 deg/s of the bias beside it: 0.015 degrees.
    assert gyroscope_error < 0.001
    assert fit.gyroscope is not None
    assert np.abs(fit.gyroscope.bias - GYROSCOPE.bias).max() < 0.02
    assert [turn.turned_deg for turn in fit.gyroscope.turns] == [360.0, 360.0, 360.0, -360.0]
    assert max(turn.left_deg for turn in fit.gyroscope.turns) < 0.2
    assert fit.complete


def test_rows_of_one_sensor_each_calibrate_as_well(tmp_path: Path) -> None:
    """As `hiltest log` writes both: every sample of the gyroscope, the accelerometer's in bursts with pauses."""
    acceleration, rate = six_faces_and_turns().readings()
    lines = ["time_s,gyr_x_dps,gyr_y_dps,gyr_z_dps,acc_x_g,acc_y_g,acc_z_g"]
    for k, (felt, turned) in enumerate(zip(acceleration.tolist(), rate.tolist(), strict=True)):
        if k % 8 < 5:
            lines.append(f"{k / RATE_HZ:.6f},,,,{felt[0]:.9g},{felt[1]:.9g},{felt[2]:.9g}")
        lines.append(f"{k / RATE_HZ + 0.002:.6f},{turned[0]:.9g},{turned[1]:.9g},{turned[2]:.9g},,,")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    log = read_imu_log(path)
    fit = fit_imu_log(log, found_intervals(log))
    assert max(errors(fit)) < 0.001  # as with both in a row
    assert fit.complete


def test_without_noise_it_is_exact() -> None:
    """What is left is the beginning of a move that looks like rest: none is within a bit of it."""
    recording = six_faces_and_turns()
    accelerometer, gyroscope = replace(ACCELEROMETER, noise=0.0), replace(GYROSCOPE, noise=0.0)
    fit = fitted(recording, accelerometer, gyroscope)
    assert max(errors(fit, accelerometer, gyroscope)) < 1e-9
    assert fit.accelerometer.spread_after_percent < 1e-9
    assert fit.accelerometer.spread_before_percent > 1.0


def test_counts_about_any_zero_calibrate_as_well() -> None:
    """As a converter gives them: the zero in the middle of 16 bits, scales that nobody says."""
    accelerometer = Sensor(4100.0 * ACCELEROMETER.response, 32768.0 + 300.0 * ACCELEROMETER.bias, 6.0)
    gyroscope = Sensor(16.0 * GYROSCOPE.response, 32768.0 + GYROSCOPE.bias, 0.8)
    fit = fitted(six_faces_and_turns(), accelerometer, gyroscope, COUNTS)
    assert max(errors(fit, accelerometer, gyroscope)) < 0.001


def test_what_counts_were_turned_by_is_said() -> None:
    recording = Recording()
    for face in FACES:
        recording.lay(face).rest().turn(720.0, 8.0).rest()
    gyroscope = Sensor(16.0 * GYROSCOPE.response, GYROSCOPE.bias, 0.8)
    units = (G, RateUnit.COUNTS)
    right, wrong = (fitted(recording, ACCELEROMETER, gyroscope, units, turn_deg=item) for item in (720.0, 360.0))
    assert errors(right, ACCELEROMETER, gyroscope)[1] < 0.001
    assert errors(wrong, ACCELEROMETER, gyroscope)[1] == pytest.approx(0.5, abs=0.01)
    # In degrees a second it tells by itself how many turns it were.
    assert errors(fitted(recording))[1] < 0.001


def test_many_poses_leave_the_norm_of_gravity_and_not_its_axes() -> None:
    symmetric = (ACCELEROMETER.response + ACCELEROMETER.response.T) / 2.0
    accelerometer = replace(ACCELEROMETER, response=symmetric)
    fit = fitted(many_poses(), accelerometer)
    assert fit.accelerometer.method == "ellipsoid"
    assert fit.accelerometer.rests == 24
    assert fit.accelerometer.spread_after_percent < 0.05 < 1.0 < fit.accelerometer.spread_before_percent
    assert fit.accelerometer.fit is not None
    assert np.abs(fit.accelerometer.fit.gain @ symmetric - np.eye(3)).max() < 0.002
    # Nothing was turned about the vertical.
    assert fit.gyroscope is not None
    assert fit.gyroscope.fit is None
    assert "fewer than three" in fit.gyroscope.refused
    assert np.abs(fit.gyroscope.bias - GYROSCOPE.bias).max() < 0.02
    assert not fit.complete


@pytest.mark.parametrize("axis", range(3))
def test_a_wrong_scale_of_one_axis_is_seen_in_that_axis(axis: int) -> None:
    """Both sensors read 4 % more on one axis than the truth that they are judged by: each must show it there alone."""
    off = np.eye(3)
    off[axis, axis] = 1.04
    wrong = [replace(item, response=off @ item.response) for item in (ACCELEROMETER, GYROSCOPE)]
    fit = fitted(six_faces_and_turns(), *wrong)
    assert fit.accelerometer.fit is not None
    assert fit.gyroscope is not None
    assert fit.gyroscope.fit is not None
    for result, sensor in ((fit.accelerometer.fit.gain, ACCELEROMETER), (fit.gyroscope.fit.matrix, GYROSCOPE)):
        remainder = result @ off @ sensor.response
        assert np.abs(remainder - np.eye(3)).max() < 0.001
        assert np.abs(result @ sensor.response - np.eye(3)).max() == pytest.approx(1.0 - 1.0 / 1.04, abs=0.002)


def test_missing_faces_are_named() -> None:
    recording = Recording()
    for face in (*FACES[:3], *FACES[4:]):
        recording.lay(face).rest()
    log = log_of(*recording.readings())
    fit = fit_imu_log(log, found_intervals(log), "six-position")
    assert fit.accelerometer.refused == "no rest on -y: lay the board down on all six faces, or use --method ellipsoid"
    assert Face.MINUS_Y not in fit.accelerometer.faces
    assert fit.gyroscope is not None
    assert fit.gyroscope.fit is None
    assert "without an accelerometer" in fit.gyroscope.refused
    assert "fewer than 9 rests" in fit_imu_log(log, found_intervals(log), "ellipsoid").accelerometer.refused
    # Between the faces gravity was seen from more sides.
    moving = fit_imu_log(log, found_intervals(log)).accelerometer
    assert (moving.method, moving.rests, moving.verdict) == ("moving", 5, Acceptance.FAIR)
    assert Face.MINUS_Y not in moving.faces


def test_turns_that_are_none_are_refused_with_the_reason() -> None:
    recording = six_faces_and_turns().turn(270.0).rest().turn(360.0, about=np.array([1.0, 0.0, 0.0])).rest()
    turns = fitted(recording).gyroscope.turns  # type: ignore[union-attr]
    assert [turn.refused for turn in turns] == [
        "",
        "",
        "",
        "",
        "0.76 of a turn of 360 degrees",
        "not about the vertical",  # its scale is 1.5 % too large
    ]


def test_turns_in_one_plane_do_not_determine_a_matrix() -> None:
    recording = Recording()
    for face in FACES:
        recording.lay(face).rest()
    for face in ([1, 0, 0], [0, 1, 0], [-1, 0, 0]):
        recording.lay(face).rest().turn(360.0).rest()
    fit = fitted(recording)
    assert fit.gyroscope is not None
    assert fit.gyroscope.fit is None
    assert "one plane" in fit.gyroscope.refused


def test_a_slow_even_turn_is_no_rest() -> None:
    """Its readings hardly scatter; its rate is not that of the rests."""
    recording = Recording().rest(5.0).turn(72.0, 8.0).rest(5.0)
    recording.rate[1] = np.tile([9.0, 0.0, 0.0], (800, 1))
    rests = found_intervals(log_of(*recording.readings())).rests
    assert [(rest.start, rest.end) for rest in rests] == [(0, 500), (1300, 1800)]


def tumbled(seed: int = 3) -> Recording:
    """Turned over twenty times, and never left alone."""
    recording = Recording()
    for up in np.random.default_rng(seed).normal(size=(20, 3)):
        recording.lay(up, 1.0)
    return recording


SYMMETRIC = replace(ACCELEROMETER, response=(ACCELEROMETER.response + ACCELEROMETER.response.T) / 2.0)


def test_a_log_that_never_rests_has_no_rest() -> None:
    log = log_of(*tumbled().readings())
    for method in ("six-position", "ellipsoid"):
        fit = fit_imu_log(log, found_intervals(log), method)
        assert fit.intervals.rests == ()
        assert fit.accelerometer.refused == "no rest of one second was detected"
        assert (fit.verdict, fit.accelerometer.verdict) == (Acceptance.REFUSED, Acceptance.REFUSED)
        assert fit.gyroscope is None
    in_counts = log_of(*(1000.0 * reading for reading in tumbled().readings()), COUNTS)
    assert found_intervals(in_counts).rests == ()


@pytest.mark.parametrize("scale", [1.0, 4100.0])
def test_readings_in_motion_are_fitted_by_their_norm_whatever_jerks_and_dropouts_there_are(scale: float) -> None:
    random = np.random.default_rng(8)
    acceleration, _ = tumbled().readings(replace(SYMMETRIC, noise=0.01))
    # A blow and a stuck output every second, and some rows that are nothing: 8 % in all.
    for first in range(50, len(acceleration), 100):
        acceleration[first : first + 4] += random.normal(0.0, 1.5, (4, 3))
        acceleration[first + 20 : first + 23] = 0.0
    acceleration[::100] = random.uniform(-8.0, 8.0, acceleration[::100].shape)
    log = log_of(scale * acceleration, None, (G, DPS) if scale == 1.0 else COUNTS)
    accelerometer = fit_imu_log(log, found_intervals(log)).accelerometer
    assert (accelerometer.method, accelerometer.rests) == ("moving", 0)
    assert accelerometer.fit is not None, accelerometer.refused
    assert accelerometer.left_out == pytest.approx(0.08 * len(acceleration), abs=0.02 * len(acceleration))
    # 10 mg of motion over 1840 readings of nine unknowns: 0.7 mg, and as much again for the sides that were not seen.
    assert np.abs(scale * accelerometer.fit.gain @ SYMMETRIC.response - np.eye(3)).max() < 0.003
    assert np.abs(accelerometer.fit.offset / scale - SYMMETRIC.bias).max() < 0.003
    assert accelerometer.direction_error_deg is not None
    assert 0.01 < accelerometer.direction_error_deg < 0.25
    assert (accelerometer.verdict, [reason.figure for reason in accelerometer.reasons]) == (
        Acceptance.FAIR,
        ["spread_after_percent"],
    )


def test_a_log_of_shocks_is_poor_and_one_from_one_side_is_refused() -> None:
    random = np.random.default_rng(9)
    acceleration, _ = tumbled().readings(SYMMETRIC)
    shaken = log_of(acceleration + random.normal(0.0, 0.1, acceleration.shape), None)
    accelerometer = fit_imu_log(shaken, found_intervals(shaken)).accelerometer
    assert accelerometer.verdict is Acceptance.POOR
    assert "spread_after_percent" in [reason.figure for reason in accelerometer.reasons]
    half = log_of(acceleration[acceleration[:, 2] > 0.8], None)
    accelerometer = fit_imu_log(half, found_intervals(half), "moving").accelerometer
    assert (accelerometer.verdict, accelerometer.fit) == (Acceptance.REFUSED, None)
    assert "side" in accelerometer.refused or "sphere" in accelerometer.refused


def test_a_predicted_error_beyond_the_prediction_s_validity_is_stated_by_its_bound() -> None:
    """As by `hiltest fit`: linear propagation predicts 63 deg."""
    acceleration, _ = tumbled().readings(SYMMETRIC)
    acceleration = acceleration[acceleration[:, 2] > -0.2]
    acceleration[len(acceleration) // 2 :, 0] += 0.8
    log = log_of(acceleration, None)
    fit = fit_imu_log(log, found_intervals(log), "moving")
    (value,) = (reason.value for reason in fit.accelerometer.reasons if reason.figure == "direction_error_deg")
    assert value == 30.0
    printed = io.StringIO()
    print_fit(fit, Console(file=printed))
    assert "direction error > 30 deg is above 5 deg (refused)" in printed.getvalue()


def test_faces_that_a_hand_laid_askew_are_measured_and_spoil_no_offset() -> None:
    random = np.random.default_rng(4)
    recording = Recording()
    for face in FACES:
        slope = np.radians(1.0) * random.standard_normal(3) * (1.0 - np.abs(face))
        recording.lay(face + slope).rest()
    accelerometer = fitted(recording).accelerometer
    assert accelerometer.method == "six-position"
    assert accelerometer.fit is not None
    # 1.5 mg over 300 samples are 0.09 mg, and what part and faces are askew by leaves 0.1; least squares leave 6.
    assert np.abs(accelerometer.fit.offset - ACCELEROMETER.bias).max() < 0.0005
    assert accelerometer.faces_askew_deg == pytest.approx(1.0, abs=0.6)  # from six angles
    assert (accelerometer.verdict, [reason.figure for reason in accelerometer.reasons]) == (
        Acceptance.FAIR,
        ["direction_error_deg"],
    )


@pytest.mark.parametrize(("scale", "percent"), [(0.5, 0.5), (4.0, 2.0)])
def test_cross_axis_elements_beyond_the_prior_are_estimated_and_stated(scale: float, percent: float) -> None:
    """The recording's part has .51 % rms of them; four times these are 2 %, and half of them are within the prior."""
    random = np.random.default_rng(4)
    recording = Recording()
    for face in FACES:
        recording.lay(face + np.radians(0.3) * random.standard_normal(3) * (1.0 - np.abs(face))).rest()
    part = ACCELEROMETER.response
    off = part - np.diag(np.diag(part))
    fit = fitted(recording, replace(ACCELEROMETER, response=part + (scale - 1.0) * off))
    # Six elements, of which a hand of .3 degrees moves each by .37 %.
    assert fit.accelerometer.cross_axis_percent == pytest.approx(percent, rel=0.25)
    document = imu_fit_document(fit).accelerometer
    assert document["cross_axis_percent"] == fit.accelerometer.cross_axis_percent
    # At most sqrt(2) times the deviation of an element by the faces, sigma / sqrt(2), and by the prior.
    askew_deg, error_deg = fit.accelerometer.faces_askew_deg, fit.accelerometer.direction_error_deg
    assert askew_deg is not None
    assert error_deg is not None
    assert error_deg < askew_deg
    assert (error_deg > 0.9 * askew_deg) == (scale > 1.0)


def test_an_ellipsoid_from_six_faces_says_what_it_needs() -> None:
    log = log_of(*six_faces_and_turns().readings())
    accelerometer = fit_imu_log(log, found_intervals(log), "ellipsoid").accelerometer
    assert accelerometer.fit is None
    assert "nine unknowns" in accelerometer.refused
    assert "on edges and corners too, in at least 9 poses, or use --method six-position" in accelerometer.refused


def test_what_the_page_tells_to_do_is_good_and_three_turns_are_fair() -> None:
    assert fitted(six_faces_and_turns()).verdict is Acceptance.GOOD
    recording = Recording()
    for face in FACES:
        recording.lay(face).rest()
    for face in FACES[::2]:
        recording.lay(face).rest().turn(360.0).rest()
    fit = fitted(recording)
    assert (fit.accelerometer.verdict, fit.verdict) == (Acceptance.GOOD, Acceptance.FAIR)
    assert fit.gyroscope is not None
    assert [(reason.figure, reason.value) for reason in fit.gyroscope.reasons] == [("turns", 3.0)]


def test_turns_that_contradict_each_other_are_poor() -> None:
    fit = fitted(six_faces_and_turns().turn(350.0).rest())
    assert fit.gyroscope is not None
    assert fit.gyroscope.verdict is Acceptance.POOR
    assert [reason.figure for reason in fit.gyroscope.reasons] == ["left_percent"]


@pytest.mark.parametrize(("count", "verdict"), [(10, Acceptance.FAIR), (14, Acceptance.FAIR), (24, Acceptance.GOOD)])
def test_poses_are_rated_by_how_many_are_left_over(count: int, verdict: Acceptance) -> None:
    recording = Recording()
    for up in sphere_directions(count):
        recording.lay(up).rest(2.0)
    accelerometer = fitted(recording, SYMMETRIC).accelerometer
    assert (accelerometer.method, accelerometer.rests, accelerometer.verdict) == ("ellipsoid", count, verdict), (
        accelerometer.reasons
    )


def test_samples_that_are_missing_in_a_turn_refuse_it() -> None:
    recording = six_faces_and_turns()
    log = log_of(*recording.readings())
    whole = fit_imu_log(log, found_intervals(log)).gyroscope
    assert whole is not None
    middle = round(RATE_HZ * (whole.turns[0].start_s + whole.turns[0].end_s) / 2.0)
    stored = np.r_[0:middle, middle + 50 : len(log.time_s)]
    cut = replace(log, time_s=log.time_s[stored], acceleration=log.acceleration[stored], rate=log.rate[stored])  # type: ignore[index]
    turns = fit_imu_log(cut, found_intervals(cut)).gyroscope.turns  # type: ignore[union-attr]
    assert [turn.refused for turn in turns] == ["samples are missing in it", "", "", ""]
