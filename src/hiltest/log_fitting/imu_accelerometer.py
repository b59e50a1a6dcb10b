"""An accelerometer's calibration from the rests of a log, or from its readings in motion, in any unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.accelerometer import (
    COUNTS_PER_G,
    CROSS_AXIS,
    AccelerometerFit,
    AccelerometerSolution,
    AccelerometerStatus,
    axes_uncertainty_deg,
    cross_axis_of_faces,
    fit_ellipsoid,
    fit_six_position,
)
from hiltest.calibration.acceptance import Acceptance, Bound, Reason, rate_by
from hiltest.calibration.conditioning import WELL_CONDITIONED, ellipsoid_condition
from hiltest.calibration.corrected import fit_corrected
from hiltest.calibration.direct import fit_direct
from hiltest.calibration.direction_error import LARGEST_PREDICTED_DEG, predicted_direction_error
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.calibration.robust import MANY_LEFT_OUT, outliers, repeats
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.log_fitting.counts import evenly_on_sphere
from hiltest.log_fitting.imu_log import ImuLog
from hiltest.log_fitting.intervals import Interval
from hiltest.measurement.units import GRAVITIES

Reals = NDArray[np.float64]

SIX_POSITION, ELLIPSOID, MOVING = METHODS = ("six-position", "ellipsoid", "moving")
AUTO = "auto"
# Largest angle to a face: 3 degrees of placement by hand, 2 of the part's axes, 3 for an offset of 50 mg.
_FACE_COSINE = float(np.cos(np.radians(8.0)))
# Maximum number of fitted readings in motion, evenly on the sphere, so that a minute at rest weighs no more than a
# turn.
_MOST_FITTED = 2_000
_REFUSALS = {
    AccelerometerStatus.TOO_FEW_POSES: "fewer than 9 rests, and not on the six faces: lay the board down in more poses",
    AccelerometerStatus.POOR_COVERAGE: "the rests cover too little of the sphere: lay the board down in more "
    "different poses",
    AccelerometerStatus.NOT_AN_ELLIPSOID: "the rests do not lie on an ellipsoid: the board moved, or the unit changed",
}
_ONLY_FACES = (
    "an ellipsoid has nine unknowns, and rests on the six faces determine six: lay the board down on edges and "
    "corners too, "
    "in at least 9 poses, or use --method six-position"
)

# An accelerometer error e turns a heading by up to e tan(dip), 1.9 e at a dip of 62 degrees: 1 degree uses up the 2
# degrees that the thesis allows a calibrator, and a quarter of it leaves the rest to the magnetometer.
BOUNDS = (
    # Nine unknowns: nine rests leave no residual, eighteen determine the error to 24 %.
    Bound(
        "rests",
        10.0,
        Acceptance.POOR,
        "an ellipsoid through nine rests is exact, without an estimate of its error; lay the board down in more poses",
        below=True,
    ),
    Bound(
        "rests",
        18.0,
        Acceptance.FAIR,
        "too few rests remain to estimate the error; lay the board down in more poses",
        below=True,
    ),
    Bound(
        "condition",
        300.0,
        Acceptance.REFUSED,
        "too few directions of gravity to determine an ellipsoid; turn the sensor in all directions",
    ),
    Bound(
        "condition",
        WELL_CONDITIONED,
        Acceptance.FAIR,
        "a large part of the sphere is missing; turn the sensor in all directions",
    ),
    Bound(
        "spread_after_percent",
        20.0,
        Acceptance.REFUSED,
        "the readings do not lie on an ellipsoid: wrong columns, or only shocks",
    ),
    # For single readings 5 % are 3 degrees. Rests of an intact part agree to 0.1 %.
    Bound(
        "spread_after_percent",
        5.0,
        Acceptance.POOR,
        "the acceleration of the motion is too large beside gravity; turn the sensor more slowly, or lay it down",
    ),
    Bound(
        "spread_after_percent",
        0.5,
        Acceptance.FAIR,
        "motion, drift or touch adds to gravity; leave the sensor alone for three seconds in each pose",
    ),
    Bound(
        "axis_ratio",
        1.5,
        Acceptance.REFUSED,
        "the scales of one part are within some percent of each other; check that these are the columns of one "
        "accelerometer",
    ),
    Bound(
        "left_out_percent",
        100.0 * MANY_LEFT_OUT,
        Acceptance.FAIR,
        "so many readings are far from the ellipsoid that it may be wrong; turn the sensor without jerks",
    ),
    Bound(
        "direction_error_deg",
        5.0,
        Acceptance.REFUSED,
        "gravity would be less accurate than without calibration; lay the board down in more poses, in all directions",
    ),
    Bound(
        "direction_error_deg",
        1.0,
        Acceptance.POOR,
        "at a dip of 62 deg the heading error is twice as large; lay the board down in more poses, in all directions",
    ),
    Bound(
        "direction_error_deg",
        0.25,
        Acceptance.FAIR,
        "at a dip of 62 deg the heading error is twice as large; align the board more precisely, or use more poses",
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerResult:
    """Calibration of the accelerometer from a log."""

    method: str
    """One of `METHODS`."""
    rests: int
    faces: tuple[Face, ...]
    """Detected faces, by the axis that reads gravity, with its sign."""
    verdict: Acceptance
    reasons: tuple[Reason, ...]
    """Reasons why it is not good."""
    fit: AccelerometerFit | None
    """``gravity_g = gain @ (reading - offset)``, in the unit of the log; None if it was refused."""
    refused: str
    """Reason for the refusal; empty without one."""
    spread_before_percent: float = 0.0
    spread_after_percent: float = 0.0
    """Standard deviation of norms over their mean [%], of the fitted rests or readings in motion: uncalibrated, with
    counts relative to the middle of their range; and calibrated, which equals the former after a refusal."""
    residual_mg: float = 0.0
    """rms residual over the fit's own poses."""
    faces_askew_deg: float | None = None
    """rms misalignment about each axis; only for six faces, otherwise None."""
    cross_axis_percent: float | None = None
    """Assumed rms of the part's cross-axis elements, only for six faces: `CROSS_AXIS`, or more if the faces show it."""
    direction_error_deg: float | None = None
    """Predicted error of gravity's direction, rms over the sphere, without a rotation, which norms cannot show."""
    left_out: int = 0
    """Number of outliers among the readings in motion."""


