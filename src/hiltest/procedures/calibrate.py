"""Run calibrators on the board, all on the same points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.quality import offset_error_ut, residual_percent, rotation_left_deg
from hiltest.errors import CalibrationError
from hiltest.link.messages import Calibrate, ClearCalibration, SetCalibration
from hiltest.link.replies import MICROTESLA_PER_COUNT, CalibrateReply, RunCost
from hiltest.link.streams import StreamStateReply
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.tumble import Tumble
from hiltest.rig.toml_tables import number_of_points

UNCALIBRATED = "uncalibrated"
UNCALIBRATED_SLOT = 0
UNTRIMMED = "-untrimmed"
_ELLIPSOID_PARAMETERS = 9
_SPHERE_PARAMETERS = 4


@dataclass(frozen=True, slots=True, eq=False)
class CalibratorRun:
    """One calibrator's answer on the board."""

    name: str
    """Name as requested, ``direct`` or ``direct@100``."""
    slot: int
    """Slot of the calibration on the board."""
    n: int
    """Points used."""
    result: MagnetometerFit
    """Calibration, as the board computed it in float32."""
    cost: RunCost | None
    """Core cycles of the run and of an empty call; None without a cycle counter."""
    residual_percent: float
    """``100 rms(|C (m - o)| - 1)`` over the n points, computed on the host."""
    residual_predicted_percent: float
    """Residual that the declared noise alone leaves."""
    offset_error_ut: float | None
    rotation_left_deg: float | None
    """Errors against the truth; None without a truth: "not offered"."""

    @property
    def calibrator(self) -> str:
        """Name in the board's identity."""
        return self.name.partition("@")[0]

    @property
    def fit(self) -> FitStatus:
        """Status of the fit."""
        return self.result.status

    @property
    def is_sphere(self) -> bool:
        """True if the ellipsoid was refused and this is the sphere fit."""
        return self.result.is_sphere

    @property
    def iterations(self) -> int:
        """Iterations or sweeps of the solver, 0 for a closed form."""
        return self.result.iterations

    @property
    def soft_iron(self) -> NDArray[np.float64]:
        """(3, 3) [1/count]; ``unit = soft_iron @ (counts - hard_iron)``."""
        return self.result.soft_iron

    @property
    def hard_iron(self) -> NDArray[np.float64]:
        """(3,) [counts]."""
        return self.result.hard_iron

    @property
    def coverage(self) -> float | None:
        """Largest M_ii / d_i of the pivots; None for calibrators without it."""
        # The ratio is at least 1, because d_i is M_ii minus squares.
        return self.result.coverage or None

    @property
    def usable(self) -> bool:
        """True if there is a calibration to test."""
        return self.result.has_fit


def calibrate_once(board: Board, name: str, n: int, *, iterations: int = 0) -> tuple[MagnetometerFit, RunCost | None]:
    """Run one calibrator on the first n points in the board's buffer, without storing its result.

    Parameters
    ----------
    iterations
        Maximum number of iterations; 0 for its own limit.

    Returns
    -------
    fit : MagnetometerFit
        Fit, as the board computed it in float32 [counts].
    cost : RunCost or None
        Cost; None without a cycle counter.
    """
    reply = board.timed(Calibrate(n, name, iterations=iterations), name)
    return fit_of(reply), reply.cost


def fit_of(reply: CalibrateReply | StreamStateReply) -> MagnetometerFit:
    """Return the fit of a calibrator on the board [counts, body frame]."""
    calibration = reply.calibration
    return MagnetometerFit(
        reply.fit, reply.is_sphere, reply.iterations, calibration.soft_iron, calibration.hard_iron, reply.coverage
    )


