"""The float64 calibrators: exact on exact data, and honest about data that determine nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hiltest.calibration import (
    FIRMWARE,
    Calibrator,
    FitStatus,
    fit_corrected,
    fit_direct,
    fit_iterative,
    fit_sphere,
    reference,
)
from hiltest.calibration.quality import direction_difference_rms_deg, sphere_directions
from hiltest.errors import ConfigError

from ..instances import instance

CLOUDS = sorted((Path(__file__).parents[2] / "fixtures" / "clouds").glob("*.json"))
# Noiseless float64 points: the error is rounding (2e-16) times the condition of the normal equations (below 1e4 here).
EXACT = 1e-10

_angle = st.floats(0.0, 6.28)
# Up to two to one: the pivots of a fully covered ellipsoid then stay below 10, far from the 30 of poor coverage.
_eigenvalues = st.tuples(*[st.floats(0.7, 1.4)] * 3)
_offset = st.tuples(*[st.floats(-5000.0, 5000.0)] * 3)


def _rotation(about_z: float, about_x: float) -> np.ndarray:
    c, s, d, t = np.cos(about_z), np.sin(about_z), np.cos(about_x), np.sin(about_x)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, d, -t], [0, t, d]])


@pytest.mark.parametrize("name", sorted(FIRMWARE))
@given(eigenvalues=_eigenvalues, offset=_offset, about_z=_angle, about_x=_angle)
def test_noiseless_ellipsoids_are_found_exactly(
    name: str, eigenvalues: tuple[float, ...], offset: tuple[float, ...], about_z: float, about_x: float
) -> None:
    if (
        name == "li"
    ):  # its constraint 4 J - I^2 = 1 has no solution at two to one about one axis, and a poor one near it
        shape = np.array(eigenvalues) ** -2
        assume(2.0 * shape.sum() ** 2 - 2.0 * (shape**2).sum() > 1.01 * shape.sum() ** 2)
    axes = _rotation(about_z, about_x)
    distortion = (axes * eigenvalues) @ axes.T
    points = 500.0 * sphere_directions(40) @ distortion + offset
    fit = reference(name)(points)
    assert fit.status is FitStatus.ELLIPSOID
    # The descent ends within 1e-5 of the minimum in coordinates of size 1; soft iron is up to some times as far.
    exact = 1e-4 if name == "gradient-descent" else EXACT
    assert np.allclose(fit.soft_iron @ distortion * 500.0, np.eye(3), atol=exact)
    assert np.allclose(fit.hard_iron, offset, atol=exact * 500.0)


def test_three_to_one_is_told_from_poor_coverage() -> None:
    """The pivots of two short axes of three to one are those of a cap; its residual is not."""
    fit = fit_direct(500.0 * sphere_directions(40) * (0.5, 0.5, 1.5))
    assert fit.coverage > 30.0
    assert fit.status is FitStatus.ELLIPSOID


def test_an_ellipsoid_along_the_axes_is_found_as_derived_by_hand() -> None:
    """x = 10 +- 200, y = -20 +- 100, z = 30 +- 50: C = diag(1/200, 1/100, 1/50)."""
    diagonals = [(s, t, u) for s in (-0.6, 0.6) for t in (-0.64, 0.64) for u in (-0.48, 0.48)]
    unit = [*diagonals, (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    points = np.array(unit) * (200.0, 100.0, 50.0) + (10.0, -20.0, 30.0)
    for fit in (fit_direct(points), fit_iterative(points)):
        assert np.allclose(fit.soft_iron, np.diag([0.005, 0.01, 0.02]), atol=0.02 * EXACT)
        assert np.allclose(fit.hard_iron, (10.0, -20.0, 30.0), atol=200.0 * EXACT)
        assert np.allclose(fit.corrected(points), unit, atol=EXACT)


@pytest.mark.parametrize("name", ["direct", "corrected"])
@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda path: path.stem)
def test_closed_forms_match_exact_arithmetic(name: str, cloud: Path) -> None:
    golden = json.loads(cloud.read_text())
    fit, expected = reference(name)(golden["points"]), golden[name]
    assert fit.status.name == expected["status"]
    assert fit.is_sphere == expected["is_sphere"]
    assert fit.iterations == expected.get("iterations", 0)
    soft_iron = np.array(expected["soft_iron"]).reshape(3, 3)
    assert np.allclose(fit.soft_iron, soft_iron, rtol=0, atol=EXACT * soft_iron.max())
    assert np.allclose(fit.hard_iron, expected["hard_iron"], rtol=0, atol=EXACT / soft_iron[0, 0])
    if expected["coverage"] is not None:
        assert fit.coverage == pytest.approx(expected["coverage"], rel=1e-9)


@given(seed=st.integers(0, 10_000), about_z=_angle, about_x=_angle, offset=_offset)
def test_direct_follows_a_rotation_and_a_shift_of_the_points(
    seed: int, about_z: float, about_x: float, offset: tuple[float, ...]
) -> None:
    """The unit-trace fit is Euclidean-invariant: C -> R C R', o -> R o + shift.

    The pivots that judge coverage are not, so the cloud stays far from their threshold.
    """
    points = instance(seed, covered=(0.9, 1.0), stretch=0.3).points_counts.astype(float)
    turn = _rotation(about_z, about_x)
    fit, moved = fit_direct(points), fit_direct(points @ turn.T + offset)
    assert np.allclose(moved.soft_iron, turn @ fit.soft_iron @ turn.T, rtol=0, atol=EXACT)
    # Counts reach 10 000 here, so float64 holds the points only to 2e-12 of them.
    assert np.allclose(moved.hard_iron, turn @ fit.hard_iron + offset, rtol=0, atol=1e-6)


@given(seed=st.integers(0, 10_000))
def test_the_order_of_points_does_not_matter(seed: int) -> None:
    points = instance(seed, covered=(0.9, 1.0)).points_counts
    for fit in map(reference, FIRMWARE):
        assert direction_difference_rms_deg(fit(points), fit(points[::-1])) < 1e-6


def test_coverage_falls_as_less_of_the_sphere_is_covered() -> None:
    ratios = [
        np.median(
            [fit_direct(instance(seed, covered=(part, part), stretch=0.0).points_counts).coverage for seed in range(20)]
        )
        for part in (1.0, 0.75, 0.5, 0.3, 0.2)
    ]
    assert ratios == sorted(ratios)
    assert ratios[0] < 2.0
    assert ratios[-1] > 30.0


@pytest.mark.parametrize("calibrate", [fit_direct, fit_corrected])
def test_a_small_cap_is_refused_without_a_calibration(calibrate: Calibrator) -> None:
    fit = calibrate(instance(1, covered=(0.1, 0.1)).points_counts)
    assert fit.status is FitStatus.POOR_COVERAGE
    assert not fit.has_fit
    assert np.array_equal(fit.soft_iron, np.eye(3))


def test_nine_points_leave_no_residual_to_predict_an_error_from() -> None:
    directions = sphere_directions(40)
    assert fit_direct(500.0 * directions[::4][:9]).status is FitStatus.POOR_COVERAGE
    assert fit_direct(500.0 * directions[::3]).status is FitStatus.ELLIPSOID


def test_a_hyperboloid_is_refused_by_both() -> None:
    golden = json.loads((CLOUDS[0].parent / "hyperboloid.json").read_text())
    for fit in (fit_direct(golden["points"]), fit_iterative(golden["points"])):
        assert fit.status is FitStatus.NOT_AN_ELLIPSOID
        assert not fit.has_fit


def test_a_sphere_is_found_from_four_points() -> None:
    """Four points on the sphere of radius 100 about (1, 2, 3)."""
    fit = fit_sphere([(101, 2, 3), (1, 102, 3), (1, 2, 103), (1, 2, -97)])
    assert np.allclose(fit.hard_iron, (1, 2, 3), atol=100 * EXACT)
    assert np.allclose(fit.soft_iron, np.eye(3) / 100, atol=EXACT)


def test_fewer_points_than_unknowns_are_refused() -> None:
    nine = 100 * sphere_directions(9)
    assert fit_direct(nine[:8]).status is FitStatus.TOO_FEW_POINTS
    assert fit_iterative(nine[:8]).status is FitStatus.TOO_FEW_POINTS
    assert fit_sphere(nine[:3]).status is FitStatus.TOO_FEW_POINTS
    assert not fit_direct(nine[:8]).has_fit


@pytest.mark.parametrize("points", [[(1.0, 2.0)], [(1.0, np.nan, 2.0)] * 9], ids=["two columns", "not a number"])
def test_what_is_not_a_list_of_points_is_an_error(points: list[tuple[float, ...]]) -> None:
    with pytest.raises(ValueError, match="points"):
        fit_direct(points)


def test_an_unknown_calibrator_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"corrected, direct, direct-fast, .* iterative"):
        reference("magic")
