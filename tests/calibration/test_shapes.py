"""Shapes for readings that show no whole ellipsoid: found to their noise, with an error that is true."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hiltest.calibration.fit import FitStatus
from hiltest.calibration.quality import direction_error_rms_deg, sphere_directions
from hiltest.calibration.shapes import Shape, allowed_shape, fit_shape

from .hand_turned import lasting

Array: TypeAlias = NDArray[np.float64]


def _soft_iron(random: np.random.Generator, axes: int, size: float = 0.03) -> Array:
    """Return a symmetric matrix whose traceless terms have this standard deviation."""
    drawn = size * random.normal(size=(axes, axes))
    return np.eye(axes) + (drawn + drawn.T) / 2.0


def _turn(seed: int, arc_deg: float, *, noise_ut: float = 0.4, tilted: bool = False) -> tuple[Array, Array, Array]:
    """Return 36 readings over an arc, and readings without noise all round with their true directions."""
    random = np.random.default_rng(seed)
    soft_iron, hard_iron = _soft_iron(random, 2), 20.0 * random.normal(size=2)
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0] if tilted else np.eye(3)

    def readings(angles_deg: Array) -> tuple[Array, Array]:
        angles = np.radians(angles_deg)
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        flat = np.column_stack([20.0 * directions @ soft_iron + hard_iron, np.full(len(angles), 30.0)])
        return flat @ axes, np.column_stack([directions, np.zeros(len(angles))]) @ axes

    points, _ = readings(np.linspace(0.0, arc_deg, 36, endpoint=False))
    return points + random.normal(0.0, noise_ut, points.shape), *readings(np.arange(0.0, 360.0, 5.0))


def _cap(seed: int, covered: float, count: int = 300) -> tuple[Array, Array, Array]:
    """Return readings over a part of the sphere, and readings without noise all over it with their true directions."""
    random = np.random.default_rng(seed)
    soft_iron, hard_iron = _soft_iron(random, 3), 20.0 * random.normal(size=3)
    directions = random.normal(size=(int(4 * count / covered), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    direction = directions[directions @ sphere_directions(50)[seed % 50] > 1.0 - 2.0 * covered][:count]
    points = 48.0 * direction @ soft_iron + hard_iron + random.normal(0.0, 0.4, (len(direction), 3))
    return points, 48.0 * sphere_directions() @ soft_iron + hard_iron, sphere_directions()


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(
    ("shape", "arc_deg", "at_most_deg"),
    [
        # ../shared's prototype had 1.5, .38, .51, 2.6 and 4.3 with the same noise and soft iron, of other draws.
        (Shape.CIRCLE, 360.0, 1.6),
        (Shape.ELLIPSE, 360.0, 0.45),
        (Shape.ELLIPSE, 270.0, 0.6),
        (Shape.CIRCLE, 180.0, 3.0),
        (Shape.CIRCLE, 120.0, 4.3),
    ],
)
def test_a_turn_gives_headings_within_the_stated_error(shape: Shape, arc_deg: float, at_most_deg: float) -> None:
    results, stated = [], []
    for seed in range(60):
        points, readings, directions = _turn(seed, arc_deg, tilted=True)
        got = fit_shape(points, shape)
        assert got.error is not None
        results.append(direction_error_rms_deg(got.fit, readings, directions))
        stated.append(got.error.rms_deg)
    assert _rms(results) < at_most_deg
    # 60 draws know the rms of one error to 10 % each, and its mean square is not normal: 25 %.
    assert _rms(results) == pytest.approx(_rms(stated), rel=0.25)


@pytest.mark.parametrize(
    ("shape", "covered", "at_most_deg"),
    [(Shape.RIDGE, 0.5, 0.7), (Shape.RIDGE, 0.4, 1.2), (Shape.RIDGE, 0.2, 3.5), (Shape.SPHERE, 0.2, 4.5)],
)
def test_part_of_a_sphere_gives_directions_within_the_stated_error(
    shape: Shape, covered: float, at_most_deg: float
) -> None:
    results, stated = [], []
    for seed in range(40):
        points, readings, directions = _cap(seed, covered)
        got = fit_shape(points, shape)
        assert got.error is not None
        results.append(direction_error_rms_deg(got.fit, readings, directions))
        stated.append(got.error.rms_deg)
    assert _rms(results) < at_most_deg
    assert _rms(results) == pytest.approx(_rms(stated), rel=0.25)


def test_a_known_strength_helps_where_an_arc_is_short() -> None:
    unknown, known = [], []
    for seed in range(40):
        points, readings, directions = _turn(seed, 90.0)
        for result, field_ut in ((unknown, None), (known, 20.0)):
            got = fit_shape(points, Shape.CIRCLE, field=field_ut)
            result.append(direction_error_rms_deg(got.fit, readings, directions))
    assert _rms(known) < 0.7 * _rms(unknown)


def test_noise_that_lasts_is_stated_as_what_it_does() -> None:
    """A minute at 20 Hz with .3 uT of white noise and .3 uT that lasts for a second: five turns, back and forth."""
    results, stated = [], []
    swing = np.radians(360.0) * np.abs((np.linspace(0.0, 5.0, 1200) + 1.0) % 2.0 - 1.0)
    for seed in range(30):
        random = np.random.default_rng(seed)
        clean = np.column_stack([20.0 * np.cos(swing), 21.0 * np.sin(swing), np.full(1200, 30.0)])
        got = fit_shape(clean + random.normal(0.0, 0.3, clean.shape) + 0.3 * lasting(random, 1200, 1.0), Shape.ELLIPSE)
        assert got.error is not None
        around = np.radians(np.arange(0.0, 360.0, 5.0))
        directions = np.column_stack([np.cos(around), np.sin(around), np.zeros(72)])
        readings = directions * (20.0, 21.0, 0.0) + (0.0, 0.0, 30.0)
        results.append(direction_error_rms_deg(got.fit, readings, directions))
        stated.append(got.error.rms_deg)
    # Independent noise of this size would be stated 4.3 times too small. Of 20 blocks five go into the ellipse: what is
    # stated is known to 20 %, what is found of 30 logs to 10.
    assert 0.75 < _rms(results) / _rms(stated) < 1.3


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from(list(Shape)),
    radius=st.floats(1e-3, 1e5),
    away=st.floats(-10.0, 10.0),
)
@settings(max_examples=40, deadline=None)
def test_exact_readings_give_the_exact_shape_in_any_unit_and_place(
    seed: int, shape: Shape, radius: float, away: float
) -> None:
    random = np.random.default_rng(seed)
    if shape.axes == 2:
        points, readings, directions = _turn(seed, 300.0, noise_ut=0.0, tilted=True)
        if shape is Shape.CIRCLE:
            points, readings = directions[10:60] * 20.0, directions * 20.0
    else:
        directions = sphere_directions()
        readings = 50.0 * directions
        points = readings[random.permutation(250)]
    scale, centre = radius / 20.0, away * radius * random.normal(size=3)
    got = fit_shape(points * scale + centre, shape)
    assert got.fit.status is FitStatus.ELLIPSOID
    # float64, of coordinates that may be a hundred radii away from zero.
    assert direction_error_rms_deg(got.fit, readings * scale + centre, directions) < 1e-4


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.zeros((50, 3)), np.outer(np.arange(50.0), [1.0, 2.0, 3.0]), sphere_directions(4)],
    ids=["none", "one place", "a line", "four"],
)
@pytest.mark.parametrize("shape", Shape)
def test_what_shows_no_shape_gives_none(shape: Shape, points: Array) -> None:
    got = fit_shape(points, shape)
    if len(points) == 4 and shape is Shape.CIRCLE:
        return  # a circle needs three
    assert got.fit.status in (FitStatus.TOO_FEW_POINTS, FitStatus.SINGULAR)
    assert got.error is None


def test_the_shape_is_chosen_by_what_the_readings_show() -> None:
    assert allowed_shape(_turn(1, 360.0)[0]) is Shape.ELLIPSE
    assert allowed_shape(_turn(1, 120.0)[0]) is Shape.CIRCLE
    assert allowed_shape(_cap(1, 0.3)[0]) is Shape.RIDGE


def test_the_plane_of_a_turn_is_known() -> None:
    points = Rotation.from_euler("x", 5.0, degrees=True).apply(_turn(3, 360.0, noise_ut=0.1)[0])
    plane = fit_shape(points, Shape.ELLIPSE).plane
    assert plane is not None
    assert plane.axis == "z"
    assert plane.tilt_deg == pytest.approx(5.0, abs=0.2)  # .1 uT of 36 readings, of 20 uT
    assert plane.thickness == pytest.approx(0.1, rel=0.4)
    assert fit_shape(points, Shape.ELLIPSE).arc_deg == pytest.approx(350.0, abs=1.0)
