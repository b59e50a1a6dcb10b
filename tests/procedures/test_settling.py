"""When a heading stands still: two windows agree, by a tenth of a degree or by their noise."""

from __future__ import annotations

import random

import pytest

from hiltest.procedures.settling import agree, confirmed, isolated, step_of


def around(mean_deg: float, noise_deg: float, n: int = 40, seed: int = 1) -> list[float]:
    of = random.Random(seed)
    return [(mean_deg + of.gauss(0.0, noise_deg)) % 360.0 for _ in range(n)]


def test_windows_without_noise_agree_within_a_tenth_of_a_degree() -> None:
    assert agree([10.0, 10.0], [10.09, 10.09])
    assert not agree([10.0, 10.0], [10.11, 10.11])


def test_noise_widens_what_agrees_and_more_readings_narrow_it() -> None:
    # Of 40 readings with 3 degrees two means differ by 0.67 rms; of 4 000 by 0.067.
    assert agree(around(0.0, 3.0), around(1.0, 3.0, seed=2))
    assert not agree(around(0.0, 3.0, 4000), around(1.0, 3.0, 4000, seed=2))


@pytest.mark.parametrize(
    ("headings_deg", "step_deg"),
    [
        ([0.0, 359.0, 7.0], 1.0),
        ([10.0, 20.0], 10.0),
        ([12.3, 12.4], 0.1),
        ([12.300000190734863, 359.70001220703125], 0.1),
        ([12.34, 12.3], 0.02),
        ([12.3456], 0.0),
    ],
)
def test_the_step_of_headings_is_the_largest_usual_one(headings_deg: list[float], step_deg: float) -> None:
    assert step_of(headings_deg) == step_deg


def test_north_is_no_edge() -> None:
    assert agree([359.97, 359.99], [0.02, 0.04])
    assert not agree([359.0, 359.0], [1.0, 1.0])


def test_a_single_reading_has_no_noise_to_excuse_it() -> None:
    assert agree([5.0], [5.05])
    assert not agree([5.0], [5.2])


@pytest.mark.parametrize(
    ("message", "stored"),
    [
        ([10.0, 10.5, 200.0, 10.2, 10.1], [10.0, 10.5, 10.2, 10.1]),
        ([359.0, 1.0, 180.0], [359.0, 1.0]),
        ([10.0, 60.0, 110.0], []),
        ([10.0], []),
        ([], []),
        ([10.0, 200.0, 10.0], []),  # which of them is right nothing says
    ],
)
def test_a_heading_counts_where_a_neighbour_confirms_it(message: list[float], stored: list[float]) -> None:
    assert confirmed(message, [False] * len(message)) == stored


@pytest.mark.parametrize(
    ("headings", "count"),
    [([10.0, 10.5, 200.0, 10.2, 10.1], 1), ([359.0, 180.0, 1.0], 1), ([10.0, 60.0, 110.0], 0), ([10.0, 200.0], 0)],
)
def test_a_heading_sticks_out_if_its_neighbours_agree_without_it(headings: list[float], count: int) -> None:
    assert isolated(headings) == count


def test_a_heading_with_a_right_check_value_needs_no_neighbour_and_is_one() -> None:
    assert confirmed([10.0, 60.0, 110.0], [False, True, False]) == [60.0]
    assert confirmed([10.0, 10.4, 200.0], [True, False, False]) == [10.0, 10.4]
