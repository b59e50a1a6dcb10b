"""Turns calibrate a gyroscope exactly when nothing is noisy; what does not determine it is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.calibration.gyroscope import (
    GyroscopeFit,
    GyroscopeTurn,
    TurnsStatus,
    fit_turns,
    misalignment_deg,
    scale_error_percent,
)

RESPONSE = 16.0 * np.array([[1.012, 0.008, -0.013], [-0.011, 0.985, 0.006], [0.009, -0.014, 1.018]])
PERIOD_S = 0.005


def turn_about(turned_deg: np.ndarray, response: np.ndarray = RESPONSE, *, drift: float = 0.0) -> GyroscopeTurn:
    """A turn whose sum is exact up to rounding to whole counts; the bias drifts by `drift` from rest to rest."""
    n, before = 1200, np.array([24.25, -33.5, 19.0])
    after = before + drift
    bias = before + 0.4 * (after - before)
    total = np.round(response @ turned_deg / PERIOD_S + n * bias).astype(np.int64)
    return GyroscopeTurn(turned_deg, total, n, (n - 1) * PERIOD_S, before, after, 0.4)


@given(st.integers(0, 2**32 - 1), st.integers(3, 8))
def test_any_turns_that_span_give_the_matrix_back(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    response = 16.0 * (np.eye(3) + rng.uniform(-0.05, 0.05, (3, 3)))
    axes = np.concatenate([np.eye(3), rng.normal(size=(count - 3, 3))])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    turns = [turn_about(axis * rng.uniform(180, 720) * rng.choice([-1, 1]), response, drift=2.0) for axis in axes]
    fit = fit_turns(turns)
    assert fit.status is TurnsStatus.OK
    # Sums are whole counts: half a count in 180 deg * 16 / 0.005 s, 600 000; axes that are near one another add to it.
    assert np.allclose(fit.matrix @ response, np.eye(3), atol=1e-5)
    assert fit.residual_deg < 0.01


def test_the_bias_is_interpolated_to_the_middle_of_the_turn() -> None:
    turns = [turn_about(360.0 * axis, drift=16.0) for axis in np.eye(3)]
    assert np.allclose(np.linalg.inv(fit_turns(turns).matrix), RESPONSE, atol=1e-4)
    ignored = [replace(turn, bias_after=turn.bias_before) for turn in turns]
    # 6.4 counts for 6 s are 38.4 of 5760 count s.
    assert np.abs(np.linalg.inv(fit_turns(ignored).matrix) - RESPONSE).max() == pytest.approx(0.1067, rel=1e-2)


@pytest.mark.parametrize(
    ("wrong", "scale_percent", "angle_deg"),
    [
        (np.diag([1.0, 1.0, -1.0]), 0.0, 180.0),
        (np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0]]), 0.0, 90.0),
        (2.0 * np.eye(3), 100.0, 0.0),
        (np.eye(3) * np.pi / 180.0, -98.25, 0.0),
    ],
    ids=["sign", "axes swapped", "twice the scale", "radians"],
)
def test_a_wrong_sign_axis_or_unit_is_a_large_error(wrong: np.ndarray, scale_percent: float, angle_deg: float) -> None:
    response = turn_about(np.array([0.0, 0, 360]), 16.0 * wrong).response
    truth = np.array([0.0, 0, 16.0])
    assert scale_error_percent(response, truth) == pytest.approx(scale_percent, abs=0.01)
    assert misalignment_deg(response, truth) == pytest.approx(angle_deg, abs=0.01)


def test_the_error_of_one_turn_is_of_its_column() -> None:
    turn = turn_about(np.array([0.0, 0, -360]))
    assert turn.response == pytest.approx(-RESPONSE[:, 2], abs=1e-4)
    assert scale_error_percent(turn.response, RESPONSE @ turn.direction) == pytest.approx(0.0, abs=1e-4)
    assert misalignment_deg(turn.response, RESPONSE @ turn.direction) == pytest.approx(0.0, abs=1e-4)
    assert misalignment_deg(turn.response, np.array([0.0, 0, -16.0])) == pytest.approx(
        np.degrees(np.arctan2(np.hypot(-0.013, 0.006), 1.018)), abs=1e-3
    )


X, Y, Z = (360.0 * axis for axis in np.eye(3))


@pytest.mark.parametrize(
    ("turns", "status", "at_fault"),
    [
        ([X, Y], TurnsStatus.TOO_FEW, None),
        ([X, Y, Z] * 3, TurnsStatus.TOO_FEW, None),
        ([X, Y, 89.0 * Z / 360.0], TurnsStatus.TOO_SMALL, 2),
        ([X, 0.0 * Y, Z], TurnsStatus.TOO_SMALL, 1),
        ([X, Y * np.nan, Z], TurnsStatus.TOO_SMALL, 1),
        ([X, Y, -X, X + Y], TurnsStatus.NOT_SPANNING, None),
        ([X, Y, 360.0 * np.array([np.cos(0.07), 0, np.sin(0.07)])], TurnsStatus.NOT_SPANNING, None),  # 4 degrees
    ],
)
def test_turns_that_do_not_determine_the_matrix_are_named(
    turns: list[np.ndarray], status: TurnsStatus, at_fault: int | None
) -> None:
    results = [turn_about(np.nan_to_num(turned)) for turned in turns]
    fit = fit_turns([replace(entry, turned_deg=turned) for entry, turned in zip(results, turns, strict=True)])
    assert (fit.status, fit.at_fault) == (status, at_fault)
    assert not fit.matrix.any()


@pytest.mark.parametrize(
    "dead", [np.diag([1.0, 0, 1]), np.zeros((3, 3)), np.array([[1.0, 0, 0], [1, 0, 0], [0, 0, 1]])]
)
def test_a_gyroscope_with_a_dead_axis_is_singular(dead: np.ndarray) -> None:
    assert fit_turns([turn_about(turned, 16.0 * dead) for turned in (X, Y, Z)]).status is TurnsStatus.SINGULAR


def test_a_calibration_gives_rates() -> None:
    fit = GyroscopeFit(np.linalg.inv(RESPONSE), np.array([24.0, -33.0, 19.0]))
    rates = np.array([[10.0, -20.0, 30.0], [0.0, 0.0, 0.0]])
    assert fit.rate_dps(rates @ RESPONSE.T + fit.bias) == pytest.approx(rates)
    assert fit.response == pytest.approx(RESPONSE)
