"""From a cloud's unit to the firmware's counts and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltest.calibration import FitStatus, MagnetometerFit
from hiltest.calibration.quality import sphere_directions
from hiltest.log_fitting import CountScale, FieldUnit, Samples, evenly_on_sphere


def _cloud(points: np.ndarray, unit: FieldUnit) -> Samples:
    return Samples(Path("cloud.csv"), points, unit, "option", ("x", "y", "z"), 0)


@pytest.mark.parametrize(
    ("unit", "radius", "offset", "step", "shifted"),
    [
        (FieldUnit.UT, 48.5, 60.0, 0.1, False),
        (FieldUnit.GAUSS, 0.485, 0.6, 0.001, False),
        (FieldUnit.COUNTS, 485.0, 600.0, 1.0, False),
        (FieldUnit.COUNTS, 4066.0, 33_000.0, 1.0, True),
        (FieldUnit.COUNTS, 1e6, 0.0, 1e6 / 3200.0, False),
        (FieldUnit.COUNTS, 0.5, 0.2, 0.5 / 3200.0, False),
        (FieldUnit.COUNTS, 1.0, 1e6, 1.0 / 3200.0, True),
        (FieldUnit.UT, 48.5, 5000.0, 0.1, True),
    ],
)
def test_counts_fit_int16_and_keep_the_resolution(
    unit: FieldUnit, radius: float, offset: float, step: float, shifted: bool
) -> None:
    cloud = _cloud(radius * sphere_directions(400) + offset, unit)
    scale = CountScale.choose(cloud)
    counts = scale.counts(cloud.points)
    assert counts.dtype == np.int16
    # A lattice of 400 leaves the poles out by a quarter of a percent.
    assert scale.step == pytest.approx(step, rel=0.005)
    assert bool(scale.origin.any()) is shifted
    back = counts / scale.per_unit + scale.origin
    # Half a count, and what float64 leaves of an offset of 1e6.
    np.testing.assert_allclose(back, cloud.points, atol=0.5 * scale.step * (1 + 1e-6))


def test_points_that_are_all_the_same_have_a_scale_too() -> None:
    cloud = _cloud(np.full((20, 3), 1e9), FieldUnit.COUNTS)
    assert not CountScale.choose(cloud).counts(cloud.points).any()


def test_a_calibration_of_counts_is_one_of_readings() -> None:
    points = 0.485 * sphere_directions(50) + 1000.0
    scale = CountScale.choose(_cloud(points, FieldUnit.GAUSS))
    soft_iron = np.array([[2.0, 0.1, 0.0], [0.1, 1.9, 0.2], [0.0, 0.2, 2.1]]) / 1000.0
    in_counts = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, soft_iron, np.array([1.0, 2.0, 3.0]))
    in_gauss = scale.convert_fit(in_counts)
    # float64 holds 1000 to 1e-13, a thousandth of it to 1e-10.
    np.testing.assert_allclose(
        in_gauss.corrected(points), in_counts.corrected(scale.unrounded(points)), rtol=0.0, atol=1e-9
    )


def test_points_are_taken_evenly_from_a_sphere_that_is_read_unevenly() -> None:
    random = np.random.default_rng(1)
    rest = sphere_directions(2000)[7] + random.normal(0.0, 0.01, (30_000, 3))
    points = np.vstack([rest, 50.0 * sphere_directions(2000)]) + np.array([5.0, 6.0, 7.0])
    chosen = evenly_on_sphere(points, 200, np.array([5.0, 6.0, 7.0]))
    assert (len(chosen), len(set(chosen.tolist()))) == (200, 200)
    assert (np.diff(chosen) > 0).all()
    directions = points[chosen] - (5.0, 6.0, 7.0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # 200 even caps have a radius of 8 degrees; farthest points leave no hole of twice that.
    assert (sphere_directions(500) @ directions.T).max(axis=1).min() > np.cos(np.radians(16.0))


@pytest.mark.parametrize("points", [np.zeros((300, 3)), np.arange(900.0).reshape(300, 3)], ids=["one place", "a line"])
def test_points_of_no_sphere_are_taken_too(points: np.ndarray) -> None:
    chosen = evenly_on_sphere(points, 100, np.zeros(3))
    assert len(set(chosen.tolist())) == 100
    assert evenly_on_sphere(points, 300, np.zeros(3)).tolist() == list(range(300))
