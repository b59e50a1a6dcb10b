"""Accelerometer calibration: counts to gravity, from six faces or from any still poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import COVERAGE_LIMIT, ELLIPSOID_UNKNOWNS, FitStatus
from hiltest.calibration.still_pose import FACES, Face, StillPose

Reals = NDArray[np.float64]

#: Sensitivity by the data sheet of the part at its full scale of 4 g.
COUNTS_PER_G = 8192.0

# Limits that decide a status. The firmware has the same, for the same reasons.
#: Sample deviation on any axis above which the board was not still: noise is 1.3 mg, a hand that holds it 10 and more.
MOVED_SPREAD_MG = 5.0
#: Cosine of the largest angle between a face's axis and the reading: an untrimmed part and a careless hand stay within
#: 20 degrees; the next face is at 90.
FACE_COSINE = 0.94
#: Range of a reading on a face: a part at another full scale is outside, an untrimmed one inside.
FACE_NORMS_G = (0.6, 1.6)

#: Prior of a part's cross-axis sensitivities, rms of each element: half a percent, as in data sheets.
CROSS_AXIS = 0.005
# Passes of the alternation below. The third pass fits faces misaligned by 1 degree to 1e-10 mg, by 20 degrees to 4e-4;
# its step is below 0.1 mg if a solution exists.
_PASSES, _SETTLED_COUNTS = 3, 1e-4 * COUNTS_PER_G


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerFit:
    """A linear accelerometer calibration: ``gravity_g = gain @ (counts - offset)``.

    Body frame (x forward, y right, z down), gravity-positive: a level board has (0, 0, +1).
    """

    gain: Reals
    """Shape (3, 3) [g/count]."""
    offset: Reals
    """Shape (3,) [counts]."""

    def gravity_g(self, counts: ArrayLike) -> Reals:
        """Convert counts to gravity.

        Parameters
        ----------
        counts : shape (..., 3)

        Returns
        -------
        ndarray, shape (..., 3)
            Gravity [g]; its norm is 1 if the board is still and the calibration good.
        """
        return (np.asarray(counts, dtype=np.float64) - self.offset) @ self.gain.T


#: Calibration by the part's data sheet: no offset, no gain error.
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
    """An accelerometer calibration and the status of its fit."""

    status: AccelerometerStatus
    faces: tuple[Face, ...]
    """Faces at fault."""
    pose: int | None
    """Index of the first pose at fault."""
    fit: AccelerometerFit
    """`NOMINAL` unless the status is OK."""
    residual_mg: float
    """Residual over its own poses: misalignment of the faces, or rms of the norm minus 1 g; 0 without a fit."""

    @property
    def faces_askew_deg(self) -> float:
        """Misalignment of the six faces: rms of gravity's angle from its axis, about each of the two others [deg]."""
        return math.degrees(1e-3 * self.residual_mg)


def fit_six_position(poses: Sequence[StillPose], cross_axis: float = CROSS_AXIS) -> AccelerometerSolution:
    """Fit gain and offset to the six faces: norms determine both, the faces only the rotation of the axes.

    Parameters
    ----------
    poses
        Each face once; other poses are ignored.
    cross_axis
        Prior of the part's cross-axis sensitivities, rms of each element [1].

    Returns
    -------
    AccelerometerSolution
        Solution with the status OK, MISSING_FACE, REPEATED_FACE, MISPLACED_FACE or MOVED, the first of these that
        applies, with all faces that it applies to; or NOT_AN_ELLIPSOID.

    Notes
    -----
    Gravity has the length 1 g on a misaligned face too, so six norms determine three offsets and three scales. Half the
    difference of opposite faces across their axis is then the part's cross-axis error, and their mean is the
    misalignment, with standard deviation sigma, which three pairs measure twice each. The faces add a variance of
    sigma^2 / 2 to both, so the part's error is weighted with c^2 / (c^2 + sigma^2 / 2), where c is the prior, and
    removed from the readings before the norms are fitted again. Least squares on the vectors (Puc, Podobnik and Munih,
    eq. 11 to 15) would attribute a third of sigma to the offset. A cube that is misaligned as a whole turns all
    headings, because opposite faces agree.
    """
    indices = [index for index, pose in enumerate(poses) if pose.face is not Face.NONE]
    for status, wrong in _faults(poses, indices):
        if wrong:
            faces = tuple(sorted(wrong))
            first = next((index for index in indices if poses[index].face in wrong), None)
            return _solution_without_fit(status, faces, first)
    counts = np.array([poses[index].accelerometer for index in sorted(indices, key=lambda index: poses[index].face)])
    middle, half = (counts[::2] + counts[1::2]) / 2.0, (counts[::2] - counts[1::2]) / 2.0
    met = _fit_norms(middle, half)
    if met is None:
        return _solution_without_fit(AccelerometerStatus.NOT_AN_ELLIPSOID)
    variance = _misalignment_rad((middle - met[0]) * met[1]) ** 2
    shares = half / np.diag(half)[:, None] * cross_axis**2 / (cross_axis**2 + variance / 2.0)
    axes = np.where(np.eye(3, dtype=bool), 1.0, shares).T
    straight = np.linalg.inv(axes)
    met = _fit_norms(middle @ straight.T, half @ straight.T)
    if met is None:
        return _solution_without_fit(AccelerometerStatus.NOT_AN_ELLIPSOID)
    fit = AccelerometerFit(met[1][:, None] * straight, axes @ met[0])
    return AccelerometerSolution(AccelerometerStatus.OK, (), None, fit, faces_residual_mg(fit, counts))


