"""What counts as better, worse, new, gone and unchanged."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.errors import LIKELY_CAUSE, NOT_CALIBRATED
from hiltest.measurement import (
    EXACT,
    Better,
    Limit,
    Measurement,
    Outcome,
    Tolerance,
    cannot_be_ranked,
)
from hiltest.run_record.comparison import Answer, Change, Difference
from hiltest.run_record.exit_codes import comparison_code
from hiltest.run_record.run import Column, Table
from hiltest.verdict.compare import compare, not_compared
from hiltest.verdict.evidence import Evidence

from .evidence import CONDITIONS, evidence, measurement, over_seeds

NAMES = (
    "cycles.direct.total",
    "cycles.direct.per_point",
    "heading.direct.max",
    "heading.direct.bias",
    "heading.direct.worst_sector",
    "tumble.coverage",
    "fit.direct.status",
    "compass.declination",
)
OPPOSITE = {
    Change.BETTER: Change.WORSE,
    Change.WORSE: Change.BETTER,
    Change.NEW: Change.GONE,
    Change.GONE: Change.NEW,
    Change.UNCHANGED: Change.UNCHANGED,
    Change.CHANGED: Change.CHANGED,
}

ABSENT = "absent"
# Near to each other often enough to lie within a tolerance.
cells = st.one_of(
    st.sampled_from([ABSENT, None, 0, 1.0, 1.005, 1.5, -1.0]), st.integers(-(10**6), 10**6), st.floats(-2.0, 2.0)
)
limits = st.sampled_from([None, Limit(max=1.2), Limit(min=-0.5), Limit.within(1.2)])


@st.composite
def pairs_of_runs(draw: st.DrawFn) -> tuple[Evidence, Evidence]:
    """Return two sides with a measurement of one name, or without it, on each seed, each judged by one limit."""
    name, seeds, limit = draw(st.sampled_from(NAMES)), draw(st.sampled_from([1, 2, 8])), draw(limits)
    values = st.lists(cells, min_size=seeds, max_size=seeds)
    base, new = (evidence(*(cell_of(name, cell, limit) for cell in draw(values))) for _ in range(2))
    return base, new


def cell_of(name: str, cell: float | str | None, limit: Limit | None = None) -> list[Measurement]:
    """Return a measurement as a run judges it, or none."""
    if isinstance(cell, str):
        return []
    if limit is None:
        return [measurement(name, cell)]
    passes = cell is not None and limit.holds(cell)
    return [measurement(name, cell, limit=limit, outcome=Outcome.PASS if passes else Outcome.FAIL)]


def judged(name: str, *values: float | None, limit: Limit) -> Evidence:
    """Return a side over seeds 1, 2, ..., each judged by a limit."""
    return evidence(*(cell_of(name, value, limit) for value in values))


def newly_out(base: Evidence, new: Evidence, name: str) -> bool:
    """Say whether a seed fails now that did not before: one that was made, or has no number now."""
    pairs = [(base.measurements[seed].get(name), new.measurements[seed].get(name)) for seed in base.measurements]
    return any(
        now is not None and fails(now) and (now.value is None if was is None else not fails(was)) for was, now in pairs
    )


def fails(measurement: Measurement) -> bool:
    return measurement.outcome is Outcome.FAIL


def only(base: Evidence, new: Evidence) -> Difference:
    """Return the one difference between two sides."""
    (difference,) = compare(base, new).differences
    return difference


def missing(base: Evidence, new: Evidence, name: str) -> list[int | None]:
    """Return the seeds on which only the base has a number of this name."""
    seeds = [seed for seed in base.measurements if value(base, seed, name) is not None]
    return [seed for seed in seeds if value(new, seed, name) is None]


def value(side: Evidence, seed: int | None, name: str) -> float | None:
    cell = side.measurements[seed].get(name)
    return None if cell is None else cell.value


@given(pairs_of_runs())
def test_a_run_compared_with_itself_has_only_unchanged(pair: tuple[Evidence, Evidence]) -> None:
    run, _ = pair
    comparison = compare(run, run)
    assert {difference.change for difference in comparison.differences} <= {Change.UNCHANGED}
    assert not comparison.regression
    assert comparison.evaluated == any(difference.seeds for difference in comparison.differences)


@given(pairs_of_runs())
def test_swapping_the_sides_swaps_better_and_worse_and_new_and_gone(pair: tuple[Evidence, Evidence]) -> None:
    base, new = pair
    there = {difference.name: difference for difference in compare(base, new).differences}
    back = {difference.name: difference for difference in compare(new, base).differences}
    assert there.keys() == back.keys()
    for name, difference in there.items():
        lost, gained = missing(base, new, name), missing(new, base, name)
        assert (difference.change is Change.GONE, back[name].change is Change.GONE) == (bool(lost), bool(gained)), name
        if newly_out(base, new, name):
            assert difference.change is (Change.GONE if lost else Change.WORSE), name
        elif "alone" in difference.note + back[name].note:
            # One seed that got worse counts, whichever way the mean went.
            assert Change.UNCHANGED not in (difference.change, back[name].change), name
        elif not newly_out(new, base, name) and not (difference.seeds and (lost or gained)) and not (lost and gained):
            # Else it went out of its limit the other way, or is there on some seeds alone.
            assert back[name].change is OPPOSITE[difference.change], name
        assert difference.delta is None or back[name].delta == -difference.delta


@given(pairs_of_runs())
def test_what_the_base_has_and_the_new_run_has_not_always_keeps_the_gate_from_being_evaluated(
    pair: tuple[Evidence, Evidence],
) -> None:
    base, new = pair
    comparison = compare(base, new)
    gone = [name for name in NAMES if missing(base, new, name)]
    assert comparison.evaluated == (not gone and any(difference.seeds for difference in comparison.differences))
    assert {difference.name for difference in comparison.differences_with(Change.GONE)} == set(gone)
    assert not (gone and comparison.regression)


@pytest.mark.parametrize(
    ("base", "new", "change"),
    [
        (1.0, 1.1, Change.UNCHANGED),
        (1.0, 1.1000001, Change.WORSE),  # at the absolute tolerance, and beyond
        (1.0, 0.9, Change.UNCHANGED),
        (1.1, 0.9999999, Change.BETTER),
        (10.0, 10.5, Change.UNCHANGED),
        (10.0, 10.501, Change.WORSE),  # at the relative one, and beyond
        (10.0, 10.2, Change.UNCHANGED),  # beyond the absolute one alone
        (0.1, 0.15, Change.UNCHANGED),  # beyond the relative one alone
        (0.0, 0.1, Change.UNCHANGED),
        (0.0, 0.11, Change.WORSE),
    ],
)
def test_worse_is_what_is_beyond_both_tolerances(base: float, new: float, change: Change) -> None:
    name = "heading.direct.max"
    tolerances = {name: Tolerance(0.1, 0.05)}
    before, after = over_seeds(name, base), replace(over_seeds(name, new), tolerances=tolerances)
    (difference,) = compare(before, after).differences
    assert difference.change is change
    assert difference.tolerance == tolerances[name]


@pytest.mark.parametrize("name", [f"heading.direct.{name}" for name in ("max", "max_centred", "rms", "bias")])
@pytest.mark.parametrize(
    ("base", "new", "change"),
    [
        (0.5, 0.509, Change.UNCHANGED),
        (0.5, 0.511, Change.WORSE),
        (0.511, 0.5, Change.BETTER),
        (3.0, 3.029, Change.UNCHANGED),
        (3.0, 3.031, Change.WORSE),
        (3.031, 3.0, Change.BETTER),
    ],
)
def test_a_heading_may_move_by_a_hundredth_of_a_degree_or_of_itself(
    name: str, base: float, new: float, change: Change
) -> None:
    """Roundings in another order move it by less than a hundredth of that: more is the firmware's doing."""
    assert only(over_seeds(name, base), over_seeds(name, new)).change is change


