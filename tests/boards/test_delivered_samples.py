"""Answers of the firmware follow from the samples that the sensors delivered, or the difference is named."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hiltest.boards.delivered_samples import DeliveredSamples, Samples
from hiltest.errors import FirmwareContradictionError
from hiltest.link.fusion import FusionRead, FusionRecords, FusionRun, FusionStart, FusionSummary, UpdateCosts
from hiltest.link.gyroscope import (
    IntegrateGyroscope,
    IntegrateGyroscopeReply,
    LogGyroscope,
    LogGyroscopeReply,
    SetGyroscope,
    Span,
)
from hiltest.link.messages import Average, ClearPoints, Collect, Points, Read, SetCalibration, Upload
from hiltest.link.replies import AverageReply, CollectReply, PointsReply, ReadReply, SensorInfo, SensorKind, Statistic
from hiltest.orientation.attitude_filter import AttitudeFilter
from hiltest.orientation.triad import triad

MAGNETOMETER, ACCELEROMETER, GYROSCOPE = (
    SensorInfo(number, kind, 1, 0x10 + number, 0xC4, 0xC4, True, True, kind.name.lower())
    for number, kind in enumerate(SensorKind)
)
BEGIN_S, PERIOD_S, TEMPERATURE_DEGC = 1.0, 0.005, -7

counts = st.integers(2, 40).flatmap(lambda n: arrays(np.int64, (n, 3), elements=st.integers(-32_767, 32_767)))


def series(words: np.ndarray, *, first_s: float = BEGIN_S + 0.001) -> Samples:
    """Return samples that were taken one period apart, and read 0.3 ms later."""
    instants_s = first_s + PERIOD_S * np.arange(len(words))
    return Samples(np.asarray(words, np.int64), np.arange(len(words)), instants_s, instants_s + 3e-4, PERIOD_S)


class Firmware:
    """Checks of firmware to whose sensors the given samples belong."""

    def __init__(self, **samples: Samples) -> None:
        self.samples = samples
        self.checks = DeliveredSamples(
            [MAGNETOMETER, ACCELEROMETER, GYROSCOPE],
            lambda sensor: self.samples[sensor.kind.name.lower()],
            lambda _sensor: TEMPERATURE_DEGC & 0xFF,
            lambda board_us: 1e-6 * board_us,
        )

    def answer(self, request, reply) -> None:
        self.checks.begin(request.code, BEGIN_S)
        self.checks.check(request, reply)

    def refusal(self, request, reply) -> str:
        with pytest.raises(FirmwareContradictionError) as refused:
            self.answer(request, reply)
        return str(refused.value)


def statistic(words: np.ndarray) -> Statistic:
    """Return mean and spread as float32 gives them."""
    mean = (words.sum(axis=0).astype(np.float32) / np.float32(len(words))).astype(np.float64)
    return Statistic(mean, np.std(words, axis=0, ddof=1) if len(words) > 1 else None)


def average(magnetometer: np.ndarray, accelerometer: np.ndarray) -> AverageReply:
    return AverageReply(len(magnetometer), statistic(magnetometer), statistic(accelerometer), 0, {})


SAMPLES = np.random.default_rng(5).integers(-400, 400, (17, 3)) + np.array([100, -250, 431])
QUIET = np.tile([3, -5, 8192], (17, 1)) + np.arange(17)[:, None]


@given(counts)
def test_a_mean_in_float32_of_the_latest_samples_follows_from_them(words: np.ndarray) -> None:
    firmware = Firmware(magnetometer=series(words), accelerometer=series(words))
    firmware.answer(Average(len(words)), average(words, words))
    firmware.answer(Average(len(words) - 1), average(words[1:], words[1:]))


@given(counts, st.integers(0, 2), st.sampled_from([-1, 1]))
def test_a_mean_that_is_off_by_half_a_count_names_the_axis_and_the_difference(
    words: np.ndarray, axis: int, sign: int
) -> None:
    firmware = Firmware(magnetometer=series(words), accelerometer=series(words))
    reply = average(words, words)
    reply.magnetometer.mean[axis] += 0.5 * sign
    refusal = firmware.refusal(Average(len(words)), reply)
    named = re.search(r"\((.): ([\d.]+) counts (more|less)\)", refusal)
    if named is None:  # such a mean may be another axis'
        assert "in place of (x, y, z)" in refusal
        return
    assert named[1] == "xyz"[axis]
    assert float(named[2]) == pytest.approx(0.5, abs=0.01)  # less the rounding of float32
    assert named[3] == ("more" if sign > 0 else "less")


@pytest.mark.parametrize("axes", list(permutations(range(3))))
@pytest.mark.parametrize("signs", list(product((1, -1), repeat=3)))
def test_exchanged_axes_are_named(axes: tuple[int, ...], signs: tuple[int, ...]) -> None:
    firmware = Firmware(magnetometer=series(SAMPLES), accelerometer=series(QUIET))
    turned = SAMPLES[:, axes] * signs
    request, reply = Average(17), average(turned, QUIET)
    if axes == (0, 1, 2) and min(signs) == 1:
        firmware.answer(request, reply)
        return
    names = ", ".join("-" * (sign < 0) + "xyz"[axis] for axis, sign in zip(axes, signs, strict=True))
    assert f"has ({names}) in place of (x, y, z)" in firmware.refusal(request, reply)


def test_a_sample_from_before_the_request_is_named() -> None:
    early = series(SAMPLES, first_s=BEGIN_S - 0.004)
    firmware = Firmware(magnetometer=early, accelerometer=series(QUIET))
    assert "includes a sample that the part took 4.0 ms before the request" in firmware.refusal(
        Average(16), average(SAMPLES[:16], QUIET[:16])
    )


def test_a_sample_that_is_counted_twice_is_named() -> None:
    twice = series(np.repeat(SAMPLES, 2, axis=0))
    firmware = Firmware(
        magnetometer=twice._replace(number=np.repeat(np.arange(17), 2)),
        accelerometer=series(np.repeat(QUIET, 2, axis=0)),
    )
    words = np.repeat(SAMPLES, 2, axis=0)[-16:]
    assert "counts a sample more than once" in firmware.refusal(Average(16), average(words, QUIET[:16]))


def test_more_samples_than_were_delivered_are_named() -> None:
    firmware = Firmware(magnetometer=series(SAMPLES[:12]), accelerometer=series(QUIET))
    assert "the sensor delivered 12 samples" in firmware.refusal(Average(16), average(SAMPLES[:16], QUIET[:16]))


def test_a_spread_of_other_samples_is_named() -> None:
    firmware = Firmware(magnetometer=series(SAMPLES), accelerometer=series(QUIET))
    reply = average(SAMPLES, QUIET)
    filtered = replace(reply, magnetometer=Statistic(reply.magnetometer.mean, 0.5 * reply.magnetometer.spread))
    assert "spread of 17 magnetometer samples is not that" in firmware.refusal(Average(17), filtered)


def read(words: np.ndarray, times_s: np.ndarray, degc: int = TEMPERATURE_DEGC) -> ReadReply:
    return ReadReply(np.rint(1e6 * times_s).astype(np.int64), words.astype(np.int16), 0, degc)


def test_samples_and_their_times_are_those_that_were_read() -> None:
    delivered = series(SAMPLES)
    firmware, request = Firmware(magnetometer=delivered), Read(0, 8)
    firmware.answer(request, read(SAMPLES[-8:], delivered.time_s[-8:]))
    for words, times_s, fault in [
        (SAMPLES[-8:], delivered.time_s[-8:] - 0.003, r"sample 0 is 2.70 ms before the part took it"),
        (SAMPLES[-8:], delivered.time_s[-8:] + 0.003, r"sample 0 is 3.00 ms after it was read"),
        (SAMPLES[-8:][::-1], delivered.time_s[-8:], "are in reverse order"),
        (SAMPLES[[9, 11, 10, 12, 13, 14, 15, 16]], delivered.time_s[-8:], "in another order"),
        (SAMPLES[-8:] + np.array([0, 0, 2]), delivered.time_s[-8:], "(sample 0, z: 2 counts more)"),
        (SAMPLES[-8:][:, [1, 0, 2]], delivered.time_s[-8:], "(y, x, z) in place of (x, y, z)"),
    ]:
        assert fault in firmware.refusal(request, read(words, times_s))
    assert "answers 25 degC, and magnetometer delivered -7" in firmware.refusal(
        request, read(SAMPLES[-8:], delivered.time_s[-8:], 25)
    )


TURN = np.random.default_rng(6).integers(-3000, 3000, (60, 3))


def turn(words: np.ndarray, delivered: Samples, **changes) -> IntegrateGyroscopeReply:
    span = Span(float(delivered.instant_s[0]), float(delivered.instant_s[-1]), False)
    reply = IntegrateGyroscopeReply(
        len(words),
        words.sum(axis=0),
        words[:20].sum(axis=0),
        words[-20:].sum(axis=0),
        words.min(axis=0).astype(np.int16),
        words.max(axis=0).astype(np.int16),
        TEMPERATURE_DEGC,
        span,
    )
    return replace(reply, **changes)


def test_sums_of_a_turn_are_exact_and_in_order() -> None:
    delivered = series(TURN)
    firmware, request = Firmware(gyroscope=delivered), IntegrateGyroscope(60)
    firmware.answer(request, turn(TURN, delivered))
    bursts = TURN.reshape(6, 10, 3)[:, ::-1].reshape(60, 3)
    halves = TURN.reshape(2, 30, 3)[:, ::-1].reshape(60, 3)
    firmware.answer(request, turn(bursts, delivered))  # the sums of 20 hide the order within bursts of 10
    assert "sum of the first 20 of 60 gyroscope samples" in firmware.refusal(request, turn(halves, delivered))
    assert "(z: 1 counts more)" in firmware.refusal(
        request, turn(TURN, delivered, total=TURN.sum(axis=0) + np.array([0, 0, 1]))
    )
    late = Span(float(delivered.instant_s[0]) + 0.003, float(delivered.instant_s[-1]), False)
    assert "the first gyroscope sample is 3.00 ms after" in firmware.refusal(request, turn(TURN, delivered, span=late))
    firmware.samples["gyroscope"] = delivered._replace(number=delivered.number + (delivered.number > 30))
    assert "does not report that gyroscope samples are missing after sample 30" in firmware.refusal(
        request, turn(TURN, delivered)
    )


def test_a_log_goes_on_with_samples_from_before_its_request() -> None:
    delivered = series(TURN, first_s=BEGIN_S - 0.1)
    span = Span(0.0, float(delivered.instant_s[-1]), False)
    firmware = Firmware(gyroscope=delivered)
    firmware.answer(LogGyroscope(60, go_on=True), LogGyroscopeReply(TURN.astype(np.int16), TEMPERATURE_DEGC, span))
    bursts = TURN.reshape(6, 10, 3)[:, ::-1].reshape(60, 3).astype(np.int16)
    assert "another order" in firmware.refusal(
        LogGyroscope(60, go_on=True), LogGyroscopeReply(bursts, TEMPERATURE_DEGC, span)
    )


def points_between(words: np.ndarray, gravity: np.ndarray) -> tuple[Firmware, np.ndarray]:
    """Collect points, each halfway between two samples of the accelerometer; return the pairs."""
    firmware = Firmware(
        magnetometer=series(words, first_s=BEGIN_S + 1.5 * PERIOD_S), accelerometer=series(gravity, first_s=BEGIN_S)
    )
    firmware.answer(ClearPoints(), None)
    edges = np.zeros(3, np.int16)
    firmware.answer(Collect(len(words)), CollectReply(len(words), edges, edges, 0))
    halfway = (gravity[1 : 1 + len(words)] + gravity[2 : 2 + len(words)]) // 2
    return firmware, np.hstack([words, halfway])


def points(firmware: Firmware, rows: np.ndarray, first: int = 0) -> None:
    firmware.answer(Points(first, len(rows)), PointsReply(rows[:, :3], rows[:, 3:]))


def test_points_are_samples_with_the_acceleration_between_two_others() -> None:
    gravity = np.cumsum(np.full((20, 3), 40), axis=0)
    for change, fault in [
        ([0, 0, 0, 0, 0, 0], ""),
        ([0, 0, 3, 0, 0, 0], "point 0 is not the next sample that magnetometer delivered"),
        ([0, 0, 0, 20, 0, 0], "acceleration of point 0 is not the line"),
        ([0, 0, 0, 0, -20, 0], "acceleration of point 0 is not the line"),
    ]:
        firmware, rows = points_between(SAMPLES, gravity)
        if not fault:
            points(firmware, rows[8:], first=8)
            points(firmware, rows[8:], first=8)
            with pytest.raises(FirmwareContradictionError, match="point 8 has changed since it was read"):
                points(firmware, rows[8:] + 1, first=8)
            continue
        with pytest.raises(FirmwareContradictionError, match=fault):
            points(firmware, rows + change)


def test_points_from_the_host_and_of_an_unknown_buffer_are_not_checked() -> None:
    firmware, rows = points_between(SAMPLES, np.cumsum(np.full((20, 3), 40), axis=0))
    firmware.answer(Upload(17, [[1, 2, 3]]), 18)
    points(firmware, np.vstack([rows, [1, 2, 3, 0, 0, 0]]))
    firmware.checks.begin(Collect.code, BEGIN_S)  # an error reply tells no number of points
    points(firmware, rows + 100)


BIAS, UNIT_FIELD = np.array([3.0, -5.0, 8.0]), np.eye(3) / 485.0
START = FusionStart(2, 2, 4)
RATES = series(TURN // 10)
FIELDS = series(np.random.default_rng(8).integers(-4, 4, (57, 3)) + np.array([230, 10, 430]), first_s=BEGIN_S + 0.0023)
GRAVITIES = series(
    np.random.default_rng(9).integers(-9, 9, (57, 3)) + np.array([90, -50, 8192]), first_s=BEGIN_S + 0.003
)


def filtered(rates: Samples, fields: Samples, late_s: float, rest_s: float) -> FusionRecords:
    """Run the filter as PROTOCOL.md describes it: 0.25 ms before each transfer is its look."""
    fused, alone = AttitudeFilter(np.zeros(3)), AttitudeFilter(np.zeros(3))
    for attitude_filter in (fused, alone):
        attitude_filter.turn(np.zeros(3), rest_s)
        attitude_filter.correct(
            GRAVITIES.counts[-4:].mean(axis=0) / 8192.0, UNIT_FIELD @ FIELDS.counts[-4:].mean(axis=0)
        )
    at_s, rate_rad_s, records = BEGIN_S, None, []
    events = [(time_s, 0, number) for number, time_s in enumerate(rates.time_s - 0.25e-3)]
    events += [(time_s, 1, number) for number, time_s in enumerate(fields.time_s - 0.25e-3)]
    for time_s, is_field, number in sorted(events):
        before_rad_s = rate_rad_s
        if not is_field:
            rate_rad_s = np.radians((rates.counts[number] - BIAS) / 16.0)
        assert rate_rad_s is not None
        for attitude_filter in (fused, alone):
            mean_rad_s = rate_rad_s if before_rad_s is None else 0.5 * (rate_rad_s + before_rad_s)
            attitude_filter.turn(mean_rad_s, time_s - at_s)
        at_s = time_s
        if is_field:
            vectors = GRAVITIES.counts[number] / 8192.0, UNIT_FIELD @ fields.counts[number]
            fused.correct(*vectors)
            records.append((time_s - BEGIN_S + late_s, fused.attitude, triad(*vectors), alone.attitude))
    times_s, *attitudes = zip(*records[:: START.every], strict=True)
    rounded = (np.rint(32_767 * np.array(rows)) / 32_767 for rows in attitudes)
    return FusionRecords(np.rint(1e6 * np.array(times_s)).astype(np.int64), *rounded)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({}, ""),
        ({"first": 0.002}, r"first attitude does not follow from the samples .* \(0.458 degrees apart\)"),
        ({"steps": 58}, "answers 58 updates, and the sensors' samples make 57"),
        ({"late_s": 0.004}, r"time of magnetometer sample 0 is 3.75 ms after it was read"),
        ({"fields": FIELDS.counts[::-1]}, "attitude of accelerometer and magnetometer does not follow"),
        ({"rates": RATES.counts * [1, -1, 1]}, "attitude of the gyroscope does not follow"),
        ({"rest_s": 0.0}, "attitude of the filter does not follow"),
        ({"left_out": 1}, "answers 1 updates with FIELD_LEFT_OUT, not 0"),
    ],
    ids=["honest", "first attitude", "steps", "times", "fields", "rates", "weight of the first attitude", "left out"],
)
def test_attitudes_of_the_filter_follow_from_samples(change: dict, fault: str) -> None:
    firmware = Firmware(magnetometer=FIELDS, accelerometer=GRAVITIES, gyroscope=RATES)
    firmware.answer(SetCalibration(2, UNIT_FIELD, np.zeros(3)), None)
    firmware.answer(SetGyroscope(np.eye(3) / 16.0, BIAS), None)
    records = filtered(
        RATES._replace(counts=change.get("rates", RATES.counts)),
        FIELDS._replace(counts=change.get("fields", FIELDS.counts)),
        change.get("late_s", 0.0),
        change.get("rest_s", 4 * FIELDS.period_s),
    )
    first = triad(GRAVITIES.counts[-4:].mean(axis=0), FIELDS.counts[-4:].mean(axis=0)) + change.get("first", 0.0)
    costs, left_out = UpdateCosts(change.get("steps", 57), None, None), change.get("left_out", 0)

    def answer() -> None:
        firmware.answer(START, first)
        firmware.answer(FusionRun(1), FusionSummary(round(1e6 * BEGIN_S), 29, 0, left_out, 0, 0, costs))
        firmware.answer(FusionRead(0), records)

    if not fault:
        answer()
        return
    with pytest.raises(FirmwareContradictionError, match=fault):
        answer()
