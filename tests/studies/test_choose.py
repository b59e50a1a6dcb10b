"""The study that answers which calibrator to take: the cheapest of those that err least, within the budget."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.command_files import run

from hiltest.calibration.fit import FitStatus
from hiltest.measurement.estimates import Estimate, quantile
from hiltest.rig.bench_files import shipped
from hiltest.run_record.reader import read_record
from hiltest.studies.board_calibrators import board_calibrators
from hiltest.studies.choose import RECOMMENDED, RUNNER_UP, TOO_DEAR, Candidate, choose_calibrator, conclude, measure
from hiltest.studies.instances import Model, draw_instances
from hiltest.studies.study import Block, Conclusion, Conditions, Plan
from hiltest.text import hundredths

GIVEN = Conditions(field_ut=30.0, noise_ut=1.0, coverage_percent=80.0)
PLAN = Plan("choose", 3, 80, 50, GIVEN)
LARGEST_DEG = 16.0
BEST = Candidate("best", Estimate(0.5, 0.4, 0.6), Estimate(1.0, 0.9, 1.2), 100.0, 2000, 2500)


def test_errors_and_cycles_are_those_of_the_board_under_these_conditions() -> None:
    names = board_calibrators().names
    result = np.reshape(measure(PLAN, Block(0, 4, 2)), (2, len(names), 3))
    drawn = draw_instances(Model(3, 50, 1.0, occluded=0.2, field_ut=30.0), 4, 2)
    for k in range(2):
        for index, name in enumerate(names):
            fit, cycles = board_calibrators().calibrate(name, np.rint(10.0 * drawn.points_ut[k]))
            assert result[k, index, 0] == pytest.approx(drawn.direction_error_deg(k, fit, 30.0), rel=1e-12)
            assert result[k, index, 1:].tolist() == [fit.status is FitStatus.ELLIPSOID, cycles]


@pytest.mark.parametrize(
    ("other", "selected"),
    [
        (replace(BEST, name="dearer", high=Estimate(1.0001, 0.9, 1.2), cycles=2001), "best"),
        (replace(BEST, name="cheaper", high=Estimate(1.2, 0.9, 1.3), cycles=1999), "cheaper"),
        (replace(BEST, name="worse", high=Estimate(1.21, 0.9, 1.3), cycles=1), "best"),
        (replace(BEST, name="better", high=Estimate(0.7, 0.6, 0.99), cycles=9999), "better"),
        (replace(BEST, name="no better", high=Estimate(0.7, 0.6, 1.0), cycles=9999), "best"),
    ],
)
def test_the_cheapest_is_taken_of_those_that_the_instances_cannot_tell_apart(other: Candidate, selected: str) -> None:
    for candidates in ([BEST, other], [other, BEST]):
        result = choose_calibrator(candidates)
        assert result is not None
        assert result.name == selected


def concluded(cycles: int | None, instances: int = 80) -> Conclusion:
    """Conclude from some instances: each calibrator of the table errs half of the one before, for 1000 cycles more."""
    names = board_calibrators().names
    item = np.ones((instances, len(names), 3))
    for index in range(len(names)):
        item[:, index, 0] = LARGEST_DEG * np.linspace(0.9, 1.1, instances) / 2.0**index
        item[:, index, 2] = 1000 * (index + 1)
        item[0, index, 2] += 500
    halves = [half.ravel().tolist() for half in (item[:20], item[20:])]
    return conclude(replace(PLAN, instances=instances, conditions=replace(GIVEN, cycles=cycles)), [halves])


@pytest.mark.parametrize("affordable", [0, 1, 2, None])
def test_the_budget_holds_for_every_instance(affordable: int | None) -> None:
    names = board_calibrators().names
    # In the median one more costs no more than this.
    result = concluded(None if affordable is None else 1000 * affordable + 1499)
    within = len(names) if affordable is None else affordable
    marks = dict(zip(result.table.column("calibrator"), result.table.column("choice"), strict=True))
    assert [name for name, mark in marks.items() if mark != TOO_DEAR] == list(names[:within])
    assert [name for name, mark in marks.items() if mark == RECOMMENDED] == list(names[:within][-1:])
    assert [name for name, mark in marks.items() if mark == RUNNER_UP] == list(names[:within][-2:-1])
    if within:
        # The 40th, 31st and 50th of 80.
        ends = (LARGEST_DEG * (0.9 + 0.2 * k / 79) / 2.0 ** (within - 1) for k in (39, 30, 49))
        median, low, high = map(hundredths, ends)
        assert f"use {names[within - 1]}, {median} ({low} to {high}) deg in the median" in result.sentence
        assert f"{within} 000 cycles, at most {within} 500" in result.sentence
    else:
        assert f"cycles: no calibrator; the cheapest is {names[0]}, 15.98 (15.62 to 16.38) deg" in result.sentence
    # What errs less and is not within the budget is named, and of that the best.
    more = f"with more cycles {names[-1]}, " in result.sentence
    assert more == (0 < within < len(names))


@pytest.mark.parametrize(("instances", "is_chosen"), [(71, False), (72, True)])
def test_a_calibrator_is_chosen_from_as_many_instances_as_can_exclude_one(instances: int, is_chosen: bool) -> None:
    """0.95 to the power of 71 is above 2.5 %, so the 95th percentile may lie above all errors."""
    assert (quantile(range(instances), 0.95).high is not None) == is_chosen
    result = concluded(None, instances)
    assert (RECOMMENDED in result.table.column("choice")) == is_chosen
    assert ("71 instances are too few to choose; repeat with at least 72" in result.sentence) == (not is_chosen)


def test_field_noise_and_points_are_the_rig_s_unless_they_are_given(tmp_path: Path) -> None:
    rig = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    rig = rig.replace("strength_ut = 48.5", "strength_ut = 33.5").replace(
        "calibration_points = 100", "calibration_points = 60"
    )
    (tmp_path / "own.toml").write_text(rig, encoding="utf-8")
    for options, answer in (
        ([], "0.4 uT of noise in 33.5 uT, 60 points over at least 50 % of the sphere and any number of cycles"),
        (
            ["--noise", "2", "--points", "40", "--coverage", "90", "--cycles", "9000"],
            "2 uT of noise in 33.5 uT, 40 points over at least 90 % of the sphere and at most 9 000 cycles",
        ),
    ):
        out = tmp_path / answer[:3]
        words = ["--rig", str(tmp_path / "own.toml"), "--instances", "1", "--jobs", "1", "--out", str(out)]
        assert run("study", "choose", *words, *options) == 0
        assert answer in read_record(out).run.verdict.sentence