def test_what_is_counted_may_move_by_all_of_its_tolerance() -> None:
    name = "cycles.direct.total"
    for new, change in ((105, Change.UNCHANGED), (106, Change.WORSE), (95, Change.UNCHANGED), (94, Change.BETTER)):
        difference = only(over_seeds(name, 100), replace(over_seeds(name, new), tolerances={name: Tolerance(5, 0)}))
        assert difference.change is change


def test_the_last_written_digit_is_no_difference() -> None:
    name = "compass.strength"
    assert only(over_seeds(name, 48.6101624), over_seeds(name, 48.6101625)).change is Change.UNCHANGED
    assert only(over_seeds(name, 48.6101624), over_seeds(name, 48.6101634)).change is Change.CHANGED


@pytest.mark.parametrize(
    ("limit", "sense", "change"),
    [
        (Limit(max=9), Better.LOWER, Change.WORSE),
        (Limit(min=1), Better.HIGHER, Change.BETTER),
        (Limit.within(9), Better.NEARER_ZERO, Change.WORSE),
        (Limit(1, 9), Better.NEITHER, Change.CHANGED),
        (None, Better.NEITHER, Change.CHANGED),
    ],
)
def test_the_limit_says_which_way_a_measurement_of_one_s_own_gets_better(
    limit: Limit | None, sense: Better, change: Change
) -> None:
    difference = only(over_seeds("compass.lag", 4.0, limit=limit), over_seeds("compass.lag", 4.001, limit=limit))
    assert (difference.sense, difference.change, difference.limit) == (sense, change, limit)


def test_a_limit_that_the_change_under_test_drops_still_says_which_way_is_better() -> None:
    base, new = over_seeds("compass.lag", 4.0, limit=Limit(max=9)), over_seeds("compass.lag", 5.0)
    difference = only(base, new)
    assert (difference.change, difference.sense) == (Change.WORSE, Better.LOWER)
    assert difference.note == "its limit was at most 9, and was removed"


def test_a_bias_that_only_turns_its_sign_is_neither_better_nor_worse() -> None:
    difference = only(over_seeds("heading.direct.bias", -0.3), over_seeds("heading.direct.bias", 0.3))
    assert (difference.change, difference.delta) == (Change.CHANGED, 0.6)
    assert only(over_seeds("heading.direct.bias", 0.02), over_seeds("heading.direct.bias", -0.3)).change is Change.WORSE
    assert only(over_seeds("heading.direct.bias", -0.3), over_seeds("heading.direct.bias", 0.02)).change == "better"


