"""Sensors of a simulated bench: noise, temperature, axes, lost samples, and the gyroscope's bias and samples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.boards.board import NO_REQUEST_COST, Stage
from hiltest.link.fusion import FusionRead, FusionRun, FusionStart
from hiltest.link.gyroscope import (
    EDGE_SAMPLES,
    GetGyroscope,
    GyroscopeRest,
    IntegrateGyroscope,
    LogGyroscope,
    StillnessKind,
)
from hiltest.link.messages import Average, ClearCalibration, Read, Select, SetCalibration
from hiltest.link.replies import DPS_PER_COUNT, G_PER_COUNT, SensorKind
from hiltest.measurement import Limit
from hiltest.orientation.angles import Pose, wrap_180
from hiltest.orientation.quaternions import normalised, pose_of
from hiltest.procedures import Turntable
from hiltest.procedures.rest import noise_counts, rest_gyroscope
from hiltest.rig import COUNTS_PER_UT, Rig
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil

SIGMAS = 4.5  # with a few dozen comparisons per run, one run in 3000 exceeds it
PAIRS = 60
LARGE = 320
LONGEST_US = 6_000_000  # LARGE readings at 80 Hz take 4 s
# A byte at 115200 baud takes 87 us, and a UART without FIFO loses it if interrupts are masked for longer.
MASKED = Limit(max=80.0)
ROUNDING_COUNTS = math.sqrt(1.0 / 12.0)
# The 14 bits arrive in steps of four counts.
ACCELEROMETER_ROUNDING_COUNTS = 4.0 * ROUNDING_COUNTS
WARM_UP_S = 30.0
OFFSET_WORD = 600  # 30 uT for a MAG3110, whose offset word is twice its counts


@pytest.fixture(scope="module")
def stage(board: Board, turntable: Turntable) -> Stage:
    """Simulated table with the resting board."""
    if board.stage is None:
        pytest.skip("the truth of this bench is not known")
    turntable.rest()
    return board.stage


def test_sampling_masks_no_interrupts_for_long(board: Board, measure: Measure) -> None:
    board.session.request(Average(4))
    cost = board.request_cost()
    measure(
        "link.interrupts_masked",
        cost.masked_us if cost else None,
        "us",
        limit=MASKED if cost else None,
        not_offered="" if cost else NO_REQUEST_COST,
    )


@pytest.mark.parametrize("readings", [2, LARGE])
def test_spreads_are_the_noise_of_the_sensors(board: Board, stage: Stage, readings: int) -> None:
    truth = board.truth
    assert truth is not None
    repetitions = PAIRS if readings < LARGE else 1
    replies = [board.session.request(Average(readings, timeout_us=LONGEST_US)) for _ in range(repetitions)]
    for name, sigma, rounding in (
        ("magnetometer", truth.magnetometer_sigma_ut * COUNTS_PER_UT, ROUNDING_COUNTS),
        ("accelerometer", truth.accelerometer_sigma_g / G_PER_COUNT, ACCELEROMETER_ROUNDING_COUNTS),
    ):
        spreads = np.array([getattr(reply, name).spread for reply in replies])
        ratio = math.sqrt((spreads**2).mean()) / math.hypot(sigma, rounding)
        uncertainty = 1.0 / math.sqrt(2.0 * spreads.size * (readings - 1))
        assert abs(ratio - 1.0) < SIGMAS * uncertainty, (
            f"the {name}'s spread over {readings} readings is {ratio:.3f} times the noise of the world"
        )


def test_a_spread_far_from_zero_is_that_at_rest(board: Board, stage: Stage) -> None:
    board.sensor(SensorKind.GYROSCOPE)
    rest = board.session.request(GyroscopeRest(200))
    takes_s = stage.turn_round(5.0 * 360.0, rate_dps=360.0, after_s=0.1)
    board.sleep(1.5)  # until the rate is steady
    turning = board.session.request(GyroscopeRest(400))
    board.sleep(takes_s)
    assert rest.rate.spread is not None
    assert np.abs(turning.rate.mean).max() > 300.0 / DPS_PER_COUNT
    # The sum of squares of thousands of counts has more digits than a float32.
    assert turning.rate.spread is not None, "the spread of a fast turn is not a number"
    ratio = turning.rate.spread / rest.rate.spread
    assert np.abs(ratio - 1.0).max() < 0.5, f"the gyroscope's spread in a fast turn is {ratio} times that at rest"


def test_temperature_is_the_worlds_and_follows_it(board: Board, stage: Stage) -> None:
    answered, true = [], []
    for _ in range(2):
        answered.append(
            [
                board.session.request(Read(sensor.sensor_id, 1)).die_temperature_degc
                for sensor in board.sensors
                if sensor.present
            ]
        )
        true.append(stage.temperature_degc)
        board.sleep(WARM_UP_S)
    assert np.abs(np.array(answered) - np.array(true)[:, None]).max() <= 5.0, f"{answered} beside {true} degC"
    moved = np.diff(np.array(answered, dtype=float), axis=0) - (true[1] - true[0])
    assert np.abs(moved).max() <= 2.0, f"{answered} while the world went from {true[0]:.1f} to {true[1]:.1f} degC"


def test_every_magnetometer_has_the_bodys_axes(board: Board, stage: Stage, rig: Rig) -> None:
    poses = (Pose(0.0, 0.0, 0.0), Pose(90.0, 0.0, 0.0), Pose(0.0, 0.0, 90.0))
    magnetometers = [sensor for sensor in board.sensors if sensor.kind is SensorKind.MAGNETOMETER and sensor.present]
    fields = []
    for pose in poses:
        stage.turn_to(pose)
        replies = [board.session.request(Read(magnetometer.sensor_id, 16)) for magnetometer in magnetometers]
        fields.append([reply.counts.mean(axis=0) / COUNTS_PER_UT for reply in replies])
    stage.turn_to(poses[0])
    changes = np.diff(np.array(fields), axis=0)
    for index, sensor in enumerate(magnetometers):
        # All parts see the same field turn; soft iron and noise of the parts differ by less than a tenth of the field.
        error_ut = np.abs(changes[:, index] - changes[:, 0]).max()
        limit_ut = 0.1 * rig.field.strength_ut
        assert error_ut < limit_ut, f"axes of {sensor.name}: {changes[:, index]}, not {changes[:, 0]} uT"


def test_the_gyroscope_has_the_bodys_axes(board: Board, stage: Stage, rig: Rig) -> None:
    assert board.truth is not None
    assert rig.world is not None
    if any(rig.world.drift.gyroscope_bias_dps_per_degc):
        pytest.skip("the bias of this world's gyroscope drifts")
    mean_dps = rest_gyroscope(board, seconds=1.0).rate.mean * DPS_PER_COUNT
    true_dps = board.truth.gyroscope_bias_dps
    # Each axis has a different bias. The noise of the mean is 0.02 deg/s.
    assert np.abs(mean_dps - true_dps).max() < 0.1, f"at rest the gyroscope reads {mean_dps}, its biases are {true_dps}"


def test_offsets_that_an_earlier_firmware_left_in_the_sensors_do_not_enter(board: Board, stage: Stage) -> None:
    selected = {sensor.kind: sensor for sensor in board.sensors if sensor.selected and sensor.present}
    before = board.session.request(Average(32))
    magnetometer, accelerometer = selected[SensorKind.MAGNETOMETER], selected[SensorKind.ACCELEROMETER]
    if magnetometer.name.startswith("MAG3110"):
        for axis in range(3):
            stage.write_sensor(magnetometer.bus, magnetometer.address, 0x09 + 2 * axis, OFFSET_WORD >> 8)
            stage.write_sensor(magnetometer.bus, magnetometer.address, 0x0A + 2 * axis, OFFSET_WORD & 0xFF)
    stage.write_sensor(accelerometer.bus, accelerometer.address, 0x2A, 0x00)  # offsets change in standby
    for axis in range(3):
        stage.write_sensor(accelerometer.bus, accelerometer.address, 0x2F + axis, 20)  # 40 mg
    for sensor in (magnetometer, accelerometer):
        board.session.request(Select(sensor.sensor_id))
    after = board.session.request(Average(32))
    for name, limit in (("magnetometer", 1.0 * COUNTS_PER_UT), ("accelerometer", 5e-3 / G_PER_COUNT)):
        moved = np.abs(getattr(after, name).mean - getattr(before, name).mean).max()
        assert moved < limit, f"offsets in the {name}'s registers move its mean by {moved:.0f} counts"


def test_samples_that_were_overwritten_are_counted(board: Board, stage: Stage) -> None:
    accelerometer = board.sensor(SensorKind.ACCELEROMETER)
    # The part is set to 800 Hz without the firmware's knowledge, so the firmware reads one sample of four.
    for value in (0x00, 0x01):
        stage.write_sensor(accelerometer.bus, accelerometer.address, 0x2A, value)
    overruns = board.session.request(Average(32)).overruns
    board.session.request(Select(accelerometer.sensor_id))
    assert overruns >= 16, f"{overruns} overwritten samples were counted in 32 readings at four times the rate"
    assert board.session.request(Average(32)).overruns == 0


def test_samples_that_the_fifo_lost_are_told(board: Board, stage: Stage) -> None:
    board.sensor(SensorKind.GYROSCOPE)
    first = board.session.request(LogGyroscope(20))
    board.sleep(0.5)  # 100 samples, and the FIFO holds 32
    second = board.session.request(LogGyroscope(20, go_on=True))
    assert (first.span.lost, second.span.lost) == (False, True)


def test_a_turn_has_its_first_and_last_samples_apart(board: Board, stage: Stage) -> None:
    board.sensor(SensorKind.GYROSCOPE)
    turn = board.session.request(IntegrateGyroscope(2 * EDGE_SAMPLES))  # both edges together are all samples
    edges = turn.begin + turn.end
    assert np.array_equal(edges, turn.total), f"the two halves sum to {edges}, all samples to {turn.total}"


def test_every_sample_of_a_burst_is_another(board: Board, stage: Stage) -> None:
    board.sensor(SensorKind.GYROSCOPE)
    samples = board.session.request(LogGyroscope(120)).samples
    # With 4 counts rms, one sample in 3000 equals the one before on all axes; with less than a count, more do.
    same = float((np.diff(samples, axis=0) == 0).all(axis=1).mean())
    expected = (1.0 / math.hypot(1.0, 2.0 * math.sqrt(math.pi) * noise_counts(board))) ** 3
    assert same < max(0.05, 3.0 * expected), f"{same:.0%} of the gyroscope's samples equal the one before"


def test_the_gyroscopes_scale_is_the_data_sheets_or_was_calibrated(board: Board, stage: Stage) -> None:
    assert board.truth is not None
    matrix, true = board.session.request(GetGyroscope()).matrix, board.truth.gyroscope_matrix
    is_calibrated = np.abs(matrix @ np.linalg.inv(true) - np.eye(3)).max() < 3e-3  # limits: 0.1 % and 0.1 degree
    assert is_calibrated or np.array_equal(matrix, DPS_PER_COUNT * np.eye(3)), f"{matrix} deg/s a count"


def test_a_moving_board_gives_no_bias(board: Board, stage: Stage) -> None:
    board.sensor(SensorKind.GYROSCOPE)
    rest_gyroscope(board, seconds=1.0, store=True)
    stored = board.session.request(GetGyroscope()).bias
    stage.turn_round(90.0, rate_dps=90.0, after_s=0.5)
    moved = board.session.request(GyroscopeRest(400, True, noise_counts(board)))
    assert moved.stillness.kind is not StillnessKind.STILL
    assert np.array_equal(board.session.request(GetGyroscope()).bias, stored), "a bias was stored while the board moved"
    board.sleep(2.0)


@dataclass(frozen=True)
class Filtered:
    """Results of the attitude filter for a turn."""

    seconds: float
    began: Pose
    ended: Pose
    measured: Pose
    answered: Pose


def run_filter(board: Board, stage: Stage, rig: Rig, turn_deg: float) -> Filtered:
    """Run the attitude filter at rest or during a turn; return attitudes by the gyroscope alone, and by the field."""
    slot = board.identity.slots - 1
    board.session.request(SetCalibration(slot, np.eye(3) / (rig.field.strength_ut * COUNTS_PER_UT), np.zeros(3)))
    board.session.request(FusionStart(slot, 8, 16))
    takes_s = stage.turn_round(turn_deg, rate_dps=90.0, after_s=0.2) if turn_deg else 1.0
    summary = board.session.request(FusionRun(round(1e6 * (takes_s + 0.2))))
    first, last = (board.session.request(FusionRead(index, 1)) for index in (0, summary.records - 1))
    answered = board.session.request(Average(16, 1 << slot)).headings[slot].attitude
    board.session.request(ClearCalibration(slot))
    assert answered is not None
    poses = (pose_of(normalised(attitudes[0])) for attitudes in (first.turned, last.turned, last.measured))
    return Filtered(1e-6 * float(last.time_us[0]), *poses, answered)


@pytest.mark.parametrize("turn_deg", [0.0, 90.0])
def test_the_gyroscopes_bias_is_taken_off_its_rates(board: Board, stage: Stage, rig: Rig, turn_deg: float) -> None:
    for _ in range(2):  # the second bias replaces the first
        rest_gyroscope(board, seconds=1.0, store=True)
    filtered = run_filter(board, stage, rig, turn_deg)
    began, ended = filtered.began, filtered.ended
    turned = wrap_180(ended.heading_deg - began.heading_deg - turn_deg)
    tilted = math.hypot(ended.pitch_deg - began.pitch_deg, ended.roll_deg - began.roll_deg)
    # The noise of both means is 0.02 deg/s; scale and axes of the part may change a quarter turn by 5 %.
    limit = 0.1 * filtered.seconds + 0.05 * turn_deg
    assert abs(turned) < limit, (
        f"by the gyroscope the heading drifts by {turned:.2f} degrees in {filtered.seconds:.1f} s"
    )
    assert tilted < limit, f"by the gyroscope the tilt drifts by {tilted:.2f} degrees in {filtered.seconds:.1f} s"
    # Field and gravity are the same; the difference is the noise of a single reading and of a mean of 16.
    difference = wrap_180(filtered.measured.heading_deg - filtered.answered.heading_deg)
    assert abs(difference) < 10.0, (
        f"the filter measures a heading that is {difference:.1f} degrees off the answered one"
    )
