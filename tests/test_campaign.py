"""Many seeds summed up: spreads, sentence and exit code, from results written by hand."""

from __future__ import annotations

from fnmatch import fnmatchcase

import pytest

from hiltest.campaign import SeedResult, campaign_exit_code, campaign_sentence, spreads_of
from hiltest.comparison.model import Change, Comparison, Difference, Sense, Side, Tolerance
from hiltest.measurement import Limit, judge


def result(seed: int, heading_deg: float, exit_code: int = 0) -> SeedResult:
    measurements = (
        judge("heading.direct.max", heading_deg, unit="deg", limit=Limit(max=1.8)),
        judge("heading.uncalibrated.max", 10.0, unit="deg"),
        judge("board.wall_seconds", 5.0 + seed, unit="s", volatile=True),
        judge("fit.direct.offset_error", None, unit="uT"),
    )
    return SeedResult(seed, exit_code, "sentence", measurements)


def test_spreads_are_over_the_seeds_that_have_a_number() -> None:
    spreads = spreads_of([result(1, 0.9), result(2, 1.9, 1), result(3, 1.1), SeedResult(4, 20, "lost")])
    assert [spread.name for spread in spreads] == ["heading.direct.max", "heading.uncalibrated.max"]
    heading = spreads[0]
    assert (heading.n, heading.min, heading.median, heading.max) == (3, 0.9, 1.1, 1.9)
    assert heading.failed_seeds == (2,)


@pytest.mark.parametrize(
    ("codes", "may_fail", "code"),
    [
        ([0, 0, 0], 0, 0),
        ([0, 1, 0], 0, 1),
        ([0, 1, 0], 1, 0),
        ([1, 1, 0], 1, 1),
        ([1, 20, 0], 5, 20),
        ([20, 23], 0, 23),
        ([22, 0], 1, 22),
        ([1, 4], 5, 4),
        ([0, -9], 5, -9),
    ],
)
def test_only_a_missed_limit_may_be_allowed(codes: list[int], may_fail: int, code: int) -> None:
    results = [SeedResult(seed, each, "") for seed, each in enumerate(codes)]
    assert campaign_exit_code(results, may_fail=may_fail) == code


@pytest.mark.parametrize(
    ("codes", "change", "obstacles", "code", "ending"),
    [
        ([0, 0], Change.UNCHANGED, (), 0, ": PASS. Against base.json: 1 unchanged: may be merged."),
        ([0, 0], Change.WORSE, (), 21, ": REGRESSION. Against base.json: 1 worse: *(+0.2*): not to be merged."),
        ([0, 0], Change.WORSE, ("no seed in common",), 22, ": NOT JUDGED. Not compared with base.json: no seed *."),
        ([0, 1], Change.WORSE, (), 1, ": FAIL. Against base.json: 1 worse: *: not to be merged."),
        ([0, 20], Change.UNCHANGED, ("seed 2: lost",), 20, ": FAIL. Not compared with base.json: seed 2: lost."),
    ],
)
def test_a_comparison_decides_where_the_seeds_have_not(
    codes: list[int], change: Change, obstacles: tuple[str, ...], code: int, ending: str
) -> None:
    results = [SeedResult(seed, each, "") for seed, each in enumerate(codes, 1)]
    side = Side("base.json", "", "", "", "", "", "", "", (1, 2), "")
    difference = Difference(
        "heading.direct.max", "deg", change, Sense.SMALLER, 1.0, 1.2, 0.2, None, 2, Tolerance(0.01, 0.01), None, "", "",
    )
    comparison = Comparison(side, side, (difference,), obstacles, "")
    assert campaign_exit_code(results, may_fail=0, comparison=comparison) == code
    sentence = campaign_sentence(results, [], may_fail=0, comparison=comparison)
    assert fnmatchcase(sentence, f"* of 2 seeds pass*{ending}"), sentence


def test_the_sentence_says_how_many_passed_and_the_worst() -> None:
    results = [result(1, 0.9), result(2, 1.9, 1), result(3, 1.1)]
    assert campaign_sentence(results, spreads_of(results), may_fail=1) == (
        "2 of 3 seeds pass (not: 2), 1 may fail; heading.direct.max median 1.10, worst 1.90 deg: PASS."
    )
    assert campaign_sentence(results, spreads_of(results), may_fail=0).endswith(": FAIL.")
