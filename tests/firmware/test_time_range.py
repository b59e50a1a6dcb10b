"""TIME_RANGE: what it takes to keep the range of points as they are stored."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.link.messages import ClearPoints, TimeRange, Upload
from hiltest.link.replies import RunCost, Status
from hiltest.link.request import Request, decode_reply
from hiltest.procedures import golden_points
from hiltest.virtual.board.k64f import VirtualK64F

from .bench import COSTS_BY, ELF, Bench

CLOUD = golden_points(120)


def asked(bench: Bench, request: Request[object]) -> object:
    return decode_reply(request, bench.request(request.code, request.payload()).payload)


def holding_the_cloud(*, cycle_counter: bool = True) -> Bench:
    bench = Bench(cycle_counter=cycle_counter)
    asked(bench, Upload(0, CLOUD.tolist()))
    return bench


@pytest.fixture(scope="module")
def bench() -> Bench:
    return holding_the_cloud()


def cycles(bench: Bench, n: int) -> int:
    cost = asked(bench, TimeRange(n))
    assert isinstance(cost, RunCost)
    return cost.cycles


@pytest.mark.parametrize("n", [1, 2, 100, 120])
def test_its_cycles_are_those_of_each_step_without_those_of_an_empty_one(bench: Bench, n: int) -> None:
    board, limits = VirtualK64F(ELF, profile=COSTS_BY), bytearray(12)
    points = [np.ascontiguousarray(point, "<i2").tobytes() for point in CLOUD[:n]]
    board.call("point_range_start", limits, points[0])
    steps = [board.call("point_range_add", limits, point).cycles for point in points]
    empty = board.call("empty_stream_add", limits, points[0]).cycles
    assert cycles(bench, n) == sum(steps) - n * empty
    assert np.array_equal(np.frombuffer(limits, "<i2"), [*CLOUD[:n].min(axis=0), *CLOUD[:n].max(axis=0)])


def test_it_changes_nothing(bench: Bench) -> None:
    assert cycles(bench, 120) == cycles(bench, 120)


def test_what_is_refused(bench: Bench) -> None:
    for n in (121, 65535):
        request = TimeRange(n)
        assert bench.status(request.code, request.payload()) is Status.TOO_FEW_POINTS
    assert bench.status(TimeRange.code, bytes(2)) is Status.BAD_ARGUMENT
    assert bench.status(TimeRange.code, bytes(8)) is Status.BAD_LENGTH  # what PACK_POINTS was, up to protocol 6
    assert bench.status(ClearPoints.code, bytes(6)) is Status.BAD_LENGTH
    assert cycles(bench, 120) > 0  # and no point is lost by that
    with pytest.raises(ValueError, match="points"):
        TimeRange(0).payload()


def test_a_core_without_a_counter_has_no_cost() -> None:
    assert asked(holding_the_cloud(cycle_counter=False), TimeRange(100)) is None
