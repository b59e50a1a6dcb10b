"""The study of an IMU: which figures come out, where frosio ends, and what an origin cannot change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hiltest.calibration.clouds import monomials
from hiltest.studies.imu import ACCELEROMETER, JUDGED, METHODS, OFFSETS, conclude, eliminated, is_same_for_li, measure
from hiltest.studies.study import Block, Conclusion, Numbers, Plan

FROSIO = METHODS.index("frosio")
PLAN = Plan("imu", 4, 3, 60)
_axis = st.integers(-20_000, 20_000)


def counts(seed: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(-500, 500, (20, 3))


@given(seed=st.integers(0, 1000), moved=st.tuples(_axis, _axis, _axis))
def test_no_origin_changes_what_li_solves(seed: int, moved: tuple[int, int, int]) -> None:
    points = counts(seed)
    assert eliminated(points + np.array(moved)) == eliminated(points)
    assert is_same_for_li(points)


def test_what_li_solves_is_the_schur_complement_of_the_sums() -> None:
    points = counts(7)
    rows = monomials(points.astype(float))
    sums = rows.T @ rows
    expected = sums[:6, :6] - sums[:6, 6:] @ np.linalg.solve(sums[6:, 6:], sums[6:, :6])
    # float64 loses the condition of the sums of 20 points, about 1e5, from 16 digits.
    np.testing.assert_allclose(np.array(eliminated(points), dtype=float), expected, rtol=1e-9)


def test_a_scale_does_change_it() -> None:
    assert eliminated(2 * counts(7)) != eliminated(counts(7))


@pytest.fixture(scope="module")
def measured() -> list[list[Numbers]]:
    return [[measure(PLAN, Block(condition, 0, PLAN.instances))] for condition in range(ACCELEROMETER + 1)]


def test_frosio_has_no_fit_beyond_the_field_and_always_one_less_the_mean(measured: list[list[Numbers]]) -> None:
    for offset, (numbers,) in zip(OFFSETS, measured[:ACCELEROMETER], strict=True):
        norms = np.reshape(numbers, (PLAN.instances, -1))[:, :-1].reshape(-1, len(METHODS), 2)
        before, after = norms[:, FROSIO].T
        if offset in (0.0, 1.5, 2.0, 3.0, 5.0):
            assert (before > 0.0).all() == (offset == 0.0), offset
            assert before.any() == (offset == 0.0), offset
        assert (after > 0.0).all()
        # Noise of .04, by a soft iron of .5 to 1.5, less what nine unknowns of 60 points take.
        assert ((after > 0.02) & (after < 0.08)).all()
        # Norms lie about the offset, less 1.
        assert ((norms[:, 0, 0] > offset - 1.3) & (norms[:, 0, 0] < offset + 0.6)).all()


def test_six_faces_suffice_for_least_squares_and_for_nothing_else(measured: list[list[Numbers]]) -> None:
    axes = np.reshape(measured[ACCELEROMETER][0], (PLAN.instances, 6, 3))
    uncalibrated, lstsq, merayo, frosio, *of_attitudes = np.moveaxis(axes, 1, 0)
    # Noise of .005 and faces that are .3 degrees askew, .0052, of which twelve unknowns of eighteen take a part.
    assert ((lstsq > 0.0045) & (lstsq < 0.009)).all()
    assert (uncalibrated.mean(axis=0) > 3.0 * lstsq.mean(axis=0)).all()
    assert not merayo.any()
    assert not frosio.any()
    for of_attitude in of_attitudes:
        assert (np.linalg.norm(of_attitude, axis=-1) > np.linalg.norm(lstsq, axis=-1)).all()


def concluded(*, norm: float = 0.044, same: int = 1, frosio: float = 0.0) -> Conclusion:
    """Conclude from instances within 1 % of a norm, with frosio's at every offset."""
    spread = np.linspace(0.99, 1.01, 40)[:, None, None]
    norms = np.broadcast_to(norm * spread, (40, len(METHODS), 2)).copy()
    norms[:, FROSIO, 0] = frosio
    magnetometer = np.column_stack([norms.reshape(40, -1), np.full(40, same)]).ravel().tolist()
    accelerometer = np.broadcast_to(0.02 * spread, (40, 6, 3)).ravel().tolist()
    return conclude(Plan("imu", 1, 40, 60), [[magnetometer]] * ACCELEROMETER + [[accelerometer]])


def test_a_figure_is_reproduced_within_the_range_of_most_instances() -> None:
    printed = {item.figure: item for item in concluded().printed}
    assert printed["norm, frosio, less mean"].reproduced  # .04372
    assert not printed["norm, li, before"].reproduced
    assert {item.figure: item for item in concluded(norm=0.0501).printed}["norm, li, before"].reproduced


@pytest.mark.parametrize(("same", "frosio", "message"), [(1, 0.0, [True, False]), (0, 0.04, [False, True])])
def test_the_claims_follow_from_the_instances(same: int, frosio: float, message: list[bool]) -> None:
    result = concluded(same=same, frosio=frosio)
    assert [item.reproduced for item in result.printed[-2:]] == message
    values = {measurement.name: measurement.value for measurement in result.measurements}
    assert values["study.imu.li_differs"] == 40 * ACCELEROMETER * (1 - same)
    assert values["study.imu.frosio.without_fit"] == (0.0 if frosio else 100.0)
    assert result.table.rows[len(METHODS) * JUDGED + FROSIO][5] == (0.0 if frosio else 100.0)
