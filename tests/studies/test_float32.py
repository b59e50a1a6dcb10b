"""The study of single precision: what the board adds to float64, and what sums about zero add."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration import reference
from hiltest.calibration.fit import FitStatus
from hiltest.calibration.quality import direction_difference_rms_deg
from hiltest.measurement.estimates import quantile
from hiltest.studies.board_calibrators import board_calibrators
from hiltest.studies.float32 import (
    ABOUT_ZERO,
    JUDGED,
    RATIOS,
    STABLE,
    UNDECIDED,
    UNSTABLE,
    about_zero,
    conclude,
    measure,
    names,
    stability,
)
from hiltest.studies.instances import Model, draw_instances
from hiltest.studies.study import Block, Conclusion, Plan

PLAN = Plan("float32", 3, 7, 60)


def test_each_calibrator_has_its_errors_and_how_far_the_board_is_from_float64() -> None:
    block = Block(JUDGED, 5, 2)
    result = np.reshape(measure(PLAN, block), (2, len(names(PLAN)), 4))
    drawn = draw_instances(Model(3, 60, 0.3, stream=JUDGED), 5, 2).set_hard_iron(50.0 * RATIOS[JUDGED])
    np.testing.assert_allclose(np.linalg.norm(drawn.hard_iron_ut, axis=1), 500.0, rtol=1e-12)
    for k in range(2):
        for index, name in enumerate(board_calibrators().names):
            counts = np.rint(10.0 * drawn.points_ut[k])
            single, double = board_calibrators().calibrate(name, counts)[0], reference(name)(counts)
            errors = [drawn.direction_error_deg(k, fit, 50.0) for fit in (single, double)]
            apart, differs = direction_difference_rms_deg(single, double), int(single.status != double.status)
            assert result[k, index].tolist() == [*errors, apart, differs]
            assert apart > 0.0


@pytest.mark.parametrize(("ratio", "near"), [(0.0, True), (10.0, False)])
def test_sums_about_zero_are_direct_s_where_there_is_little_hard_iron(ratio: float, near: bool) -> None:
    drawn = draw_instances(Model(3, 60, 0.3, stretch=0.2, occluded=0.2), 0, 10).set_hard_iron(50.0 * ratio)
    for k in range(10):
        single, double = about_zero(drawn.counts(k)), reference("direct")(drawn.counts(k))
        assert single.status is FitStatus.ELLIPSOID
        assert (direction_difference_rms_deg(single, double) < 1e-3) == near


def concluded(instances: int = 400, **larger: float) -> Conclusion:
    """Conclude from instances whose errors in float32 are larger by these factors, at the last ratio."""
    double = np.linspace(0.1, 0.3, instances)
    blocks = []
    for ratio in RATIOS:
        item = np.zeros((instances, len(names(PLAN)), 4))
        for index, name in enumerate(names(PLAN)):
            factor = larger.get(name.replace("-", "_"), 1.0) if ratio == RATIOS[-1] else 1.0
            apart = np.full(instances, abs(factor - 1.0))
            item[:, index] = np.column_stack([factor * double, double, apart, np.zeros(instances)])
        blocks.append([half.ravel().tolist() for half in np.array_split(item, 2)])
    return conclude(Plan("float32", 1, instances, 100), blocks)


@pytest.mark.parametrize(
    ("factor", "state"), [(1.0, STABLE), (1.131, STABLE), (1.134, UNDECIDED), (1.138, UNSTABLE), (2.0, UNSTABLE)]
)
def test_stable_adds_no_more_than_a_tenth_more_noise_would(factor: float, state: str) -> None:
    """The 95th percentile of float64 is .290 here, from .286 to .295; sqrt(1.1^2 - 1) of it is .131 to .136."""
    result = concluded(direct=factor)
    count = len(names(PLAN)) - 1
    assert result.sentence.startswith(f"{count - (state != STABLE)} of the board's {count} calibrators are stable")
    assert ("unstable are direct;" in result.sentence) == (state == UNSTABLE)
    assert (", 1 undecided;" in result.sentence) == (state == UNDECIDED)
    assert result.table.rows[-len(names(PLAN))][-1] == state


@pytest.mark.parametrize(("factor", "message"), [(1.0, [False, True]), (2.0, [True, False]), (1.134, [None, None])])
def test_what_the_papers_say_is_judged_by_sums_about_zero(factor: float, message: list[bool | None]) -> None:
    result = concluded(direct_about_zero=factor)
    assert [figure.reproduced for figure in result.printed] == message
    assert result.sentence.endswith(
        {
            1.0: "direct is stable, too.",
            2.0: "direct is stable up to 10 times the field and unstable from 20 times the field on.",
            1.134: "direct is stable up to 10 times the field.",
        }[factor]
    )


def test_more_instances_decide_more_and_change_no_decision() -> None:
    """The states of a heavy-tailed effect near the limit of .46 x .93: 38 % above it, ten times as large."""
    random = np.random.default_rng(1)
    double = random.uniform(0.0, 1.0, 4000)
    decided: list[list[str]] = []
    for share in (0.01, 0.04, 0.07, 0.38):
        apart = np.where(random.uniform(size=4000) < share, 4.0, 0.01)
        states = [stability(quantile(apart[:n], 0.95), quantile(double[:n], 0.95)) for n in (20, 60, 200, 800, 4000)]
        decided.append(states)
    assert [states[-1] for states in decided] == [STABLE, STABLE, UNSTABLE, UNSTABLE]
    for states in decided:
        assert states[0] == UNDECIDED
        assert set(states) == {UNDECIDED, states[-1]}
        assert states == sorted(states, key=UNDECIDED.__ne__)


def test_measurements_are_of_ten_times_the_field() -> None:
    values = {measurement.name: measurement.value for measurement in concluded(direct_about_zero=2.0).measurements}
    assert values[f"study.float32.{ABOUT_ZERO}.apart"] == 0.0