def fit_accelerometer(log: ImuLog, rests: Sequence[Interval], method: str = AUTO) -> AccelerometerResult:
    """Fit the six faces, if all are present and most rests are on one of them; otherwise the ellipsoid of the rests.

    Parameters
    ----------
    method
        One of `METHODS`, or `AUTO`, which falls back to the ellipsoid of all readings in motion if the rests determine
        nothing.
    """
    if not len(log.acceleration):
        return _refused_result(ELLIPSOID if method == AUTO else method, 0, (), "no accelerometer in the log")
    if method == MOVING:
        return _fit_moving(log, len(rests))
    result = _fit_rests(log, rests, method)
    if method == AUTO and result.fit is None:
        moving = _fit_moving(log, len(rests))
        return result if moving.fit is None else replace(moving, faces=result.faces)
    return result


def _fit_rests(log: ImuLog, rests: Sequence[Interval], method: str) -> AccelerometerResult:
    if not rests:
        return _refused_result(ELLIPSOID if method == AUTO else method, 0, (), "no rest of one second was detected")
    means = np.array([log.acceleration[rest.start : rest.end].mean(axis=0) for rest in rests])
    zero, per_g = _nominal_range(log, means)
    nominal = COUNTS_PER_G / per_g * (means - zero)
    faces = [_face(mean) for mean in nominal]
    face_set = tuple(sorted(set(faces) - {Face.NONE}))
    if method == AUTO:
        on_a_face = sum(face is not Face.NONE for face in faces)
        method = SIX_POSITION if face_set == FACES and 2 * on_a_face > len(faces) else ELLIPSOID
    before = _spread_percent(np.linalg.norm(nominal, axis=1))
    if method == ELLIPSOID and face_set == FACES and Face.NONE not in faces:
        return _refused_result(method, len(rests), face_set, _ONLY_FACES, before)
    counts = [rest.end - rest.start for rest in rests]
    cross_axis = CROSS_AXIS
    if method == SIX_POSITION:
        poses = _mean_poses(nominal, faces, counts)
        solution = fit_six_position(poses)
        if solution.status is AccelerometerStatus.OK:
            cross_axis = cross_axis_of_faces([pose.accelerometer for pose in poses], solution.faces_askew_deg)
            solution = fit_six_position(poses, cross_axis)
    else:
        solution = fit_ellipsoid([_pose(mean, Face.NONE) for mean in nominal])
    if solution.status is not AccelerometerStatus.OK:
        return _refused_result(method, len(rests), face_set, _refusal(solution), before)
    fit = AccelerometerFit(solution.fit.gain * COUNTS_PER_G / per_g, solution.fit.offset * per_g / COUNTS_PER_G + zero)
    askew_deg = solution.faces_askew_deg if method == SIX_POSITION else None
    # Two elements of an axis define its rotation.
    error_deg = (
        _error_deg(means, fit) if askew_deg is None else math.sqrt(2.0) * axes_uncertainty_deg(askew_deg, cross_axis)
    )
    return _rate_result(
        AccelerometerResult(
            method,
            len(rests),
            face_set,
            Acceptance.GOOD,
            (),
            fit,
            "",
            before,
            _spread_percent(np.linalg.norm(fit.gravity_g(means), axis=1)),
            solution.residual_mg,
            askew_deg,
            None if askew_deg is None else 100.0 * cross_axis,
            error_deg,
        ),
        means,
    )


