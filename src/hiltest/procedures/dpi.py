"""Calibration of the magnetometer against gravity on the board, from pairs or still poses, and its cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.boards.board import Board
from hiltest.calibration import FitStatus, joint
from hiltest.calibration.dpi import PAIRS_MINIMUM, POSE_READINGS, UNKNOWNS
from hiltest.calibration.fit import MagnetometerFit
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.errors import CalibrationError
from hiltest.link.accelerometer import GetAccelerometer, SetAccelerometer
from hiltest.link.dpi import DpiReply, DpiSource, FitDpi
from hiltest.link.messages import SetCalibration
from hiltest.link.replies import CycleSource
from hiltest.procedures.calibrate import UNCALIBRATED_SLOT, CalibratorRun, calibrator_run
from hiltest.procedures.cycles import CycleCost, fit_line, instructions_of, no_cycle_counter, upload_pairs
from hiltest.procedures.golden_points import golden_pairs
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.still_poses import stored_poses
from hiltest.procedures.tumble import Tumble

DPI = "dpi"
DPI_POSES = "dpi-poses"
JOINT = "joint"
# Numbers of pairs, from the fewest that can be fitted to the capacity of a board's buffer.
DPI_SIZES = (PAIRS_MINIMUM, 400, 500)
JOINT_SIZES = (joint.PAIRS_MINIMUM, 300, 500)


@dataclass(frozen=True, slots=True, eq=False)
class DpiRun:
    """Calibration that the board made from field and gravity."""

    run: CalibratorRun
    """The calibration, compared with points and truth like any other."""
    n_used: int
    """Rows of the least squares; of a refused fit, the rows until then."""
    dip_deg: float | None
    strength_ut: float | None
    """Dip and strength of the field from the data; None if undetermined."""
    standard_error_percent: float | None
    """Standard error of one dot product, in parts of the field's strength."""


def fit_tumble(
    board: Board, tumble: Tumble, *, slot: int, dip_deg: float | None = None, is_joint: bool = False
) -> DpiRun:
    """Let the board fit all pairs of a tumble, and store the calibration in a slot.

    Parameters
    ----------
    board
        Board with the pairs of `tumble`. Gravity is corrected by the accelerometer calibration of slot 0, which is
        copied to `slot`.
    dip_deg
        Declared inclination of the field; without it the board estimates it.
    is_joint
        True to fit norms and dot products together (`JOINT`).
    """
    request = FitDpi(len(tumble.points), UNCALIBRATED_SLOT, dip_deg=dip_deg, is_joint=is_joint)
    reply = board.session.request(request)
    fit = _dpi_run(board, JOINT if is_joint else DPI, reply, tumble.points, slot)
    if fit.run.usable:
        accelerometer = board.session.request(GetAccelerometer(UNCALIBRATED_SLOT))
        board.session.request(SetCalibration(slot, fit.run.soft_iron, fit.run.hard_iron))
        board.session.request(SetAccelerometer(slot, accelerometer.gain, accelerometer.offset))
    return fit


def fit_still_poses(board: Board, n: int, *, dip_deg: float | None = None) -> DpiRun:
    """Let the board fit its first n still poses.

    Parameters
    ----------
    board
        Board with the poses, of at least 16 readings each. Gravity is corrected by the accelerometer calibration of
        slot 0.
    n
        Number of poses, at least 38.
    dip_deg
        See `fit_tumble`.
    """
    poses = stored_poses(board, n)
    reply = board.session.request(FitDpi(n, UNCALIBRATED_SLOT, source=DpiSource.POSES, dip_deg=dip_deg))
    return _dpi_run(board, DPI_POSES, reply, np.array([pose.magnetometer for pose in poses]), None)


def _dpi_run(
    board: Board, name: str, reply: DpiReply, points: NDArray[np.int16] | ArrayLike, slot: int | None
) -> DpiRun:
    calibration = reply.calibration
    fit = MagnetometerFit(
        reply.fit, False, reply.iterations, calibration.soft_iron, calibration.hard_iron, reply.coverage
    )
    readings = POSE_READINGS if name == DPI_POSES else 1
    run = calibrator_run(
        board,
        name,
        UNCALIBRATED_SLOT if slot is None else slot,
        np.asarray(points),
        fit,
        reply.cost,
        parameters=joint.UNKNOWNS if name == JOINT else UNKNOWNS,
        readings=readings,
    )
    return DpiRun(
        run,
        reply.n_used,
        reply.dip_deg,
        None if reply.strength_counts is None else reply.strength_counts / COUNTS_PER_UT,
        None if reply.standard_error is None else 100.0 * reply.standard_error,
    )


def measure_dpi_cycles(
    board: Board,
    *,
    point_sets: int = 2,
    sizes: Sequence[int] | None = None,
    is_joint: bool = False,
    progress: Progress | None = None,
) -> CycleCost:
    """Count the cycles of FIT_DPI on golden pairs.

    Parameters
    ----------
    board
        Board whose point buffer is replaced.
    point_sets
        Number of point sets of the spread, each at the first size; at least 1.
    sizes
        Numbers of pairs of the line; `total` is at the first. By default `DPI_SIZES` or `JOINT_SIZES`.
    is_joint
        See `fit_tumble`.

    Raises
    ------
    CalibrationError
        When the board refuses to fit them.
    DeviceError
        When the board's core has no cycle counter.
    """
    if board.identity.cycle_source is CycleSource.NONE:
        raise no_cycle_counter()
    tell, name = progress or silent, JOINT if is_joint else DPI
    sizes = sizes or (JOINT_SIZES if is_joint else DPI_SIZES)
    work = [(sizes[0], index) for index in range(point_sets)] + [(size, 0) for size in sizes[1:]]
    cycles: dict[tuple[int, int], int] = {}
    instructions = band = request = None
    for done, (size, index) in enumerate(work):
        tell(f"cycles of {name}", done, len(work))
        upload_pairs(board, *golden_pairs(size, index=index))
        reply = board.timed(FitDpi(size, UNCALIBRATED_SLOT, is_joint=is_joint), name)
        cost = reply.cost
        if reply.fit is not FitStatus.ELLIPSOID:
            raise CalibrationError(
                f"the board refuses {size} golden pairs against gravity: {reply.fit.name}. The cost of a refusal is "
                "not the cost of the fit: check the calibration of the accelerometer in slot 0"
            )
        if cost is None:
            raise no_cycle_counter()
        cycles[size, index] = cost.cycles
        if not done:
            request = board.request_cost()
            instructions, band = instructions_of(board, cost), board.cycle_range(cost, name)
    tell(f"cycles of {name}", len(work), len(work))
    over_sizes = [cycles[size, 0] for size in sizes]
    at_first = [cycles[sizes[0], index] for index in range(point_sets)]
    line = fit_line(sizes, over_sizes)
    return CycleCost(
        calibrator=name,
        model=board.cycle_model,
        n=sizes[0],
        total=at_first[0],
        per_point=line.slope,
        fixed=line.intercept,
        regression_residual=line.residual,
        spread=max(at_first) - min(at_first),
        instructions=instructions,
        band=band,
        iterations=0,
        per_iteration=None,
        sizes=np.array(sizes),
        cycles=np.array(over_sizes),
        request=None if request is None else request.awake_cycles,
        unchecked=board.unchecked(name),
    )
