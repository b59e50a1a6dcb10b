"""Accelerometer calibration: counts to gravity, from six faces or from any still poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import ELLIPSOID_UNKNOWNS, FitStatus
from hiltest.calibration.still_pose import FACES, Face, StillPose

Reals = NDArray[np.float64]

#: By the data sheet of the part at its full scale of 4 g.
COUNTS_PER_G = 8192.0

# Limits that decide a status. The firmware has the same, for the same reasons.
#: Sample deviation on any axis above which the board was not still: noise is 1.3 mg, a hand that holds it 10 and more.
MOVED_SPREAD_MG = 5.0
#: Cosine of the angle between a face's axis and what was read above which it is that face: an untrimmed part and a
#: careless hand stay within 20 degrees; the next face is at 90.
FACE_COSINE = 0.94
#: What a board on a face may read at least and at most: a part at another full scale is outside, an untrimmed one not.
FACE_NORMS_G = (0.6, 1.6)


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerFit:
    """A linear accelerometer calibration: ``gravity_g = gain @ (counts - offset)``.

    Body frame (x forward, y right, z down), gravity-positive: a level board has (0, 0, +1).

    Attributes
    ----------
    gain : ndarray, shape (3, 3)
        [g/count].
    offset : ndarray, shape (3,)
        [counts].
    """

    gain: Reals
    offset: Reals

    def gravity_g(self, counts: ArrayLike) -> Reals:
        """Return the gravity that counts mean.

        Parameters
        ----------
        counts : array_like, shape (..., 3)

        Returns
        -------
        ndarray, shape (..., 3)
            Gravity [g]; its norm is 1 where the board is still and the calibration good.
        """
        return (np.asarray(counts, dtype=np.float64) - self.offset) @ self.gain.T


#: What the part is by its data sheet: no offset, no gain error.
NOMINAL = AccelerometerFit(np.eye(3) / COUNTS_PER_G, np.zeros(3))


class AccelerometerStatus(IntEnum):
    """Status of a fit; the values are those of the link protocol."""

    OK = 0
    MISSING_FACE = 1
    REPEATED_FACE = 2
    MISPLACED_FACE = 3
    MOVED = 4
    TOO_FEW_POSES = 5
    POOR_COVERAGE = 6
    NOT_AN_ELLIPSOID = 7


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerSolution:
    """An accelerometer calibration and how it came about.

    Attributes
    ----------
    status : AccelerometerStatus
    faces : tuple of Face
        At fault.
    pose : int or None
        Index of the first pose at fault.
    fit : AccelerometerFit
        `NOMINAL` unless the status is OK.
    residual_mg : float
        What the fit leaves of its own poses: rms of the vector between gravity on a face and what is
        calibrated, or of the norm less 1 g; 0 without a fit.
    """

    status: AccelerometerStatus
    faces: tuple[Face, ...]
    pose: int | None
    fit: AccelerometerFit
    residual_mg: float


def fit_six_position(poses: Sequence[StillPose]) -> AccelerometerSolution:
    """Fit gain and offset to the six faces by linear least squares.

    Parameters
    ----------
    poses : sequence of StillPose
        Each face once; poses that are none are left out.

    Returns
    -------
    AccelerometerSolution
        OK, MISSING_FACE, REPEATED_FACE, MISPLACED_FACE or MOVED, with all faces that this is true of: the first
        in this order that is true of any.

    Notes
    -----
    Puc, Podobnik and Munih, eq. 11 to 15: ``A counts - b* = gravity``, 12 unknowns in 18 equations; offset ``A^-1 b*``.
    It finds every linear error, a rotation among them, and takes that of the faces themselves for one: a cube
    that sits askew turns all headings with it. A single face askew by e leaves e/3 on it and on its opposite.
    """
    indices = [index for index, pose in enumerate(poses) if pose.face is not Face.NONE]
    for status, wrong in _faults(poses, indices):
        if wrong:
            faces = tuple(sorted(wrong))
            first = next((index for index in indices if poses[index].face in wrong), None)
            return _no_fit(status, faces, first)
    counts = np.array([poses[index].accelerometer for index in indices])
    gravity_g = np.array([poses[index].face.gravity_g for index in indices])
    rows = np.column_stack([counts, np.full(len(counts), -COUNTS_PER_G)])  # the last in counts, for the scale alone
    solution = np.linalg.lstsq(rows, gravity_g, rcond=None)[0]
    gain: Reals = solution[:3].T
    fit = AccelerometerFit(gain, np.linalg.solve(gain, COUNTS_PER_G * solution[3]))
    errors_g = fit.gravity_g(counts) - gravity_g
    return AccelerometerSolution(AccelerometerStatus.OK, (), None, fit, 1000.0 * _rms(np.linalg.norm(errors_g, axis=1)))


def fit_ellipsoid(poses: Sequence[StillPose]) -> AccelerometerSolution:
    """Fit the ellipsoid of gravity's means, and the symmetric gain that makes it a sphere of 1 g.

    Parameters
    ----------
    poses : sequence of StillPose
        At least 9, gravity from all sides; their faces are not looked at.

    Returns
    -------
    AccelerometerSolution
        OK, TOO_FEW_POSES, MOVED, POOR_COVERAGE or NOT_AN_ELLIPSOID.

    Notes
    -----
    Coelho and Hemerly, eq. 5 and 6. Norms show nothing of a rotation: of a gain ``M = S R`` it finds ``S^-1``, and
    what it calibrates is gravity turned by R.
    """
    if len(poses) < ELLIPSOID_UNKNOWNS:
        return _no_fit(AccelerometerStatus.TOO_FEW_POSES)
    moved = next((index for index, pose in enumerate(poses) if _moved(pose)), None)
    if moved is not None:
        return _no_fit(AccelerometerStatus.MOVED, (), moved)
    counts = np.array([pose.accelerometer for pose in poses])
    found = fit_direct(counts)
    if found.status is not FitStatus.ELLIPSOID:
        refused = found.status is FitStatus.NOT_AN_ELLIPSOID
        return _no_fit(AccelerometerStatus.NOT_AN_ELLIPSOID if refused else AccelerometerStatus.POOR_COVERAGE)
    fit = AccelerometerFit(found.soft_iron, found.hard_iron)
    errors_g = np.linalg.norm(fit.gravity_g(counts), axis=1) - 1.0
    return AccelerometerSolution(AccelerometerStatus.OK, (), None, fit, 1000.0 * _rms(errors_g))


def is_on_face(counts: ArrayLike, face: Face) -> bool:
    """Say whether an accelerometer's counts are those of a board on this face, roughly."""
    mean_g = np.asarray(counts, dtype=np.float64) / COUNTS_PER_G
    norm_g = float(np.linalg.norm(mean_g))
    return FACE_NORMS_G[0] < norm_g < FACE_NORMS_G[1] and float(mean_g @ face.gravity_g) > FACE_COSINE * norm_g