def test_from_eight_pairs_on_a_degree_is_worse_only_if_its_interval_excludes_zero() -> None:
    base = [0.9] * 8
    scattered = [0.9 + change for change in (0.5, -0.4, 0.3, -0.2, 0.1, -0.1, 0.2, -0.1)]
    certain = [0.9 + change for change in (0.05, 0.03, 0.04, 0.02, 0.05, 0.03, 0.04, 0.04)]
    difference = only(over_seeds("heading.direct.max", *base), over_seeds("heading.direct.max", *scattered))
    assert difference.change is Change.UNCHANGED
    assert difference.delta == pytest.approx(0.0375)
    assert difference.interval is not None
    assert difference.interval[0] < 0 < difference.interval[1]
    assert "seeds" in difference.note
    difference = only(over_seeds("heading.direct.max", *base), over_seeds("heading.direct.max", *certain))
    assert (difference.change, difference.delta, difference.seeds) == (Change.WORSE, 0.0375, 8)
    assert difference.interval is not None
    assert 0.028 < difference.interval[0] < difference.delta < difference.interval[1] < 0.047
    # With one seed less there is no interval, and the mean alone counts.
    difference = only(over_seeds("heading.direct.max", *base[:7]), over_seeds("heading.direct.max", *scattered[:7]))
    assert (difference.change, difference.interval) == (Change.WORSE, None)


@pytest.mark.parametrize(
    ("name", "way", "back"),
    [
        ("heading.direct.rms", Change.WORSE, Change.BETTER),
        ("heading.direct.bias", Change.WORSE, Change.BETTER),
        ("tumble.coverage", Change.BETTER, Change.WORSE),
        ("fit.direct.strength", Change.CHANGED, Change.CHANGED),
    ],
)
@pytest.mark.parametrize("seeds", [7, 8, 100])
def test_a_seed_that_moves_alone_is_never_lost_in_the_mean(name: str, way: Change, back: Change, seeds: int) -> None:
    base, new = over_seeds(name, *[0.5] * seeds), over_seeds(name, 0.5, 0.5, 90.0, *[0.5] * (seeds - 3))
    assert (only(base, new).change, only(new, base).change) == (way, back)
    assert "alone on seed 3" in only(base, new).note


def test_a_seed_that_got_worse_alone_is_not_made_up_for_by_another() -> None:
    name = "heading.direct.rms"
    base, new = over_seeds(name, 90.0, *[0.5] * 7), over_seeds(name, *[0.5] * 7, 90.0)
    assert (only(base, new).change, only(base, new).note) == (Change.WORSE, "moved alone on seed 8")
    assert (only(new, base).change, only(new, base).note) == (Change.WORSE, "moved alone on seed 1")


@pytest.mark.parametrize(("moved", "change"), [(0.1, Change.UNCHANGED), (0.1001, Change.WORSE)])
def test_alone_is_beyond_ten_tolerances(moved: float, change: Change) -> None:
    name = "heading.direct.rms"
    base, new = over_seeds(name, *[0.0] * 9), over_seeds(name, *[0.0] * 8, moved)
    difference = only(base, replace(new, tolerances={name: Tolerance(0.01, 0.01)}))
    assert difference.change is change


def test_cycles_need_no_interval() -> None:
    base, new = [84_397] * 8, [84_397] * 7 + [97_146]
    difference = only(over_seeds("cycles.iterative.total", *base), over_seeds("cycles.iterative.total", *new))
    assert difference.change is Change.WORSE
    swapped = [97_146] + [84_397] * 7
    difference = only(over_seeds("cycles.iterative.total", *new), over_seeds("cycles.iterative.total", *swapped))
    assert (difference.change, difference.delta) == (Change.CHANGED, 0)


def test_seeds_are_paired_and_the_others_left_out() -> None:
    base = evidence([measurement("heading.direct.max", 0.9)], [measurement("heading.direct.max", 5.0)])
    new = evidence([measurement("heading.direct.max", 0.9)], [measurement("heading.direct.max", 50.0)], seeds=[1, 7])
    difference = only(base, new)
    assert (difference.change, difference.seeds, difference.base) == (Change.UNCHANGED, 1, 0.9)


@pytest.mark.parametrize("nothing", [None, float("nan"), float("inf")])
def test_what_is_no_number_never_makes_a_pass(nothing: float | None) -> None:
    name = "heading.direct.max"
    comparison = compare(over_seeds(name, 0.9), over_seeds(name, nothing))
    assert [difference.change for difference in comparison.differences] == [Change.GONE]
    assert not comparison.evaluated
    comparison = compare(over_seeds(name, 0.9, 0.8), over_seeds(name, 0.9, nothing))
    assert not comparison.evaluated
    assert "on seed 2" in comparison.obstacles[0]
    assert only(over_seeds(name, nothing), over_seeds(name, 0.9)).change is Change.NEW
    on_neither_side = compare(over_seeds(name, nothing), over_seeds(name, nothing)).differences
    assert [difference.change for difference in on_neither_side] == ([] if nothing is None else [Change.UNCHANGED])


@pytest.mark.parametrize(("base", "new"), [(1.7e308, -1.7e308), (1.0, 1.7e308), (1.7e308, 1.0), (1e101, 1e101)])
@pytest.mark.parametrize("seeds", [1, 8])
def test_a_number_that_is_too_large_to_compare_is_an_obstacle(base: float, new: float, seeds: int) -> None:
    name = "heading.direct.max"
    comparison = compare(over_seeds(name, *[base] * seeds), over_seeds(name, *[new] * seeds))
    assert comparison.obstacles[0].startswith(f"measurement missing: {name} (numbers beyond 1e+100 cannot")
    assert asdict(comparison)["differences"][0]["delta"] is None


