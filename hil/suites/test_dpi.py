"""Magnetometer calibration against gravity, which also corrects a rotation: pairs of the tumble, and still poses."""

from __future__ import annotations

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration.dpi import DpiFit, fit_dpi
from hiltest.calibration.joint import fit_joint_pairs
from hiltest.link.accelerometer import GetAccelerometer
from hiltest.measurement import Limit
from hiltest.procedures import (
    DPI,
    JOINT,
    UNCALIBRATED_SLOT,
    DpiRun,
    RequestedAngles,
    Tumble,
    heading_errors_deg,
    summarise,
)
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil

# A larger difference from the declared dip means another field, or gravity in another unit: 300 pairs with 0.4 uT of
# noise determine the dip to 0.1 degree. The dip has no effect on headings.
DIP_WITHIN_DEG = 2.0


def measure_fit(measure: Measure, dpi: DpiRun, rig: Rig) -> None:
    """Record the measurements of a calibration against gravity."""
    run, dip_deg = dpi.run, rig.field.dip_deg
    measure(f"fit.{run.name}.status", int(run.fit), "")
    measure(f"fit.{run.name}.n_used", dpi.n_used, "")
    assert run.usable, f"{run.name} of {dpi.n_used} rows: {run.fit.name}"
    measure(f"fit.{run.name}.residual", run.residual_percent, "%")
    measure(f"fit.{run.name}.residual_predicted", run.residual_predicted_percent, "%")
    measure(f"fit.{run.name}.offset_error", run.offset_error_ut, "uT")
    measure(f"fit.{run.name}.rotation_left", run.rotation_left_deg, "deg")
    measure(f"fit.{run.name}.coverage", run.coverage, "")
    measure(f"fit.{run.name}.standard_error", dpi.standard_error_percent, "%")
    declared = Limit(min=dip_deg - DIP_WITHIN_DEG, max=dip_deg + DIP_WITHIN_DEG)
    measure(f"fit.{run.name}.dip", dpi.dip_deg, "deg", limit=declared)
    measure(f"fit.{run.name}.dip_declared", dip_deg, "deg")
    measure(f"fit.{run.name}.strength", dpi.strength_ut, "uT")
    measure(f"fit.{run.name}.strength_declared", rig.field.strength_ut, "uT")


def require(dpi: DpiRun | None) -> DpiRun:
    """Return the calibration, or skip the test if the rig requests none against gravity."""
    if dpi is None:
        pytest.skip("the rig's [procedure] has no calibration against gravity")
    return dpi


def test_norms_and_gravity_calibrate_the_magnetometer_together(
    joint: DpiRun | None, rig: Rig, measure: Measure
) -> None:
    measure_fit(measure, require(joint), rig)


@pytest.mark.full
def test_gravity_alone_calibrates_the_magnetometer(dpi: DpiRun | None, rig: Rig, measure: Measure) -> None:
    measure_fit(measure, require(dpi), rig)


def measure_float32_error(
    measure: Measure, name: str, board: Board, reference: DpiFit, known_angles: RequestedAngles
) -> None:
    """Record the difference between the board's headings and those of a float64 fit to the same pairs."""
    accelerometer = board.session.request(GetAccelerometer(UNCALIBRATED_SLOT))
    errors = heading_errors_deg(known_angles, reference.calibration, accelerometer)
    assert errors is not None
    differences = (known_angles.error_deg[name] - errors + 180.0) % 360.0 - 180.0
    measure(f"heading.{name}.float32_error", float(np.abs(differences).max()), "deg")


@pytest.mark.full
def test_the_boards_arithmetic_does_not_enter_dpi(
    board: Board, dpi: DpiRun | None, known_angles: RequestedAngles, tumble: Tumble, rig: Rig, measure: Measure
) -> None:
    if not require(dpi).run.usable:
        pytest.skip("there is no calibration")
    gravity = board.session.request(GetAccelerometer(UNCALIBRATED_SLOT)).gravity_g(tumble.accelerometer)
    reference = fit_dpi(tumble.points, gravity, dip_deg=rig.field.dip_deg)
    measure_float32_error(measure, DPI, board, reference, known_angles)


def test_the_boards_arithmetic_does_not_enter_joint(
    board: Board, joint: DpiRun | None, known_angles: RequestedAngles, tumble: Tumble, rig: Rig, measure: Measure
) -> None:
    if not require(joint).run.usable:
        pytest.skip("there is no calibration")
    gravity = board.session.request(GetAccelerometer(UNCALIBRATED_SLOT)).gravity_g(tumble.accelerometer)
    reference = fit_joint_pairs(tumble.points, gravity, dip_deg=rig.field.dip_deg)
    measure_float32_error(measure, JOINT, board, reference, known_angles)


@pytest.mark.full
def test_still_poses_do_as_well(
    board: Board, dpi_from_poses: DpiRun | None, known_angles: RequestedAngles, rig: Rig, measure: Measure
) -> None:
    dpi = require(dpi_from_poses)
    measure_fit(measure, dpi, rig)
    accelerometer = board.session.request(GetAccelerometer(UNCALIBRATED_SLOT))
    errors = heading_errors_deg(known_angles, dpi.run.result, accelerometer)
    assert errors is not None
    summary = summarise(errors, known_angles.reference_deg, level=known_angles.level)
    measure(f"heading.{dpi.run.name}.max", summary.max_deg, "deg", limit=Limit(max=2.0))
    measure(f"heading.{dpi.run.name}.rms", summary.rms_deg, "deg")
    measure(f"heading.{dpi.run.name}.bias", summary.bias_deg, "deg")
    measure(f"heading.{dpi.run.name}.max_centred", summary.max_centred_deg, "deg")
