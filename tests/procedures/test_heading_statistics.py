"""Heading statistics are right across north, and nothing is removed silently."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.procedures.heading_statistics import rms, summarise

HEADINGS = [30.0 * k for k in range(12)]
# Sums of a dozen doubles below 360: a few ulp of 360, well below 1e-12.
EXACT = 1e-12
SMALL_ERRORS = st.lists(st.floats(-20.0, 20.0), min_size=12, max_size=12)


def test_errors_wrap_across_north() -> None:
    summary = summarise([359.0, -359.0, 1.0], [0.0, 120.0, 240.0])
    assert summary.max_deg == pytest.approx(1.0, abs=EXACT)
    # -1, +1 and +1: mean square 1, circular mean atan2((2-1) sin 1, 3 cos 1) as sines of 1 degree.
    assert summary.rms_deg == pytest.approx(1.0, abs=EXACT)
    expected = math.degrees(math.atan2(math.sin(math.radians(1.0)), 3.0 * math.cos(math.radians(1.0))))
    assert summary.bias_deg == pytest.approx(expected, abs=EXACT)


def test_a_constant_error_is_all_bias_and_stays_in_the_maximum() -> None:
    summary = summarise([1.7] * 12, HEADINGS)
    assert summary.max_deg == pytest.approx(1.7)
    assert summary.bias_deg == pytest.approx(1.7)
    assert summary.max_centred_deg == pytest.approx(0.0, abs=EXACT)


def test_errors_on_both_sides_of_half_a_turn_are_centred_the_short_way_round() -> None:
    """A sensor that is mounted backwards: its errors lie about 180 degrees, some of them written as -179."""
    summary = summarise([179.0, -179.0, 178.0, -178.0], [0.0, 90.0, 180.0, 270.0])
    assert abs(summary.bias_deg or 0.0) == pytest.approx(180.0, abs=EXACT)
    assert summary.max_centred_deg == pytest.approx(2.0, abs=EXACT)


def test_the_worst_sector_is_where_the_largest_error_is() -> None:
    errors = [0.1] * 12
    errors[7] = -3.0
    summary = summarise(errors, HEADINGS)
    sector = summary.worst_sector
    assert (sector.start_deg, sector.end_deg, sector.max_deg) == (210.0, 240.0, 3.0)
    assert summary.worst_heading_deg == 210.0


def test_a_reference_just_below_north_is_in_the_last_sector() -> None:
    assert summarise([2.0], [-0.5]).worst_sector.start_deg == 330.0


def test_a_stuck_compass_has_a_maximum_and_no_bias() -> None:
    summary = summarise([-heading for heading in HEADINGS], HEADINGS)
    assert summary.max_deg == 180.0
    assert summary.bias_deg is None
    assert summary.max_centred_deg is None


def test_tilt_sensitivity_is_the_extra_error_of_tilted_poses() -> None:
    summary = summarise([1.0, -1.0, 3.0, -3.0], [0.0, 90.0, 180.0, 270.0], level=[True, True, False, False])
    assert summary.tilt_sensitivity_deg == pytest.approx(2.0)
    assert summarise([1.0], [0.0], level=[True]).tilt_sensitivity_deg is None


@given(errors=SMALL_ERRORS, offset=st.floats(-150.0, 150.0))
def test_an_offset_moves_the_bias_by_itself_and_leaves_the_centred_maximum(errors: list[float], offset: float) -> None:
    before = summarise(errors, HEADINGS)
    after = summarise([error + offset for error in errors], HEADINGS)
    assert before.bias_deg is not None
    assert before.max_centred_deg is not None
    # atan2 of sums near 1 in length: 1e-9 degrees is far above double rounding and far below a bench.
    assert after.bias_deg == pytest.approx(before.bias_deg + offset, abs=1e-9)
    assert after.max_centred_deg == pytest.approx(before.max_centred_deg, abs=1e-9)


@given(errors=SMALL_ERRORS, turns=st.lists(st.integers(-2, 2), min_size=12, max_size=12))
def test_whole_turns_change_nothing(errors: list[float], turns: list[int]) -> None:
    turned = [error + 360.0 * turn for error, turn in zip(errors, turns, strict=True)]
    assert summarise(turned, HEADINGS).rms_deg == pytest.approx(summarise(errors, HEADINGS).rms_deg, abs=1e-9)


@given(errors=SMALL_ERRORS)
def test_rms_lies_between_mean_magnitude_and_maximum(errors: list[float]) -> None:
    summary = summarise(errors, HEADINGS)
    assert np.mean(np.abs(errors)) - 1e-9 <= summary.rms_deg <= summary.max_deg + 1e-9


def test_rms_by_hand() -> None:
    assert rms([3.0, 4.0]) == pytest.approx(math.sqrt(12.5))


@pytest.mark.parametrize(("errors", "references"), [([], []), ([1.0], [1.0, 2.0])])
def test_lengths_must_fit(errors: list[float], references: list[float]) -> None:
    with pytest.raises(ValueError, match="give equally many"):
        summarise(errors, references)