def axis_error_deg(fit: AccelerometerFit, truth: AccelerometerFit) -> float:
    """Return the largest angle between an axis of the body and where the calibration puts it [deg]."""
    turned = fit.gain @ np.linalg.inv(truth.gain)
    cosines = np.diag(turned) / np.linalg.norm(turned, axis=0)
    sines = np.linalg.norm(np.cross(turned.T, np.eye(3)), axis=1) / np.linalg.norm(turned, axis=0)
    return max(math.degrees(math.atan2(*pair)) for pair in zip(sines.tolist(), cosines.tolist(), strict=True))


def offset_error_mg(fit: AccelerometerFit, truth: AccelerometerFit) -> float:
    """Return the distance between the offsets [mg]."""
    return 1000.0 / COUNTS_PER_G * math.hypot(*(fit.offset - truth.offset).tolist())


def _faults(
    poses: Sequence[StillPose], indices: Sequence[int]
) -> list[tuple[AccelerometerStatus, set[Face]]]:
    given: list[Face] = [poses[index].face for index in indices]
    return [
        (AccelerometerStatus.MISSING_FACE, set[Face](FACES) - set(given)),
        (AccelerometerStatus.REPEATED_FACE, {face for face in given if given.count(face) > 1}),
        (AccelerometerStatus.MISPLACED_FACE,
         {poses[index].face for index in indices if not is_on_face(poses[index].accelerometer, poses[index].face)}),
        (AccelerometerStatus.MOVED, {poses[index].face for index in indices if _moved(poses[index])}),
    ]  # fmt: skip


def _moved(pose: StillPose) -> bool:
    """Say whether the board moved: a single reading cannot show that it did not."""
    spread = pose.accelerometer_spread
    return spread is None or not bool((spread <= 1e-3 * MOVED_SPREAD_MG * COUNTS_PER_G).all())


def _no_fit(
    status: AccelerometerStatus, faces: tuple[Face, ...] = (), pose: int | None = None
) -> AccelerometerSolution:
    return AccelerometerSolution(status, faces, pose, NOMINAL, 0.0)


def _rms(values: Reals) -> float:
    return math.sqrt(math.fsum((values * values).tolist()) / len(values))
