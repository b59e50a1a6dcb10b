"""The calibrators of the literature: exact on exact data, as equivariant as what they minimise, and honest."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from ellipse import LsqEllipse
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eig
from scipy.optimize import least_squares

from hiltest.calibration import BATCHES, FIRMWARE, REFERENCES, FitStatus, MagnetometerFit, fit_direct, reference
from hiltest.calibration.algebraic import slope_products
from hiltest.calibration.clouds import Clouds, mean_products, monomials
from hiltest.calibration.gradient_descent import LEAST_EIGENVALUE
from hiltest.calibration.norm_residuals import nearest_points, parameters_of
from hiltest.calibration.quality import sphere_directions

from ..instances import instance

NAMES = sorted(REFERENCES.keys() - FIRMWARE)
# Solved at once, whatever the points: these have an ellipsoid for every noiseless one.
CLOSED_FORMS = ("fitzgibbon-ying", "hyper", "li", "merayo", "taubin", "gradient-descent")
ITERATIVE = sorted(set(NAMES) - set(CLOSED_FORMS))
# What constrains these to ellipsoids holds for any points.
ELLIPSOID_SPECIFIC = ("fitzgibbon-ying", "gradient-descent", "li")
# Their norm, and their start, are those of the sensor's own origin.
ABOUT_ZERO = ("frosio", "merayo")
# Noiseless float64 points: rounding (2e-16) times the condition of the normal equations (below 50 here), and times the
# square of what the offset adds to the size of the coordinates (10) where they are the sensor's own.
EXACT = 1e-9
# Where its steps end.
DESCENT = 1e-4
HYPERBOLOID = Path(__file__).parents[2] / "fixtures" / "clouds" / "hyperboloid.json"

_angle = st.floats(0.0, 6.28)
# The longest axis up to 1.9 of the shortest: `li` holds no more than 2.
_eigenvalues = st.tuples(*[st.floats(0.7, 1.33)] * 3)
_offset = st.tuples(*[st.floats(-2000.0, 2000.0)] * 3)


def _rotation(about_z: float, about_x: float) -> np.ndarray:
    c, s, d, t = np.cos(about_z), np.sin(about_z), np.cos(about_x), np.sin(about_x)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, d, -t], [0, t, d]])


def _noisy(seed: int, *, count: int = 100, noise_ut: float = 1.0, hard_iron_ut: float = 20.0) -> np.ndarray:
    return instance(
        seed, count, noise_ut=noise_ut, stretch=0.2, largest_hard_iron_ut=hard_iron_ut, covered=(0.8, 1.0)
    ).points_counts.astype(float)


def _assert_same(fit: MagnetometerFit, other: MagnetometerFit, tolerance: float) -> None:
    """Compare with the radius, some 500 counts, as the unit."""
    assert fit.status is other.status is FitStatus.ELLIPSOID
    assert np.allclose(fit.soft_iron, other.soft_iron, rtol=0, atol=tolerance / 500.0)
    assert np.allclose(fit.hard_iron, other.hard_iron, rtol=0, atol=tolerance * 500.0)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10)
@given(eigenvalues=_eigenvalues, offset=_offset, about_z=_angle, about_x=_angle)
def test_noiseless_ellipsoids_are_found_exactly_or_the_status_says_not(
    name: str, eigenvalues: tuple[float, ...], offset: tuple[float, ...], about_z: float, about_x: float
) -> None:
    axes = _rotation(about_z, about_x)
    distortion = (axes * eigenvalues) @ axes.T
    fit = reference(name)(500.0 * sphere_directions(40) @ distortion + offset)
    if name in ITERATIVE and fit.status is not FitStatus.ELLIPSOID:
        assert fit.status is FitStatus.NOT_AN_ELLIPSOID
        assert not fit.has_fit
        return
    exact = DESCENT if name == "gradient-descent" else EXACT
    assert fit.status is FitStatus.ELLIPSOID
    assert np.allclose(fit.soft_iron @ distortion * 500.0, np.eye(3), atol=exact)
    assert np.allclose(fit.hard_iron, offset, atol=exact * 500.0)


@pytest.mark.parametrize("name", sorted(set(ITERATIVE) - {"frosio"}))
@settings(max_examples=5)
@given(seed=st.integers(0, 10_000))
def test_iterations_from_the_points_converge_on_good_samples(name: str, seed: int) -> None:
    assert reference(name)(_noisy(seed, hard_iron_ut=500.0)).status is FitStatus.ELLIPSOID


@pytest.mark.parametrize("ratio", [0.0, 0.5])
def test_frosio_converges_from_zero_for_a_small_offset(ratio: float) -> None:
    assert _frosio_converged("frosio", ratio) == 1.0


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_frosio_needs_the_mean_subtracted_for_an_offset_of_the_field(ratio: float) -> None:
    """Puc, Podobnik and Munih, section 3.2: it never converged before, and did after."""
    assert _frosio_converged("frosio", ratio) < 0.2
    assert _frosio_converged("frosio-centred", ratio) == 1.0


def _frosio_converged(name: str, ratio: float) -> float:
    offset = ratio * np.array([300.0, 400.0, 0.0])
    points = [_noisy(seed, hard_iron_ut=0.0) + offset for seed in range(20)]
    return float(BATCHES[name](points).is_ellipsoid.mean())


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=5)
@given(seed=st.integers(0, 10_000), about_z=_angle, about_x=_angle, offset=_offset, scale=st.floats(0.01, 100.0))
def test_turns_shifts_and_scales_of_the_points_are_those_of_the_fit(
    name: str, seed: int, about_z: float, about_x: float, offset: tuple[float, ...], scale: float
) -> None:
    points, turn = _noisy(seed), _rotation(about_z, about_x)
    shift = np.zeros(3) if name in ABOUT_ZERO else np.array(offset)
    if name == "merayo":
        turn = np.eye(3)[[1, 2, 0]]
    fit, moved = reference(name)(points), reference(name)(scale * points @ turn.T + shift)
    back = MagnetometerFit(
        moved.status, False, 0, scale * turn.T @ moved.soft_iron @ turn, turn.T @ (moved.hard_iron - shift) / scale
    )
    # The descent ends short of the minimum, least squares where float64 no longer tells two errors apart: 1e-8.
    _assert_same(fit, back, DESCENT if name == "gradient-descent" else 1e-6)


def test_the_unit_norm_of_merayo_depends_on_origin_and_axes() -> None:
    points = _noisy(1, hard_iron_ut=0.0)
    about_zero, shifted = (reference("merayo")(points + shift).hard_iron - shift for shift in (0.0, 1000.0))
    turn = _rotation(0.7, 0.4)
    turned = reference("merayo")(points @ turn.T).hard_iron @ turn
    # Counts of 0.1 uT, and noise of 10 counts: by more than a tenth of a count is no rounding.
    assert np.linalg.norm(shifted - about_zero) > 0.1
    assert np.linalg.norm(turned - about_zero) > 1e-4


def test_frosio_without_the_mean_subtracted_depends_on_the_origin() -> None:
    points = _noisy(1, hard_iron_ut=0.0)
    assert reference("frosio")(points).status is FitStatus.ELLIPSOID
    assert not reference("frosio")(points + 1000.0).has_fit


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), squeeze=st.floats(0.5, 2.0), shear=st.floats(-0.5, 0.5))
def test_fitzgibbons_fit_follows_any_affine_map(seed: int, squeeze: float, shear: float) -> None:
    points, affine = _noisy(seed), np.array([[squeeze, shear, 0.0], [0.0, 1.0, shear], [0.0, 0.0, 1.0]])
    fit, mapped = reference("fitzgibbon-ying")(points), reference("fitzgibbon-ying")(points @ affine.T)
    shape = affine.T @ mapped.soft_iron @ mapped.soft_iron @ affine
    assert np.allclose(shape, fit.soft_iron @ fit.soft_iron, rtol=0, atol=1e-9 / 500.0**2)
    assert np.allclose(mapped.hard_iron, affine @ fit.hard_iron, rtol=0, atol=1e-9 * 500.0)


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000))
def test_gradient_descent_ends_where_least_squares_of_unit_trace_do(seed: int) -> None:
    points = _noisy(seed)
    x, y, z = points.T / 500.0
    rows = np.column_stack([x * x - z * z, y * y - z * z, x * y, x * z, y * z, x, y, z, np.ones(len(x))])
    a, b, d, e, f, *linear = np.linalg.lstsq(rows, -z * z, rcond=None)[0][:8]
    shape = np.array([[a, d / 2, e / 2], [d / 2, b, f / 2], [e / 2, f / 2, 1.0 - a - b]])
    fit = reference("gradient-descent")(points)
    assert np.allclose(fit.hard_iron, -250.0 * np.linalg.solve(shape, linear), atol=DESCENT * 500.0)
    _assert_same(fit, fit_direct(points), DESCENT)


def test_li_is_the_eigenvector_of_the_papers_equation_15() -> None:
    points = _noisy(3)
    x, y, z = points.T / 500.0
    rows = np.column_stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z, np.ones(len(x))])
    scatter = rows.T @ rows
    first = np.diag([-1.0, -1.0, -1.0, -4.0, -4.0, -4.0])
    first[:3, :3] = 1.0 - 2.0 * np.eye(3)
    rest = np.linalg.solve(scatter[6:, 6:], scatter[6:, :6])
    values, vectors = eig(np.linalg.solve(first, scatter[:6, :6] - scatter[:6, 6:] @ rest))
    a, b, c, f, g, h = vectors[:, values.real.argmax()].real
    linear = -(rest @ (a, b, c, f, g, h))[:3]
    expected = -500.0 * np.linalg.solve([[a, h, g], [h, b, f], [g, f, c]], linear)
    # Two ways to the same eigenvector: rounding times the condition.
    assert np.allclose(reference("li")(points).hard_iron, expected, atol=EXACT * 500.0)


def test_li_holds_no_ellipsoid_of_three_to_one() -> None:
    points = 500.0 * sphere_directions(60) * (1.2, 1.2, 0.4)
    assert np.allclose(reference("taubin")(points).soft_iron, np.diag([1 / 600, 1 / 600, 1 / 200]), atol=EXACT / 500)
    assert not np.allclose(reference("li")(points).soft_iron, np.diag([1 / 600, 1 / 600, 1 / 200]), rtol=0.1)


@pytest.mark.parametrize(
    ("name", "same"), [("gauss-newton", "levenberg-marquardt"), ("gauss-newton-geometric", "geometric")]
)
def test_two_ways_down_end_at_one_minimum(name: str, same: str) -> None:
    points = _noisy(4)
    # At a minimum float64 no longer tells errors apart whose parameters differ by the root of its rounding, 1.5e-8.
    _assert_same(reference(name)(points), reference(same)(points), 1e-6)


def test_geometric_is_least_squares_over_points_of_the_surface_as_well() -> None:
    """Independent: the point of the surface for each sample is unknown too, and no distance is ever computed."""
    points = _noisy(5, count=25) / 500.0

    def off(unknowns: np.ndarray) -> np.ndarray:
        centre, matrix, (turn, lift) = unknowns[:3], np.zeros((3, 3)), unknowns[9:].reshape(2, -1)
        matrix[np.tril_indices(3)] = unknowns[3:9]
        units = np.column_stack([np.cos(turn) * np.cos(lift), np.sin(turn) * np.cos(lift), np.sin(lift)])
        return np.ravel(centre + units @ matrix.T - points)

    start = points - points.mean(axis=0)
    angles = [np.arctan2(start[:, 1], start[:, 0]), np.arctan2(start[:, 2], np.hypot(*start[:, :2].T))]
    result = least_squares(
        off, np.concatenate([points.mean(axis=0), [1, 0, 1, 0, 0, 1], *angles]), xtol=1e-15, ftol=1e-15, gtol=1e-15
    ).x
    matrix = np.zeros((3, 3))
    matrix[np.tril_indices(3)] = result[3:9]
    fit = reference("geometric")(points * 500.0)
    # Its derivatives are differences, good to 1e-8 of the parameters.
    assert np.allclose(fit.hard_iron / 500.0, result[:3], atol=1e-6)
    assert np.allclose(np.linalg.inv(500.0 * fit.soft_iron @ fit.soft_iron * 500.0), matrix @ matrix.T, atol=1e-6)


def test_the_nearest_point_is_on_the_surface_and_straight_below() -> None:
    soft_iron = np.array([[1.4, 0.2, 0.0], [0.2, 0.8, 0.1], [0.0, 0.1, 1.0]])
    centre = np.array([0.3, -0.2, 0.1])
    surface = sphere_directions(60) @ np.linalg.inv(soft_iron)
    for part in (0.6, 1.0, 3.0):
        points = centre + part * surface
        feet = nearest_points(parameters_of(centre, soft_iron), points)
        assert np.allclose(np.linalg.norm((feet - centre) @ soft_iron, axis=1), 1.0, atol=1e-12)
        normals = (feet - centre) @ soft_iron @ soft_iron
        assert np.allclose(np.cross(points - feet, normals), 0.0, atol=1e-12)
        # None of the 60 that the others have is nearer.
        others = np.linalg.norm(points[:, None] - feet, axis=2)
        assert (np.linalg.norm(points - feet, axis=1) <= others.min(axis=1) + 1e-12).all()


def test_frosio_centred_is_scipys_least_squares_of_squared_norms() -> None:
    points = _noisy(6) / 500.0

    def off(parameters: np.ndarray) -> np.ndarray:
        upper = np.zeros((3, 3))
        upper[np.triu_indices(3)] = parameters[3:]
        return ((upper @ (points - parameters[:3]).T) ** 2).sum(axis=0) - 1.0

    result = least_squares(off, [0, 0, 0, 1, 0, 0, 1, 0, 1], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    fit = reference("frosio-centred")(500.0 * points)
    assert np.allclose(fit.hard_iron / 500.0, result[:3], atol=1e-6)


@pytest.mark.parametrize("name", ["li", "fitzgibbon-ying"])
def test_fitzgibbons_ellipse_is_that_of_lsq_ellipse(name: str) -> None:
    random = np.random.default_rng(7)
    angle = random.uniform(0.0, 4.5, 60)
    points = np.column_stack([500.0 * np.cos(angle), 300.0 * np.sin(angle)]) @ [[0.8, 0.6], [-0.6, 0.8]]
    points += random.normal(0.0, 10.0, points.shape)
    centre, width, height, turn = LsqEllipse().fit(points).as_parameters()
    along = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    fit = BATCHES[name](points)
    # It takes the counts as they are: its scatter's condition of 1e11 leaves 5 digits.
    assert np.allclose(fit.hard_iron, centre, atol=1e-4)
    assert np.allclose(fit.soft_iron, along @ np.diag([1 / width, 1 / height]) @ along.T, rtol=0, atol=1e-5 / 500.0)


def test_products_of_slopes_are_those_of_differences() -> None:
    points, step = _noisy(8, count=20) / 500.0, 1e-4
    slopes = [(monomials(points + item) - monomials(points - item)) / (2.0 * step) for item in step * np.eye(3)]
    total = sum(mean_products(slope) for slope in slopes)
    # Central differences of a quadratic are exact but for rounding, 1e-16 over the step.
    assert np.allclose(slope_products(mean_products(monomials(points)), 3), total, atol=1e-10)


def test_hyper_takes_out_the_bias_that_shrinks_the_ellipse_of_direct() -> None:
    """Half an ellipse with noise of a twentieth of it, 4000 times: the mean centre is off by bias alone."""
    random = np.random.default_rng(9)
    angle = np.linspace(0.0, np.pi, 40)
    points = np.column_stack([np.cos(angle), 0.8 * np.sin(angle)]) + random.normal(0.0, 0.03, (4000, 40, 2))
    bias = {
        name: float(np.nanmedian(BATCHES[name](points).hard_iron[:, 1]))
        for name in ("hyper", "taubin", "fitzgibbon-ying")
    }
    # The median over 4000 is known to 1.25 x 0.03 / sqrt 4000 = 6e-4 of the spread that one has.
    assert abs(bias["hyper"]) < 0.3 * abs(bias["fitzgibbon-ying"])
    assert abs(bias["hyper"]) <= abs(bias["taubin"]) + 2e-3


@pytest.mark.parametrize("name", ELLIPSOID_SPECIFIC)
def test_estimators_kept_to_ellipsoids_make_one_of_a_hyperboloid_and_calibrators_refuse_it(name: str) -> None:
    points = np.array(json.loads(HYPERBOLOID.read_text())["points"])
    assert reference(name)(points).status is fit_direct(points).status is FitStatus.NOT_AN_ELLIPSOID
    fit = BATCHES[name](points)
    assert fit.is_ellipsoid
    if name == "gradient-descent":
        shape = fit.soft_iron @ fit.soft_iron
        assert np.linalg.eigvalsh(shape / np.trace(shape))[0] == pytest.approx(LEAST_EIGENVALUE, rel=1e-9)


@pytest.mark.parametrize("name", sorted(set(NAMES) - set(ELLIPSOID_SPECIFIC)))
def test_what_is_not_kept_to_ellipsoids_says_that_a_hyperboloid_is_none(name: str) -> None:
    fit = reference(name)(json.loads(HYPERBOLOID.read_text())["points"])
    assert fit.status is FitStatus.NOT_AN_ELLIPSOID
    assert not fit.has_fit


_DEGENERATE = {
    "plane": lambda random: np.column_stack([random.normal(size=(60, 2)), np.zeros(60)]),
    "ring": lambda random: _unit(random, 60) * (1.0, 1.0, 0.0) + (0.0, 0.0, 1.0),
    "line": lambda random: np.outer(random.normal(size=60), (1.0, 2.0, 3.0)),
    "repeats": lambda random: np.repeat(random.normal(size=(8, 3)), 8, axis=0),
    "one place": lambda random: np.repeat(random.normal(size=(1, 3)), 40, axis=0),
    "far outlier": lambda random: np.vstack([_unit(random, 60), 100.0 * _unit(random, 1)]),
    "cap": lambda random: _cap(random, 0.15),
    "few": lambda random: _unit(random, 8),
}


def _unit(random: np.random.Generator, count: int) -> np.ndarray:
    vectors = random.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _cap(random: np.random.Generator, part: float) -> np.ndarray:
    along, turn = random.uniform(1.0 - 2.0 * part, 1.0, 100), random.uniform(0.0, 6.28, 100)
    across = np.sqrt(1.0 - along**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), along]) + random.normal(0, 0.01, (100, 3))


@pytest.mark.parametrize("kind", _DEGENERATE)
@settings(max_examples=25)
@given(name=st.sampled_from(NAMES), seed=st.integers(0, 10_000), about_z=_angle, about_x=_angle, offset=_offset)
def test_degenerate_samples_have_no_ellipsoid(
    kind: str, name: str, seed: int, about_z: float, about_x: float, offset: tuple[float, ...]
) -> None:
    points = _DEGENERATE[kind](np.random.default_rng(seed)) @ _rotation(about_z, about_x).T
    fit = reference(name)(500.0 * points + offset)
    undetermined = {FitStatus.POOR_COVERAGE, FitStatus.SINGULAR, FitStatus.NOT_AN_ELLIPSOID}
    statuses = {"few": {FitStatus.TOO_FEW_POINTS}, "cap": {FitStatus.POOR_COVERAGE}}
    assert fit.status in statuses.get(kind, undetermined)


@pytest.mark.parametrize("name", NAMES)
def test_many_instances_at_once_are_fitted_as_each_alone(name: str) -> None:
    points = np.array([[_noisy(seed, noise_ut=noise) for noise in (0.3, 10.0)] for seed in range(2)])
    points[1, 1] = 0.0
    batch = BATCHES[name](points)
    assert batch.status.shape == (2, 2)
    for place in np.ndindex(2, 2):
        fit = reference(name)(points[place])
        assert batch.is_ellipsoid[place] == (fit.status is FitStatus.ELLIPSOID)
        if batch.is_ellipsoid[place]:
            # Of one product of matrices for all, another order of sums.
            assert np.allclose(batch.soft_iron[place], fit.soft_iron, rtol=0, atol=1e-6 / 500.0)
            assert np.allclose(batch.hard_iron[place], fit.hard_iron, rtol=0, atol=1e-6 * 500.0)
        else:
            assert np.isnan(batch.soft_iron[place]).all()
            assert np.isnan(batch.hard_iron[place]).all()


@pytest.mark.parametrize("name", NAMES)
def test_ellipses_in_a_plane_are_found_exactly(name: str) -> None:
    angle = np.linspace(0.0, 5.0, 40)
    distortion = np.array([[1.1, 0.1], [0.1, 0.9]])
    centre = np.array([50.0, -80.0])
    fit = BATCHES[name](500.0 * np.column_stack([np.cos(angle), np.sin(angle)]) @ distortion + centre)
    exact = DESCENT if name == "gradient-descent" else EXACT
    assert bool(fit.is_ellipsoid)
    assert np.allclose(fit.soft_iron @ distortion * 500.0, np.eye(2), atol=exact)
    assert np.allclose(fit.hard_iron, centre, atol=exact * 500.0)


def test_an_arc_of_an_ellipse_has_poor_coverage() -> None:
    angle = np.linspace(0.0, 2.0, 40)
    assert int(BATCHES["taubin"](np.column_stack([np.cos(angle), np.sin(angle)])).status) == (FitStatus.POOR_COVERAGE)


@pytest.mark.parametrize("points", [[1.0, 2.0, 3.0], np.zeros((9, 4)), [(1.0, np.nan, 2.0)] * 9])
def test_what_is_no_array_of_points_is_an_error(points: object) -> None:
    with pytest.raises(ValueError, match="points"):
        Clouds.centre(points)  # type: ignore[arg-type]
