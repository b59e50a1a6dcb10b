"""What noise moves, and the smallest change that a comparison sees: by simulation, with the rule itself."""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist, stdev

import numpy as np
import pytest
from scipy.stats import nct, t

from hiltest.measurement import Deviation, Limit, Measurement, Outcome, Tolerance, deviation_of
from hiltest.run_record.comparison import Change, Comparison
from hiltest.run_record.outcomes import TestOutcome
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import REAL, Evidence
from hiltest.verdict.run_noise import (
    FALSE_ALARMS,
    Noise,
    chance_seen,
    half_width,
    mean_interval,
    paired,
    runs_a_side,
    seeds_needed,
    smallest_seen,
    unpaired,
)

from .evidence import CONDITIONS, evidence, measurement

PAIRS = 200
RMS = ["heading.direct.rms", "heading.dpi.rms"]
OTHERS = ["fit.direct.residual", "accelerometer.norm_rms", "heading.direct.bias"]
NAMES = [*RMS, *OTHERS]
ON_A_BENCH = replace(CONDITIONS, board=REAL)


def on_a_bench(runs: np.ndarray) -> Evidence:
    """Return runs of a real board: a row each, a column a measurement of `NAMES`."""
    return evidence(*_made(runs), conditions=ON_A_BENCH)


def _made(values: np.ndarray) -> list[list[Measurement]]:
    return [[measurement(name, float(item)) for name, item in zip(NAMES, row, strict=True)] for row in values]


def seen(comparison: Comparison, name: str) -> float:
    (result,) = (difference.seen for difference in comparison.differences if difference.name == name)
    assert result is not None
    return result


def called(comparison: Comparison, name: str) -> bool:
    return name in {difference.name for difference in comparison.differences_with(Change.WORSE)}


@pytest.mark.parametrize("freedom", [4, 7, 14, 60])
@pytest.mark.parametrize("share", [0.05, 0.01, 1e-4])
def test_without_a_tolerance_the_smallest_change_is_that_of_the_noncentral_t(freedom: int, share: float) -> None:
    noise = Noise(2.0, freedom, 0.5)
    size = smallest_seen(noise, 0.0, share)
    assert 1.0 - nct.cdf(t.ppf(1.0 - share / 2.0, freedom), freedom, size) == pytest.approx(0.8, abs=1e-3)
    assert half_width(noise, share) == pytest.approx(t.ppf(1.0 - share / 2.0, freedom))


def test_a_change_is_seen_beyond_the_tolerance_alone_where_there_is_no_noise() -> None:
    assert smallest_seen(None, 0.01, 1e-4) == 0.01
    assert smallest_seen(Noise(1e-9, 7, 1.0), 0.01, 1e-4) == pytest.approx(0.01, rel=1e-4)


def test_of_a_few_pairs_the_tolerance_alone_decides() -> None:
    few = paired([0.0, 0.02, -0.01, 0.01])
    assert few is not None
    assert not few.tested
    expected = 0.01 + NormalDist().inv_cdf(0.8) * few.error
    assert smallest_seen(few, 0.01, 1e-4) == pytest.approx(expected, rel=1e-3)


def test_pairs_that_all_moved_alike_have_no_noise() -> None:
    assert paired([0.1]) is None
    assert paired([0.1, 0.1, 0.1]) is None


def test_a_bench_s_own_noise_counts_from_five_runs_and_one_on() -> None:
    deviation = Deviation(0.05, 60)
    single = unpaired([0.3], [0.4], deviation)
    assert single == Noise(0.05, 60, 2**0.5, of_these_runs=False)
    assert unpaired([0.3], [0.4], None) is None
    own = unpaired([0.1, 0.3, 0.5, 0.2, 0.4], [0.7], deviation)
    assert own is not None
    assert (own.deviation, own.freedom, own.of_these_runs) == (pytest.approx(stdev([1, 2, 3, 4, 5]) / 10), 4, True)
    # A few runs that differ by more than those of the default rig are believed, fewer and quieter ones are not.
    loud, quiet = unpaired([0.1, 0.9], [0.5], deviation), unpaired([0.5, 0.5], [0.5], deviation)
    assert loud is not None
    assert loud.deviation == pytest.approx(0.8 / 2**0.5)
    assert quiet is not None
    assert quiet.deviation == 0.05


