"""Every measurement has a sense and a tolerance, and the tolerance is of a size that was measured."""

from __future__ import annotations

from statistics import stdev
from typing import Any

import pytest
from scipy.stats import t

from hiltest.comparison.interval import mean_interval, student_t
from hiltest.comparison.model import EXACT, Sense, Tolerance
from hiltest.comparison.rules import UNPAIRED_DEVIATIONS, is_known, rule_of
from hiltest.rig.file import MEASUREMENT_UNITS


def test_every_measurement_of_a_real_run_has_a_row(real_record: dict[str, Any]) -> None:
    compared = [each["name"] for each in real_record["measurements"] if not each["volatile"]]
    assert [name for name in compared if not is_known(name)] == []


def test_every_measurement_that_a_limit_may_name_has_a_row() -> None:
    names = [name.replace("*", "direct") for name in MEASUREMENT_UNITS if name != "board.wall_seconds"]
    assert [name for name in names if not is_known(name)] == []


@pytest.mark.parametrize("name", ["heading.direct.maximum", "heading.direct", "link.lost", "compass.lag", ""])
def test_a_name_that_hiltest_does_not_measure_has_none(name: str) -> None:
    assert not is_known(name)


@pytest.mark.parametrize(
    ("name", "sense"),
    [
        ("cycles.direct.total", Sense.SMALLER), ("cycles.fusion.update", Sense.SMALLER),
        ("accelerometer.six_position.cycles", Sense.SMALLER), ("heading.direct.max", Sense.SMALLER),
        ("heading.direct.bias", Sense.NEARER_ZERO), ("gyroscope.scale_error.z", Sense.NEARER_ZERO),
        ("heading.direct.worst_sector", Sense.NEITHER), ("heading.uncalibrated.max", Sense.NEITHER),
        ("tumble.coverage", Sense.LARGER), ("fit.direct.status", Sense.SMALLER),
    ],
)
def test_each_gets_better_the_way_it_should(name: str, sense: Sense) -> None:
    assert rule_of(name, None).sense is sense


@pytest.mark.parametrize(
    "name", ["cycles.direct.total", "cycles.dpi.total", "cycles.fusion.predict", "accelerometer.six_position.cycles",
             "stream.direct-stream.fit_cycles"],
)
def test_cycles_of_one_kernel_are_exact_on_a_virtual_board(name: str) -> None:
    assert rule_of(name, None).tolerance_on("virtual") == EXACT


def test_a_nop_a_point_is_beyond_the_tolerance_of_the_slope_too() -> None:
    tolerance = rule_of("cycles.direct.per_point", None).tolerance
    assert tolerance.absolute < 1.0
    assert tolerance.relative * 92.25 < 1.0


def test_a_third_of_a_degree_is_beyond_the_tolerance_of_every_heading() -> None:
    for calibrator in ("direct", "corrected", "iterative", "dpi"):
        for what in ("max", "rms", "bias"):
            tolerance = rule_of(f"heading.{calibrator}.{what}", None).tolerance
            assert max(tolerance.absolute, tolerance.relative * 2.0) < 0.3


def test_a_board_with_noise_of_its_own_has_six_deviations() -> None:
    rule = rule_of("heading.direct.bias", None)
    assert rule.tolerance_on("real").absolute == pytest.approx(UNPAIRED_DEVIATIONS * rule.deviation)


@pytest.mark.parametrize(("absolute", "relative"), [(-1, 0), (0, -1), (float("inf"), 0), (0, float("nan"))])
def test_a_tolerance_that_lets_everything_pass_is_none(absolute: float, relative: float) -> None:
    with pytest.raises(ValueError, match="finite number"):
        Tolerance(absolute, relative)


@pytest.mark.parametrize("freedom", [7, 8, 12, 31, 99, 999])
def test_student_s_t_is_the_one_of_the_tables(freedom: int) -> None:
    assert student_t(freedom) == pytest.approx(t.ppf(0.975, freedom), abs=1e-4)


def test_the_interval_is_there_from_eight_pairs_on() -> None:
    changes = [0.1, 0.2, 0.3, 0.1, 0.2, 0.3, 0.2]
    assert mean_interval(changes) is None
    changes.append(0.4)
    interval = mean_interval(changes)
    assert interval is not None
    assert sum(interval) / 2 == pytest.approx(0.225)
    assert interval[1] - interval[0] == pytest.approx(2 * 2.3646 * stdev(changes) / 8**0.5, rel=1e-4)
