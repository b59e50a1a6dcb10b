"""An accelerometer's calibration from the rests of a log, whatever its unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.calibration.accelerometer import (
    COUNTS_PER_G,
    AccelerometerFit,
    AccelerometerSolution,
    AccelerometerStatus,
    fit_ellipsoid,
    fit_six_position,
)
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.logs.imu_log import ImuLog
from hiltest.logs.intervals import Interval
from hiltest.units import GRAVITIES

Reals = NDArray[np.float64]

METHODS = ("six-position", "ellipsoid")
AUTO = "auto"
# Laid down by hand within 3 degrees, the part's axes within 2 more, an offset of 50 mg 3 more.
_FACE_COSINE = float(np.cos(np.radians(8.0)))
_REFUSALS = {
    AccelerometerStatus.TOO_FEW_POSES: "fewer than 9 rests, and not the six faces: lay it down in more poses",
    AccelerometerStatus.POOR_COVERAGE: "the rests show too little of the sphere: lay it down in more different poses",
    AccelerometerStatus.NOT_AN_ELLIPSOID: "the rests lie on no ellipsoid: they were not still, or their unit changed",
}


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerResult:
    """Calibration of the accelerometer from the rests of a log.

    Attributes
    ----------
    method : str
        ``six-position`` or ``ellipsoid``.
    rests : int
    faces : tuple of Face
        Faces that were found, by the axis on which gravity is read, with its sign.
    fit : AccelerometerFit or None
        ``gravity_g = gain @ (reading - offset)``, in the unit of the log. None when it was refused.
    refused : str
        Why, empty when it was not.
    spread_before_percent, spread_after_percent : float
        Standard deviation of the rests' norms over their mean [%]: of readings, counts about the middle of their
        range; and of what is calibrated, the same as before when it was refused.
    residual_mg : float
        rms residual over the fit's own poses.
    """

    method: str
    rests: int
    faces: tuple[Face, ...]
    fit: AccelerometerFit | None
    refused: str
    spread_before_percent: float
    spread_after_percent: float
    residual_mg: float


def fit_rests(log: ImuLog, rests: Sequence[Interval], method: str = AUTO) -> AccelerometerResult:
    """Fit the six faces, if they are all there and most of the rests are on one, or else the ellipsoid.

    Parameters
    ----------
    log : ImuLog
    rests : sequence of Interval
    method : str
        One of `METHODS`, or `AUTO`.
    """
    if not rests:
        return AccelerometerResult(method, 0, (), None, "no rest of a second was found", 0.0, 0.0, 0.0)
    means = np.array([log.acceleration[rest.start : rest.end].mean(axis=0) for rest in rests])
    zero, per_g = _nominal(log, means)
    nominal = COUNTS_PER_G / per_g * (means - zero)
    norms = np.linalg.norm(nominal, axis=1)
    faces = [_face(each) for each in nominal]
    found = tuple(sorted(set(faces) - {Face.NONE}))
    if method == AUTO:
        on_a_face = sum(face is not Face.NONE for face in faces)
        method = METHODS[0] if found == FACES and 2 * on_a_face > len(faces) else METHODS[1]
    counts = [rest.end - rest.start for rest in rests]
    solution = (
        fit_six_position(_joined(nominal, faces, counts)) if method == METHODS[0]
        else fit_ellipsoid([_pose(each, Face.NONE) for each in nominal])
    )
    before = _spread_percent(norms)
    if solution.status is not AccelerometerStatus.OK:
        return AccelerometerResult(method, len(rests), found, None, _refusal(solution), before, before, 0.0)
    fit = AccelerometerFit(solution.fit.gain * COUNTS_PER_G / per_g, solution.fit.offset * per_g / COUNTS_PER_G + zero)
    after = _spread_percent(np.linalg.norm(fit.gravity_g(means), axis=1))
    return AccelerometerResult(method, len(rests), found, fit, "", before, after, solution.residual_mg)


def _nominal(log: ImuLog, means: Reals) -> tuple[Reals, float]:
    """Return the readings' zero, and what 1 g reads; for counts the middle and half of their range."""
    known = GRAVITIES[log.acceleration_unit]
    if known is not None:
        return np.zeros(3), 1.0 / known
    low, high = means.min(axis=0), means.max(axis=0)
    half = float((high - low).mean()) / 2.0
    return (low + high) / 2.0, half if half > 0.0 else 1.0


def _face(mean: Reals) -> Face:
    along = mean / max(float(np.linalg.norm(mean)), 1e-30)
    return next((face for face in FACES if float(along @ face.gravity_g) > _FACE_COSINE), Face.NONE)


def _joined(nominal: Reals, faces: Sequence[Face], counts: Sequence[int]) -> list[StillPose]:
    """Return one pose a face: all of its rests together."""
    poses = []
    for face in sorted(set(faces) - {Face.NONE}):
        of_face = [index for index, each in enumerate(faces) if each is face]
        poses.append(_pose(np.average(nominal[of_face], axis=0, weights=[counts[index] for index in of_face]), face))
    return poses


def _pose(mean: Reals, face: Face) -> StillPose:
    # It was found still by what the log itself has of noise, which need not be that of the part on the board.
    return StillPose(np.zeros(3), np.zeros(3), mean, np.zeros(3), 1, face)


def _refusal(solution: AccelerometerSolution) -> str:
    if solution.status is AccelerometerStatus.MISSING_FACE:
        names = ", ".join(face_name(face) for face in solution.faces)
        return f"no rest on {names}: lay it down on all six faces, or use --method ellipsoid"
    return _REFUSALS.get(solution.status, solution.status.name.lower().replace("_", " "))


def face_name(face: Face) -> str:
    """Return the axis that reads gravity, with its sign."""
    return f"{'+-'[face % 2]}{'xyz'[face // 2]}"


def _spread_percent(norms: Reals) -> float:
    return 100.0 * float(norms.std() / max(float(norms.mean()), 1e-30))
