"""Steps are what the comparison calls a change, between neighbours of the same conditions and nowhere else."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace

import pytest

from hiltest.measurement import Limit, Tolerance, check
from hiltest.report.trend.series import ChangePoint, Trend, trend_of
from hiltest.report.trend.words import sentence
from hiltest.run_record.comparison import Change

from .entries import cycles, degrees, entry


def steps_of(trend: Trend) -> list[tuple[int, int, Change]]:
    return [(step.before, step.after, step.difference.change) for step in reversed(trend.change_points)]


def test_one_cycle_more_is_a_step_where_it_happened_and_only_there() -> None:
    trend = trend_of([entry(day, cycles(11_061 if day < 4 else 11_062)) for day in range(1, 7)])
    assert steps_of(trend) == [(2, 3, Change.WORSE)]
    (measured,) = trend.measured
    assert [point.value for point in measured.series[0].points] == [11_061] * 3 + [11_062] * 3
    assert trend.change_points[0].difference.delta == 1


def test_entries_stand_in_the_order_of_time_whatever_order_they_were_found_in() -> None:
    entries = [entry(day, cycles(11_000 + day), file=f"{9 - day}.json") for day in range(1, 10)]
    random.Random(5).shuffle(entries)
    trend = trend_of(entries)
    assert [entry_.when_utc[8:10] for entry_ in trend.entries] == [f"{day:02d}" for day in range(1, 10)]
    assert steps_of(trend) == [(index, index + 1, Change.WORSE) for index in range(8)]


def test_a_change_within_the_tolerance_is_no_step_and_beyond_it_is_one() -> None:
    tolerances = {"heading.direct.max": Tolerance(0.05, 0.0)}
    values = {1: 0.80, 2: 0.84, 3: 0.90, 4: 0.70}
    trend = trend_of([entry(day, degrees(value), tolerances=tolerances) for day, value in values.items()])
    assert steps_of(trend) == [(1, 2, Change.WORSE), (2, 3, Change.BETTER)]


def test_a_fact_that_changed_is_neither_better_nor_worse() -> None:
    name = "heading.direct.worst_sector"
    trend = trend_of([entry(1, degrees(200, name)), entry(2, degrees(230, name))])
    assert steps_of(trend) == [(0, 1, Change.CHANGED)]


@pytest.mark.parametrize(
    "other", [{"model": "cortex-m4-trm/1@sram"}, {"rig": "bb"}, {"poses": "level"}, {"seeds": {2: (cycles(11_961),)}}]
)
def test_other_conditions_are_a_line_of_their_own_and_never_compared(other: Mapping[str, object]) -> None:
    model = str(other.get("model", "cortex-m4-trm/3@sram"))
    target = {"seeds": other["seeds"]} if "seeds" in other else {}
    trend = trend_of(
        [
            entry(1, cycles(11_061)),
            entry(2, cycles(11_961, model=model), **(dict(other) | target)),  # type: ignore[arg-type]
            entry(3, cycles(11_061)),
            entry(4, cycles(11_061)),
        ]
    )
    assert steps_of(trend) == []
    (measured,) = trend.measured
    assert [[point.entry for point in series.points] for series in measured.series] == [[0, 2, 3], [1]]
    assert trend.line_of == (0, 1, 0, 0)


def test_another_model_of_the_number_itself_is_not_joined_either() -> None:
    trend = trend_of([entry(1, cycles(100, model="a")), entry(2, cycles(200, model="b"))])
    assert steps_of(trend) == []
    assert [series.cycle_model for series in trend.measured[0].series] == ["a", "b"]


def test_a_number_in_another_unit_is_another_measurement() -> None:
    trend = trend_of([entry(1, check("x", 1, unit="deg")), entry(2, check("x", 60, unit="arcmin"))])
    assert steps_of(trend) == []
    assert [(series.name, series.unit) for series in trend.measured] == [("x", "arcmin"), ("x", "deg")]


def test_a_compiler_that_changed_does_not_hide_a_step() -> None:
    trend = trend_of([entry(1, cycles(11_061)), entry(2, cycles(10_000), compiler="GCC 14")])
    assert steps_of(trend) == [(0, 1, Change.BETTER)]


def test_a_run_without_the_number_is_passed_over() -> None:
    trend = trend_of([entry(1, cycles(11_061)), entry(2, degrees(1.0)), entry(3, cycles(11_161))])
    assert steps_of(trend) == [(0, 2, Change.WORSE)]


def test_a_limit_that_was_moved_is_no_step_of_what_it_limits() -> None:
    trend = trend_of([entry(1, cycles(11_061)), entry(2, cycles(11_061, limit=11_000)), entry(3, cycles(11_061))])
    assert steps_of(trend) == []
    points = trend.measured[0].series[0].points
    assert [(str(point.limit), point.outcome) for point in points] == [
        ("at most 12 500", "pass"),
        ("at most 11 000", "fail"),
        ("at most 12 500", "pass"),
    ]


def test_who_does_not_know_the_limit_does_not_say_that_there_is_none() -> None:
    seeds = {1: (cycles(11_061, limit=None),), 2: (cycles(11_061, limit=None),)}
    of_other_seeds = replace(entry(2, seeds=seeds), knows_limits=False)
    trend = trend_of([entry(1, cycles(11_061)), of_other_seeds])
    assert str(trend.measured[0].limit) == "at most 12 500"
    assert trend_of([of_other_seeds]).measured[0].limit is None


def test_a_number_within_its_tolerance_is_no_step_for_a_limit_that_it_misses_now() -> None:
    before, after = (
        check("heading.direct.max", value, unit="deg", limit=Limit(max=most))
        for value, most in ((1.0, 1.8), (1.001, 1.0005))
    )
    assert (before.outcome, after.outcome) == ("pass", "fail")
    assert steps_of(trend_of([entry(1, before), entry(2, after), entry(3, before)])) == []


def test_a_step_out_of_the_limit_says_that_it_fails() -> None:
    trend = trend_of([entry(1, cycles(11_061)), entry(2, cycles(13_000))])
    assert trend.change_points[0].difference.outcome == "fail"
    assert trend.measured[0].limit is not None


def test_what_is_volatile_or_no_number_has_no_trend() -> None:
    trend = trend_of(
        [
            entry(
                1,
                check("board.wall_seconds", 8.1, unit="s", volatile=True),
                check("a", None, unit="deg"),
                check("b", float("nan"), unit="deg"),
            ),
        ]
    )
    assert trend.measured == ()


def test_a_campaign_is_one_point_with_its_spread_and_its_paired_change() -> None:
    def campaign(day: int, more: float) -> object:
        return entry(day, seeds={seed: (degrees(0.5 + 0.1 * seed + more),) for seed in range(1, 11)})

    trend = trend_of([campaign(1, 0.0), campaign(2, 0.2)])  # type: ignore[list-item]
    first, second = trend.measured[0].series[0].points
    assert (first.value, first.low, first.high) == pytest.approx((1.05, 0.6, 1.5))
    assert second.value - first.value == pytest.approx(0.2)
    (step,) = trend.change_points
    assert step.difference.seeds == 10
    assert step.difference.interval == pytest.approx((0.2, 0.2))


def test_steps_of_all_measurements_are_listed_newest_first() -> None:
    def both(day: int, one: float, other: float) -> object:
        return entry(day, cycles(one), degrees(other))

    trend = trend_of([both(1, 100, 1.0), both(2, 200, 1.0), both(3, 200, 2.0)])  # type: ignore[list-item]
    assert [step.difference.name for step in trend.change_points] == ["heading.direct.max", "cycles.direct.total"]
    assert all(isinstance(step, ChangePoint) for step in trend.change_points)


def test_of_one_run_what_got_worse_stands_first_and_the_farthest_before_all() -> None:
    names = {"fit.a.residual": 0.5, "heading.a.max": 1.0, "heading.b.max": 1.5, "heading.a.worst_sector": 30.0}
    before = [cycles(11_000), *(degrees(0.9, name) for name in names)]
    after = [cycles(10_000), *(degrees(value, name) for name, value in names.items())]
    trend = trend_of([entry(1, *before), entry(2, *after)])
    assert [step.difference.name for step in trend.change_points] == [
        "heading.b.max",
        "heading.a.max",
        "fit.a.residual",
        "cycles.direct.total",
        "heading.a.worst_sector",
    ]
    assert "the last in run 2: heading.b.max 0.9 -> 1.5 deg" in sentence(trend)
