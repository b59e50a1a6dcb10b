"""A hand turns a board all round in most of a minute: the points are those of all of it."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pytest

from hiltest.boards import Board, open_board
from hiltest.link.messages import Points
from hiltest.orientation.angles import Pose, wrap_180
from hiltest.procedures import OperatorTurntable, Tumble, collect_tumble, held_as_taken, run_calibrators
from hiltest.procedures.tumble import poor_coverage
from hiltest.rig import Rig

POINTS = 150
HAND_S = 20.0


@pytest.fixture(scope="module")
def coverages() -> list[str]:
    return []


@pytest.fixture(scope="module")
def board(bench_rig: Rig) -> Iterator[Board]:
    with open_board(bench_rig) as board:
        yield board


@pytest.fixture(scope="module")
def by_hand(board: Board, coverages: list[str]) -> Tumble:
    """Points of a virtual board that somebody turns as slowly as a hand does."""
    assert board.stage is not None
    stage, turned = board.stage, iter(np.linspace(-89.0, 89.0, POINTS))

    def turn_on(_: float) -> None:
        # Nose down to nose up, rolling seven times: not round before the end.
        pitch_deg = float(next(turned))
        stage.turn_to(Pose(0.0, pitch_deg, wrap_180(14.0 * pitch_deg)))

    table = OperatorTurntable(prompt=lambda _: "", uncertainty_deg=0.5, tumble_s=HAND_S)
    return collect_tumble(
        board,
        table,
        points=POINTS,
        progress=lambda case, done, of: coverages.append(f"{case} {done}/{of}"),
        sleep=turn_on,
    )


def test_the_first_points_are_spread_over_all_of_the_turn(by_hand: Tumble) -> None:
    assert by_hand.points.shape == (POINTS, 3)
    # At a dip of 62 degrees the field ends 28 degrees from the body's x axis on one side: 94 % of the sphere.
    assert by_hand.coverage == pytest.approx(0.94, abs=0.03)
    # In the order in which they were taken the first hundred would stop at two thirds of the turn.
    assert by_hand.coverage_of(100) == pytest.approx(by_hand.coverage, abs=0.05)
    assert by_hand.coverage_of(50) > 0.8


def test_the_board_holds_the_points_in_that_order_for_every_calibrator(board: Board, by_hand: Tumble) -> None:
    back = [board.session.request(Points(first, 50)) for first in (0, 50, 100)]
    assert np.array_equal(np.concatenate([pose.magnetometer for pose in back]), by_hand.points)
    assert np.array_equal(np.concatenate([pose.accelerometer for pose in back]), by_hand.accelerometer)
    for run in run_calibrators(board, by_hand, calibrators=["direct", "iterative"], n=100).values():
        assert not run.is_sphere
        # Noise alone: its rms scatters by 7 %; 30 % are four sigma.
        assert run.residual_percent == pytest.approx(run.residual_predicted_percent, rel=0.3)


def test_the_board_can_hold_them_as_they_were_taken_and_then_as_before(board: Board, by_hand: Tumble) -> None:
    def held() -> np.ndarray:
        return np.concatenate([board.session.request(Points(first, 50)).magnetometer for first in (0, 50, 100)])

    with held_as_taken(board, by_hand):
        # The field along x is that of the pitch at which each was taken; soft iron and noise are 3 % of it.
        expected = np.cos(np.radians(62.0 + np.linspace(-89.0, 89.0, POINTS)))
        assert np.corrcoef(held()[:, 0], expected)[0, 1] > 0.995
    assert np.array_equal(held(), by_hand.points)


def test_the_coverage_is_told_while_the_board_is_turned(by_hand: Tumble, coverages: list[str]) -> None:
    assert len(coverages) == 15
    assert coverages[0].endswith(" of the sphere 10/150")
    observations = [int(line.split()[1]) for line in coverages]
    # After a third nothing was seen yet of the nose up.
    assert observations[4] < 60 < observations[-1]


def test_a_tumble_with_a_hole_is_refused_at_once_with_the_sides_to_turn_into_it(board: Board, bench_rig: Rig) -> None:
    assert board.stage is not None
    stage, questions = board.stage, list[str]()
    # At rest; with the nose never down, which is a pitch of -90 degrees; and all round.
    tumbles = iter(
        [iter(np.linspace(first, last, POINTS)) for first, last in ((0.0, 0.0), (50.0, 89.0), (-89.0, 89.0))]
    )
    pitches = iter(np.zeros(0))

    def answer(question: str) -> str:
        nonlocal pitches
        questions.append(question)
        if "all round" in question:
            pitches = next(tumbles)
        return ""

    def turn_on(_: float) -> None:
        pitch_deg = float(next(pitches))
        stage.turn_to(Pose(0.0, pitch_deg, wrap_180(14.0 * pitch_deg)))

    tumble = collect_tumble(
        board,
        OperatorTurntable(prompt=answer, uncertainty_deg=0.5, tumble_s=HAND_S),
        points=POINTS,
        refuse=lambda tumble: poor_coverage(tumble, bench_rig),
        sleep=turn_on,
    )
    assert tumble.coverage > 0.9
    _, at_rest, half = questions  # one Enter begins each tumble
    assert at_rest.startswith("the tumble covers 0% of the sphere, at least 50% is needed: the points are no sphere")
    assert re.match(
        r"the tumble covers \d\d% of the sphere, .*a hole of \d+ deg is left where its nose points down", half
    )
    assert half.endswith("Enter to begin: ")
