"""The study of constraints: its optimum is that of the direct fit, its border where the smallest eigenvalue is zero."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.calibration.clouds import Clouds
from hiltest.calibration.direct_batch import fit_quadrics
from hiltest.calibration.li import fit_li
from hiltest.errors import HiltestError
from hiltest.studies import constraints
from hiltest.studies.constraints import (
    METHODS,
    SURFACES,
    coefficients,
    conclude,
    is_ellipsoid,
    leaves_at,
    measure,
    shape_of,
    unconstrained,
)
from hiltest.studies.instances import Model, draw_instances
from hiltest.studies.study import Block, Plan

PLAN = Plan("constraints", 1, 1, 30)


def quadric(*eigenvalues: float, level: float = 1.0) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([*eigenvalues, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -level])


def test_the_optimum_is_that_of_the_direct_fit() -> None:
    points = draw_instances(Model(2, 40, 5.0), 0, 3).points_ut
    for item, shape in zip(points, fit_quadrics(points).shape, strict=True):
        # Both are of unit trace, and neither depends on where the points lie or how large they are.
        assert shape_of(unconstrained(Clouds.centre(item))) == pytest.approx(shape, abs=1e-9)


def test_a_calibration_s_quadric_is_the_ellipsoid_it_takes_to_the_unit_sphere() -> None:
    clouds = Clouds.centre(draw_instances(Model(3, 40, 0.0, stretch=0.2), 0, 1).points_ut[0])
    result = coefficients(fit_li.solve(clouds))
    assert np.abs(clouds.rows @ result).max() < 1e-8  # noiseless points lie on it, to the table of cosines
    assert is_ellipsoid(result)


@pytest.mark.parametrize("level", [1.0, -1.0])
def test_a_positive_definite_shape_is_an_ellipsoid_where_its_level_is_positive(level: float) -> None:
    assert is_ellipsoid(quadric(0.2, 0.3, 0.5, level=level)) == (level > 0.0)


def test_the_border_is_found_where_the_determinant_is_positive_at_both_ends() -> None:
    best, sphere = quadric(-0.5, -0.5, 2.0), quadric(1 / 3, 1 / 3, 1 / 3)
    assert np.linalg.det(shape_of(best)) > 0.0
    # -1/2 + t (1/3 + 1/2) = 0
    assert leaves_at(best, sphere) == pytest.approx(0.6, abs=1e-9)


def test_each_surface_has_clouds_that_the_line_betters_and_none_that_it_does_not() -> None:
    blocks = [[measure(PLAN, Block(surface, 0, 1))] for surface in range(len(SURFACES))]
    result = conclude(PLAN, blocks)
    values = {measurement.name: measurement.value for measurement in result.measurements}
    assert values["study.constraints.clouds"] == len(SURFACES)
    assert values["study.constraints.fits"] == values["study.constraints.bettered"] == len(SURFACES) * len(METHODS)
    assert result.printed[0].reproduced


def test_one_fit_that_is_not_bettered_is_not_what_the_thesis_says() -> None:
    numbers = [0.0, 1, 0.5, 1, 0, 1.1, 1, 0.5, 1, 1, 0.9]  # the first method's is worse
    result = conclude(PLAN, [[numbers]] * len(SURFACES))
    assert not result.printed[0].reproduced
    assert result.printed[1].reproduced


def test_points_that_always_make_an_ellipsoid_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constraints, "_ATTEMPTS", 3)
    with pytest.raises(HiltestError, match="the best quadric of 1000 points was an ellipsoid 3 times"):
        measure(Plan("constraints", 1, 1, 1000), Block(0, 0, 1))