def test_the_interval_is_there_from_eight_pairs_on() -> None:
    changes = [0.1, 0.2, 0.3, 0.1, 0.2, 0.3, 0.2]
    assert mean_interval(changes) is None
    changes.append(0.4)
    interval = mean_interval(changes)
    assert interval is not None
    assert sum(interval) / 2 == pytest.approx(0.225)
    assert interval[1] - interval[0] == pytest.approx(2 * 2.3646 * stdev(changes) / 8**0.5, rel=1e-4)
    assert mean_interval([0.1] * 8) == (pytest.approx(0.1), pytest.approx(0.1))


@pytest.mark.parametrize(("deviation", "runs"), [(0.0492, 17), (0.16, 163), (0.313, 617)])
def test_runs_a_side_are_those_of_the_books(deviation: float, runs: int) -> None:
    """Two-sided 5 % and a power of 80 %: 2 (1.960 + 0.842)^2 (deviation / 0.05)^2, and one more for Student's t."""
    by_normal = 2 * (1.960 + 0.8416) ** 2 * (deviation / 0.05) ** 2
    assert runs_a_side(deviation, 0.0, 0.05, 0.05) == pytest.approx(by_normal, abs=2)
    assert abs((runs_a_side(deviation, 0.0, 0.05, 0.05) or 0) - runs) <= 1
    assert (runs_a_side(deviation, 0.0, FALSE_ALARMS / 50, 0.05) or 0) > 2 * runs


def test_so_many_runs_see_the_change_and_one_fewer_does_not() -> None:
    runs = runs_a_side(0.08, 0.01, 1e-4, 0.05)
    assert runs is not None
    chances = [chance_seen(Noise(0.08, 2 * n - 2, (2.0 / n) ** 0.5), 0.01, 1e-4, 0.05) for n in (runs - 1, runs)]
    assert chances[0] < 0.8 <= chances[1]


@pytest.mark.parametrize(
    ("deviation", "floor", "size", "seeds"),
    [
        (0.0, 0.01, 0.05, 1),  # every seed moves alike
        (0.002, 0.01, 0.05, 1),  # noise stays within the tolerance
        (0.0, 0.05, 0.05, None),
        (0.02, 0.05, 0.04, None),  # within the tolerance: no number of seeds sees it
        (1.0, 0.01, 1e-6 + 0.01, None),
    ],
)
def test_paired_seeds_need_few_runs(deviation: float, floor: float, size: float, seeds: int | None) -> None:
    assert seeds_needed(deviation, floor, 1e-4, size) == seeds


def test_paired_seeds_whose_changes_differ_are_eight_at_least() -> None:
    seeds = seeds_needed(0.05, 0.01, 1e-3, 0.05)
    assert seeds is not None
    assert 8 < seeds < (runs_a_side(0.05, 0.01, 1e-3, 0.05) or 0)


@pytest.mark.parametrize(("before", "after", "scale"), [(1, 1, 1), (8, 1, 1), (3, 3, 3), (8, 8, 3)])
def test_200_pairs_of_runs_on_a_bench(before: int, after: int, scale: int) -> None:
    """Of 200 at 80 %, fewer than 140 or more than 180 are 1 in 2000; at 1 %, more than 4 are 1 in 20 of such tests.

    The deviations of one run against one are those of the default rig: a bench that is noisier has to say so.
    """
    random = np.random.default_rng([before, after, scale])
    deviations = scale * np.array([deviation.value for name in NAMES if (deviation := deviation_of(name))])
    middle = 20.0 * deviations  # far from zero, where a bias would turn its sign

    def compared(base: np.ndarray, new: np.ndarray) -> Comparison:
        return compare(on_a_bench(middle + deviations * base), on_a_bench(middle + deviations * new))

    size = seen(compared(*_with_deviations_of_one(random, before, after)), RMS[0])
    calls = alarms = 0
    for _ in range(PAIRS):
        base, new = (random.standard_normal((runs, len(NAMES))) for runs in (before, after))
        alarms += compared(base, new).regression
        new[:, 0] += size / deviations[0]
        calls += called(compared(base, new), RMS[0])
    assert alarms <= 4
    assert 0.7 * PAIRS <= calls <= 0.9 * PAIRS


