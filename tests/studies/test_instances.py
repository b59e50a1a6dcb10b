"""Instances of the thesis' generator: of the model that is said, the same in C and numpy, and fitted alike."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiltest.calibration.direct import design
from hiltest.calibration.direct_batch import fit_quadrics
from hiltest.studies.instances import Kernel, Model, draw_instances, kernel, non_ellipsoids
from hiltest.virtual.core.c_library import INSTANCES_KERNEL, SOURCES, compiled

# Two ways to solve one system differ by rounding times its condition number.
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def in_c(require_tool: Callable[[str], object]) -> Kernel:
    require_tool("gcc")
    result, reason = kernel()
    assert result is not None, reason
    return result


MODELS = st.builds(
    Model,
    seed=st.integers(0, 2**64 - 1),
    points=st.integers(9, 40),
    noise_ut=st.sampled_from([0.0, 0.3, 25.0]),
    stream=st.integers(0, 30),
    stretch=st.floats(0.0, 0.9),
    occluded=st.floats(0.0, 0.9),
    hard_iron_ut=st.floats(0.0, 500.0),
)


@settings(deadline=None)
@given(model=MODELS, first=st.integers(0, 1 << 40), count=st.integers(1, 9))
def test_c_and_numpy_draw_the_same_to_the_last_bit(in_c: Kernel, model: Model, first: int, count: int) -> None:
    assert np.array_equal(in_c.points_ut(model, first, count), draw_instances(model, first, count).points_ut)


@settings(deadline=None)
@given(model=MODELS, first=st.integers(0, 1 << 40), count=st.integers(1, 9), apart=st.integers(0, 9))
def test_an_instance_is_the_same_in_any_block(model: Model, first: int, count: int, apart: int) -> None:
    cut = min(apart, count)
    parts = [draw_instances(model, first, cut).points_ut, draw_instances(model, first + cut, count - cut).points_ut]
    assert np.array_equal(np.concatenate(parts), draw_instances(model, first, count).points_ut)


def test_other_seeds_streams_and_numbers_of_points_are_other_instances() -> None:
    models = [Model(seed, points, 0.0, stream=stream) for seed in (1, 2) for stream in (0, 1) for points in (20, 21)]
    firsts = {tuple(draw_instances(model, k, 1).points_ut[0, 0]) for model in models for k in (0, 1)}
    assert len(firsts) == 16


def test_without_noise_the_points_are_the_distorted_sphere_and_its_fit_is_the_truth(in_c: Kernel) -> None:
    model = Model(5, 60, 0.0)
    drawn = draw_instances(model, 0, 500)
    undone = np.linalg.solve(drawn.soft_iron[:, None], (drawn.points_ut - drawn.hard_iron_ut[:, None])[..., None])
    # The table of cosines is rounded to 2**-30.
    np.testing.assert_allclose(np.linalg.norm(undone[..., 0], axis=-1), 50.0, rtol=2e-9)
    eigenvalues = np.linalg.eigvalsh(drawn.soft_iron)
    assert eigenvalues.min() >= 0.5
    assert eigenvalues.max() <= 1.5
    assert np.abs(drawn.hard_iron_ut).max() <= 100.0
    for quadrics in (fit_quadrics(drawn.points_ut), in_c.fit_quadrics(drawn.points_ut)):
        assert quadrics.is_ellipsoid.all()
        # The same 2**-30, where a cap of half the sphere is not seen, on radii of 25 to 75 uT.
        np.testing.assert_allclose(quadrics.centre, drawn.hard_iron_ut, rtol=0, atol=1e-5)
        inverse = np.linalg.inv(drawn.soft_iron @ drawn.soft_iron)
        shape = inverse / np.trace(inverse, axis1=-1, axis2=-2)[:, None, None]
        np.testing.assert_allclose(quadrics.shape, shape, rtol=0, atol=1e-7)


def test_directions_are_even_outside_a_cap_and_noise_is_normal() -> None:
    # 4 standard errors of a mean of as many numbers.
    drawn = draw_instances(Model(6, 100, 0.0, stretch=0.0, hard_iron_ut=0.0, occluded=0.0), 0, 2000)
    directions = drawn.points_ut.reshape(-1, 3) / 50.0
    error = 4.0 / np.sqrt(len(directions))
    assert np.abs(directions.mean(axis=0)).max() < error
    assert np.abs((directions**2).mean(axis=0) - 1 / 3).max() < error
    noisy = draw_instances(Model(6, 100, 2.0, stretch=0.0, hard_iron_ut=0.0, occluded=0.0), 0, 2000)
    noise = (noisy.points_ut - drawn.points_ut) / 2.0
    assert abs(noise.mean()) < error
    assert abs(noise.var() - 1.0) < error * np.sqrt(2.0)
    capped = draw_instances(Model(6, 100, 0.0, stretch=0.0, hard_iron_ut=0.0, occluded=0.5), 0, 2000).points_ut / 50.0
    # A sphere without a cap of the share f has its mean at f from its middle, and f is uniform up to .5.
    shares = np.linalg.norm(capped.mean(axis=1), axis=-1)
    assert abs((shares**2).mean() - (0.25 / 3 + 0.01)) < 0.01  # 1/100 is the scatter of a mean of 100 directions


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), points=st.integers(12, 120), noise_ut=st.sampled_from([0.3, 5.0, 50.0]))
def test_c_and_numpy_fit_alike(in_c: Kernel, seed: int, points: int, noise_ut: float) -> None:
    drawn = draw_instances(Model(seed, points, noise_ut), 0, 7).points_ut
    one, other = fit_quadrics(drawn), in_c.fit_quadrics(drawn)
    for k, item in enumerate(drawn):
        half = np.ptp(item, axis=0).max() / 2
        middle = (item.max(axis=0) + item.min(axis=0)) / 2
        within = ROUNDING * np.linalg.cond(design((item - middle) / half)[0]) ** 2
        np.testing.assert_allclose(other.shape[k], one.shape[k], rtol=0, atol=within * np.abs(one.shape[k]).max())
        # The inverse of the shape makes the centre, and its condition number multiplies what the shape is off.
        within *= np.linalg.cond(one.shape[k])
        size = half + np.abs(one.centre[k]).max()
        np.testing.assert_allclose(other.centre[k], one.centre[k], rtol=0, atol=within * size)
    if one.is_ellipsoid.all():
        assert other.is_ellipsoid.all()


@pytest.mark.parametrize("points", [12, 30, 100])
def test_c_and_numpy_count_the_same(in_c: Kernel, points: int) -> None:
    model = Model(11, points, 25.0, stream=9)
    # Of as few instances none is so near the border that rounding decides.
    assert in_c.non_ellipsoids(model, 3, 4099) == non_ellipsoids(model, 3, 4099)


@pytest.mark.parametrize(("noise_ut", "in_a_million"), [(5.0, 1_470), (10.0, 22_470), (25.0, 122_860), (50.0, 168_700)])
def test_as_many_are_no_ellipsoids_as_an_independent_program_counted(
    in_c: Kernel, noise_ut: float, in_a_million: int
) -> None:
    # That program drew 100 000 instances of 30 points at each noise; both counts scatter, by 4 standard errors at most.
    of = 100_000
    expected = of * in_a_million / 1e6
    result = in_c.non_ellipsoids(Model(1, 30, noise_ut), 0, of)
    assert abs(result - expected) < 4.0 * np.sqrt(2.0 * expected)


def test_the_source_compiles_without_a_warning(tmp_path: Path, require_tool: Callable[[str], object]) -> None:
    require_tool("gcc")
    library = tmp_path / "kernel.so"
    flags = ("-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")
    assert compiled(library, SOURCES[INSTANCES_KERNEL], flags) == ""
    assert library.exists()