def test_a_setting_of_a_sensor_may_not_change_either_way_and_comes_before_its_effects() -> None:
    setting, effect = "sensor.FXOS8700CQ.M_CTRL_REG1.set_up", "heading.direct.max"
    runs = {
        value: evidence(*[[measurement(setting, value), *cell_of(effect, degrees, Limit(max=2.0))]] * 2)
        for value, degrees in ((0x1F, 0.9), (0x03, 3.0))
    }
    there, back = compare(runs[0x1F], runs[0x03]), compare(runs[0x03], runs[0x1F])
    assert [row.name for row in there.differences_with(Change.WORSE)] == [setting, effect]
    assert "2 worse: FXOS8700CQ M_CTRL_REG1 0x03, was 0x1F: oversampling (after set-up), heading" in there.sentence
    assert [row.name for row in back.differences_with(Change.WORSE)] == [setting]


def test_a_base_without_settings_compares_none() -> None:
    heading = measurement("heading.direct.max", 0.9)
    base, new = evidence([heading]), evidence([heading, measurement("sensor.MAG3110.CTRL_REG1.set_up", 1)])
    comparison = compare(base, new)
    assert comparison.answer is Answer.MAY
    assert [row.name for row in comparison.differences_with(Change.NEW)] == ["sensor.MAG3110.CTRL_REG1.set_up"]


def test_volatile_measurements_are_never_compared() -> None:
    name = "board.wall_seconds"
    assert compare(over_seeds(name, 8.0, volatile=True), over_seeds(name, 80.0, volatile=True)).differences == ()
    assert compare(evidence([]), over_seeds(name, 80.0, volatile=True)).differences == ()
    # Calling it volatile is no way to get rid of it.
    comparison = compare(over_seeds("compass.lag", 8.0), over_seeds("compass.lag", 80.0, volatile=True))
    assert "volatile" in comparison.obstacles[0]


@pytest.mark.parametrize(
    ("model", "dearer", "tie"),
    [
        ("m@flash", 10_990, True),
        ("m@flash", 11_000, True),
        ("m@flash", 11_010, False),
        ("m@flash", 11_050, False),
        ("m@sram+flash", 10_900, True),
        ("m@sram", 10_900, False),
    ],
)
def test_a_comparison_ranks_counts_from_flash_where_a_report_does_and_both_ways_round(
    model: str, dearer: int, tie: bool
) -> None:
    cheap, dear = (
        replace(measurement("cycles.direct.total", cycles), cycle_model=model) for cycles in (10_000, dearer)
    )
    assert cannot_be_ranked(cheap, dear) is cannot_be_ranked(dear, cheap) is tie
    assert only(evidence([cheap]), evidence([dear])).change == ("unchanged" if tie else "worse")
    assert only(evidence([dear]), evidence([cheap])).change == ("unchanged" if tie else "better")


def test_another_unit_or_cycle_model_is_never_compared() -> None:
    comparison = compare(over_seeds("compass.lag", 8.0, unit="ms"), over_seeds("compass.lag", 8.0, unit="s"))
    assert comparison.differences[0].change is Change.GONE
    assert "the unit was 'ms', and is 's'" in comparison.obstacles[0]
    new = over_seeds("cycles.direct.total", 11_061)
    silicon = replace(new.measurements[1]["cycles.direct.total"], cycle_model="silicon-dwt")
    comparison = compare(new, replace(new, measurements={1: {"cycles.direct.total": silicon}}))
    assert comparison.differences[0].change is Change.GONE
    assert not comparison.evaluated


def test_passing_a_limit_is_worse_however_small_the_step() -> None:
    limit = Limit(max=1.8)
    within = over_seeds("heading.direct.max", 1.799, limit=limit, outcome=Outcome.PASS)
    out = over_seeds("heading.direct.max", 1.801, limit=limit, outcome=Outcome.FAIL)
    assert (only(within, out).change, only(within, out).note) == (Change.WORSE, "out of its limit")
    assert (only(out, within).change, only(out, within).note) == (Change.UNCHANGED, "within its limit again")


def test_one_seed_that_comes_within_its_limit_hides_nothing() -> None:
    name, limit = "heading.direct.max", Limit(max=1.8)
    base, new = judged(name, 1.81, *[0.5] * 7, limit=limit), judged(name, *[1.79] * 8, limit=limit)
    difference = only(base, new)
    assert (difference.change, difference.note) == (Change.WORSE, "within its limit again")


def test_a_limit_that_was_raised_makes_nothing_better() -> None:
    name = "heading.direct.max"
    difference = only(judged(name, 2.0, limit=Limit(max=1.8)), judged(name, 20.0, limit=Limit(max=30)))
    assert (difference.change, difference.note) == (
        Change.WORSE,
        "within its limit again; its limit was at most 1.8 in the base",
    )


def test_each_seed_that_goes_out_of_its_limit_counts_though_another_was_out_before() -> None:
    name, limit = "heading.direct.max", Limit(max=1.8)
    base, new = judged(name, 1.801, *[1.795] * 7, limit=limit), judged(name, *[1.804] * 8, limit=limit)
    difference = only(base, new)
    assert (difference.change, difference.note) == (Change.WORSE, "out of its limit on seed 2, 3, 4 and 4 more")
    assert only(new, new).change is Change.UNCHANGED


@pytest.mark.parametrize("base", [evidence([]), over_seeds("compass.lag", None)])
def test_a_limit_that_fails_without_a_number_is_worse_than_none_that_failed(base: Evidence) -> None:
    fails = over_seeds("compass.lag", float("nan"), limit=Limit(max=9), outcome=Outcome.FAIL)
    assert (only(base, fails).change, only(base, fails).note) == (Change.WORSE, "out of its limit")
    assert only(fails, fails).change is Change.UNCHANGED


