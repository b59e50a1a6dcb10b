"""The study of an IMU: which figures come out, where frosio ends, and what an origin cannot change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hiltest.calibration.clouds import monomials
from hiltest.studies.imu import (
    ACCELEROMETER,
    JUDGED,
    METHODS,
    OFFSETS,
    conclude,
    eliminated,
    is_same_for_li,
    measure,
    row_probability,
)
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


def concluded(
    *, norm: tuple[float, ...] = (0.5, 0.044, 0.044, 0.044), same: int = 1, frosio: float = 0.0
) -> Conclusion:
    """Conclude from instances that scatter by 5 % about the norms of each method, with frosio's at every offset."""
    random = np.random.default_rng(1)
    norms = np.array(norm)[:, None] * np.exp(0.05 * random.standard_normal((200, len(METHODS), 1))) * np.ones(2)
    norms[:, FROSIO, 0] *= frosio > 0.0
    magnetometer = np.column_stack([norms.reshape(200, -1), np.full(200, same)]).ravel().tolist()
    accelerometer = (0.02 * np.exp(0.05 * random.standard_normal((200, 6, 3)))).ravel().tolist()
    return conclude(Plan("imu", 1, 200, 60), [[magnetometer]] * ACCELEROMETER + [[accelerometer]])


def test_a_row_of_the_model_is_as_unusual_as_its_rank_says_whatever_the_distribution() -> None:
    random = np.random.default_rng(2)
    probabilities = []
    for _ in range(2000):
        common, own = random.standard_cauchy((151, 1)), random.standard_normal((151, 3))
        rows = np.exp(np.clip(common, -50.0, 50.0) + 0.1 * own)
        probabilities.append(row_probability(rows[0].tolist(), rows[1:]) or 0.0)
    for level in (0.01, 0.05, 0.5):
        # Four deviations of a share of 2000 rows.
        assert np.mean(np.array(probabilities) <= level) == pytest.approx(level, abs=4.0 * (level / 2000) ** 0.5)


def test_figures_that_are_usual_one_by_one_can_be_impossible_together() -> None:
    random = np.random.default_rng(3)
    common, own = random.standard_normal((200, 1)), random.standard_normal((200, 2))
    rms = 0.04 * np.exp(0.1 * (common + 0.1 * own))
    row = np.quantile(rms, [0.1, 0.9], axis=0).diagonal().tolist()
    for figure, column in zip(row, rms.T, strict=True):
        assert 0.09 < np.mean(column < figure) < 0.91
    assert row_probability(row, rms) == pytest.approx(1.0 / 201.0)
    assert (row_probability([row[0], row[0]], rms) or 0.0) > 0.1


def test_a_row_is_compared_with_instances_of_the_same_fits_and_with_enough_of_them() -> None:
    rms = 0.04 * np.exp(0.1 * np.random.default_rng(4).standard_normal((240, 2)))
    rms[:120, 1] = 0.0
    assert (row_probability([0.04, None], rms) or 0.0) > 0.5
    assert row_probability([0.04, None], rms[4:]) is None  # 116 of them: one in 117 is above a sixth of 5 %
    assert row_probability([None, 0.04], rms) is None


def test_a_row_is_reproduced_if_its_figures_together_are_not_unusual() -> None:
    printed = {item.figure.split(":")[0]: item for item in concluded(norm=(0.6, 0.05, 0.042, 0.044)).printed}
    assert printed["norm, before"].reproduced
    assert printed["norm, less mean"].reproduced is False
    assert printed["accelerometer, z"].reproduced is False
    less_mean = concluded(norm=(0.24, 0.042, 0.04, 0.044))
    assert {item.figure.split(":")[0]: item for item in less_mean.printed}["norm, less mean"].reproduced


@pytest.mark.parametrize(("same", "frosio", "message"), [(1, 0.0, [True, False]), (0, 0.04, [False, True])])
def test_the_claims_follow_from_the_instances(same: int, frosio: float, message: list[bool]) -> None:
    result = concluded(same=same, frosio=frosio)
    assert [item.reproduced for item in result.printed[-2:]] == message
    values = {measurement.name: measurement.value for measurement in result.measurements}
    assert values["study.imu.li_differs"] == 200 * ACCELEROMETER * (1 - same)
    assert values["study.imu.frosio.without_fit"] == (0.0 if frosio else 100.0)
    assert result.table.rows[len(METHODS) * JUDGED + FROSIO][9] == (0.0 if frosio else 100.0)
