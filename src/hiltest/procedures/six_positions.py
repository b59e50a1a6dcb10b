"""The accelerometer on its six faces: each is checked when it is taken, and the board fits its stored poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration.accelerometer import (
    COUNTS_PER_G,
    MOVED_SPREAD_MG,
    AccelerometerFit,
    AccelerometerSolution,
    AccelerometerStatus,
    axes_uncertainty_deg,
    axis_error_deg,
    faces_residual_mg,
    is_on_face,
    norm_residual_mg,
    offset_error_mg,
)
from hiltest.calibration.still_pose import FACES, Face, StillPose
from hiltest.errors import FaceError, FirmwareContradictionError
from hiltest.link.accelerometer import FitAccelerometer, SetAccelerometer
from hiltest.link.messages import Average
from hiltest.link.poses import MAX_TRANSFER, AddPose, ClearPoses, Poses, UploadPoses
from hiltest.link.replies import RunCost, SensorKind, Statistic
from hiltest.measurement import CycleRange, Limit, identify
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.still_poses import stored_poses
from hiltest.procedures.turntables import FACE_WORDS, Turntable

Reals = NDArray[np.float64]

# Readings per face: a second at the magnetometer's 80 Hz. The last ones are averaged separately, and compared.
READINGS = 64
READINGS_AFTER = 16
# Largest change of the mean within that second for a still board. Noise is 1.3 mg per reading, which makes the
# difference of the two means 0.35 mg rms; 2 mg are 0.1 degree.
_DRIFT_MG = 2.0
# Allowance beyond the faces' own uncertainty: 5 times the noise of a mean of 64 readings.
_NOISE_MG = 0.8
# Tolerance of the residual that the board computes from its poses and calibration. The rounding of 1 g to float32 is
# 0.0001 mg; a residual from differences of 6 sums stays far below.
_RESIDUAL_ROUNDING_MG = 0.01
# Heading error by axes from six misaligned faces, relative to their rms uncertainty times tan(dip): the 99th percentile
# over 1000 boards with misalignments of 1 degree rms, at the sixty known angles and without any other error.
_TURNED_BY_AXES = {
    "heading.{calibrator}.max": 4.2,
    "heading.{calibrator}.max_centred": 4.2,
    "heading.{calibrator}.rms": 2.4,
}


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerRun:
    """A fit of the accelerometer on the board, compared with the truth if it is known."""

    method: str
    counts: Reals
    """Shape (n, 3). Means of the poses, in order."""
    solution: AccelerometerSolution
    """Solution, as the board computed it in float32."""
    cost: RunCost | None
    """Cost; None without a cycle counter."""
    band: CycleRange | None
    """Uncertainty range of its cycles; None if unknown."""
    die_temperature_degc: int
    """Temperature of the die at the last pose."""
    axis_error_deg: float | None
    offset_error_mg: float | None
    """Errors against the truth; None without a truth: "not offered"."""

    @property
    def fit(self) -> AccelerometerFit:
        """The calibration."""
        return self.solution.fit


class FaceJournal(Protocol):
    """Journal of the six faces, from which a run can resume."""

    def faces(self) -> tuple[Sequence[StillPose], int]:
        """Return the stored faces, and the die's temperature at the last of them [degC]."""

    def keep_faces(self, faces: Sequence[StillPose], die_temperature_degc: int) -> None:
        """Store all faces."""


def measure_six_positions(
    board: Board,
    turntable: Turntable,
    *,
    uncertainty_deg: float,
    limits: Mapping[str, Limit] | None = None,
    dip_deg: float = 0.0,
    progress: Progress | None = None,
    again: Callable[[FaceError], bool] | None = None,
    see_axes: Callable[[], object] | None = None,
    journal: FaceJournal | None = None,
) -> AccelerometerRun:
    """Put the board on each face for a second, and let it fit gain and offset to them.

    Parameters
    ----------
    board
        Board whose pose buffer is cleared first, and holds the faces afterwards.
    uncertainty_deg
        Declared uncertainty of the faces.
    limits
        Limits by measurement. Those of headings, at the dip `dip_deg`, are compared with the misalignment of the faces.
    again
        Returns whether to repeat a refused face; faces without fault are kept.
    see_axes
        Returns a description of wrong sensor axes if a board stays on another face than requested: an automatic table
        reaches the requested face, so the axes must be wrong.
    journal
        Returns the stored faces, and stores all faces.

    Raises
    ------
    FaceError
        When the board lies on another face than requested, or on none; when it moved; when the faces contradict each
        other beyond their declared uncertainty; or when their misalignment exceeds a limit's allowance.
    SensorAbsentError
        When the board has no accelerometer or magnetometer.
    """
    tell = progress or silent
    for kind in (SensorKind.ACCELEROMETER, SensorKind.MAGNETOMETER):
        board.sensor(kind)
    earlier, degc = journal.faces() if journal else ((), 0)
    _store(board, earlier)
    while True:
        try:
            degc = _take_missing(board, turntable, tell, degc)
            run = fit_poses(board, "six-position", len(FACES), degc)
            _refuse_contradiction(run, uncertainty_deg)
            _refuse_limits(run, limits or {}, dip_deg)
        except FaceError as error:
            if again is None or not again(error):
                wrong = str(see_axes()) if see_axes is not None and isinstance(error, _MisplacedError) else ""
                if wrong:
                    raise FaceError(f"{wrong}: {error}", faces=error.faces) from error
                raise
            _drop_faces(board, error.faces or FACES)
        else:
            if journal is not None:
                journal.keep_faces(_read_faces(board), degc)
            turntable.rest()
            return run