def without(name: str, why: str) -> Measurement:
    return replace(measurement(name, None), outcome=Outcome.NOT_OFFERED, note=why)


def test_what_a_result_leaves_nothing_to_measure_of_is_changed_and_what_just_vanishes_is_gone() -> None:
    name, total = "cycles.corrected.per_iteration", "cycles.corrected.total"
    base = evidence([measurement(name, 1_663.0), measurement(total, 14_000)])
    comparison = compare(base, evidence([without(name, "it took 1 iteration"), measurement(total, 12_000)]))
    assert {difference.name: str(difference.change) for difference in comparison.differences} == {
        name: "changed",
        total: "better",
    }
    assert comparison.differences_with(Change.CHANGED)[0].note == "not offered: it took 1 iteration"
    assert comparison.evaluated
    for why in (
        "",
        "worst of 2 attempts",
        "worst of several attempts",
    ):  # no reason at all, and the remark of one that was measured twice
        comparison = compare(base, evidence([without(name, why), measurement(total, 12_000)]))
        assert comparison.obstacles[0].startswith(f"measurement missing: {name}")


def test_what_the_base_held_to_a_limit_is_gone_whatever_the_reason() -> None:
    base = over_seeds("heading.direct.max", 0.9, limit=Limit(max=1.8))
    comparison = compare(base, evidence([without("heading.direct.max", "nobody asked")]))
    assert comparison.obstacles[0].startswith("measurement missing: heading.direct.max (nobody asked; its limit was")
    assert comparison_code(comparison) == 22


def test_a_reason_on_one_seed_hides_nothing_of_the_others() -> None:
    name = "cycles.corrected.per_iteration"
    base, reason = over_seeds(name, 1_663.0, 1_663.0), without(name, "none was needed")
    difference = only(base, evidence([measurement(name, 1_663.0)], [reason]))
    assert (difference.change, difference.note, difference.seeds) == (
        Change.CHANGED,
        "not offered on seed 2: none was needed",
        1,
    )
    assert only(base, evidence([measurement(name, 9_999.0)], [reason])).change is Change.WORSE
    assert only(base, evidence([], [reason])).change is Change.GONE
    assert only(evidence([reason], [reason]), base).change is Change.NEW


def test_two_sides_without_a_number_in_common_are_not_compared() -> None:
    time = measurement("board.virtual_seconds", 3.0)
    new = evidence([measurement("heading.direct.max", 0.9), time])
    assert [difference.name for difference in compare(new, new).differences] == ["heading.direct.max"]
    for base in (evidence([]), evidence([time]), evidence([measurement("heading.direct.max", None), time])):
        comparison = compare(base, new)
        assert not comparison.evaluated
        assert comparison.obstacles[0].startswith("run.json and run.json have no number")


@pytest.mark.parametrize("board", ["virtual", "real"])
def test_a_calibration_that_the_base_had_in_the_same_tumble_is_lost_by_the_change(board: str) -> None:
    conditions = replace(CONDITIONS, board=board)
    base = evidence([measurement("device.calibrated_after", 2.25, unit="s")], conditions=conditions)
    cause = "too few directions. Give it more under [device]: tumbles, tumble_s."
    failed = f"test_heading.py::test_a ({NOT_CALIBRATED} in 1 tumble of 20 s{LIKELY_CAUSE}{cause}) on seed 1"
    comparison = compare(base, replace(evidence([], conditions=conditions), failed=(failed,)))
    assert comparison.answer is Answer.NOT
    worse = comparison.differences_with(Change.WORSE)
    if board == "real":
        assert comparison.failed == (failed,), "a hand tumbles in another way each time"
        assert not worse
        return
    change = "the change of the firmware, since the base calibrated itself after 2.25 s of the same tumble"
    assert comparison.failed == (failed.replace(cause, change),)
    assert [(difference.name, difference.base, difference.new, difference.note) for difference in worse] == [
        ("device.calibrated_after", 2.25, None, change)
    ]


def table_of_headings(*answered_deg: float, step_deg: float | None) -> Table:
    names = ("answered.firmware", "error.firmware", *(("step.firmware",) if step_deg is not None else ()))
    rows = tuple((answer, answer, step_deg)[: len(names)] for answer in answered_deg)
    return Table("heading.poses", tuple(Column(name, "deg") for name in names), rows)


ROUNDED = "whole degrees (multiples of 1 deg, in the base of 0.1 deg)"


@pytest.mark.parametrize(
    ("base", "new", "note"),
    [
        (table_of_headings(0.4, 359.7, step_deg=0.1), table_of_headings(0.0, 0.0, step_deg=1.0), ROUNDED),
        (table_of_headings(0.4, 359.7, step_deg=0.1), table_of_headings(0.0, 3.0, step_deg=1.0), ""),
        (table_of_headings(0.4, 359.7, step_deg=1.0), table_of_headings(0.0, 0.0, step_deg=1.0), ""),
        (table_of_headings(0.4, 359.7, step_deg=None), table_of_headings(0.0, 0.0, step_deg=1.0), ""),
        (
            table_of_headings(0.41, 359.7, step_deg=0.0),
            table_of_headings(0.4, 359.7, step_deg=0.1),
            "rounding of the heading (multiples of 0.1 deg, in the base not rounded)",
        ),
    ],
    ids=["rounded", "moved further", "rounded before", "an older record", "to tenths"],
)
def test_headings_in_coarser_steps_are_named_as_the_cause(base: Table, new: Table, note: str) -> None:
    sides = [
        replace(
            evidence([measurement("heading.firmware.max", value), measurement("heading.ecompass.max", value)]),
            poses=table,
        )
        for value, table in ((0.4, base), (0.8, new))
    ]
    notes = {difference.name: difference.note for difference in compare(*sides).differences}
    assert notes == {"heading.firmware.max": note, "heading.ecompass.max": ""}