def _with_deviations_of_one(random: np.random.Generator, before: int, after: int) -> tuple[np.ndarray, np.ndarray]:
    """Return runs whose deviations, as a comparison estimates them, are those that they are drawn with."""
    sides = [random.standard_normal((runs, len(NAMES))) for runs in (before, after)]
    about = [side - side.mean(axis=0) for side in sides]
    square = sum((side**2).sum(axis=0) for side in about) / max(before + after - 2, 1)
    base, new = (side / np.sqrt(square) if before + after > 2 else side for side in about)
    return base, new


def test_200_pairs_of_campaigns() -> None:
    """As on a bench, with changes that differ from seed to seed by twice their tolerance."""
    seeds, random = 8, np.random.default_rng(8)

    def campaign(values: np.ndarray) -> Evidence:
        return evidence(*_made(values), tolerances={name: Tolerance(0.01, 0.0) for name in NAMES})

    base = random.normal(1.0, 0.1, (seeds, len(NAMES)))
    exact = random.standard_normal(base.shape)
    exact = (exact - exact.mean(axis=0)) / exact.std(axis=0, ddof=1)
    size = seen(compare(campaign(base), campaign(base + 0.02 * exact)), RMS[0])
    calls = alarms = 0
    for _ in range(PAIRS):
        moved = base + random.normal(0.0, 0.02, base.shape)
        alarms += compare(campaign(base), campaign(moved)).regression
        moved[:, 0] += size
        calls += called(compare(campaign(base), campaign(moved)), RMS[0])
    assert alarms <= 4
    assert 0.7 * PAIRS <= calls <= 0.9 * PAIRS


def bench(name: str, *values: float, **more: object) -> Evidence:
    """Return runs of a real board that measured one thing."""
    result = ([measurement(name, value, unit="deg", **more)] for value in values)  # type: ignore[arg-type]
    return evidence(*result, conditions=ON_A_BENCH)


def test_on_a_bench_the_rms_decides_and_the_largest_error_informs() -> None:
    def run(rms: float, largest: float, **more: object) -> Evidence:
        made = [measurement("heading.direct.rms", rms, **more), measurement("heading.direct.max", largest, **more)]
        return evidence(made, conditions=ON_A_BENCH)

    results = {difference.name: difference for difference in compare(run(0.4, 0.9), run(0.4, 9.9)).differences}
    assert results["heading.direct.max"].change is Change.CHANGED
    assert results["heading.direct.max"].note == "on a real board heading.direct.rms decides"
    comparison = compare(run(0.4, 0.9), run(2.4, 9.9))
    assert [difference.name for difference in comparison.differences_with(Change.WORSE)] == ["heading.direct.rms"]
    alone = compare(bench("heading.direct.max", 0.9), bench("heading.direct.max", 9.9))
    assert alone.regression, "without an rms it decides"


def test_a_largest_error_decides_where_the_rig_states_its_tolerance() -> None:
    names = ("heading.direct.rms", "heading.direct.max")
    base, new = (
        replace(
            evidence([measurement(name, value) for name in names], conditions=ON_A_BENCH),
            tolerances={names[1]: Tolerance(0.1, 0.0)},
        )
        for value in (0.4, 0.52)
    )
    assert [difference.name for difference in compare(base, new).differences_with(Change.WORSE)] == [names[1]]
    within = evidence([measurement(name, 0.49) for name in names], conditions=ON_A_BENCH)
    assert not compare(base, replace(within, tolerances=new.tolerances)).regression


def test_a_largest_error_that_leaves_its_limit_is_worse_on_a_bench_too() -> None:
    names, limit = ("heading.direct.rms", "heading.direct.max"), Limit(max=2.0)
    good = evidence([measurement(name, 0.5, limit=limit) for name in names], conditions=ON_A_BENCH)
    bad = evidence(
        [
            measurement(names[0], 0.5, limit=limit),
            measurement(names[1], 2.1, limit=limit, outcome=Outcome.FAIL),
        ],
        conditions=ON_A_BENCH,
    )
    assert [difference.name for difference in compare(good, bad).differences_with(Change.WORSE)] == [names[1]]


