"""Magnetometer and accelerometer calibrated together: what gravity adds to the norms."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hiltest.calibration import FitStatus
from hiltest.calibration.constant_dip import fit_constant_dip
from hiltest.calibration.pair_fit import PAIR_METHODS, fit_joint, fit_norms, fit_turned, held_out_dip_deg
from hiltest.calibration.quality import rotation_left_deg

from ..interfaces.conftest import shared_data  # noqa: F401  # a fixture
from .still_pairs import (
    ALIGNED,
    DIP_DEG,
    FIELD_UT,
    ROTATION,
    TRUTH,
    Shots,
    direction_error_deg,
    repeats_within_deg,
    still_pairs,
)

METHODS = {"norms": fit_norms, **PAIR_METHODS}


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(-85.0, 85.0))
def test_any_rotation_of_one_sensor_against_the_other_is_found(seed: int, dip_deg: float) -> None:
    attitudes, rotation = Rotation.random(30, random_state=seed), Rotation.random(random_state=seed // 2)
    dip = np.radians(dip_deg)
    field = attitudes.apply([np.cos(dip), 0.0, np.sin(dip)])
    result = fit_constant_dip(rotation.inv().apply(field), attitudes.apply([0.0, 0.0, 1.0]))
    # Rounding of float64, 1e-16, by the slope of the least defined turn, cos(85 deg), squared in the variance.
    np.testing.assert_allclose(result.rotation, rotation.as_matrix(), atol=1e-6)
    assert result.angle_deg == pytest.approx(np.degrees(rotation.magnitude()), abs=1e-4)
    assert result.spread < 1e-7


@pytest.mark.parametrize("name", PAIR_METHODS)
@pytest.mark.parametrize("per_unit", [1.0, 1e-2, 1e4])
def test_readings_without_noise_give_the_truth_in_any_unit(name: str, per_unit: float) -> None:
    points, acceleration = still_pairs(1, 40, noise_ut=0.0, noise_g=0.0)
    fit = PAIR_METHODS[name](points * per_unit, 9.8 * acceleration)
    assert fit.is_ellipsoid
    # The solver of `joint` ends where a step is 1e-8 of what it is.
    np.testing.assert_allclose(fit.magnetometer.soft_iron * per_unit, TRUTH.soft_iron, atol=1e-7 / FIELD_UT)
    np.testing.assert_allclose(fit.magnetometer.hard_iron / per_unit, TRUTH.hard_iron, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(fit.accelerometer.gravity_g(9.8 * acceleration), axis=1), 1.0, atol=1e-7)
    np.testing.assert_allclose(fit.dips_deg(points * per_unit, 9.8 * acceleration), DIP_DEG, atol=1e-5)


def test_norms_alone_are_as_wrong_as_the_rotation_and_the_dip_held_out_shows_it() -> None:
    pairs = still_pairs(2, 400)
    norms, turned = fit_norms(*pairs), fit_turned(*pairs)
    angle_deg = np.degrees(ROTATION.magnitude())
    # Directions across the axis of a rotation are off by its angle, and rms over the sphere by sqrt(2/3) of it.
    assert direction_error_deg(norms.magnetometer) == pytest.approx(np.sqrt(2.0 / 3.0) * angle_deg, rel=0.1)
    assert rotation_left_deg(turned.magnetometer, np.linalg.inv(TRUTH.soft_iron)) < 0.1 * angle_deg
    alone, held_out = (held_out_dip_deg(method, *pairs) for method in (fit_norms, fit_turned))
    assert alone is not None
    assert held_out is not None
    # Of a rotation that is not about the field or gravity, half or more; of the noise, 0.2 uT and 2 mg, 0.27 deg.
    assert alone > angle_deg / 2.0
    assert held_out == pytest.approx(np.degrees(np.hypot(0.2 / FIELD_UT, 0.002)), rel=0.2)


def test_more_unknowns_do_not_win_by_fitting_their_own_pairs() -> None:
    """The dip within 24 pairs of a fit varies less than their noise makes it; the dip held out more."""
    noise_deg = np.degrees(np.hypot(0.4 / FIELD_UT, 0.002))
    within, held_out, wrong = [], [], []
    for seed in range(10):
        pairs = still_pairs(seed, 24, noise_ut=0.4)
        fits = [method(*pairs) for method in PAIR_METHODS.values()]
        within.append([fit.dips_deg(*pairs).std() for fit in fits])
        held_out.append([held_out_dip_deg(method, *pairs) or np.inf for method in PAIR_METHODS.values()])
        wrong.append([direction_error_deg(fit.magnetometer) for fit in fits])
    _, joint, _ = np.median(within, axis=0)
    # 22 unknowns take their part of 72 residuals: 0.83 of the noise is left.
    assert joint < 0.9 * noise_deg
    assert np.median(held_out, axis=0).min() > 1.1 * noise_deg
    # As the truth has it: 12 unknowns in 24 products are too many for the norms to be thrown away.
    assert np.argsort(np.median(held_out, axis=0)).tolist() == np.argsort(np.median(wrong, axis=0)).tolist()


def test_the_joint_fit_is_the_best_of_noisy_pairs() -> None:
    """In float64, of 20 draws; the accelerometer's noise bends its own ellipsoid, and the joint fit sees both."""
    errors = np.array(
        [
            [
                direction_error_deg(method(*still_pairs(seed, 24, noise_ut=0.2, noise_g=0.005)).magnetometer)
                for method in METHODS.values()
            ]
            for seed in range(20)
        ]
    )
    norms, turned, joint, dpi = np.sqrt((errors**2).mean(axis=0))
    assert joint < turned < dpi < norms


