"""Bias, scale, axes and noise of the gyroscope, from rests, full turns of the table, and a log at rest.

The gate set measures a rest, one turn about z and another rest. The full set adds turns about x and y, and the board
fits and stores its calibration.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hiltest.boards import Board
from hiltest.calibration.noise_density import noise_density
from hiltest.link.gyroscope import Axis
from hiltest.link.replies import SensorKind
from hiltest.procedures import (
    FittedTurns,
    MeasuredTurn,
    Progress,
    Turntable,
    log_gyroscope,
    measure_turn,
)
from hiltest.rig import Rig
from hiltest.session.fixtures import Measure

pytestmark = pytest.mark.hil

NOISE_LOG_S = 10.0


def test_bias_is_gone_in_the_second_rest(
    turn_about_z: MeasuredTurn, board: Board, measure: Measure, record_settings: Callable[..., int | None]
) -> None:
    measure("gyroscope.bias_error", turn_about_z.bias_error_dps, "dps")
    measure("gyroscope.uncorrected_error", turn_about_z.uncorrected_error_dps, "dps")
    measure("gyroscope.temperature", turn_about_z.after.die_temperature_degc, "degC")
    record_settings("turn", board.sensor(SensorKind.GYROSCOPE))


def test_one_turn_is_as_long_as_the_table_s(turn_about_z: MeasuredTurn, board: Board, measure: Measure) -> None:
    truth = board.truth and board.truth.gyroscope_response
    measure("gyroscope.sensitivity_error.z", turn_about_z.sensitivity_error_percent, "%")
    measure("gyroscope.scale_error.z", None if truth is None else turn_about_z.scale_error_percent(truth), "%")
    measure("gyroscope.misalignment.z", None if truth is None else turn_about_z.misalignment_deg(truth), "deg")


@pytest.mark.full
def test_turns_about_all_axes_find_scale_and_axes(
    gyroscope_calibration: FittedTurns, board: Board, measure: Measure
) -> None:
    truth = board.truth and board.truth.gyroscope_response
    scale = misalignment = None
    if truth is not None:
        # Errors of the matrix that the board stores, not of the turns that it was fitted to.
        scale = max(gyroscope_calibration.scale_errors_percent(truth), key=abs)
        misalignment = max(gyroscope_calibration.misalignments_deg(truth))
    measure("gyroscope.scale_error", scale, "%")
    measure("gyroscope.misalignment", misalignment, "deg")
    measure("gyroscope.scale_uncertainty", gyroscope_calibration.scale_uncertainty_percent, "%")
    measure("gyroscope.misalignment_uncertainty", gyroscope_calibration.misalignment_uncertainty_deg, "deg")
    cycles, band = gyroscope_calibration.cost and gyroscope_calibration.cost.cycles, gyroscope_calibration.band
    measure("cycles.gyroscope-turns.total", cycles, "cycle", cycle_model=board.cycle_model, band=band)


@pytest.mark.full
def test_the_calibrated_gyroscope_follows_a_turn_that_it_was_not_fitted_to(
    gyroscope_calibration: FittedTurns,
    board: Board,
    turntable: Turntable,
    rig: Rig,
    measure: Measure,
    hil_progress: Progress,
) -> None:
    turn_back = measure_turn(
        board,
        turntable,
        Axis.Z,
        degrees=-360.0,
        rate_dps=rig.procedure.gyroscope_turn_dps,
        rest_s=rig.procedure.gyroscope_rest_s,
        progress=hil_progress,
    )
    error_deg = gyroscope_calibration.fit.matrix @ turn_back.turn.integral - turn_back.turn.turned_deg
    measure("gyroscope.turn_error", float(np.linalg.norm(error_deg)), "deg")


@pytest.mark.full
def test_noise_density_at_rest(board: Board, turntable: Turntable, measure: Measure, hil_progress: Progress) -> None:
    turntable.rest()
    log = log_gyroscope(board, seconds=NOISE_LOG_S, progress=hil_progress)
    density = noise_density(log.rates_dps, rate_hz=log.rate_hz)
    measure("gyroscope.noise_density", 1000.0 * density.together, "mdps/rtHz")
    measure.table(
        "gyroscope.noise_density",
        {"axis": "", "density": "mdps/rtHz"},
        zip("xyz", (1000.0 * density.per_axis).tolist(), strict=True),
    )