class _MisplacedError(FaceError):
    """Error for a board on another face than requested, or on none."""


def _take_missing(board: Board, turntable: Turntable, tell: Progress, degc: int) -> int:
    """Take the faces that the buffer lacks, and sort it; return the die's temperature [degC]."""
    held = {pose.face for pose in _read_faces(board)}
    for number, face in enumerate(FACES):
        if face not in held:
            tell("six faces", number, len(FACES))
            turntable.turn_to_face(face)
            degc = _take(board, face)
    tell("six faces", len(FACES), len(FACES))
    if held:
        _store(board, sorted(_read_faces(board), key=lambda pose: pose.face))
    return degc


def _drop_faces(board: Board, faces: Sequence[int]) -> None:
    """Remove the poses on some faces from the board's buffer."""
    _store(board, [pose for pose in _read_faces(board) if pose.face not in faces])


def _read_faces(board: Board) -> list[StillPose]:
    """Read every pose of the board's buffer, which holds only faces, each at most twice."""
    stored = board.session.request(Poses(0, MAX_TRANSFER))
    return list(stored)


def _store(board: Board, poses: Sequence[StillPose]) -> None:
    board.session.request(ClearPoses())
    if poses:
        board.session.request(UploadPoses(0, poses))


def fit_poses(board: Board, method: str, n: int, die_temperature_degc: int) -> AccelerometerRun:
    """Let the board fit its first n poses.

    Raises
    ------
    FaceError
        When the board refuses; the message has the reason.
    FirmwareContradictionError
        When its residual contradicts its poses and calibration.
    """
    poses = stored_poses(board, n)
    reply = board.session.request(FitAccelerometer(n, method))
    solution = reply.solution
    if solution.status is not AccelerometerStatus.OK:
        which = f" (pose {solution.pose + 1})" if solution.pose is not None else ""
        raise FaceError(
            f"the board refuses the {method} fit of {n} poses: {solution.status.name}{which}"
            + (f", {_face_names(solution.faces)}" if solution.faces else "")
            + f"; {_REMEDIES[solution.status]}",
            faces=[int(face) for face in solution.faces],
        )
    _check_residual(method, poses, solution)
    truth = true_accelerometer(board)
    return AccelerometerRun(
        method,
        np.array([pose.accelerometer for pose in poses]),
        solution,
        reply.cost,
        board.cycle_range(reply.cost),
        die_temperature_degc,
        None if truth is None else axis_error_deg(solution.fit, truth),
        None if truth is None else offset_error_mg(solution.fit, truth),
    )


def _check_residual(method: str, poses: Sequence[StillPose], solution: AccelerometerSolution) -> None:
    """Refuse a residual that contradicts the board's calibration and poses."""
    counts = [pose.accelerometer for pose in sorted(poses, key=lambda pose: pose.face)]
    residual_mg = faces_residual_mg if method == "six-position" else norm_residual_mg
    computed_mg = residual_mg(solution.fit, counts)
    if not abs(solution.residual_mg - computed_mg) <= _RESIDUAL_ROUNDING_MG:
        raise FirmwareContradictionError(
            f"the firmware contradicts itself: it answers a residual of {solution.residual_mg:.3f} mg for its "
            f"{method} fit, and its own poses and calibration give {computed_mg:.3f} mg; check that it applies the "
            "calibration that it reports"
        )


def store_accelerometer(board: Board, fit: AccelerometerFit, slots: Sequence[int]) -> None:
    """Store an accelerometer calibration in slots, and keep their magnetometer calibrations."""
    for slot in slots:
        board.session.request(SetAccelerometer(slot, fit.gain, fit.offset))


def true_accelerometer(board: Board) -> AccelerometerFit | None:
    """Return the true calibration of a simulated world; None if unknown."""
    if board.truth is None:
        return None
    inverse = np.linalg.inv(board.truth.accelerometer_response)
    return AccelerometerFit(
        np.asarray(inverse / COUNTS_PER_G, dtype=np.float64), COUNTS_PER_G * board.truth.accelerometer_offset_g
    )


