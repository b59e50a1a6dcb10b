"""The study of budgets: what its numbers say of a curve."""

from __future__ import annotations

import pytest

from hiltest.studies.budget import BUDGETS, NAMES, STUDY
from hiltest.studies.study import Plan

PLAN = Plan("budget", 1, 2, 30)


def numbers(cycles: dict[str, float], enough: dict[str, float]) -> list[float]:
    """An instance in which each error is 1 where the budget pays for all, and there is none below."""
    results: list[float] = []
    for name in NAMES:
        results += [1.0 if budget >= cycles[name] else -1.0 for budget in BUDGETS]
        results += [1.0, cycles[name], enough[name]]
    return results


def test_an_error_is_a_mean_only_where_every_instance_has_one() -> None:
    cheap, dear = (dict.fromkeys(NAMES, item) for item in (3_000.0, 30_000.0))
    result = STUDY.conclude(PLAN, [[numbers(cheap, cheap), numbers(dear, dear)]])
    for name, budget, error in result.table.rows:
        assert name in NAMES
        assert isinstance(budget, int)
        assert error == (1.0 if budget >= 30_000 else None)
    (mean,) = (
        measurement.value
        for measurement in result.measurements
        if measurement.name == "study.budget.direct.mean_cycles"
    )
    assert mean == pytest.approx(16_500.0)


def test_ten_times_is_of_the_cycles_after_which_little_changes() -> None:
    cycles = dict.fromkeys(NAMES, 60_000.0) | {"direct": 4_000.0}
    enough = cycles | {"gauss-newton": 30_000.0}
    result = STUDY.conclude(PLAN, [[numbers(cycles, enough)]])
    reproduced = {item.figure.removeprefix("speed ratio to "): item.reproduced for item in result.printed[1:]}
    assert reproduced == {"FSFLK": True, "gradient descent": True, "Gauss-Newton": False}