def faces_residual_mg(fit: AccelerometerFit, counts: ArrayLike) -> float:
    """Return the misalignment of faces under a calibration, rms [mg], from their readings in the order of `FACES`."""
    gravity_g = fit.gravity_g(np.asarray(counts, dtype=np.float64))
    return 1000.0 * _misalignment_rad((gravity_g[::2] + gravity_g[1::2]) / 2.0)


def norm_residual_mg(fit: AccelerometerFit, counts: ArrayLike) -> float:
    """Return the deviation of gravity's length from 1 g under a calibration, rms [mg]."""
    gravity_g = fit.gravity_g(np.asarray(counts, dtype=np.float64))
    return 1000.0 * _rms(np.linalg.norm(gravity_g, axis=1) - 1.0)


def cross_axis_of_faces(counts: ArrayLike, faces_askew_deg: float) -> float:
    """Return the rms of a part's cross-axis elements by its readings on six faces, at least `CROSS_AXIS` [1].

    Parameters
    ----------
    counts : shape (6, 3)
        In the order of `FACES`.

    Notes
    -----
    Half the difference of opposite faces across their axis has the variance ``c^2 + sigma^2 / 2``, see
    `fit_six_position`; sigma is known from their means. This is the estimate of c by the moment of all six.
    """
    faces = np.asarray(counts, dtype=np.float64)
    half = (faces[::2] - faces[1::2]) / 2.0
    shares = (half / np.diag(half)[:, None])[~np.eye(3, dtype=bool)]
    return math.sqrt(max(CROSS_AXIS**2, _rms(shares) ** 2 - math.radians(faces_askew_deg) ** 2 / 2.0))


def axes_uncertainty_deg(faces_askew_deg: float, cross_axis: float = CROSS_AXIS) -> float:
    """Return the uncertainty of the axes from six misaligned faces: rms of each cross-axis element [deg].

    Notes
    -----
    It is the posterior standard deviation of the estimate of `fit_six_position`: c sigma / sqrt(2 c^2 + sigma^2). So it
    never exceeds the prior c, which is 0.29 degree by default.
    """
    sigma = math.radians(faces_askew_deg)
    return math.degrees(cross_axis * sigma / math.hypot(math.sqrt(2.0) * cross_axis, sigma))


def fit_ellipsoid(poses: Sequence[StillPose]) -> AccelerometerSolution:
    """Fit the ellipsoid of gravity's means, and the symmetric gain that makes it a sphere of 1 g.

    Parameters
    ----------
    poses
        At least 9 poses, with gravity from all sides; their faces are ignored.

    Returns
    -------
    AccelerometerSolution
        OK, TOO_FEW_POSES, MOVED, POOR_COVERAGE or NOT_AN_ELLIPSOID.

    Notes
    -----
    Coelho and Hemerly, eq. 5 and 6. Norms do not show a rotation: for a gain ``M = S R`` the fit is ``S^-1``, and
    calibrated gravity is rotated by R.
    """
    if len(poses) < ELLIPSOID_UNKNOWNS:
        return _solution_without_fit(AccelerometerStatus.TOO_FEW_POSES)
    moved = next((index for index, pose in enumerate(poses) if _moved(pose)), None)
    if moved is not None:
        return _solution_without_fit(AccelerometerStatus.MOVED, (), moved)
    counts = np.array([pose.accelerometer for pose in poses])
    direct = fit_direct(counts)
    if direct.status is not FitStatus.ELLIPSOID or direct.coverage > COVERAGE_LIMIT:
        if direct.status is FitStatus.NOT_AN_ELLIPSOID:
            return _solution_without_fit(AccelerometerStatus.NOT_AN_ELLIPSOID)
        return _solution_without_fit(AccelerometerStatus.POOR_COVERAGE)
    fit = AccelerometerFit(direct.soft_iron, direct.hard_iron)
    return AccelerometerSolution(AccelerometerStatus.OK, (), None, fit, norm_residual_mg(fit, counts))