def test_the_sentence_begins_with_the_answer() -> None:
    base, worse = over_seeds("cycles.direct.total", 11_061), over_seeds("cycles.direct.total", 11_161)
    against = "(against run.json)"
    assert compare(base, base).sentence == f"May be merged {against}: 1 unchanged."
    assert compare(base, worse).sentence == (
        f"Not to be merged {against}: 1 worse: cycles.direct.total 11 061 -> 11 161 (+100, +0.9 %)."
    )
    assert compare(worse, base).sentence == (
        f"May be merged {against}: 1 better: cycles.direct.total 11 161 -> 11 061 (-100, -0.9 %)."
    )
    chosen = [replace(side, chosen=True) for side in (base, base)]
    assert compare(*chosen).sentence == f"May be merged as far as the chosen tests show {against}: 1 unchanged."
    gate_set = replace(base, tests_left_out=11)
    shown = "May be merged as far as the gate set shows, without 11 tests of the full set"
    assert compare(base, gate_set).sentence == f"{shown} {against}: 1 unchanged."
    assert compare(base, replace(gate_set, chosen=True)).sentence.startswith(
        "May be merged as far as the chosen tests show, without 11 tests of the full set "
    )
    assert compare(base, replace(worse, tests_left_out=11)).sentence.startswith(f"Not to be merged {against}")
    gone = compare(base, evidence([]))
    cannot = "Cannot say whether it may be merged"
    assert gone.sentence.startswith(f"{cannot} {against}: measurement missing: cycles.direct.total; restore it")
    assert not_compared("old.json", "old.json: no such file", base).sentence == (
        f"{cannot} (against old.json): old.json: no such file."
    )


def test_what_got_better_is_named_where_nobody_can_say_too() -> None:
    base = evidence([measurement("cycles.direct.total", 11_161), measurement("link.echoed", 3)])
    comparison = compare(base, over_seeds("cycles.direct.total", 11_061))
    assert comparison.answer is Answer.UNKNOWN
    assert comparison.sentence.endswith(
        "; apart from that 1 better: cycles.direct.total 11 161 -> 11 061 (-100, -0.9 %)."
    )


def test_a_run_that_fails_by_itself_is_not_to_be_merged_whatever_it_is_compared_with() -> None:
    name, limit = "heading.direct.max", Limit(max=1.8)
    fails = judged(name, 1.9, limit=limit)
    for base in (fails, judged(name, 2.5, limit=limit)):
        comparison = compare(base, fails)
        assert (comparison.answer, comparison_code(comparison)) == (Answer.NOT, 1)
        assert "failed: heading.direct.max " in comparison.sentence
    broken = replace(over_seeds(name, 0.9), failed=("test_lamp.py::test_life (it broke)",))
    comparison = compare(over_seeds(name, 0.9), broken)
    assert (comparison.answer, comparison_code(comparison)) == (Answer.NOT, 1)
    assert "failed: test_lamp.py::test_life (it broke); 1 unchanged." in comparison.sentence
    unlike = not_compared("old.json", "old.json: no such file", broken)
    assert (unlike.answer, comparison_code(unlike)) == (Answer.NOT, 1)
    assert unlike.sentence.endswith("test_life (it broke); not compared: old.json: no such file.")


def test_a_new_measurement_that_fails_its_limit_is_no_pass() -> None:
    new = evidence([measurement("link.echoed", 3), *cell_of("compass.lag", 12.0, Limit(max=9))])
    comparison = compare(evidence([measurement("link.echoed", 3)]), new)
    assert (comparison.differences_with(Change.NEW)[0].name, comparison_code(comparison)) == ("compass.lag", 1)
    assert "failed: compass.lag 12 (limit at most 9); 1 new; 1 unchanged." in comparison.sentence


def test_a_limit_that_was_not_judged_leaves_the_answer_open_and_a_regression_is_one_all_the_same() -> None:
    unset = measurement("heading.direct.max", 0.9, limit=Limit(max=2), outcome=Outcome.UNSET)
    base = evidence([unset, measurement("cycles.direct.total", 5)])
    comparison = compare(base, base)
    assert (comparison.answer, comparison_code(comparison)) == (Answer.UNKNOWN, 22)
    assert "not evaluated: heading.direct.max ()" in comparison.sentence
    worse = compare(base, evidence([unset, measurement("cycles.direct.total", 6)]))
    assert (worse.answer, comparison_code(worse)) == (Answer.NOT, 22)


