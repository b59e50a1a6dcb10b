"""The magnetometer calibrated against gravity: what it sees, what it cannot, and where it says so."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltest.calibration import FitStatus, fit_direct
from hiltest.calibration.dpi import DpiFit, fit_dpi, fit_dpi_of_any_number
from hiltest.calibration.quality import direction_error_rms_deg, rotation_left_deg
from hiltest.orientation import tilt_heading
from hiltest.orientation.angles import Pose, rotation_rows

from ..dpi_instances import DpiInstance, dpi_instance

POSES = [
    Pose(heading, pitch, roll)
    for pitch, roll in [(0.0, 0.0), (20.0, 0.0), (-20.0, 0.0), (0.0, 20.0), (0.0, -20.0)]
    for heading in range(0, 360, 30)
]
BODY_FROM_NED = np.array([rotation_rows(pose) for pose in POSES])
HEADINGS_DEG = [pose.heading_deg for pose in POSES]


def fitted(drawn: DpiInstance, *, dip_deg: float | None = None) -> DpiFit:
    return fit_dpi(drawn.magnetometer, drawn.gravity_g, dip_deg=dip_deg)


def field_ned(dip_deg: float) -> np.ndarray:
    dip = np.radians(dip_deg)
    return np.array([np.cos(dip), 0.0, np.sin(dip)])


def headings_deg(fields: np.ndarray, gravities: np.ndarray) -> np.ndarray:
    """`tilt_heading` of many at once."""
    east = np.cross(gravities, fields)
    north = np.cross(east, gravities)
    forward = [axis[:, 0] / np.linalg.norm(axis, axis=1) for axis in (east, north)]
    return np.degrees(np.arctan2(*forward)) % 360.0


def worst_heading_deg(fields: np.ndarray, gravities: np.ndarray) -> float:
    """Over the sixty judged poses."""
    errors_deg = (headings_deg(fields, gravities) - HEADINGS_DEG + 180.0) % 360.0 - 180.0
    return float(np.abs(errors_deg).max())


def test_headings_of_many_are_those_of_each() -> None:
    fields, gravities = np.random.default_rng(1).normal(size=(2, 100, 3))
    each = [tilt_heading(gravity, field).heading_deg for gravity, field in zip(gravities, fields, strict=True)]
    # float64 carries 2e-16 of a turn; fields as near to the vertical as one in a hundred is multiply it by some 10.
    assert headings_deg(fields, gravities) == pytest.approx(np.array(each), abs=1e-10)


def worst_heading_of(fit: DpiFit, drawn: DpiInstance) -> float:
    """Of a calibration, with readings at the judged poses that have no noise, and gravity as it is."""
    readings = drawn.field_counts * BODY_FROM_NED @ field_ned(drawn.dip_deg) @ drawn.soft_iron.T
    corrected = fit.calibration.corrected(readings + drawn.hard_iron_counts)
    return worst_heading_deg(corrected, BODY_FROM_NED[:, :, 2])


@pytest.mark.parametrize("dip_deg", [5.0, -5.0, 62.0, -62.0, 80.0])
@pytest.mark.parametrize("arguments", [True, False])
def test_it_is_exact_on_data_without_noise(dip_deg: float, arguments: bool) -> None:
    turns = Rotation.random(300, random_state=1).as_matrix()
    soft_iron = Rotation.from_rotvec([0.1, -0.2, 0.15]).as_matrix() @ np.diag([0.8, 1.1, 1.2])
    true = turns @ field_ned(dip_deg)
    points = 485.0 * true @ soft_iron.T + [1200.0, -700.0, 300.0]
    fit = fit_dpi(points, turns[:, :, 2], dip_deg=dip_deg if arguments else None)
    assert fit.status is FitStatus.ELLIPSOID
    # float64 carries 2e-16, and the least squares are worse conditioned by 1 / sin(5 deg)^2 at most: 130.
    assert np.abs(fit.calibration.corrected(points) - true).max() < 1e-11
    assert fit.dip_deg == pytest.approx(dip_deg, abs=1e-9)
    # Up to the field's scale: the sensor's gain is what the mean of its soft iron's gains is.
    assert fit.strength_counts == pytest.approx(485.0 * np.linalg.det(soft_iron) ** (1.0 / 3.0), rel=1e-9)
    assert fit.standard_error < 1e-6


def test_it_sees_the_rotation_that_a_fit_of_norms_cannot() -> None:
    for seed in range(20):
        drawn = dpi_instance(seed, dip_deg=60.0)
        # 300 pairs of 0.4 uT leave some 0.2 degrees in every component.
        assert rotation_left_deg(fitted(drawn).calibration, drawn.soft_iron) < 1.0
    assert (
        np.median(
            [
                rotation_left_deg(fit_direct(drawn.magnetometer), drawn.soft_iron)
                for drawn in (dpi_instance(seed, dip_deg=60.0) for seed in range(20))
            ]
        )
        > 5.0
    )


def test_a_wrong_dip_scales_the_calibration_and_leaves_every_heading() -> None:
    drawn = dpi_instance(3, dip_deg=60.0)
    right, wrong = fitted(drawn, dip_deg=60.0), fitted(drawn, dip_deg=61.0)
    scale = np.sin(np.radians(61.0)) / np.sin(np.radians(60.0))  # 1 %
    assert np.allclose(wrong.calibration.soft_iron, scale * right.calibration.soft_iron, rtol=1e-12)
    assert worst_heading_of(wrong, drawn) == pytest.approx(worst_heading_of(right, drawn), abs=1e-9)
    # What is estimated beside it does not believe what was given.
    assert wrong.dip_deg == right.dip_deg
    assert wrong.dip_deg == pytest.approx(60.0, abs=0.3)


def test_without_a_dip_the_corrected_points_have_norm_one() -> None:
    for seed in range(20):
        drawn = dpi_instance(seed, dip_deg=-40.0)
        fit = fitted(drawn)
        norms = np.linalg.norm(fit.calibration.corrected(drawn.magnetometer), axis=1)
        # Weighted by gravity's own square, of noise 0.25 %; noise of 0.8 % spreads over 300 points.
        assert np.sqrt(np.mean(norms**2)) == pytest.approx(1.0, abs=2e-4)
        assert fit.dip_deg == pytest.approx(-40.0, abs=0.5)


@pytest.mark.parametrize("dip_deg", [5.0, -5.0])
def test_it_works_at_five_degrees_of_dip(dip_deg: float) -> None:
    drawn = [dpi_instance(seed, dip_deg=dip_deg) for seed in range(100)]
    fits = [fitted(draw, dip_deg=dip_deg) for draw in drawn]
    assert {fit.status for fit in fits} == {FitStatus.ELLIPSOID}
    # The horizontal field is 48 uT instead of 23 there: headings are twice as good as at 62 degrees.
    assert max(worst_heading_of(*pair) for pair in zip(fits, drawn, strict=True)) < 1.0
    assert np.median([fit.dip_deg for fit in fits]) == pytest.approx(dip_deg, abs=0.05)


@pytest.mark.parametrize(
    ("readings", "count", "refused_deg", "works_deg"),
    # 5 standard errors: 0.41 uT of a single pair in 48.5 are 2.4 degrees of dip, a quarter of it at poses 0.6.
    [(1, 300, 1.0, 3.2), (16, 60, 0.4, 1.0)],
)
def test_a_field_that_is_too_horizontal_is_refused(
    readings: int, count: int, refused_deg: float, works_deg: float
) -> None:
    for dip_deg, expected in [
        (0.0, FitStatus.HORIZONTAL_FIELD),
        (refused_deg, FitStatus.HORIZONTAL_FIELD),
        (works_deg, FitStatus.ELLIPSOID),
    ]:
        for seed in range(30):
            drawn = dpi_instance(seed, count, dip_deg=dip_deg, readings=readings)
            fit = fit_dpi(drawn.magnetometer, drawn.gravity_g, readings=readings)
            assert fit.status is expected, f"seed {seed}, dip {dip_deg}"
            assert fit.n_used == count
            assert not (fit.calibration.has_fit and expected is FitStatus.HORIZONTAL_FIELD)


def test_a_dip_given_as_horizontal_is_refused_too() -> None:
    assert fitted(dpi_instance(1, dip_deg=60.0), dip_deg=1.0).status is FitStatus.HORIZONTAL_FIELD


def test_the_standard_error_is_the_noise_of_one_dot_product() -> None:
    # 0.4 uT, counts of 0.1 uT, and 1.26 mg in a field of 48.5 uT.
    expected_ut = np.sqrt(0.4**2 + 0.1**2 / 12 + (0.00126 * 48.5) ** 2)
    errors_ut = [48.5 * fitted(dpi_instance(seed, dip_deg=dip)).standard_error for seed in range(30) for dip in (5, 60)]
    # 288 degrees of freedom: one estimate within 4 %, sixty within 1 %; soft iron of 20 % makes fields unlike counts.
    assert np.mean(errors_ut) == pytest.approx(expected_ut, rel=0.05)


@pytest.mark.parametrize(("readings", "least"), [(1, 300), (15, 300), (16, 38), (100, 38)])
def test_too_few_rows_are_refused_and_counted(readings: int, least: int) -> None:
    drawn = dpi_instance(1, least)
    enough = fit_dpi(drawn.magnetometer, drawn.gravity_g, readings=readings)
    few = fit_dpi(drawn.magnetometer[1:], drawn.gravity_g[1:], readings=readings)
    assert (enough.status, enough.n_used) == (FitStatus.ELLIPSOID, least)
    assert (few.status, few.n_used) == (FitStatus.TOO_FEW_POINTS, least - 1)
    assert not few.calibration.has_fit


@pytest.mark.slow
def test_a_hundred_single_pairs_exceed_two_degrees_in_one_of_a_hundred_seeds() -> None:
    """Why 300 are asked for: attitudes all round, 0.4 uT, and poses of 16 readings in the default world's field.

    With an accelerometer without errors it is 1 %; with the 3 mg and 0.3 % of the default world left in, 6.6 %.
    """

    def exceeding(count: int, seeds: int) -> float:
        noise = np.random.Generator(np.random.Philox(1))
        worst = []
        for seed in range(seeds):
            drawn = dpi_instance(seed, count, dip_deg=62.0, turn_deg=0.0, stretch=0.03)
            fit = fit_dpi_of_any_number(drawn.magnetometer.astype(float), drawn.gravity_g, dip_deg=62.0)
            readings = drawn.field_counts * BODY_FROM_NED @ field_ned(62.0) @ drawn.soft_iron.T
            readings += drawn.hard_iron_counts + noise.normal(0.0, 4.0 / 4.0, (60, 3))
            gravity = BODY_FROM_NED[:, :, 2] + noise.normal(0.0, 0.00126 / 4.0, (60, 3))
            worst.append(worst_heading_deg(fit.calibration.corrected(readings), gravity))
        return float(np.mean(np.array(worst) > 2.0))

    few, all_of_them = exceeding(100, 1000), exceeding(300, 300)
    print(f"of 100 pairs {100 * few:.1f} % exceed 2 degrees, of 300 {100 * all_of_them:.1f} %")
    # 0.9 % of 4000 seeds, which a thousand tell within 0.3.
    assert 0.003 <= few <= 0.02
    assert all_of_them == 0.0


@pytest.mark.parametrize("case", ["gravity's sign", "the dip's sign", "two axes swapped", "one axis reversed"])
def test_a_reflection_is_refused_by_name(case: str) -> None:
    drawn = dpi_instance(5, dip_deg=60.0)
    points, gravity, dip_deg = drawn.magnetometer.astype(float), drawn.gravity_g, 60.0
    if case == "gravity's sign":
        gravity = -gravity
    elif case == "the dip's sign":
        dip_deg = -dip_deg
    elif case == "two axes swapped":
        points = points[:, [1, 0, 2]]
    else:
        points = points * [1.0, -1.0, 1.0]
    assert fit_dpi(points, gravity, dip_deg=dip_deg).status is FitStatus.MIRRORED


def test_axes_turned_into_each_other_are_no_reflection_but_a_rotation_that_shows() -> None:
    drawn = dpi_instance(5, dip_deg=60.0)
    fit = fit_dpi(drawn.magnetometer[:, [1, 2, 0]], drawn.gravity_g, dip_deg=60.0)
    assert fit.status is FitStatus.ELLIPSOID
    assert rotation_left_deg(fit.calibration, drawn.soft_iron) == pytest.approx(120.0, abs=1.0)


def test_attitudes_that_never_tilt_or_never_turn_are_refused() -> None:
    level = Rotation.from_rotvec(np.outer(np.linspace(0, 12, 300), [0, 0, 1])).inv()
    one = Rotation.from_rotvec(np.zeros((300, 3)))
    about_one_axis = Rotation.from_rotvec(np.outer(np.linspace(0, 12, 300), [1, 0, 0])).inv()
    for attitudes in (level, one, about_one_axis):
        for noise in (0.0, 0.4):
            drawn = dpi_instance(1, attitudes=attitudes, dip_deg=62.0, noise_ut=noise)
            assert fitted(drawn).status is FitStatus.SINGULAR
    same = np.full((300, 3), 100)
    assert fit_dpi(same, np.zeros((300, 3))).status is FitStatus.SINGULAR


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="pairs"):
        fit_dpi(np.zeros((300, 3)), np.zeros((299, 3)))
    with pytest.raises(ValueError, match="finite"):
        fit_dpi(np.zeros((300, 3)), np.full((300, 3), np.nan))


@pytest.mark.slow
def test_the_papers_scenario() -> None:
    """Medians over 100 trials: 58 degrees, 11 with both ellipsoids, 0.37 with gravity's ellipsoid and DPI.

    From the text: axes turned by up to 0.5 and 8 degrees, soft iron of 20 %, noise of 1e-3, tilts to 20 degrees. Its
    tables are lost; what it does not say is chosen here so that the first two medians come out: a dip of 50 degrees,
    hard iron of up to half the field, an accelerometer within 5 %, and 1000 attitudes.
    """
    medians = np.median([_trial(seed) for seed in range(100)], axis=0)
    print("uncalibrated {:.1f}, both ellipsoids {:.1f}, DPI {:.2f} deg".format(*medians))
    assert medians[0] == pytest.approx(58.0, rel=0.15)
    assert medians[1] == pytest.approx(11.0, rel=0.15)
    # Not chosen: what is left is the accelerometer's own rotation.
    assert medians[2] == pytest.approx(0.37, rel=0.15)


def _trial(seed: int) -> tuple[float, float, float]:
    random = np.random.Generator(np.random.Philox(seed))

    def distortion(turn_deg: float, stretch: float) -> np.ndarray:
        axes = Rotation.random(random_state=random.integers(1 << 30)).as_matrix()
        turned = Rotation.from_euler("zyx", random.uniform(-turn_deg, turn_deg, 3), degrees=True).as_matrix()
        product: np.ndarray = turned @ (axes * random.uniform(1.0 - stretch, 1.0 + stretch, 3)) @ axes.T
        return product

    def reading(vectors: np.ndarray, matrix: np.ndarray, offset: np.ndarray, noise: float) -> np.ndarray:
        # Ten thousand to one: finer than the noise, and the calibrators' limits are made for counts.
        result: np.ndarray = 1e4 * (vectors @ matrix.T + offset + noise * random.standard_normal(vectors.shape))
        return result

    soft_iron, hard_iron = distortion(8.0, 0.2), random.uniform(-0.5, 0.5, 3)
    gains, offset = distortion(0.5, 0.05), random.uniform(-0.05, 0.05, 3)
    turns = Rotation.random(1000, random_state=seed).as_matrix()
    points = reading(turns @ field_ned(50.0), soft_iron, hard_iron, 1e-3)
    accelerations = reading(turns[:, :, 2], gains, offset, 1e-3)
    judged = reading(BODY_FROM_NED @ field_ned(50.0), soft_iron, hard_iron, 0.0)
    judged_gravity = reading(BODY_FROM_NED[:, :, 2], gains, offset, 0.0)
    gravity, ellipsoid = fit_direct(accelerations), fit_direct(points)
    dpi = fit_dpi(points, gravity.corrected(accelerations)).calibration
    level = gravity.corrected(judged_gravity)
    return (
        worst_heading_deg(judged, judged_gravity),
        worst_heading_deg(ellipsoid.corrected(judged), level),
        worst_heading_deg(dpi.corrected(judged), level),
    )


def test_directions_do_not_depend_on_how_far_the_hard_iron_is() -> None:
    for hard_iron_ut in (0.0, 100.0, 1000.0):
        drawn = dpi_instance(7, dip_deg=60.0, largest_hard_iron_ut=hard_iron_ut)
        readings = drawn.field_counts * BODY_FROM_NED @ field_ned(60.0) @ drawn.soft_iron.T + drawn.hard_iron_counts
        error_deg = direction_error_rms_deg(fitted(drawn).calibration, readings, BODY_FROM_NED @ field_ned(60.0))
        # The same noise every time: 0.2 degrees of it, and the rounding to counts differs.
        assert error_deg < 0.6