def is_on_face(counts: ArrayLike, face: Face) -> bool:
    """Return whether an accelerometer's counts roughly are those of a board on this face."""
    mean_g = np.asarray(counts, dtype=np.float64) / COUNTS_PER_G
    norm_g = float(np.linalg.norm(mean_g))
    return FACE_NORMS_G[0] < norm_g < FACE_NORMS_G[1] and float(mean_g @ face.gravity_g) > FACE_COSINE * norm_g


def axis_error_deg(fit: AccelerometerFit, truth: AccelerometerFit) -> float:
    """Return the largest angle between an axis of the body and its calibrated direction [deg]."""
    turned = fit.gain @ np.linalg.inv(truth.gain)
    cosines = np.diag(turned) / np.linalg.norm(turned, axis=0)
    sines = np.linalg.norm(np.cross(turned.T, np.eye(3)), axis=1) / np.linalg.norm(turned, axis=0)
    return max(math.degrees(math.atan2(*pair)) for pair in zip(sines.tolist(), cosines.tolist(), strict=True))


def offset_error_mg(fit: AccelerometerFit, truth: AccelerometerFit) -> float:
    """Return the distance between the offsets [mg]."""
    return 1000.0 / COUNTS_PER_G * math.hypot(*(fit.offset - truth.offset).tolist())


def _fit_norms(middle: Reals, half: Reals) -> tuple[Reals, Reals] | None:
    """Return offsets [counts] and gains [g/count] that make gravity 1 g long on every face; None if none do.

    Rows are the three pairs of faces. With ``e = middle - offset`` the norms of a pair are ``sum_j gain_j^2 (e_j +-
    half_j)^2 = 1``. Their mean is linear in the squares of the gains, their difference in the offsets, and the coupling
    is weak: a few alternations converge.
    """
    offset: Reals = np.diag(middle).copy()
    step: Reals = np.zeros(3)
    try:
        for _ in range(_PASSES):
            rows = _gain_squares(middle, half, offset) * half
            step = np.linalg.solve(rows, (rows * (middle - offset)).sum(axis=1))
            offset = offset + step
        squares = _gain_squares(middle, half, offset)
    except np.linalg.LinAlgError:
        return None
    if not ((np.abs(step) <= _SETTLED_COUNTS).all() and (squares > 0.0).all()):
        return None
    return offset, np.sqrt(squares)


def _gain_squares(middle: Reals, half: Reals, offset: Reals) -> Reals:
    """Return the squares of the gains that satisfy the mean norm of each pair, for given offsets."""
    return np.asarray(np.linalg.solve((middle - offset) ** 2 + half**2, np.ones(3)))


def _misalignment_rad(middle_g: Reals) -> float:
    """Return the misalignment of faces from the means of pairs, rms [rad]; a pair's mean has half the variance."""
    return math.sqrt(2.0) * _rms(middle_g[~np.eye(3, dtype=bool)])


def _faults(poses: Sequence[StillPose], indices: Sequence[int]) -> list[tuple[AccelerometerStatus, set[Face]]]:
    faces: list[Face] = [poses[index].face for index in indices]
    return [
        (AccelerometerStatus.MISSING_FACE, set[Face](FACES) - set(faces)),
        (AccelerometerStatus.REPEATED_FACE, {face for face in faces if faces.count(face) > 1}),
        (
            AccelerometerStatus.MISPLACED_FACE,
            {poses[index].face for index in indices if not is_on_face(poses[index].accelerometer, poses[index].face)},
        ),
        (AccelerometerStatus.MOVED, {poses[index].face for index in indices if _moved(poses[index])}),
    ]


def _moved(pose: StillPose) -> bool:
    """Return whether the board moved: a single reading cannot show that it did not."""
    spread = pose.accelerometer_spread
    return spread is None or not bool((spread <= 1e-3 * MOVED_SPREAD_MG * COUNTS_PER_G).all())


def _solution_without_fit(
    status: AccelerometerStatus, faces: tuple[Face, ...] = (), pose: int | None = None
) -> AccelerometerSolution:
    return AccelerometerSolution(status, faces, pose, NOMINAL, 0.0)


def _rms(values: Reals) -> float:
    return math.sqrt(math.fsum((values * values).tolist()) / len(values))
