"""The commands of the stream calibrators, executed on the virtual board."""

from __future__ import annotations

import math
import struct

import pytest

from hiltest.link.fields import FieldReader
from hiltest.link.replies import Status
from hiltest.link.streams import StreamStateReply, StreamStatus, StreamStepsReply

from .bench import CALIBRATE, STREAM_FEED, STREAM_REMOVE, STREAM_RESET, STREAM_STATE, Bench, sphere

DIRECT = b"direct-stream"


@pytest.fixture
def bench() -> Bench:
    """A board with no sensor; streams keep what they are given, so each test has its own."""
    return Bench()


def named(name: bytes) -> bytes:
    return bytes([len(name)]) + name


def steps(bench: Bench, kind: int, first: int, count: int, name: bytes = DIRECT) -> StreamStepsReply:
    reply = bench.request(kind, struct.pack("<HB", first, count) + named(name)).payload
    assert reply[0] in (Status.OK, Status.NO_CYCLE_COUNTER)
    fields = FieldReader(reply[1:], "reply")
    parsed = StreamStepsReply.read(fields)
    fields.end()
    return parsed


def state(bench: Bench, name: bytes = DIRECT) -> StreamStateReply:
    reply = bench.request(STREAM_STATE, named(name)).payload
    assert reply[0] in (Status.OK, Status.NO_CYCLE_COUNTER)
    fields = FieldReader(reply[1:], "reply")
    parsed = StreamStateReply.read(fields)
    fields.end()
    return parsed


def test_a_stream_is_fed_point_by_point_and_answers_what_it_knows(bench: Bench) -> None:
    bench.upload(sphere(100))
    assert (state(bench).fit.name, state(bench).held) == ("TOO_FEW_POINTS", 0)
    fed = [steps(bench, STREAM_FEED, 0, 80), steps(bench, STREAM_FEED, 80, 20)]
    assert [(each.status, each.taken) for each in fed] == [(StreamStatus.OK, 80), (StreamStatus.OK, 20)]
    costs = [cost for each in fed for cost in each.costs or ()]
    assert len(costs) == 100
    assert all(0 < cost.overhead_cycles < 100 < cost.cycles < 1000 for cost in costs)
    found = state(bench)
    assert (found.fit.name, found.is_sphere, found.held, found.elements, found.fit_error_percent) == (
        "ELLIPSOID",
        False,
        100,
        0,
        None,
    )
    # Rounding to whole counts moves each point by at most 0.87 counts; the centre is a mean over 100 of them.
    assert math.dist(found.calibration.hard_iron, (100, -200, 300)) < 0.87
    assert found.cost is not None
    assert found.cost.cycles > 1000  # the solution, made when it was asked for


def test_a_window_moves_over_the_points_and_leaves_nothing_behind(bench: Bench) -> None:
    far = [(x + 900, y - 700, z) for x, y, z in sphere(60)]
    bench.upload([*sphere(60), *far])
    # One that only ever saw the last points, its anchor the same point of the buffer.
    steps(bench, STREAM_FEED, 59, 1)
    steps(bench, STREAM_FEED, 60, 60)
    steps(bench, STREAM_REMOVE, 59, 1)
    only = state(bench)
    bench.ask(STREAM_RESET, b"\x00" + named(DIRECT))
    assert state(bench).held == 0
    for index in range(59, 60 + 60):
        steps(bench, STREAM_FEED, index, 1)
        if index >= 60 + 30:
            steps(bench, STREAM_FEED, index - 30, 1)
            steps(bench, STREAM_REMOVE, index - 30, 1)
    steps(bench, STREAM_REMOVE, 59, 1)
    moved = state(bench)
    assert moved.held == only.held == 60
    assert moved.calibration.hard_iron.tolist() == only.calibration.hard_iron.tolist()
    assert moved.calibration.soft_iron.tolist() == only.calibration.soft_iron.tolist()
    assert math.dist(moved.calibration.hard_iron, (1000, -900, 300)) < 0.87


def test_a_point_too_far_from_the_anchor_is_refused_and_those_before_it_stay(bench: Bench) -> None:
    bench.upload([(0, 0, 0), (2047, -2047, 0), (0, 0, 2048), (1, 2, 3)])
    fed = steps(bench, STREAM_FEED, 0, 4)
    assert (fed.status, fed.taken, len(fed.costs or ())) == (StreamStatus.OUT_OF_RANGE, 2, 2)
    assert state(bench).held == 2
    back = steps(bench, STREAM_REMOVE, 0, 2)
    assert (back.status, back.taken) == (StreamStatus.OK, 2)
    assert steps(bench, STREAM_REMOVE, 0, 1).status is StreamStatus.EMPTY
    assert steps(bench, STREAM_FEED, 2, 2).status is StreamStatus.OK  # empty again, it has another anchor


def test_the_sums_have_room_for_512_points(bench: Bench) -> None:
    bench.upload(sphere(512))
    for first in range(0, 512, 64):
        assert steps(bench, STREAM_FEED, first, 64).taken == 64
    assert steps(bench, STREAM_FEED, 0, 1).status is StreamStatus.FULL
    assert state(bench).held == 512


