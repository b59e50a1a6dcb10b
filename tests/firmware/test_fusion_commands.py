"""The commands of the attitude filter, executed on the virtual board."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from hiltest.link.fields import FieldReader
from hiltest.link.fusion import FusionRead, FusionRecords, FusionRun, FusionSummary
from hiltest.link.replies import Status
from hiltest.orientation.angles import Pose, heading_error_deg
from hiltest.orientation.quaternions import from_pose, normalised, pose_of

from ..orientation.quaternion_algebra import angle_between_deg
from .bench import CLEAR, SET, Bench, bench_with

START, RUN, READ = 0x22, 0x23, 0x24
SLOT = 3
# Identity, unit field: the noise and the distortion of the default world are then all that is wrong.
NOMINAL = struct.pack("<12f", 1 / 485, 0, 0, 0, 1 / 485, 0, 0, 0, 1 / 485, 24, -22, 40)


@pytest.fixture(scope="module")
def bench() -> Bench:
    bench = bench_with("i2c1")
    bench.ask(SET, bytes([SLOT]) + NOMINAL)
    return bench


@pytest.fixture(scope="module")
def bare_bench() -> Bench:
    return Bench()


def start(*, slot: int = SLOT, every: int = 1, readings: int = 16, timeout_us: int = 2_000_000) -> bytes:
    return struct.pack("<BBHI", slot, every, readings, timeout_us)


def run(bench: Bench, seconds: float) -> FusionSummary:
    reply = bench.request(RUN, FusionRun(round(1e6 * seconds)).payload()).payload
    assert reply[0] in (Status.OK, Status.NO_CYCLE_COUNTER)
    fields = FieldReader(reply[1:], "reply")
    summary = FusionSummary.read(fields)
    fields.end()
    return summary


def read(bench: Bench, first: int, count: int) -> FusionRecords:
    fields = FieldReader(bench.ask(READ, FusionRead(first, count).payload()), "reply")
    records = FusionRecords.read(fields)
    fields.end()
    return records


def test_the_first_attitude_is_that_of_the_resting_board(bench: Bench) -> None:
    attitude = np.frombuffer(bench.ask(START, start(readings=64)), "<f4").astype(float)
    assert np.linalg.norm(attitude) == pytest.approx(1.0, abs=1e-6)
    # The default world: 1.7 degrees of mounting, 3 mg, up to 2.5 % of soft iron; noise of 64 readings is 0.13 degrees.
    assert angle_between_deg(attitude, from_pose(Pose(1.7))) < 2.0


def test_at_rest_all_three_attitudes_stay(bench: Bench) -> None:
    rest = struct.pack("<HIBf", 400, 5_000_000, 1, 0.0)
    bench.ask(0x0F, rest)
    first = np.frombuffer(bench.ask(START, start(every=2)), "<f4").astype(float)
    summary = run(bench, 1.0)
    assert (summary.no_attitude, summary.field_left_out, summary.bad_steps, summary.overruns) == (0, 0, 0, 0)
    assert summary.costs.updates in (79, 80, 81)
    assert summary.records == math.ceil(summary.costs.updates / 2)
    records = read(bench, 0, 36)
    assert len(records.time_us) == 36
    assert np.diff(records.time_us) == pytest.approx(25_000.0, abs=1_600)  # a look may be an eighth of a period late
    for attitude in records.turned:  # a second of what is left of the bias, and of noise
        assert angle_between_deg(normalised(attitude), first) < 0.05
    headings = [heading_error_deg(pose_of(normalised(each)).heading_deg, 1.7) for each in records.measured]
    assert np.std(headings) == pytest.approx(1.0, rel=0.5)  # 0.4 uT over 22.8 uT; 36 readings
    fused = [heading_error_deg(pose_of(normalised(each)).heading_deg, 1.7) for each in records.fused]
    assert np.std(fused) < 0.5 * np.std(headings)


def test_records_are_read_in_parts_and_end_where_they_end(bench: Bench) -> None:
    bench.ask(START, start(every=7))
    kept = run(bench, 0.5).records
    assert kept in (5, 6, 7)
    whole, tail = read(bench, 0, 36), read(bench, kept - 2, 36)
    assert len(whole.time_us) == kept
    assert tail.fused.tolist() == whole.fused[-2:].tolist()
    assert len(read(bench, kept, 36).time_us) == 0
    assert bench.status(READ, FusionRead(kept + 1).payload()) == Status.BAD_ARGUMENT
    assert bench.status(READ, struct.pack("<HB", 0, 37)) == Status.BAD_ARGUMENT


def test_every_run_begins_anew(bench: Bench) -> None:
    bench.ask(START, start())
    run(bench, 0.2)
    first = read(bench, 0, 1).turned[0]
    run(bench, 0.2)
    again = read(bench, 0, 1)
    assert angle_between_deg(normalised(again.turned[0]), normalised(first)) < 0.02
    assert again.time_us[0] < 20_000


def test_an_update_costs_what_the_design_page_says(bench: Bench) -> None:
    """Virtual cycles are exact: 515 without the empty update, as long as the tilt follows the mean."""
    bench.ask(START, start())
    summary = run(bench, 0.3)
    assert summary.costs.largest is not None
    assert summary.costs.largest.cycles == summary.costs.mean_cycles == 515


def test_without_a_field_the_heading_is_left_to_the_gyroscope(bench: Bench) -> None:
    bench.ask(START, start())
    bench.ask(SET, bytes([SLOT]) + struct.pack("<12f", *[0] * 12))  # a calibration that leaves nothing of the field
    try:
        summary = run(bench, 0.3)
        records = read(bench, 0, 10)
        assert bench.status(START, start()) == Status.DEGENERATE_FIELD
    finally:
        bench.ask(SET, bytes([SLOT]) + NOMINAL)
    assert summary.field_left_out == summary.costs.updates > 20
    assert np.isnan(records.measured).all()
    assert not np.isnan(records.fused).any()


def test_requests_that_make_no_sense_are_refused(bench: Bench) -> None:
    for name, value in (
        ("slot", 16),
        ("every", 0),
        ("readings", 0),
        ("readings", 513),
        ("timeout_us", 60_000_001),
    ):
        assert bench.status(START, start(**{name: value})) == Status.BAD_ARGUMENT, name
    assert bench.status(START, start(slot=5)) == Status.NO_CALIBRATION
    assert bench.status(RUN, struct.pack("<I", 1_000_000)) == Status.NO_CALIBRATION  # that start was none
    for duration_us in (0, 300_000_001):
        assert bench.status(RUN, struct.pack("<I", duration_us)) == Status.BAD_ARGUMENT
    bench.ask(START, start())
    bench.ask(CLEAR, bytes([SLOT]))
    assert bench.status(RUN, struct.pack("<I", 1_000_000)) == Status.NO_CALIBRATION
    bench.ask(SET, bytes([SLOT]) + NOMINAL)


def test_a_board_without_sensors_says_so(bare_bench: Bench) -> None:
    assert bare_bench.status(RUN, struct.pack("<I", 1_000_000)) == Status.NO_CALIBRATION
    assert bare_bench.status(START, start()) == Status.SENSOR_ABSENT


def test_without_a_cycle_counter_the_filter_runs_all_the_same() -> None:
    bench = bench_with("i2c1")
    bench.board.cycle_counter.present = False
    bench.ask(SET, bytes([SLOT]) + NOMINAL)
    bench.ask(START, start(readings=1))
    summary = run(bench, 0.1)
    assert summary.costs.updates in (7, 8, 9)
    assert (summary.costs.largest, summary.costs.mean_cycles) == (None, None)
