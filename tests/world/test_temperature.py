"""The board's temperature over time."""

import math

import pytest

from hiltest.world.temperature import Temperature


def test_it_is_constant_unless_it_has_an_end():
    assert {Temperature(31.5).temperature_at(time_s) for time_s in (0.0, 1.0, 1e6)} == {31.5}


def test_a_ramp_is_straight_and_stops_at_its_end():
    ramp = Temperature(20.0, 50.0, ramp_s=60.0)
    assert [ramp.temperature_at(time_s) for time_s in (0.0, 20.0, 30.0, 60.0, 61.0, 1e9)] == [
        20.0,
        30.0,
        35.0,
        50.0,
        50.0,
        50.0,
    ]


def test_a_warm_up_goes_63_percent_of_what_is_left_in_a_time_constant():
    for begin, end in ((20.0, 45.0), (45.0, 20.0)):
        course = Temperature(begin, end, time_constant_s=30.0)
        assert course.temperature_at(0.0) == begin
        for time_s in (0.0, 12.0, 55.0):
            remainder = (end - course.temperature_at(time_s + 30.0)) / (end - course.temperature_at(time_s))
            # Temperatures are rounded to 1e-6 degC.
            assert remainder == pytest.approx(1.0 / math.e, abs=2e-6)
        assert course.temperature_at(1e6) == end


@pytest.mark.parametrize(
    "parts",
    [
        {"end_degc": 40.0},
        {"ramp_s": 10.0},
        {"time_constant_s": 10.0},
        {"end_degc": 40.0, "ramp_s": 10.0, "time_constant_s": 10.0},
        {"end_degc": 40.0, "ramp_s": 0.0},
        {"end_degc": 40.0, "time_constant_s": -1.0},
    ],
)
def test_a_course_that_is_not_one_is_refused(parts):
    with pytest.raises(ValueError, match="temperature"):
        Temperature(25.0, **parts)
