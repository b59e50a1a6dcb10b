"""Every measurement has its kind: unit, which way it is better, and a tolerance of a size that was measured."""

from __future__ import annotations

from pathlib import Path
from statistics import stdev
from typing import Any

import pytest
from scipy.stats import f

from hiltest.measurement import (
    EXACT,
    KINDS,
    Better,
    Limit,
    NamedKind,
    Tolerance,
    better_of,
    deviation_of,
    identify,
    is_compared,
    nearest_name,
    tolerance_of,
)
from hiltest.measurement import check as measured
from hiltest.measurement.deviations import DEVIATIONS
from hiltest.verdict.baseline_file import read_baseline


def test_every_measurement_of_a_real_run_has_a_row(real_record: dict[str, Any]) -> None:
    compared = [measurement["name"] for measurement in real_record["measurements"] if not measurement["volatile"]]
    assert [name for name in compared if identify(name).kind is None] == []


def test_every_kind_has_a_next_step_and_a_cost_that_of_costs() -> None:
    steps = {name: NamedKind(kind).next_step for name, kind in KINDS.items()}
    assert [name for name, step in steps.items() if not step] == []
    costs = {step for name, step in steps.items() if KINDS[name].unit == "cycle"}
    own = measured("crc.cost", 900, unit="cycle", cycle_model="silicon-dwt").next_step
    assert costs == {own, identify("cycles.awake.share").next_step}
    assert "hiltest explain" in identify("cycles.kalman.median").next_step
    assert identify("cycles.direct.total").next_step == own.replace("FUNCTION", "direct")
    assert own != measured("crc.errors", 9, unit="").next_step != ""


@pytest.mark.parametrize("name", ["heading.direct.maximum", "heading.direct", "link.lost", "compass.lag", ""])
def test_a_name_that_hiltest_does_not_measure_has_none(name: str) -> None:
    assert identify(name).kind is None


@pytest.mark.parametrize(
    ("name", "sense"),
    [
        ("cycles.direct.total", Better.LOWER),
        ("cycles.fusion.update", Better.LOWER),
        ("accelerometer.six_position.cycles", Better.LOWER),
        ("heading.direct.max", Better.LOWER),
        ("heading.direct.bias", Better.NEARER_ZERO),
        ("gyroscope.scale_error.z", Better.NEARER_ZERO),
        ("heading.direct.worst_sector", Better.NEITHER),
        ("heading.uncalibrated.max", Better.NEITHER),
        ("tumble.coverage", Better.HIGHER),
        ("fit.direct.status", Better.LOWER),
    ],
)
def test_each_gets_better_the_way_it_should(name: str, sense: Better) -> None:
    assert better_of(name, None) is sense


@pytest.mark.parametrize(
    "name",
    [
        "cycles.direct.total",
        "cycles.dpi.total",
        "cycles.fusion.update",
        "accelerometer.six_position.cycles",
        "stream.direct-stream.fit_cycles",
    ],
)
def test_cycles_of_one_kernel_are_exact_on_a_virtual_board(name: str) -> None:
    assert tolerance_of(name, {}) == EXACT


def test_a_nop_a_point_is_beyond_the_tolerance_of_the_slope_too() -> None:
    tolerance = tolerance_of("cycles.direct.per_point", {})
    assert tolerance.absolute < 1.0
    assert tolerance.relative * 92.25 < 1.0


def test_a_third_of_a_degree_is_beyond_the_tolerance_of_every_heading() -> None:
    for calibrator in ("direct", "corrected", "iterative", "dpi"):
        for name in ("max", "rms", "bias"):
            tolerance = tolerance_of(f"heading.{calibrator}.{name}", {})
            assert max(tolerance.absolute, tolerance.relative * 2.0) < 0.3


def test_each_measurement_has_a_deviation_of_its_own() -> None:
    direct, dpi, mine = (deviation_of(f"heading.{calibrator}.rms") for calibrator in ("direct", "dpi", "mine"))
    assert direct is not None
    assert dpi is not None
    assert direct.value < dpi.value
    kind = KINDS["heading.{calibrator}.rms"]
    heading_rms = [deviation.value for name, deviation in DEVIATIONS.items() if identify(name).kind is kind]
    assert mine is not None
    assert mine.value == max(heading_rms), "of a calibrator that is not known the largest"
    for same in ("cycles.direct.total", "stream.direct-stream.cycles_max", "compass.lag"):
        assert deviation_of(same) is None


