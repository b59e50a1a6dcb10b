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

#: How askew a part's own axes are, rms of each cross-axis element: half a percent, as data sheets have it.
CROSS_AXIS = 0.005
# Of the alternation below. The third pass meets faces that are askew by 1 degree to 1e-10 mg, by 20 to 4e-4; its step
# is below 0.1 mg where there is anything to be met.
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
        """Return the gravity that counts mean.

        Parameters
        ----------
        counts : shape (..., 3)

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
    """An accelerometer calibration and how it came about."""

    status: AccelerometerStatus
    faces: tuple[Face, ...]
    """At fault."""
    pose: int | None
    """Index of the first pose at fault."""
    fit: AccelerometerFit
    """`NOMINAL` unless the status is OK."""
    residual_mg: float
    """What the fit leaves of its own poses: how askew the faces were, or rms of the norm less 1 g; 0 without a fit."""

    @property
    def faces_askew_deg(self) -> float:
        """How askew the six faces were: rms of gravity's angle from its axis, about each of the two others [deg]."""
        return math.degrees(1e-3 * self.residual_mg)


def fit_six_position(poses: Sequence[StillPose]) -> AccelerometerSolution:
    """Fit gain and offset to the six faces: norms decide both, the faces only how the axes are turned.

    Parameters
    ----------
    poses
        Each face once; poses that are none are left out.

    Returns
    -------
    AccelerometerSolution
        OK, MISSING_FACE, REPEATED_FACE, MISPLACED_FACE or MOVED, with all faces that this is true of: the first
        in this order that is true of any; or NOT_AN_ELLIPSOID.

    Notes
    -----
    Gravity is 1 g long however askew a face is: six norms determine three offsets and three scales. Half of what
    opposite faces differ by across their axis is then the part's, and the middle of the two how askew they were by
    sigma, an angle that is measured twice on each of three pairs. The faces add a variance of sigma^2 / 2 to both, so
    the part's is taken with the weight c^2 / (c^2 + sigma^2 / 2), c being `CROSS_AXIS`, and divided out of the
    readings before the norms are met once more. Least squares on the vectors (Puc, Podobnik and Munih, eq. 11 to 15)
    take a third of sigma for the offset. A cube that sits askew as a whole turns all headings: opposite faces agree.
    """
    indices = [index for index, pose in enumerate(poses) if pose.face is not Face.NONE]
    for status, wrong in _faults(poses, indices):
        if wrong:
            faces = tuple(sorted(wrong))
            first = next((index for index in indices if poses[index].face in wrong), None)
            return _no_fit(status, faces, first)
    counts = np.array([poses[index].accelerometer for index in sorted(indices, key=lambda index: poses[index].face)])
    middle, half = (counts[::2] + counts[1::2]) / 2.0, (counts[::2] - counts[1::2]) / 2.0
    met = _meet_norms(middle, half)
    if met is None:
        return _no_fit(AccelerometerStatus.NOT_AN_ELLIPSOID)
    variance = _askew((middle - met[0]) * met[1]) ** 2
    shares = half / np.diag(half)[:, None] * CROSS_AXIS**2 / (CROSS_AXIS**2 + variance / 2.0)
    axes = np.where(np.eye(3, dtype=bool), 1.0, shares).T
    straight = np.linalg.inv(axes)
    met = _meet_norms(middle @ straight.T, half @ straight.T)
    if met is None:
        return _no_fit(AccelerometerStatus.NOT_AN_ELLIPSOID)
    fit = AccelerometerFit(met[1][:, None] * straight, axes @ met[0])
    return AccelerometerSolution(AccelerometerStatus.OK, (), None, fit, faces_residual_mg(fit, counts))


def faces_residual_mg(fit: AccelerometerFit, counts: ArrayLike) -> float:
    """Return how askew faces were under a calibration, rms [mg], from their readings in the order of `FACES`."""
    gravity_g = fit.gravity_g(np.asarray(counts, dtype=np.float64))
    return 1000.0 * _askew((gravity_g[::2] + gravity_g[1::2]) / 2.0)


def norm_residual_mg(fit: AccelerometerFit, counts: ArrayLike) -> float:
    """Return by how much gravity is not 1 g long under a calibration, rms [mg]."""
    gravity_g = fit.gravity_g(np.asarray(counts, dtype=np.float64))
    return 1000.0 * _rms(np.linalg.norm(gravity_g, axis=1) - 1.0)


def axes_uncertainty_deg(faces_askew_deg: float) -> float:
    """Return what six faces that were askew leave of an axis: rms of each cross-axis element [deg].

    Notes
    -----
    The standard deviation of what `fit_six_position` estimates, before and after: c sigma / sqrt(2 c^2 + sigma^2). So
    it is never more than the part itself is askew by, 0.29 degree.
    """
    sigma = math.radians(faces_askew_deg)
    return math.degrees(CROSS_AXIS * sigma / math.hypot(math.sqrt(2.0) * CROSS_AXIS, sigma))


def fit_ellipsoid(poses: Sequence[StillPose]) -> AccelerometerSolution:
    """Fit the ellipsoid of gravity's means, and the symmetric gain that makes it a sphere of 1 g.

    Parameters
    ----------
    poses
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
    return AccelerometerSolution(AccelerometerStatus.OK, (), None, fit, norm_residual_mg(fit, counts))


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


def _meet_norms(middle: Reals, half: Reals) -> tuple[Reals, Reals] | None:
    """Return offsets [counts] and gains [g/count] that make gravity 1 g long on every face; None where none do.

    Rows are the three pairs of faces. With ``e = middle - offset`` the norms of a pair are ``sum_j gain_j^2 (e_j +-
    half_j)^2 = 1``. Their mean is linear in the squares of the gains, their difference in the offsets, and each hardly
    feels the other: a few turns of both settle.
    """
    offset: Reals = np.diag(middle).copy()
    step: Reals = np.zeros(3)
    try:
        for _ in range(_PASSES):
            rows = _squares(middle, half, offset) * half
            step = np.linalg.solve(rows, (rows * (middle - offset)).sum(axis=1))
            offset = offset + step
        squares = _squares(middle, half, offset)
    except np.linalg.LinAlgError:
        return None
    if not ((np.abs(step) <= _SETTLED_COUNTS).all() and (squares > 0.0).all()):
        return None
    return offset, np.sqrt(squares)


def _squares(middle: Reals, half: Reals, offset: Reals) -> Reals:
    """Return the squares of the gains that meet the mean norm of each pair, for some offsets."""
    return np.asarray(np.linalg.solve((middle - offset) ** 2 + half**2, np.ones(3)))


def _askew(middle_g: Reals) -> float:
    """Return how askew faces are that have these middles, rms [rad]: that of two has half of their variance."""
    return math.sqrt(2.0) * _rms(middle_g[~np.eye(3, dtype=bool)])


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