_REMEDIES = {
    AccelerometerStatus.MISSING_FACE: "take all six",
    AccelerometerStatus.REPEATED_FACE: "use each face once",
    AccelerometerStatus.MISPLACED_FACE: "put the board on the requested faces",
    AccelerometerStatus.MOVED: "leave the board alone for a second on each",
    AccelerometerStatus.TOO_FEW_POSES: "an ellipsoid needs at least 9",
    AccelerometerStatus.POOR_COVERAGE: "turn the board to more sides",
    AccelerometerStatus.NOT_AN_ELLIPSOID: "the poses do not lie on an ellipsoid: keep the board still, without "
    "vibration",
}


def _take(board: Board, face: Face) -> int:
    """Store one face as a pose, if the board is on it and still; return the die's temperature [degC]."""
    reply = board.session.request(AddPose(READINGS, face))
    stored = reply.average.accelerometer
    after = board.session.request(Average(READINGS_AFTER)).accelerometer
    if not is_on_face(stored.mean, face):
        raise _MisplacedError(
            f"asked for {FACE_WORDS[face]}, and the board reads {_grams(stored.mean)}: "
            f"it lies {_face_name(stored.mean)}; put it on the requested face, or check the accelerometer's axes if "
            "it lies there",
            faces=[face],
        )
    moved = _movement(stored, after)
    if moved:
        raise FaceError(
            f"the board moved while it lay {FACE_WORDS[face]}: {moved}; leave it alone for a second",
            faces=[face],
        )
    return reply.die_temperature_degc


def _movement(stored: Statistic, after: Statistic) -> str:
    """Describe how the board moved, from the spread of its readings and the change of their mean."""
    spread_mg = math.inf if stored.spread is None else 1000.0 / COUNTS_PER_G * float(stored.spread.max())
    if not spread_mg <= MOVED_SPREAD_MG:
        return f"its readings spread by {spread_mg:.1f} mg rms, a still board's by 1.3"
    drift_mg = 1000.0 / COUNTS_PER_G * math.hypot(*(after.mean - stored.mean).tolist())
    return f"gravity changed by {drift_mg:.1f} mg within the second" if drift_mg > _DRIFT_MG else ""


def _refuse_contradiction(run: AccelerometerRun, uncertainty_deg: float) -> None:
    """Refuse faces that disagree by more than their declared error.

    Notes
    -----
    The mean of opposite faces has no gravity. A face misaligned by e leaves e/2 across it; with both misaligned by up
    to u, at most u.
    """
    middle_mg = 500.0 * (run.fit.gravity_g(run.counts[::2]) + run.fit.gravity_g(run.counts[1::2]))
    across_mg = np.linalg.norm(np.where(np.eye(3, dtype=bool), 0.0, middle_mg), axis=1)
    worst = int(np.argmax(across_mg))
    allowed_mg = 1000.0 * math.sin(math.radians(uncertainty_deg)) + _NOISE_MG
    if not across_mg[worst] <= allowed_mg:
        pair = FACES[2 * worst : 2 * worst + 2]
        askew_deg = math.degrees(2e-3 * float(across_mg[worst]))
        raise FaceError(
            f"the faces contradict each other: one of {_face_names(pair)} is askew by some {askew_deg:.1f} deg (midway "
            f"between them {across_mg[worst]:.1f} mg are left; faces within {uncertainty_deg:g} deg leave at most "
            f"{allowed_mg:.1f}); put the board flat on both",
            faces=[int(face) for face in pair],
        )


def _refuse_limits(run: AccelerometerRun, limits: Mapping[str, Limit], dip_deg: float) -> None:
    """Refuse faces whose misalignment alone may move a heading beyond its limit."""
    askew_deg = run.solution.faces_askew_deg
    lever = abs(math.tan(math.radians(dip_deg))) * axes_uncertainty_deg(askew_deg)
    for name, limit in limits.items():
        kind = identify(name).kind
        turned_deg = _TURNED_BY_AXES.get(kind.name, 0.0) * lever if kind is not None else 0.0
        if limit.max is not None and limit.max < turned_deg:
            raise FaceError(
                f"the faces were askew by {askew_deg:.2f} deg rms, too much for limits.{name} of {limit.max:g} deg: "
                f"what they leave of the accelerometer's axes turns it by up to {turned_deg:.2g} deg (99th percentile, "
                f"at a dip of {dip_deg:g} deg); align the board more precisely, for example in a block, or widen the "
                "limit",
                faces=[int(face) for face in FACES],
            )


def _face_name(counts: Reals) -> str:
    """Name the face that a board lies on, from its readings."""
    face = next((face for face in FACES if is_on_face(counts, face)), None)
    return "on none of the six faces" if face is None else FACE_WORDS[face]


def _grams(counts: Reals) -> str:
    return "(" + ", ".join(f"{count / COUNTS_PER_G:+.2f}" for count in counts.tolist()) + ") g"


def _face_names(faces: Sequence[Face]) -> str:
    return ", ".join(f"{FACE_WORDS[face]} ({face.label} down)" for face in faces)
