"""Numbers of `hiltest judge`: intervals, comparisons, limits and exit codes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hiltest.errors import ConfigError
from hiltest.judge.answers import Answer, Outcome, rate
from hiltest.judge.judge_tables import page
from hiltest.judge.judgement import (
    ALL,
    Judged,
    check_limits,
    compare,
    document,
    judge,
    limit_values,
    root_mean_square,
)
from hiltest.judge.worlds import FAMILIES, HALF_SPHERE, RIG, World, draw_world
from hiltest.measurement.estimates import Estimate


class Truth:
    """An entry that knows the truth, with an error of the hard iron."""

    name, built_by, cycle_model, flash_bytes = "truth", "gcc 12.2.1 -O2", "model/1@sram", 100

    def __init__(
        self, error_ut: float, cycles: int | None = 1000, refused: tuple[int, ...] = (), twice_in: str = ""
    ) -> None:
        self._error_ut, self._cycles, self._refused, self._twice_in = error_ut, cycles, refused, twice_in

    def answer(self, world: World) -> Answer:
        error_ut = self._error_ut * (2.0 if world.family == self._twice_in else 1.0)
        hard_iron_ut = world.hard_iron_ut + np.array([error_ut, 0.0, 0.0])
        is_refused = world.family == RIG and world.number in self._refused
        return Answer(is_refused, hard_iron_ut, np.linalg.inv(world.soft_iron), cycles=self._cycles)


@pytest.fixture(scope="module")
def small() -> Judged:
    return judge(Truth(0.1), "judged")


@pytest.fixture(scope="module")
def large() -> Judged:
    return judge(Truth(0.2, cycles=900, refused=(3, 4)), "against")


def test_the_interval_of_a_root_mean_square_contains_the_true_one_in_95_of_100_samples() -> None:
    random = np.random.default_rng(2)
    estimates = [root_mean_square(random.standard_normal(500).tolist()) for _ in range(1000)]
    inside = [estimate is not None and (estimate.low or 0.0) <= 1.0 <= (estimate.high or 9.0) for estimate in estimates]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)  # three deviations of a share of 1000


@pytest.mark.parametrize(
    ("soft_iron", "outcome"),
    [
        (np.eye(3), Outcome.ACCEPTED),
        (np.diag([1.0, 1.0, -1.0]), Outcome.NO_ELLIPSOID),
        (np.diag([1.0, 1.0, 0.0]), Outcome.NO_ELLIPSOID),
        (np.diag([1.0, 1.0, np.nan]), Outcome.NO_ELLIPSOID),
        (np.diag([1.0, np.inf, 1.0]), Outcome.NO_ELLIPSOID),
    ],
    ids=["identity", "mirrored", "singular", "not a number", "infinite"],
)
def test_an_answer_that_is_no_ellipsoid_has_no_error(soft_iron: np.ndarray, outcome: Outcome) -> None:
    world = draw_world(FAMILIES[0], 1)
    rating = rate(Answer(False, world.hard_iron_ut, soft_iron), world)
    assert rating.outcome is outcome
    assert (rating.rms_deg is None) == (outcome is Outcome.NO_ELLIPSOID)
    assert rate(Answer(True, world.hard_iron_ut, soft_iron), world).outcome is Outcome.REFUSED


def test_refused_calibrations_are_counted_with_the_error_that_they_would_have_had(large: Judged) -> None:
    rig = large.result.family(RIG)
    assert (rig.worlds, rig.refused, rig.no_ellipsoid) == (100, 2, 0)
    # 0.2 uT in a horizontal field of 22.8 uT: at most 0.50 deg, times a sine over the headings.
    assert rig.refused_deg == pytest.approx(0.5 / np.sqrt(2.0), abs=0.1)
    assert large.result.family(ALL).refused == 2


def test_twice_the_error_is_twice_the_error(small: Judged, large: Judged) -> None:
    comparison = compare(large, small)
    assert comparison.error is not None
    assert comparison.error.value == pytest.approx(2.0, abs=0.01)  # errors of 0.5 deg are linear to a hundredth
    assert (comparison.cycles, comparison.more_refused, comparison.is_worse) == (0.9, 2, True)
    back = compare(small, large)
    assert (back.cycles, back.more_refused, back.is_worse) == (pytest.approx(10 / 9), -2, True)


def test_a_larger_error_in_one_family_is_a_regression(small: Judged) -> None:
    comparison = compare(judge(Truth(0.1, twice_in="points"), "judged"), small)
    assert comparison.error == Estimate(1.0, 1.0, 1.0)
    assert comparison.families["rig"] == Estimate(1.0, 1.0, 1.0)
    assert comparison.families["points"].value == pytest.approx(2.0, abs=0.01)  # linear, as above
    assert comparison.is_worse


def test_an_entry_without_cycles_is_drawn_at_the_edge(small: Judged, large: Judged) -> None:
    without = judge(Truth(0.3, cycles=None), "against")
    text = page(document(small, [], {}, without))
    drawing = text.partition("<svg viewBox")[2].partition("</svg>")[0]
    assert drawing.count("data-row") == 2
    assert "no cycles" in drawing
    assert "no cycles" not in page(document(small, [], {}, large)), "all have cycles"


def test_other_entries_are_ranked_by_the_larger_error_of_both_default_clouds(small: Judged, large: Judged) -> None:
    unusable = judge(Truth(np.nan), "hiltest")
    roles = [entry.role for entry in document(small, [unusable, large, small], {}).entries]
    assert roles == ["judged", "judged", "against", "hiltest"]


@pytest.mark.parametrize(("refused", "error"), [(0, 2.0), (50, 2.0), (51, math.inf)])
def test_an_entry_without_an_answer_in_more_than_half_of_a_default_cloud_has_no_rank(
    small: Judged, refused: int, error: float
) -> None:
    half = {"rms": Estimate(2.0, None, None), "refused": refused // 2, "no_ellipsoid": refused - refused // 2}
    changes = {RIG: {"rms": Estimate(1.0, None, None)}, HALF_SPHERE: half}
    families = [replace(family, **changes.get(family.family, {})) for family in small.result.families]
    assert replace(small.result, families=tuple(families)).rank_error == error


def test_cycles_of_another_compiler_or_an_unknown_one_are_not_ranked(small: Judged, large: Judged) -> None:
    for built_by in ("zig 0.14.0 -O2", "", "-O2 -mthumb"):
        other = Judged(replace(large.result, built_by=built_by), large.ratings)
        assert compare(small, other).cycles is None
        assert compare(other, other).cycles == (1.0 if built_by.startswith("zig") else None)


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        ({}, 0),
        ({"cycles": 1000.0, "refused": 0.0}, 0),
        ({"cycles": 999.0}, 1),
        ({"bound.p99": 1e-3}, 1),
        ({"us": 100.0}, 22),
        ({"us": 100.0, "cycles": 999.0}, 1),
    ],
    ids=["none", "held", "cycles", "bound", "not measured", "both"],
)
def test_limits_decide_the_exit_code(small: Judged, limits: dict[str, float], code: int) -> None:
    result = document(small, [], limits)
    assert result.exit_code == code
    assert [(limit.name, limit.most) for limit in result.limits] == list(limits.items())
    passes = code == 0 and limits != {}
    assert result.sentence.startswith("PASS") == passes, "without a limit there is no verdict"


def test_more_cycles_than_the_other_are_a_regression_but_a_missed_limit_comes_first(
    small: Judged, large: Judged
) -> None:
    assert document(small, [], {}, large).exit_code == 21
    assert document(small, [], {"cycles": 1.0}, large).exit_code == 1
    assert document(small, [], {}, small).exit_code == 0


def test_a_limit_of_no_value_is_refused_with_a_near_name(small: Judged) -> None:
    with pytest.raises(ConfigError, match=r"--limit bound\.p9: no such value; did you mean 'bound\.p99'"):
        list(check_limits(limit_values(small.result), {"bound.p9": 1.0}))