@pytest.mark.parametrize(
    ("before", "after", "base", "new", "change"),
    [
        (Limit(max=2), Limit(max=1), 1.5, 1.5, Change.UNCHANGED),  # the limit did it
        (Limit(max=2), Limit(max=1), 0.9995, 1.0005, Change.WORSE),  # it went through the new one
        (Limit(max=2), Limit(max=1), 1.995, 2.004, Change.WORSE),  # it went through the old one
        (None, Limit(max=1), 1.5, 1.5, Change.UNCHANGED),
        (None, Limit(max=1), 0.9995, 1.0005, Change.WORSE),
    ],
)
def test_an_edited_limit_is_not_the_firmware_s_doing(
    before: Limit | None, after: Limit, base: float, new: float, change: Change
) -> None:
    name = "heading.direct.max"
    comparison = compare(evidence(cell_of(name, base, before)), evidence(cell_of(name, new, after)))
    (difference,) = comparison.differences
    assert difference.change is change
    if before is not None:
        assert "its limit was at most 2 in the base" in comparison.sentence
    elif change is Change.UNCHANGED:
        assert "the base has no limit for it" in comparison.sentence
    assert comparison_code(comparison) == 1  # the run fails its limit, whoever's doing that is


@pytest.mark.parametrize(
    ("before", "after", "change"),
    [
        (Limit(max=2), None, Change.CHANGED),
        (Limit(max=2), Limit(max=3), Change.CHANGED),
        (Limit(max=2), Limit(min=-2), Change.CHANGED),
        (Limit.within(2), Limit(-3, 2), Change.CHANGED),
        (Limit(max=2), Limit(max=1.5), Change.UNCHANGED),
        (Limit(max=2), Limit.within(2), Change.UNCHANGED),
        (Limit(max=2), Limit(max=2), Change.UNCHANGED),
        (None, Limit(max=2), Change.UNCHANGED),
    ],
)
def test_a_limit_that_the_change_under_test_loosens_is_shown_although_the_number_is_what_it_was(
    before: Limit | None, after: Limit | None, change: Change
) -> None:
    name = "heading.direct.max"
    comparison = compare(evidence(cell_of(name, 1.0, before)), evidence(cell_of(name, 1.0, after)))
    (difference,) = comparison.differences
    assert (difference.change, comparison_code(comparison)) == (change, 0)
    if change is Change.CHANGED:
        assert "1 changed" in comparison.sentence
        assert f"was {before}" in difference.note


@pytest.mark.parametrize(
    ("before", "after", "moved", "change", "remark"),
    [
        (EXACT, Tolerance(0.5, 0.0), 0.1, Change.WORSE, "its tolerance was exact in the base"),
        (EXACT, Tolerance(0.5, 0.0), 0.0, Change.CHANGED, "its tolerance was exact in the base"),
        (Tolerance(0.2, 0.0), Tolerance(0.2, 0.5), 0.3, Change.WORSE, "its tolerance was 0.2 deg in the base"),
        (Tolerance(0.2, 0.1), EXACT, 0.1, Change.UNCHANGED, "its tolerance was 0.2 deg and 10 % in the base"),
        (EXACT, EXACT, 0.1, Change.WORSE, ""),
        (None, Tolerance(0.5, 0.0), 0.1, Change.UNCHANGED, ""),
    ],
)
def test_a_tolerance_that_the_base_states_is_not_taken_away_by_the_change_under_test(
    before: Tolerance | None, after: Tolerance, moved: float, change: Change, remark: str
) -> None:
    name = "heading.direct.max"
    base, new = (
        evidence([measurement(name, value, unit="deg")], tolerances={name: after}) for value in (1.0, 1.0 + moved)
    )
    difference = only(replace(base, in_force={} if before is None else {name: before}), new)
    assert (difference.change, difference.note) == (change, remark)
    assert difference.tolerance == (before or after)


def test_the_first_concern_is_what_is_out_of_its_limit_then_the_farthest() -> None:
    moved = {  # by how many tolerances: an exact one counts in percent
        "cycles.direct.total": (10_000, 10_100),
        "cycles.corrected.total": (10_000, 10_300),
        "fit.direct.residual": (1.0, 1.1),
        "heading.direct.rms": (1.0, 1.05),
        "heading.direct.max": (1.0, 1.02),
        "heading.iterative.max": (1.79, 1.9),
        "tumble.coverage": (90.0, 80.0),
        "link.retried": (0, 1),
    }
    limits = {"heading.direct.max": Limit(max=1.8), "heading.iterative.max": Limit(max=1.8)}
    base, new = (
        evidence([cell for name, both in moved.items() for cell in cell_of(name, both[side], limits.get(name))])
        for side in (0, 1)
    )
    comparison = compare(base, new)
    worse = [difference.name for difference in comparison.differences_with(Change.WORSE)]
    assert worse == [
        "heading.iterative.max",
        "link.retried",
        "fit.direct.residual",
        "tumble.coverage",
        "heading.direct.rms",
        "cycles.corrected.total",
        "heading.direct.max",
        "cycles.direct.total",
    ]
    assert re.search(r"8 worse: heading\.iterative\.max .*, link\.retried .* and 6 more", comparison.sentence)
    assert [difference.name for difference in comparison.differences] == sorted(moved)


@pytest.mark.parametrize("chosen", [False, True])
def test_what_a_run_did_not_come_to_is_not_taken_and_no_wall_of_what_is_gone(chosen: bool) -> None:
    base = evidence([measurement(f"lamp.{index}", 1.0) for index in range(9)])
    new = replace(
        evidence([measurement("lamp.0", 1.0), measurement("lamp.1", None)]),
        chosen=chosen,
        faults=() if chosen else ("this run: the run is incomplete (interrupted); repeat it",),
    )
    comparison = compare(base, new)
    assert [difference.name for difference in comparison.differences_with(Change.GONE)] == [
        "lamp.1"
    ]  # it came to that one
    assert len(comparison.differences_with(Change.NOT_TAKEN)) == 7
    assert (len(comparison.obstacles), comparison_code(comparison)) == (2, 22)
    assert any(
        ("only chosen tests ran, without 7 measurements of" if chosen else "interrupted") in obstacle
        for obstacle in comparison.obstacles
    )
    both = compare(replace(base, chosen=True), replace(new, chosen=True, faults=()))
    assert len(both.differences_with(Change.GONE)) == 8  # of the same choice all of it is missed