def test_what_runs_of_a_bench_differ_by_is_the_tolerance_that_is_shown() -> None:
    base, new = bench("compass.lag", 4.0, 5.0, 6.0, 5.0, 5.0), bench("compass.lag", 5.5)
    (difference,) = compare(base, new).differences
    assert (difference.change, difference.base, difference.new) == (Change.UNCHANGED, 5.0, 5.5)
    assert difference.tolerance.absolute == pytest.approx(t.ppf(1.0 - FALSE_ALARMS / 2, 4) * 0.5**0.5 * 1.2**0.5)
    (difference,) = compare(base, bench("compass.lag", 9.5)).differences
    assert difference.change is Change.CHANGED


@pytest.mark.parametrize("side", ["base", "new"])
def test_a_run_of_several_without_a_number_is_never_left_out(side: str) -> None:
    name = "heading.direct.rms"
    whole = bench(name, 0.4, 0.5, 0.4, 0.5, 0.4)
    some = evidence(*([measurement(name, value)] for value in (0.4, 0.5, None)), conditions=ON_A_BENCH)
    comparison = compare(some, whole) if side == "base" else compare(whole, some)
    (difference,) = comparison.differences
    assert difference.change is (Change.NEW if side == "base" else Change.GONE)
    assert comparison.evaluated is (side == "base" and bool(difference.seeds))


def test_a_test_that_one_of_several_runs_lacks_is_missed() -> None:
    runs = bench("heading.direct.rms", 0.4, 0.5, 0.4, 0.5, 0.4)
    ran = {seed: {"test_a.py::test_b": TestOutcome.PASSED} for seed in runs.measurements}
    skipped = {**ran, 3: {"test_a.py::test_b": TestOutcome.SKIPPED}}
    assert compare(replace(runs, tests=ran), replace(runs, tests=ran)).evaluated
    comparison = compare(replace(runs, tests=ran), replace(runs, tests=skipped))
    assert comparison.obstacles[0].startswith("test missing: test_a.py::test_b passed before and is skipped now")


def test_what_would_be_worse_alone_is_shown_among_many() -> None:
    """0.30 deg between two single runs are three standard deviations: nothing to pass over, and no proof."""
    names = [
        f"heading.{calibrator}.{name}"
        for calibrator in ("direct", "corrected", "dpi", "iterative")
        for name in ("rms", "bias", "tilt_sensitivity")
    ]
    base = evidence([measurement(name, 0.4) for name in names], conditions=ON_A_BENCH)
    new = evidence([measurement(name, 0.4 + 0.3 * (name == names[0])) for name in names], conditions=ON_A_BENCH)
    (difference,) = compare(base, new).differences_with(Change.CHANGED)
    assert difference.name == names[0]
    assert "but not of 12: compare more runs" in difference.note
    assert compare(bench(names[0], 0.4), bench(names[0], 0.7)).regression


def test_a_bench_that_has_not_said_its_noise_is_told_how_to() -> None:
    name = "heading.direct.rms"
    assert "hiltest baseline save RUN RUN ... FILE" in compare(bench(name, 0.4), bench(name, 0.4)).remark
    assert compare(bench(name, 0.4, 0.5, 0.4, 0.5, 0.6), bench(name, 0.4)).remark == ""


def test_a_tolerance_is_kept_on_a_bench_that_is_quieter_and_gives_way_to_noise() -> None:
    """0.1 deg of `dpi` stand for when its samples were taken, which is part of what runs of a bench differ by."""
    quiet = [0.0001 * (-1.0) ** number for number in range(8)]
    for moved, change in ((0.004, Change.UNCHANGED), (0.006, Change.WORSE)):
        name = "fit.direct.rotation_left"
        (difference,) = compare(
            bench(name, *(0.02 + deviation for deviation in quiet)),
            bench(name, *(0.02 + moved + deviation for deviation in quiet)),
        ).differences
        assert difference.change is change
        assert difference.tolerance.absolute == 0.005
    loud = [0.12 * (-1.0) ** number for number in range(200)]
    base, new = (bench("heading.dpi.rms", *(middle + item for item in loud)) for middle in (0.40, 0.47))
    (difference,) = compare(base, new).differences
    assert difference.change is Change.WORSE
    assert difference.seen is not None
    assert difference.seen < 0.07 < 0.1
