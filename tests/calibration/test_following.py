"""Hard iron that follows a current and a temperature, in logs whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.following import fit_following
from hiltest.errors import CalibrationError

from .hand_turned import hand_turned


def _current(random: np.random.Generator, count: int) -> np.ndarray:
    """Return the current of a motor whose throttle changes every two and a half seconds [A], shape (count,)."""
    return np.repeat(np.abs(random.normal(4.0, 3.0, count // 50 + 1)), 50)[:count]


def test_of_fifty_logs_the_vector_is_within_twice_its_error_in_95_percent() -> None:
    within, ratios = 0, []
    for seed in range(50):
        random = np.random.default_rng(seed)
        points, current, truth = hand_turned(seed, 600), _current(random, 600), random.normal(0.0, 0.7, 3)
        iron = fit_following(points + np.outer(current, truth), current[:, None])
        off = float(np.linalg.norm(iron.vectors[0] - truth))
        within += off <= 2.0 * float(iron.errors[0])
        ratios.append(off / float(iron.errors[0]))
    assert within >= 48
    # Their rms is 1 if the stated errors are right; 50 draws of three components scatter by 6 %, the jackknife by more.
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.25)


def test_two_quantities_are_told_apart_and_their_effect_is_stated() -> None:
    points, current = hand_turned(1, 1200), _current(np.random.default_rng(1), 1200)
    warming, truth = np.linspace(-10.0, 10.0, 1200), np.array([[0.6, -0.4, 0.2], [0.05, 0.0, -0.1]])
    values = np.column_stack([current, warming])
    iron = fit_following(points + values @ truth, values)
    assert (np.linalg.norm(iron.vectors - truth, axis=1) < 2.5 * iron.errors).all()
    clean = fit_following(points, values)
    assert iron.after_percent == pytest.approx(clean.after_percent, rel=0.02)
    assert iron.before_percent > 2.0 * iron.after_percent
    assert (iron.explained > 0.75, clean.explained < 0.1) == (True, True)


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        (np.full((400, 1), 3.0), "does not change"),
        (np.column_stack([np.arange(400.0), 2.0 * np.arange(400.0)]), "not independently"),
        (np.ones((400, 1))[:20], "too few"),
    ],
)
def test_a_column_that_determines_nothing_is_refused(values: np.ndarray, complaint: str) -> None:
    with pytest.raises(CalibrationError, match=complaint):
        fit_following(hand_turned(1, 400)[: len(values)], values)
