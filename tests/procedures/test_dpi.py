"""The board calibrates its magnetometer against gravity: from a tumble, from still poses, and what it costs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration import FitStatus
from hiltest.calibration.dpi import fit_dpi
from hiltest.calibration.joint import fit_joint_pairs
from hiltest.errors import CalibrationError
from hiltest.link.accelerometer import GetAccelerometer, SetAccelerometer
from hiltest.link.messages import GetCalibration, Points
from hiltest.orientation.angles import rotation_rows
from hiltest.procedures import (
    DpiRun,
    Tumble,
    Turntable,
    collect_still_poses,
    collect_tumble,
    fit_still_poses,
    fit_tumble,
    golden_pairs,
    measure_dpi_cycles,
    spread_poses,
    upload_pairs,
)

SLOT = 9
# A calibration unlike the nominal one, so that it shows which was used.
GAIN, OFFSET = np.diag([1.002, 0.9985, 1.001]) / 8192.0, np.array([10.0, -12.0, 16.0])


@pytest.fixture(scope="module")
def tumble(virtual_board: Board, bench_rig) -> Tumble:  # type: ignore[no-untyped-def]
    from hiltest.procedures import SimulatedTurntable

    return collect_tumble(virtual_board, SimulatedTurntable(virtual_board.stage, uncertainty_deg=0.1), points=300)


@pytest.fixture(scope="module")
def run(virtual_board: Board, tumble: Tumble) -> DpiRun:
    virtual_board.session.request(SetAccelerometer(0, GAIN, OFFSET))
    run = fit_tumble(virtual_board, tumble, slot=SLOT, dip_deg=62.0)
    return run


def test_all_pairs_of_the_tumble_are_used(run: DpiRun) -> None:
    assert run.run.fit is FitStatus.ELLIPSOID
    assert (run.n_used, run.run.n, run.run.slot) == (300, 300, SLOT)


def test_the_board_does_as_the_reference_does_with_the_active_slots_accelerometer(run: DpiRun, tumble: Tumble) -> None:
    gravity = (tumble.accelerometer - OFFSET) @ GAIN.T
    reference = fit_dpi(tumble.points, gravity, dip_deg=62.0)
    # The margins of C against the reference.
    assert np.allclose(run.run.soft_iron, reference.calibration.soft_iron, rtol=0, atol=1e-7)
    assert np.allclose(run.run.hard_iron, reference.calibration.hard_iron, rtol=0, atol=0.005)


def test_norms_and_gravity_are_fitted_together_by_their_own_name(virtual_board: Board, tumble: Tumble) -> None:
    virtual_board.session.request(SetAccelerometer(0, GAIN, OFFSET))
    fit = fit_tumble(virtual_board, tumble, slot=SLOT + 1, dip_deg=62.0, is_joint=True)
    reference = fit_joint_pairs(tumble.points, (tumble.accelerometer - OFFSET) @ GAIN.T).calibration
    assert (fit.run.name, fit.run.fit, fit.n_used) == ("joint", FitStatus.ELLIPSOID, 300)
    # The margins of C against the reference: 0.002 degrees of 0.002 counts^-1.
    assert np.allclose(fit.run.soft_iron, reference.soft_iron, rtol=0, atol=1e-7)
    stored = virtual_board.session.request(GetCalibration(SLOT + 1))
    assert np.array_equal(stored.soft_iron, fit.run.soft_iron)


def test_cycles_of_joint_are_a_line_over_the_pairs_from_100_on(virtual_board: Board) -> None:
    virtual_board.session.request(SetAccelerometer(0, np.eye(3) / 8192.0, np.zeros(3)))
    cost = measure_dpi_cycles(virtual_board, sizes=(100, 300), is_joint=True)
    assert (cost.calibrator, cost.n) == ("joint", 100)
    assert cost.total <= 50_000
    # A row, its sums, and the moments of the start.
    assert 380 < cost.per_point < 400


def test_the_slot_gets_both_calibrations(virtual_board: Board, run: DpiRun) -> None:
    stored = virtual_board.session.request(GetCalibration(SLOT))
    assert np.array_equal(stored.soft_iron, run.run.soft_iron)
    assert np.array_equal(stored.hard_iron, run.run.hard_iron)
    accelerometer = virtual_board.session.request(GetAccelerometer(SLOT))
    assert np.allclose(accelerometer.gain, GAIN, rtol=1e-6)
    assert np.allclose(accelerometer.offset, OFFSET)


def test_what_the_data_say_of_the_field_is_near_the_truth(virtual_board: Board, run: DpiRun) -> None:
    assert virtual_board.truth is not None
    # Noise of 300 pairs is 0.1 degree; 2 mg of the accelerometer's offset are another.
    assert run.dip_deg == pytest.approx(virtual_board.truth.dip_deg, abs=0.5)
    gain = np.linalg.det(virtual_board.truth.soft_iron) ** (1.0 / 3.0)
    assert run.strength_ut == pytest.approx(48.5 * gain, abs=0.3)
    # 0.4 uT, the counts' rounding, and gravity's 1.26 mg, of 48.5 uT: 0.84 %; 288 degrees of freedom.
    assert run.standard_error_percent == pytest.approx(0.84, rel=0.15)
    assert run.run.rotation_left_deg is not None
    assert run.run.rotation_left_deg < 1.0


@pytest.mark.slow
def test_still_poses_leave_less_of_a_rotation(virtual_board: Board, simulated_turntable: Turntable) -> None:
    collect_still_poses(virtual_board, simulated_turntable, spread_poses(38))
    still = fit_still_poses(virtual_board, 38)
    assert (still.run.fit, still.n_used) == (FitStatus.ELLIPSOID, 38)
    assert still.dip_deg == pytest.approx(62.0, abs=0.3)
    # 38 x 16 readings tell what 608 single ones do: 0.15 degrees in each component.
    assert still.run.rotation_left_deg is not None
    assert still.run.rotation_left_deg < 0.6
    few = fit_still_poses(virtual_board, 37)
    assert (few.run.fit, few.n_used) == (FitStatus.TOO_FEW_POINTS, 37)
    assert not few.run.usable


@pytest.mark.parametrize("count", [38, 60, 128])
def test_spread_poses_determine_everything(count: int) -> None:
    turns = np.array([rotation_rows(pose) for pose in spread_poses(count)])
    dip = math.radians(62.0)
    fit = fit_dpi(485.0 * turns @ [math.cos(dip), 0.0, math.sin(dip)], turns[:, :, 2], readings=16)
    assert fit.status is FitStatus.ELLIPSOID
    assert fit.calibration.coverage < 3.5  # random attitudes have 2 to 5; headings that follow gravity 8


def test_golden_pairs_are_a_calibrators_and_a_gravity_at_one_angle() -> None:
    points, gravities = golden_pairs(300)
    assert np.linalg.norm(gravities, axis=1) == pytest.approx(8192.0, abs=1.0)
    fit = fit_dpi(points, gravities / 8192.0)
    assert fit.dip_deg == pytest.approx(62.0, abs=0.5)
    assert fit.calibration.coverage < 3.0


def test_cycles_do_not_depend_on_the_pairs_but_on_their_number(virtual_board: Board) -> None:
    cost = measure_dpi_cycles(virtual_board, point_sets=2, sizes=(300, 350, 400))
    print(f"{cost.total} cycles of 300 pairs, {cost.per_point:.0f} a pair, {cost.fixed:.0f} fixed")
    assert cost.spread == 0
    assert cost.regression_residual < 1e-6
    assert cost.total == pytest.approx(cost.fixed + 300 * cost.per_point)
    assert cost.instructions is not None
    assert 0.5 * cost.total < cost.instructions < cost.total


def test_what_a_refusal_costs_is_no_measure_of_the_fit(virtual_board: Board) -> None:
    virtual_board.session.request(SetAccelerometer(0, np.diag([1.0, 1.0, 0.0]) / 8192.0, np.zeros(3)))
    try:
        with pytest.raises(CalibrationError, match="the board refuses 300 golden pairs against gravity: SINGULAR"):
            measure_dpi_cycles(virtual_board, point_sets=1, sizes=(300, 350))
    finally:
        virtual_board.session.request(SetAccelerometer(0, GAIN, OFFSET))


def test_pairs_that_are_uploaded_are_those_that_come_back(virtual_board: Board) -> None:
    points, gravities = golden_pairs(100)
    upload_pairs(virtual_board, points, gravities)
    back = [virtual_board.session.request(Points(first, 50)) for first in (0, 50)]
    assert np.array_equal(np.concatenate([pose.magnetometer for pose in back]), points)
    assert np.array_equal(np.concatenate([pose.accelerometer for pose in back]), gravities)