def test_direct_stream_and_direct_find_the_same(bench: Bench) -> None:
    bench.upload([(x + y // 3, y, z - x // 4) for x, y, z in sphere(80)])
    steps(bench, STREAM_FEED, 0, 80)
    found = state(bench)
    direct = struct.unpack_from("<9f3f", bench.ask(CALIBRATE, struct.pack("<HHB", 80, 0, 6) + b"direct"), 4)
    # float32 sums of 80 points against exact ones, times the condition of the normal equations: some parts in 1e5.
    assert found.calibration.soft_iron.ravel().tolist() == pytest.approx(direct[:9], abs=1e-4 * direct[0])
    assert found.calibration.hard_iron.tolist() == pytest.approx(direct[9:], abs=0.05)


ITERATIVE = b"iterative-stream"


def test_iterative_stream_gets_better_as_it_is_fed(bench: Bench) -> None:
    bench.upload([(x + y // 3, y, z - x // 4) for x, y, z in sphere(400)])
    # Spirals come in order of height: a stride spreads them, so that each part is all round.
    found = []
    for offset in range(7):
        for index in range(offset, 400, 7):
            assert steps(bench, STREAM_FEED, index, 1, ITERATIVE).taken == 1
        found.append(state(bench, ITERATIVE))
    assert [each.held for each in found] == sorted(each.held for each in found)
    assert [each.elements for each in found] == sorted(each.elements for each in found)
    first, last = found[0], found[-1]
    assert (first.fit.name, first.elements, first.accepted, first.fit_error_percent) == ("TOO_FEW_POINTS", 0, 0, 1000.0)
    assert (last.fit.name, last.is_sphere, last.elements, last.is_solving) == ("ELLIPSOID", False, 10, False)
    assert last.accepted >= 2
    assert last.fit_error_percent is not None
    assert last.fit_error_percent < 0.2  # rounding to whole counts: 0.3 of 500 counts rms on each axis
    assert math.dist(last.calibration.hard_iron, (100 - 200 / 3, -200, 300 - 25)) < 1.5  # as above, and the floors


def test_a_sliced_solver_says_that_it_is_at_work(bench: Bench) -> None:
    bench.upload(sphere(400))
    bench.ask(STREAM_RESET, b"\x01" + named(ITERATIVE))
    largest = 0
    solving = []
    for first in range(0, 400, 10):
        costs = steps(bench, STREAM_FEED, first, 10, ITERATIVE).costs
        assert costs is not None
        largest = max(largest, *(cost.cycles for cost in costs))
        solving.append(state(bench, ITERATIVE).is_solving)
    assert solving[0] is False
    assert True in solving
    assert largest < 30_000  # no slice comes near a whole solver


def test_only_what_can_be_taken_back_is(bench: Bench) -> None:
    bench.upload(sphere(20))
    steps(bench, STREAM_FEED, 0, 20, ITERATIVE)
    remove = struct.pack("<HB", 0, 1) + named(ITERATIVE)
    assert bench.status(STREAM_REMOVE, remove) == Status.NOT_SUPPORTED
    assert state(bench, ITERATIVE).held > 0


def test_requests_that_make_no_sense_are_refused(bench: Bench) -> None:
    bench.upload(sphere(20))
    feed = struct.Struct("<HB")
    assert bench.status(STREAM_FEED, feed.pack(0, 21) + named(DIRECT)) == Status.TOO_FEW_POINTS
    assert bench.status(STREAM_FEED, feed.pack(20, 1) + named(DIRECT)) == Status.TOO_FEW_POINTS
    assert bench.status(STREAM_FEED, feed.pack(65535, 80) + named(DIRECT)) == Status.TOO_FEW_POINTS
    assert bench.status(STREAM_FEED, feed.pack(0, 0) + named(DIRECT)) == Status.BAD_ARGUMENT
    assert bench.status(STREAM_FEED, feed.pack(0, 81) + named(DIRECT)) == Status.BAD_ARGUMENT
    assert bench.status(STREAM_RESET, b"\x02" + named(DIRECT)) == Status.BAD_ARGUMENT
    for kind, start in ((STREAM_RESET, b"\x00"), (STREAM_FEED, feed.pack(0, 1)), (STREAM_STATE, b"")):
        assert bench.status(kind, start + named(b"direct")) == Status.UNKNOWN_CALIBRATOR
        assert bench.status(kind, start + named(DIRECT)[:-1]) == Status.BAD_LENGTH
        assert bench.status(kind, start + named(DIRECT) + b"!") == Status.BAD_LENGTH
    assert state(bench).held == 0


def test_without_a_cycle_counter_points_are_taken_all_the_same() -> None:
    bench = Bench(cycle_counter=False)
    bench.upload(sphere(20))
    fed = steps(bench, STREAM_FEED, 0, 20)
    assert (fed.taken, fed.costs) == (20, None)
    assert (state(bench).held, state(bench).cost) == (20, None)