def _fit_moving(log: ImuLog, rests: int) -> AccelerometerResult:
    """Fit the ellipsoid that the readings agree on; accelerations of the motion are noise about it."""
    readings = log.acceleration
    left_out = outliers(readings)
    moving = readings[~(left_out | repeats(readings))]
    about = fit_direct(moving)
    used = moving[
        evenly_on_sphere(moving, _MOST_FITTED, about.hard_iron if about.has_fit else np.median(moving, axis=0))
    ]
    corrected = fit_corrected(used)
    if corrected.status is not FitStatus.ELLIPSOID:
        return _refused_result(MOVING, rests, (), "the readings in motion also cover too little of the sphere")
    fit = AccelerometerFit(corrected.soft_iron, corrected.hard_iron)
    zero, _ = _nominal_range(log, used)
    norms = np.linalg.norm(fit.gravity_g(used), axis=1)
    residual_mg = 1000.0 * float(np.sqrt(np.mean((norms - 1.0) ** 2)))
    return _rate_result(
        AccelerometerResult(
            MOVING,
            rests,
            (),
            Acceptance.GOOD,
            (),
            fit,
            "",
            _spread_percent(np.linalg.norm(used - zero, axis=1)),
            _spread_percent(norms),
            residual_mg,
            None,
            None,
            _error_deg(used, fit, unbiased=corrected.iterations > 0),
            int(left_out.sum()),
        ),
        used,
        len(readings),
    )


def _rate_result(result: AccelerometerResult, fitted: Reals, readings: int = 0) -> AccelerometerResult:
    """Return a result with its verdict, without the fit if it is refused."""
    assert result.fit is not None
    verdict, reasons = rate_by(
        BOUNDS,
        {
            "rests": float(result.rests) if result.method == ELLIPSOID else None,
            # Rests are accurate enough to need fewer sides: their direction error is the criterion.
            "condition": ellipsoid_condition(fitted) if result.method == MOVING else None,
            "spread_after_percent": result.spread_after_percent,
            "axis_ratio": float(np.linalg.cond(result.fit.gain)),
            "left_out_percent": 100.0 * result.left_out / readings if readings else None,
            "direction_error_deg": result.direction_error_deg,
        },
    )
    if verdict is Acceptance.REFUSED:
        why = next(reason.meaning for reason in reasons if reason.verdict is verdict)
        return _refused_result(result.method, result.rests, result.faces, why, result.spread_before_percent, reasons)
    return replace(result, verdict=verdict, reasons=reasons)


def _refused_result(
    method: str,
    rests: int,
    faces: tuple[Face, ...],
    why: str,
    spread_percent: float = 0.0,
    reasons: tuple[Reason, ...] = (),
) -> AccelerometerResult:
    return AccelerometerResult(
        method, rests, faces, Acceptance.REFUSED, reasons, None, why, spread_percent, spread_percent
    )


def _error_deg(readings: Reals, fit: AccelerometerFit, *, unbiased: bool = False) -> float | None:
    """Return the predicted error of gravity's direction, computed and bounded like a magnetometer's.

    None if it is unknown.
    """
    ellipsoid = MagnetometerFit(FitStatus.ELLIPSOID, False, 0, fit.gain, fit.offset)
    predicted = predicted_direction_error(readings, ellipsoid, unbiased=unbiased)
    return None if predicted is None else min(predicted.rms_deg, LARGEST_PREDICTED_DEG)


def _nominal_range(log: ImuLog, means: Reals) -> tuple[Reals, float]:
    """Return the readings' zero, and the reading of 1 g; for counts, the middle and half of their range."""
    gravity_units = GRAVITIES[log.acceleration_unit]
    if gravity_units is not None:
        return np.zeros(3), 1.0 / gravity_units
    low, high = means.min(axis=0), means.max(axis=0)
    half = float((high - low).mean()) / 2.0
    return (low + high) / 2.0, half if half > 0.0 else 1.0


def _face(mean: Reals) -> Face:
    along = mean / max(float(np.linalg.norm(mean)), 1e-30)
    return next((face for face in FACES if float(along @ face.gravity_g) > _FACE_COSINE), Face.NONE)


def _mean_poses(nominal: Reals, faces: Sequence[Face], counts: Sequence[int]) -> list[StillPose]:
    """Return one pose per face, the mean of its rests."""
    poses = []
    for face in sorted(set(faces) - {Face.NONE}):
        of_face = [index for index, index_face in enumerate(faces) if index_face is face]
        poses.append(_pose(np.average(nominal[of_face], axis=0, weights=[counts[index] for index in of_face]), face))
    return poses


def _pose(mean: Reals, face: Face) -> StillPose:
    # Stillness was judged by the log's own noise, which may differ from that of the board's part.
    return StillPose(np.zeros(3), np.zeros(3), mean, np.zeros(3), 1, face)


def _refusal(solution: AccelerometerSolution) -> str:
    if solution.status is AccelerometerStatus.MISSING_FACE:
        names = ", ".join(face_name(face) for face in solution.faces)
        return f"no rest on {names}: lay the board down on all six faces, or use --method ellipsoid"
    return _REFUSALS.get(solution.status, solution.status.name.lower().replace("_", " "))


def face_name(face: Face) -> str:
    """Return the axis that reads gravity, with its sign."""
    return f"{'+-'[face % 2]}{'xyz'[face // 2]}"


def _spread_percent(norms: Reals) -> float:
    return 100.0 * float(norms.std() / max(float(norms.mean()), 1e-30))
