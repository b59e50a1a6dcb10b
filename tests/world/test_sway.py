"""The motion that a filter is judged by."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.world.motion import body_rate_dps
from hiltest.world.sway import SWAY_S, Sway


def test_a_sway_goes_from_rest_to_rest_once_and_a_half_round() -> None:
    sway = Sway(3.0, 3.0 + SWAY_S, 10.0)
    begin, end = sway.angles(3.0), sway.angles(3.0 + SWAY_S)
    assert begin[1] == end[1] == (0.0, 0.0, 0.0)
    assert (begin[0].heading_deg, end[0].heading_deg) == (10.0, 550.0)
    for pose in (begin[0], end[0]):
        assert (pose.pitch_deg, pose.roll_deg) == (0.0, 0.0)
    assert sway.angles(100.0)[0] == end[0]


def test_rates_are_the_slopes_of_the_angles() -> None:
    sway, step_s = Sway(0.0, SWAY_S), 1e-4
    for time_s in np.linspace(0.5, SWAY_S - 0.5, 20):
        before, after = (sway.angles(time_s + sign * step_s)[0] for sign in (-1, 1))
        slopes = [
            (getattr(after, name) - getattr(before, name)) / (2 * step_s)
            for name in ("heading_deg", "pitch_deg", "roll_deg")
        ]
        # Central differences: a third derivative of some 100 deg/s^3 times the step squared.
        assert sway.angles(time_s)[1] == pytest.approx(slopes, abs=1e-5)


def test_it_turns_and_tilts_at_tens_of_degrees_a_second() -> None:
    sway = Sway(0.0, SWAY_S)
    angles = [sway.angles(time_s) for time_s in np.linspace(0.0, SWAY_S, 500)]
    rates = np.array([np.linalg.norm(body_rate_dps(*angle)) for angle in angles])
    assert 40.0 < rates.max() < 70.0
    assert np.mean(rates > 10.0) > 0.7
    assert max(abs(pose.pitch_deg) for pose, _ in angles) == pytest.approx(20.0, abs=0.1)
    assert max(abs(pose.roll_deg) for pose, _ in angles) == pytest.approx(20.0, abs=0.1)
