"""Stream calibrators over a tumble: every point in order, and what they know on the way."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration import fit_direct
from hiltest.link.messages import GetCalibration
from hiltest.link.streams import StreamFeed, StreamReset, StreamStatus
from hiltest.measurement import PUBLISHED, CycleRange
from hiltest.procedures import StreamRun, golden_points, run_streams, store_streams, upload_points

POINTS = 130
CLOUD = golden_points(POINTS)


@pytest.fixture
def runs(virtual_board: Board) -> dict[str, StreamRun]:
    upload_points(virtual_board, CLOUD)
    return run_streams(virtual_board, POINTS, stages=(40, 100, 200))


def test_every_point_is_given_in_order_and_each_costs(runs: dict[str, StreamRun]) -> None:
    assert "direct-stream" in runs
    for run in runs.values():
        assert run.refused is StreamStatus.OK
        assert run.cycles is not None
        assert run.cycles.shape == (POINTS,)
        assert run.cycles.min() > 0
        # A stage beyond the points is none; the end is one in any case.
        assert [stage.points for stage in run.stages] == [40, 100, POINTS]


def test_what_is_known_at_a_stage_is_of_the_points_so_far(runs: dict[str, StreamRun]) -> None:
    for stage in runs["direct-stream"].stages:
        expected = fit_direct(CLOUD[: stage.points])
        assert stage.state.held == stage.points
        # Sums are exact; what is left is the solution in float32, 1e-5 of counts of some hundreds.
        assert stage.fit.hard_iron == pytest.approx(expected.hard_iron, abs=0.01)
    fewer, more = (stage.fit.hard_iron for stage in runs["direct-stream"].stages[:2])
    assert np.abs(fewer - more).max() > 0.01


def test_slices_are_another_run_of_a_calibrator_that_has_them(runs: dict[str, StreamRun]) -> None:
    assert set(runs) == {"direct-stream", "iterative-stream", "iterative-stream-sliced"}
    whole, sliced = runs["iterative-stream"], runs["iterative-stream-sliced"]
    assert whole.cycles is not None
    assert sliced.cycles is not None
    assert sliced.cycles.max() < whole.cycles.max()


def test_the_total_of_a_stream_has_the_band_of_all_its_steps_together(
    virtual_board: Board, runs: dict[str, StreamRun]
) -> None:
    for run in runs.values():
        band, fit_range = run.total_range, run.fit_range
        assert run.total is not None
        assert band is not None
        assert fit_range is not None
        assert fit_range.high < band.low < run.total < band.high
    # A step of `direct-stream` is the same for every point but the first and those behind it that carry.
    direct = runs["direct-stream"]
    assert direct.total_range is not None
    assert direct.fit_range is not None
    virtual_board.session.request(StreamReset("direct-stream"))
    lows, highs = [], []
    for index in range(POINTS):
        reply = virtual_board.session.request(StreamFeed("direct-stream", index, 1))
        assert reply.costs is not None
        band = virtual_board.cycle_range(reply.costs[0])
        assert band is not None
        low, high = rows_of(band)
        lows.append(low)
        highs.append(high)
    fit, total = rows_of(direct.fit_range), rows_of(direct.total_range)
    assert (sum(lows) + fit[0], sum(highs) + fit[1]) == total


def rows_of(band: CycleRange) -> tuple[int, int]:
    """The ends without what no row explains, which is rounded up in each count."""
    doubt = next(row for row in band.rows if row.row == PUBLISHED)
    half = (doubt.high - doubt.low) // 2
    return band.low + half, band.high - half


def test_steps_that_were_not_the_last_that_were_timed_have_no_band(virtual_board: Board) -> None:
    upload_points(virtual_board, CLOUD)
    virtual_board.session.request(StreamReset("direct-stream"))
    reply = virtual_board.session.request(StreamFeed("direct-stream", 0, 5))
    assert reply.costs is not None
    cycles, overhead = [cost.cycles for cost in reply.costs], reply.costs[0].overhead_cycles
    for wrong, reference in ((cycles, True), ([*cycles[:-1], 1], False), ([7] * 200, False)):
        steps = virtual_board.timed_steps()
        assert steps is not None
        steps.add(wrong, overhead)
        assert (steps.band() is not None) is reference


def test_points_are_taken_back_exactly_where_that_can_be(virtual_board: Board, runs: dict[str, StreamRun]) -> None:
    direct = runs["direct-stream"]
    assert direct.cycles is not None
    assert direct.remove_cycles is not None
    assert len(direct.remove_cycles) == 20
    assert 150 < direct.remove_cycles.max() <= 235
    assert [runs[name].remove_cycles for name in ("iterative-stream", "iterative-stream-sliced")] == [None, None]
    # What was told of the end is of all points, and was told before.
    assert direct.last.state.held == POINTS


def test_the_last_calibrations_go_into_slots_as_far_as_there_are(
    virtual_board: Board, runs: dict[str, StreamRun]
) -> None:
    slots = store_streams(virtual_board, runs, first_slot=3)
    assert list(slots.values()) == list(range(3, 3 + len(slots)))
    back = virtual_board.session.request(GetCalibration(slots["direct-stream"]))
    assert np.array_equal(back.hard_iron, runs["direct-stream"].last.fit.hard_iron)
    assert store_streams(virtual_board, runs, first_slot=virtual_board.identity.slots) == {}


def test_a_point_that_is_refused_ends_a_run_and_is_named(virtual_board: Board) -> None:
    cloud = CLOUD.copy()
    cloud[90] = cloud[0] + 2048  # a count beyond what the exact sums have room for
    upload_points(virtual_board, cloud)
    run = run_streams(virtual_board, POINTS, stages=(40, 100))["direct-stream"]
    assert run.refused is StreamStatus.OUT_OF_RANGE
    assert run.cycles is not None
    assert len(run.cycles) == run.last.state.held == 90
    assert [stage.points for stage in run.stages] == [40, 90]