@pytest.mark.parametrize("name", METHODS)
def test_pairs_that_determine_nothing_are_singular(name: str) -> None:
    points, acceleration = still_pairs(3, 60)
    for wrong in ((points[:5], acceleration[:5]), (points, 0.0 * acceleration), (0.0 * points, acceleration)):
        fit = METHODS[name](*wrong)
        assert fit.magnetometer.status is FitStatus.SINGULAR
        assert not fit.is_ellipsoid
    assert held_out_dip_deg(METHODS[name], points[:9], acceleration[:9]) is None


@pytest.fixture
def shots(shared_data: Callable[[str], Path]) -> list[Shots]:  # noqa: F811
    """16 instruments: eight shots all round, and twice eight of one aim, rolled."""
    folder = shared_data("circuitpython_magcal/tests/fixtures")
    return [Shots.read(path) for path in sorted(folder.glob("*/*.json"))]


def test_aligned_shots_repeat_as_they_should(shots: list[Shots]) -> None:
    """What a group of eight says that the calibration has not seen; the other sixteen shots made it."""
    results: dict[str, list[float]] = {name: [] for name in METHODS}
    for shot in shots:
        for aligned in ALIGNED:
            stored = np.delete(np.arange(len(shot.points)), aligned)
            for name, method in METHODS.items():
                fit = method(shot.points[stored], shot.acceleration[stored])
                field = fit.magnetometer.corrected(shot.points[aligned])
                results[name].append(repeats_within_deg(field, fit.accelerometer.gravity_g(shot.acceleration[aligned])))
    norms, turned, joint, dpi = (float(np.median(values)) for values in results.values())
    # What a cave survey asks of an instrument.
    assert turned < 0.7
    assert joint < 0.7
    assert joint < turned < dpi < norms


@pytest.mark.slow  # 13 fits of each method on 16 instruments
def test_the_dip_held_out_orders_methods_as_aligned_shots_do(shots: list[Shots]) -> None:
    agreed: dict[tuple[str, str], int] = dict.fromkeys(combinations(METHODS, 2), 0)
    for shot in shots:
        wrong: dict[str, float] = {}
        for name, method in METHODS.items():
            groups = []
            for aligned in ALIGNED:
                stored = np.delete(np.arange(len(shot.points)), aligned)
                fit = method(shot.points[stored], shot.acceleration[stored])
                field = fit.magnetometer.corrected(shot.points[aligned])
                groups.append(repeats_within_deg(field, fit.accelerometer.gravity_g(shot.acceleration[aligned])))
            wrong[name] = float(np.hypot(*groups))
        spread = {
            name: held_out_dip_deg(method, shot.points, shot.acceleration) or np.inf for name, method in METHODS.items()
        }
        for first, second in agreed:
            agreed[first, second] += (wrong[first] < wrong[second]) == (spread[first] < spread[second])
    assert agreed["norms", "joint"] == agreed["norms", "direct+rotation"] == len(shots)
    # Chance alone has 12 or more of 16 right in 4 of 100 cases.
    assert min(agreed.values()) >= 12


def test_a_joint_fit_that_does_not_end_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from scipy import optimize

    whole = optimize.least_squares
    monkeypatch.setattr(optimize, "least_squares", lambda *arguments, **how: whole(*arguments, **how, max_nfev=1))
    assert fit_joint(*still_pairs(4, 60)).magnetometer.status is FitStatus.NOT_CONVERGED