def test_the_deviations_are_those_of_the_committed_seeds() -> None:
    """The ratio of two variances is F distributed: beyond its 1e-6 quantiles they are not of one firmware and rig."""
    for row in read_baseline(Path(__file__).parents[2] / "hil" / "baselines" / "virtual-k64f.json").measurements:
        values = [float(value) for value in row.values if value is not None]
        stated = deviation_of(row.name)
        if stated is None:
            assert len(set(values)) == 1 or not is_compared(row.name), row.name
        else:
            ratio = (stdev(values) / stated.value) ** 2
            assert ratio < f.ppf(1 - 1e-6, len(values) - 1, stated.freedom), row.name


@pytest.mark.parametrize(
    ("name", "kind", "subject"),
    [
        ("heading.direct.max", "heading.{calibrator}.max", "direct"),
        ("heading.direct@100.max", "heading.{calibrator}.max", "direct@100"),
        ("heading.uncalibrated.max_level", "heading.uncalibrated.max_level", ""),
        ("cycles.fusion.update", "cycles.fusion.update", ""),
        ("accelerometer.norm_rms", "accelerometer.norm_rms", ""),
        ("accelerometer.ellipsoid.norm_rms", "accelerometer.{fit}.norm_rms", "ellipsoid"),
        ("gyroscope.scale_error.z", "gyroscope.scale_error.{axis}", "z"),
        ("fusion.gyroscope.heading.max", "fusion.{source}.heading.max", "gyroscope"),
        (
            "sensor.FXOS8700CQ.M_CTRL_REG1.turn",
            "sensor.{part}.{register}.{moment}",
            "FXOS8700CQ.M_CTRL_REG1.turn",
        ),
    ],
)
def test_a_name_is_of_a_kind_and_a_subject(name: str, kind: str, subject: str) -> None:
    result = identify(name)
    assert result.kind is KINDS[kind]
    assert result.subject == subject


def test_each_cost_of_a_calibrator_stands_beside_its_worst_heading() -> None:
    assert identify("cycles.mine.total").accuracy == "heading.mine.max"
    assert identify("stream.mine.cycles_mean").accuracy == "heading.mine.max"
    assert identify("cycles.fusion.update").accuracy == "fusion.heading.max"
    assert identify("heading.mine.max").accuracy == ""
    assert identify("cycles.fn").accuracy == ""


@pytest.mark.parametrize(
    ("limit", "better"),
    [
        (Limit(max=3), Better.LOWER),
        (Limit(min=3), Better.HIGHER),
        (Limit.within(3), Better.NEARER_ZERO),
        (Limit(min=1, max=3), Better.NEITHER),
        (None, Better.NEITHER),
    ],
)
def test_the_limit_says_which_way_a_measurement_of_one_s_own_gets_better(limit: Limit | None, better: Better) -> None:
    assert better_of("compass.lag", limit) is better
    assert better_of("crc.cycles", limit, "cycle") is Better.LOWER, "whatever its limit: a count of cycles is a cost"
    assert tolerance_of("compass.lag", {}) == EXACT


@pytest.mark.parametrize(
    ("slip", "meant"),
    [
        ("heading.direct.maks", "heading.direct.max"),
        ("headin.direct.max", "heading.direct.max"),
        ("heading.*.max", "heading.direct.max"),
        ("heading.direct.maximum", None),
        ("cycles.fn", None),
        ("compass.lag", None),
    ],
)
def test_only_a_slip_of_two_letters_is_taken_for_a_known_name(slip: str, meant: str | None) -> None:
    assert nearest_name(slip) == meant


@pytest.mark.parametrize(("absolute", "relative"), [(-1, 0), (0, -1), (float("inf"), 0), (0, float("nan"))])
def test_a_tolerance_that_lets_everything_pass_is_none(absolute: float, relative: float) -> None:
    with pytest.raises(ValueError, match="finite number"):
        Tolerance(absolute, relative)
