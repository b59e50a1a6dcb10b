"""A difference in words: what it was and is, by how much it moved, and its limit."""

from __future__ import annotations

import pytest

from hiltest.measurement import Limit, Measurement, check
from hiltest.report.comparison_overview import change_figure, changed
from hiltest.run_record.comparison import Change
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import Evidence
from hiltest.verdict.wording import SHOWN, counted_by, models_shown, moved, numbers, percent, shown

from .evidence import evidence, measurement, over_seeds


def test_all_of_it_stands_in_one_line() -> None:
    limit = Limit(max=12_500)
    base, new = (over_seeds("cycles.direct.total", value, limit=limit, unit="cycle") for value in (11_061, 11_161))
    (difference,) = compare(base, new).differences
    assert numbers(difference) == "11 061 -> 11 161 cycles (+100, +0.9 %; limit at most 12 500)"


@pytest.mark.parametrize(
    ("was", "now", "words"),
    [
        (300, 60, "300 -> 60 deg (+120)"),
        (30, 330, "30 -> 330 deg (-60)"),
        (0, 180, "0 -> 180 deg (+180)"),
        (200, 230, "200 -> 230 deg (+30)"),
    ],
)
def test_a_direction_moves_the_short_way_round_and_by_no_percentage(was: float, now: float, words: str) -> None:
    base, new = (over_seeds("heading.direct.worst_sector", item, unit="deg") for item in (was, now))
    comparison = compare(base, new)
    assert [numbers(difference) for difference in comparison.differences_with(Change.CHANGED)] == [words]
    assert change_figure(comparison) is None


def of_a_calibrator(cost: str, value: float, *more: tuple[str, float | None]) -> Evidence:
    """Return a side with a cost and what else of the calibrator was measured."""
    others = [measurement(name, number, unit="deg") for name, number in more]
    return evidence([measurement(cost, value, unit="cycle"), *others])


def test_what_a_calibrator_costs_is_never_told_without_what_its_worst_heading_did() -> None:
    base = of_a_calibrator("cycles.direct-fast.total", 6919, ("heading.direct-fast.max", 0.8905))
    new = of_a_calibrator("cycles.direct-fast.total", 6800, ("heading.direct-fast.max", 1.204))
    comparison = compare(base, new)
    words = "6 919 -> 6 800 cycles (-119, -1.7 %; heading.direct-fast.max 0.89 -> 1.20 deg)"
    assert numbers(comparison.differences_with(Change.BETTER)[0]) == words
    assert words in comparison.sentence
    (cheaper,) = (item for item in changed(comparison) if item.name == "cycles.direct-fast.total")
    assert "heading.direct-fast.max 0.89 -> 1.20 deg" in cheaper.outcome
    back = compare(new, base)
    assert "6 800 -> 6 919 cycles (+119, +1.8 %; heading.direct-fast.max 1.20 -> 0.89 deg)" in back.sentence


def counted(model: str, name: str, cycles: float, limit: Limit | None = None) -> Measurement:
    return check(name, cycles, unit="cycle", cycle_model=model, limit=limit)


def test_every_model_that_counted_cycles_that_are_shown_is_named_and_no_other() -> None:
    same = counted("dwt", "cycles.direct.fixed", 5)
    old, new = (
        evidence([counted("m@sram", "cycles.direct.total", 10), counted("m@flash", "crc32.cycles", cycles), same])
        for cycles in (10, 20)
    )
    assert counted_by(models_shown(compare(old, new))) == "cycles counted by m@flash"
    assert models_shown(compare(old, old)) == set(), "what is unchanged is only counted"
    missed = evidence([counted("m@sram", "cycles.direct.total", 10, Limit(max=9)), same])
    assert models_shown(compare(missed, missed)) == {"m@sram"}, "a limit that is missed is named, unchanged as it is"


def test_a_comparison_without_cycles_names_no_model() -> None:
    base, new = (over_seeds("heading.direct.max", value, unit="deg") for value in (1.0, 2.0))
    assert counted_by(models_shown(compare(base, new))) == ""


@pytest.mark.parametrize(
    ("cost", "was", "now"),
    [("cycles.direct.total", 0.9, None), ("cycles.direct.total", None, 0.9), ("cycles.fusion.update", 0.9, 0.9)],
)
def test_without_a_worst_heading_on_both_sides_the_cost_stands_alone(
    cost: str, was: float | None, now: float | None
) -> None:
    base, new = (
        of_a_calibrator(cost, value, ("heading.direct.max", number)) for value, number in ((10, was), (9, now))
    )
    assert [difference.note for difference in compare(base, new).differences_with(Change.BETTER)] == [""]


@pytest.mark.parametrize(
    ("base", "new", "words"),
    [
        (81.35, 238.9, "+157.6, +194 %"),
        (2.0, 2.0, "+0, +0 %"),
        (0.0, 0.3, "+0.3"),
        (-0.1, 0.2, "+0.3"),
        (-0.1, -0.2, "-0.1, -100 %"),
        (1.0, 1001.0, "+1 000"),
        (10.0, 9.95, "-0.05, -0.5 %"),
        (1e-300, 1e10, "+10 000 000 000"),
        (1.0, 11.0, "+10, +1 000 %"),
        (0.0004, 1.6496, "+1.649"),
    ],
)
def test_percent_are_given_where_they_mean_something(base: float, new: float, words: str) -> None:
    (difference,) = compare(over_seeds("compass.lag", base), over_seeds("compass.lag", new)).differences
    assert moved(difference) == words


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (412_300.0, "beyond +1 000 %"),
        (-1_001.0, "beyond -1 000 %"),
        (1_000.0, "+1 000 %"),
        (0.94, "+0.94 %"),
        (-100.0, "-100 %"),
        (float("inf"), "beyond +1 000 %"),
    ],
)
def test_a_share_of_next_to_nothing_is_cut(share: float, words: str) -> None:
    assert percent(share) == words


def test_over_eight_seeds_the_interval_is_shown() -> None:
    base = over_seeds("heading.direct.max", *[0.9] * 8, unit="deg")
    new = over_seeds("heading.direct.max", *(1.2 + step / 100 for step in range(8)), unit="deg")
    (difference,) = compare(base, new).differences
    assert numbers(difference) == "0.9 -> 1.235 deg (+0.335, 34 times its tolerance, 95 % +0.3145 to +0.3555)"


def test_what_is_new_or_gone_shows_its_one_number() -> None:
    base = evidence([measurement("compass.lag", 8.0, unit="ms")])
    new = evidence([measurement("compass.drift", 0.5, unit="deg", limit=Limit(max=1.0))])
    gone, result = sorted(compare(base, new).differences, key=lambda difference: difference.change)
    assert (numbers(gone), numbers(result)) == ("8 ms", "0.5 deg (limit at most 1)")


def test_groups_come_in_one_order_and_none_is_empty() -> None:
    names = ("cycles.a.total", "cycles.b.total", "heading.direct.worst_sector", "tumble.points", "link.retried")
    base = evidence([measurement(name, value) for name, value in zip(names, (5, 5, 30.0, 300, None), strict=True)])
    new = evidence([measurement(name, value) for name, value in zip(names, (6, 4, 60.0, None, 0), strict=True)])
    groups = [change for change, _ in shown(compare(base, new))]
    assert groups == list(SHOWN) == ["worse", "gone", "better", "new", "changed"]
    assert shown(compare(base, base)) == []
