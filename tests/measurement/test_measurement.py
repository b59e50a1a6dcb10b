"""Limits, outcomes and rounding, by hand-worked values."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.measurement import Limit, Outcome, check, round_significant


@pytest.mark.parametrize(
    ("limit", "value", "holds"),
    [
        (Limit(max=1.8), 1.8, True),
        (Limit(max=1.8), 1.8000001, False),
        (Limit(min=4), 3, False),
        (Limit(min=4), 4, True),
        (Limit.within(0.5), -0.5, True),
        (Limit.within(0.5), -0.51, False),
        (Limit(max=1.8), math.nan, False),
    ],
)
def test_a_limit_is_a_closed_interval(limit: Limit, value: float, holds: bool) -> None:
    assert limit.holds(value) is holds


@pytest.mark.parametrize(
    ("sides", "complaint"),
    [({}, "needs min"), ({"max": math.inf}, "finite"), ({"min": 2, "max": 1}, "above its max")],
)
def test_a_limit_that_cannot_be_meant_is_refused(sides: dict[str, float], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Limit(**sides)


def test_a_limit_reads_as_words() -> None:
    assert str(Limit(max=1.8)) == "at most 1.8"
    assert str(Limit(min=16)) == "at least 16"
    assert str(Limit.within(0.75)) == "within ±0.75"
    assert str(Limit(min=7, max=9)) == "7 to 9"
    assert str(Limit(min=0, max=0)) == "exactly 0"
    assert str(Limit(max=1_234_567)) == "at most 1 234 567"


def test_a_value_inside_its_limit_passes_and_one_outside_fails() -> None:
    assert check("heading.direct.max", 0.97, unit="deg", limit=Limit(max=1.8)).outcome is Outcome.PASS
    assert check("heading.direct.max", 1.97, unit="deg", limit=Limit(max=1.8)).outcome is Outcome.FAIL


@pytest.mark.parametrize(
    ("limit", "value", "outcome"),
    [
        (Limit(max=2.0), 1.5, Outcome.PASS),  # the limit less U
        (Limit(max=2.0), 1.5001, Outcome.CANNOT_TELL),
        (Limit(max=2.0), 2.5, Outcome.CANNOT_TELL),  # the limit and U
        (Limit(max=2.0), 2.5001, Outcome.FAIL),
        (Limit(min=4.0), 4.5, Outcome.PASS),
        (Limit(min=4.0), 3.4, Outcome.FAIL),
        (Limit.within(2.0), -1.5, Outcome.PASS),
        (Limit.within(2.0), -2.5, Outcome.CANNOT_TELL),
        (Limit.within(2.0), -2.6, Outcome.FAIL),
        (Limit.within(0.25), 0.0, Outcome.CANNOT_TELL),  # wider than the whole limit: nothing passes
        (Limit.within(0.25), 0.8, Outcome.FAIL),
    ],
)
def test_within_its_references_uncertainty_of_a_limit_nothing_is_proven(
    limit: Limit, value: float, outcome: Outcome
) -> None:
    measurement = check("heading.direct.max", value, unit="deg", limit=limit, uncertainty=0.5)
    assert measurement.outcome is outcome
    assert measurement.gates == (outcome is not Outcome.PASS)
    assert ("nearer to its limit than its reference is known, U = 0.5 deg" in measurement.note) == (
        outcome is Outcome.CANNOT_TELL
    )


@given(
    side=st.floats(0.1, 10.0),
    two_sides=st.booleans(),
    value=st.floats(-20.0, 20.0),
    uncertainty=st.floats(0.0, 5.0),
    share=st.floats(-1.0, 1.0),
)
def test_no_true_value_within_the_uncertainty_contradicts_a_verdict(
    side: float, two_sides: bool, value: float, uncertainty: float, share: float
) -> None:
    limit = Limit.within(side) if two_sides else Limit(max=side)
    met = limit.is_met(value, uncertainty)
    assert met in (None, limit.holds(value + share * uncertainty))
    assert limit.is_met(value) is limit.holds(value)


def test_a_value_without_limit_is_recorded() -> None:
    measurement = check("heading.direct.worst_sector", 210.0, unit="deg")
    assert (measurement.outcome, measurement.limit) == (Outcome.INFORMATION, None)


def test_what_a_number_is_of_stands_beside_it_unless_its_outcome_needs_the_place() -> None:
    assert check("x", 1.0, unit="deg", limit=Limit(max=2), note="of one cloud").note == "of one cloud"
    assert "nan" in check("x", math.nan, unit="deg", note="of one cloud").note
    assert check("x", None, unit="deg", not_offered="none needed", note="of one cloud").note == "none needed"
    assert not check("x", None, unit="deg", note="of one cloud").says_why_not


def test_a_nan_fails_and_leaves_no_value() -> None:
    measurement = check("heading.direct.max", math.nan, unit="deg")
    assert (measurement.outcome, measurement.value) == (Outcome.FAIL, None)
    assert "nan" in measurement.note


def test_truth_that_a_real_board_cannot_offer_is_not_unset() -> None:
    measurement = check("fit.direct.offset_error", None, unit="uT", limit=Limit(max=1))
    assert measurement.outcome is Outcome.NOT_OFFERED
    assert not measurement.gates


def test_a_limit_that_cannot_be_judged_is_unset_and_gates() -> None:
    measurement = check("heading.direct.max", 2.7, unit="deg", limit=Limit(max=1.8), not_checked="no mounting declared")
    assert measurement.outcome is Outcome.UNSET
    assert measurement.value == 2.7
    assert measurement.gates


def test_no_value_under_a_limit_is_unset_where_the_board_could_offer_one() -> None:
    measurement = check("fit.direct.offset_error", None, unit="uT", limit=Limit(max=1), could_offer=True)
    assert measurement.outcome is Outcome.UNSET
    assert "no value was given" in measurement.note
    assert check("fit.direct.offset_error", None, unit="uT", could_offer=True).outcome is Outcome.NOT_OFFERED


def test_nothing_is_unset_where_no_limit_was_asked_for() -> None:
    assert check("x", 1.0, unit="deg", not_checked="no mounting declared").outcome is Outcome.INFORMATION


def test_cycles_without_their_model_are_refused() -> None:
    with pytest.raises(ValueError, match="cycle model"):
        check("cycles.direct.total", 12400, unit="cycle")


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (0.1 + 0.2, 0.3),
        (123456789.4, 123456789.0),
        (1.23456789049e-7, 1.23456789e-7),
        (203000, 203000),
        (None, None),
        (-0.0, 0.0),
    ],
)
def test_host_numbers_are_written_with_nine_significant_digits(value: float | None, written: float | None) -> None:
    assert repr(round_significant(value)) == repr(written)


def test_numbers_are_never_written_in_powers_of_ten() -> None:
    limit = Limit(max=10_000)
    measurement = check("cycles.direct.total", 12_345_678.0, unit="cycle", limit=limit, cycle_model="m")
    assert str(measurement) == "cycles.direct.total = 12 345 678 cycle, limit at most 10 000: fail"


def test_a_measurement_says_itself_in_one_line() -> None:
    measurement = check("heading.direct.max", 1.97, unit="deg", limit=Limit(max=1.8))
    assert str(measurement) == "heading.direct.max = 1.97 deg, limit at most 1.8: fail"