def run_calibrators(
    board: Board, tumble: Tumble, *, calibrators: Sequence[str], n: int = 100, progress: Progress | None = None
) -> dict[str, CalibratorRun]:
    """Run each calibrator on the first points, and store its result in its own slot.

    Parameters
    ----------
    board
        Board with the points of `tumble`. Slot 0 becomes the identity: no calibration.
    calibrators
        Names as in the board's identity, optionally with a number of points: ``direct@100``.
    n
        Number of points for the others.

    Returns
    -------
    dict of str to CalibratorRun
        Runs by these names, in the same order.

    Raises
    ------
    CalibrationError
        When a calibrator is not in the firmware, or there are more of them than slots.
    """
    tell = progress or silent
    asked = {name: (name.partition("@")[0], number_of_points(name) or n) for name in calibrators}
    missing = [calibrator for calibrator, _ in asked.values() if calibrator not in board.identity.calibrators]
    if missing:
        raise CalibrationError(
            f"the firmware has no calibrator {', '.join(missing)}; it has {', '.join(board.identity.calibrators)}"
        )
    if len(asked) >= board.identity.slots:
        raise CalibrationError(f"{len(asked)} calibrations; the board has {board.identity.slots - 1} slots for them")
    board.session.request(SetCalibration(UNCALIBRATED_SLOT, np.eye(3), np.zeros(3)))
    runs = {}
    for slot, (name, (calibrator, points)) in enumerate(asked.items(), start=1):
        tell(f"calibrator {name}", slot - 1, len(asked))
        fit, cost = calibrate_once(board, calibrator, points)
        parameters = _SPHERE_PARAMETERS if fit.is_sphere else _ELLIPSOID_PARAMETERS
        runs[name] = calibrator_run(board, name, slot, tumble.points[:points], fit, cost, parameters=parameters)
        if runs[name].usable:
            board.session.request(SetCalibration(slot, runs[name].soft_iron, runs[name].hard_iron))
    tell("calibrators", len(asked), len(asked))
    return runs


def store_untrimmed(board: Board, runs: Mapping[str, CalibratorRun], *, first_slot: int) -> dict[str, int]:
    """Store calibrations in further slots without the accelerometer's; return the slots by name.

    The names have the suffix `UNTRIMMED`. These slots give the headings of the same magnetometer calibration with an
    accelerometer in factory state.

    Raises
    ------
    CalibrationError
        When there are not enough slots.
    """
    slots = {}
    usable = [(name, run) for name, run in runs.items() if run.usable]
    if first_slot + len(usable) > board.identity.slots:
        raise CalibrationError(
            f"no slots for {', '.join(name + UNTRIMMED for name, _ in usable)}: the board has {board.identity.slots}, "
            f"and {first_slot} are taken; name fewer further_calibrations or untrimmed_calibrations under [procedure]"
        )
    for slot, (name, run) in enumerate(usable, start=first_slot):
        board.session.request(ClearCalibration(slot))
        board.session.request(SetCalibration(slot, run.soft_iron, run.hard_iron))
        slots[f"{name}{UNTRIMMED}"] = slot
    return slots


def calibrator_run(
    board: Board,
    name: str,
    slot: int,
    points: NDArray[np.int16] | NDArray[np.float64],
    result: MagnetometerFit,
    cost: RunCost | None,
    *,
    parameters: int,
    readings: int = 1,
) -> CalibratorRun:
    """Compare a calibration with the points it was fitted to, and with the truth if it is known.

    Parameters
    ----------
    points : shape (n, 3)
        Counts, or means of `readings` samples each.
    parameters
        Number of parameters of the fit.
    """
    truth = board.truth if result.has_fit else None
    return CalibratorRun(
        name=name,
        slot=slot,
        n=len(points),
        result=result,
        cost=cost,
        residual_percent=residual_percent(points, result),
        residual_predicted_percent=predicted_residual_percent(
            board.declared.magnetometer_sigma_ut / math.sqrt(readings),
            board.declared.field_ut,
            len(points),
            parameters=parameters,
        ),
        offset_error_ut=None if truth is None else offset_error_ut(result, truth.hard_iron_ut),
        rotation_left_deg=None if truth is None else rotation_left_deg(result, truth.soft_iron),
    )


def predicted_residual_percent(sigma_ut: float, field_ut: float, n: int, *, parameters: int = 9) -> float:
    """Return the relative norm residual that sensor noise alone leaves after a fit [%].

    Parameters
    ----------
    sigma_ut
        rms noise of one axis of one reading [uT].
    field_ut
        Field strength [uT].
    n
        Points the fit used.
    parameters
        Number of parameters of the fit: 9 for an ellipsoid, 4 for a sphere.

    Raises
    ------
    ValueError
        When there are not more points than parameters.

    Notes
    -----
    To first order the norm of a calibrated point errs by the noise along the field, sigma / B. Quantisation adds a
    uniform error of variance q^2 / 12. A least-squares fit of p parameters leaves n - p degrees of freedom, and the
    residual is a mean over n: ``100 sqrt((sigma^2 + q^2/12) (n - p) / n) / B``. Terms of second order, sigma^2 / B^2,
    are below 1 % of it at sigma = 0.4 uT.
    """
    if n <= parameters:
        raise ValueError(f"{n} points for {parameters} parameters: no residual is left to predict")
    variance = sigma_ut**2 + MICROTESLA_PER_COUNT**2 / 12.0
    return 100.0 * math.sqrt(variance * (n - parameters) / n) / field_ut