def test_what_tests_that_failed_did_not_measure_is_not_gone_and_is_not_to_be_accepted() -> None:
    base = evidence([measurement(f"lamp.{index}", 1.0) for index in range(9)])
    unmet = replace(measurement("lamp.1", None), outcome=Outcome.UNSET, limit=Limit(max=2.0))
    new = replace(evidence([measurement("lamp.0", 1.0), unmet]), failed=("t.py::t (the firmware contradicts itself)",))
    comparison = compare(base, new)
    assert (comparison.differences_with(Change.GONE), len(comparison.differences_with(Change.NOT_TAKEN))) == ((), 8)
    assert [obstacle for obstacle in comparison.obstacles if "accept" in obstacle] == []
    assert (comparison.failed, comparison_code(comparison)) == (new.failed, 1)


@pytest.mark.parametrize("limit", [None, Limit(max=1.2)])
def test_what_neither_side_has_a_number_for_is_not_counted_unless_it_has_a_limit(limit: Limit | None) -> None:
    lines = [measurement("cycles.direct.total", 11061), *cell_of("cycles.direct.sweeps", None, limit)]
    names = [difference.name for difference in compare(evidence(lines), evidence(lines)).differences]
    assert names == (["cycles.direct.sweeps"] if limit else []) + ["cycles.direct.total"]


def with_side(side: Evidence, **more: Any) -> Evidence:
    return replace(side, side=replace(side.side, **more))


def test_remarks_say_that_the_firmware_or_the_whole_run_is_the_same_and_which_tests_are_not() -> None:
    base, new = over_seeds("fit.direct.residual", 1.0), over_seeds("fit.direct.residual", 1.0)
    assert compare(base, new).remark == ""
    known = [with_side(side, firmware_sha256="ab" * 32) for side in (base, new)]
    assert compare(*known).remark == "Both sides ran the same firmware file."
    assert compare(known[0], with_side(new, firmware_sha256="cd" * 32)).remark == ""
    assert compare(*(replace(side, record="ab" * 32) for side in (base, new))).remark == (
        "The run was compared with itself."
    )
    suites = {"conftest.py": "a", "test_heading.py": "b", "test_link.py": "c"}
    edited = {"conftest.py": "x", "test_heading.py": "b", "test_new.py": "d"}
    changed = compare(replace(base, suites=suites), replace(new, suites=edited))
    assert changed.remark == "Tests differ from those of the base: conftest.py, test_new.py."
    assert compare(base, replace(new, suites=edited)).remark == "", "an older base has no digests"


def test_cycles_that_fell_by_more_than_a_third_are_listed_as_work_that_may_have_moved() -> None:
    costs = {"cycles.direct.total": (10_844, 1_330), "cycles.iterative.total": (9_000, 6_001)}
    base, new = (
        evidence([measurement(name, both[side], unit="cycle") for name, both in costs.items()]) for side in (0, 1)
    )
    comparison = compare(base, new)
    assert (comparison.answer, len(comparison.differences_with(Change.BETTER))) == (Answer.MAY, 2)
    assert comparison.remark == "Check that no work moved: cycles.direct.total fell by more than a third."


@pytest.mark.parametrize(
    ("base_sha256", "total", "build_id", "change"),
    [
        ("ab", 10_000, "0123456789abcdef", Change.CHANGED),
        ("", 10_000, "0123456789abcdef", Change.CHANGED),
        ("cd", 10_000, "0123456789abcdef", Change.WORSE),
        ("", 10_001, "0123456789abcdef", Change.WORSE),
        ("", 10_000, "fedcba9876543210", Change.WORSE),
    ],
    ids=["one file", "one build", "a patched file", "another total", "another build"],
)
def test_another_worst_input_is_no_regression_of_a_calibrator_whose_code_did_not_change(
    base_sha256: str, total: int, build_id: str, change: Change
) -> None:
    name = "cycles.direct.worst_found"
    cells = [measurement("cycles.direct.total", 10_000, unit="cycle"), measurement(name, 11_000, unit="cycle")]
    base = with_side(evidence(cells), firmware_sha256=base_sha256, build_id=build_id)
    cells = [measurement("cycles.direct.total", total, unit="cycle"), measurement(name, 11_500, unit="cycle")]
    differences = {
        item.name: item for item in compare(base, with_side(evidence(cells), firmware_sha256="ab")).differences
    }
    assert differences[name].change is change


@pytest.mark.parametrize(("new_deg", "change"), [(0.6, Change.CHANGED), (0.8, Change.WORSE)])
def test_values_that_few_poses_predict_differ_only_beyond_their_uncertainties(new_deg: float, change: Change) -> None:
    def side(rms_deg: float, poses: int) -> Evidence:
        rms = replace(measurement("heading.direct.rms", rms_deg), uncertainty=0.2)
        return evidence([rms, measurement("heading.poses", poses)])

    differences = {one.name: one.change for one in compare(side(0.4, 22), side(new_deg, 27)).differences}
    assert differences["heading.direct.rms"] is change
    assert differences["heading.poses"] not in (Change.BETTER, Change.WORSE)
