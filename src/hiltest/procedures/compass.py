"""The known-angle procedure for firmware with its own protocol: turn, wait, and read the heading."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.errors import PoorCoverageError
from hiltest.interfaces.frames import FRAMES, Frame
from hiltest.interfaces.quantities import Moment, Observation, Quantity
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.orientation.angles import Pose, circular_mean_deg, heading_error_deg, wrap_180, wrap_360
from hiltest.procedures.compass_by_hand import hold_by_hand
from hiltest.procedures.conventions import other_frame, other_tilt, other_way, standing_still
from hiltest.procedures.hand_poses import missing_in_words
from hiltest.procedures.heading_statistics import HeadingSummary, summarise
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.settling import Settled, wait_until_settled
from hiltest.procedures.turntables import Achieved, OperatorTurntable, Turntable
from hiltest.rig import COUNTS_PER_UT, Rig
from hiltest.text import format_count

Reals = NDArray[np.float64]
# Pitch and roll [deg]: reported, and true.
_Tilt: TypeAlias = tuple[tuple[float, float], tuple[float, float]]

FIRMWARE = "firmware"
"""Source: the heading that the firmware reports, from its filter."""
ECOMPASS = "ecompass"
"""Source: a heading computed from the firmware's calibrated field and gravity, without its filter."""
CALIBRATED = "calibrated"
"""Source: a heading computed with the firmware's calibration from the raw field."""
UNCALIBRATED = "uncalibrated"

#: Quantities that give gravity, the calibrated one first.
_GRAVITY = (Quantity.ACCELEROMETER_CALIBRATED, Quantity.ACCELEROMETER)
# Interval between checks of whether the firmware has calibrated itself [s].
_LOOK_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """The firmware's calibration of magnetometer and gyroscope, in hiltest's axes; None for missing values."""

    hard_iron_ut: Reals | None = None
    """Shape (3,)."""
    inverse_soft_iron: Reals | None = None
    """Shape (3, 3). calibrated = inverse_soft_iron @ (read - hard_iron)"""
    gyroscope_bias_dps: Reals | None = None
    """Shape (3,)."""
    field_strength_ut: float | None = None
    dip_deg: float | None = None
    fit_error_percent: float | None = None

    @property
    def fit(self) -> MagnetometerFit | None:
        """Its magnetometer calibration; None without a hard iron. A missing soft iron is the identity."""
        if self.hard_iron_ut is None:
            return None
        inverse = np.eye(3) if self.inverse_soft_iron is None else self.inverse_soft_iron
        return MagnetometerFit(FitStatus.ELLIPSOID, False, 0, inverse, COUNTS_PER_UT * self.hard_iron_ut)


@dataclass(frozen=True, slots=True, eq=False)
class HeldPose:
    """Observations at one known angle."""

    pose: Pose
    attitude: Pose
    """Requested pose of the table; and attitude of the board: the reached pose with the declared mounting."""
    settled: Settled
    field_ut: Reals | None
    gravity_g: Reals | None
    """Shape (3,), or None. Means of the firmware's calibrated vectors, in hiltest's axes."""
    read_ut: Reals | None
    """Shape (3,), or None. Mean of the raw magnetometer; in a simulated world the noise-free reading if the firmware
    does not report it."""


@dataclass(frozen=True, slots=True, eq=False)
class CompassHeadings:
    """Headings at known angles, by source."""

    held: tuple[HeldPose, ...]
    reference_deg: Reals
    """Shape (n,). Heading of the board at each pose."""
    heading_deg: Mapping[str, Reals]
    error_deg: Mapping[str, Reals]
    """Shape (n,). Heading, and heading minus reference in (-180, 180], by source: `FIRMWARE` and others."""
    belief: Belief
    """Firmware's calibration at the end."""
    tilt_error_deg: float | None
    """Largest error of the firmware's pitch and roll; None if it does not report them, or in another frame than NED,
    whose pitch and roll are other angles."""
    contradictions: Mapping[str, str]
    """Descriptions of conventions under which values that are far off by the declared one are right, for ``heading``,
    ``vectors`` and ``tilt``; and of a heading that stands ``still``."""
    skipped: tuple[Pose, ...] = ()
    """Known angles that an operator skipped."""

    @property
    def not_measured(self) -> str:
        """Missing known angles, in words; empty without any. A limit applies to the complete set."""
        return missing_in_words(self.skipped, len(self.held))

    @property
    def level(self) -> NDArray[np.bool_]:
        """Mask of the level poses, shape (n,)."""
        return np.array([pose.pose.pitch_deg == 0.0 and pose.pose.roll_deg == 0.0 for pose in self.held])

    def under(self, fit: MagnetometerFit) -> HeadingSummary | None:
        """Return the statistics of another calibration of the same readings; None if they are unknown."""
        headings = [_heading(pose.gravity_g, _corrected_field(pose, fit)) for pose in self.held]
        valid_headings = [heading for heading in headings if heading is not None]
        if len(valid_headings) < len(headings):
            return None
        errors = [heading_error_deg(*pair) for pair in zip(valid_headings, self.reference_deg.tolist(), strict=True)]
        return summarise(errors, self.reference_deg, level=self.level)

    def summary(self, source: str) -> HeadingSummary:
        """Return the statistics of one source."""
        return summarise(self.error_deg[source], self.reference_deg, level=self.level)

    def max_level_deg(self, source: str) -> float | None:
        """Return the largest error of a source over the level poses; None if none was taken."""
        level = self.level
        return summarise(self.error_deg[source][level], self.reference_deg[level]).max_deg if level.any() else None

    @property
    def settle_s(self) -> Reals:
        """Wait at each pose [s], shape (n,)."""
        return np.array([pose.settled.took_s for pose in self.held])

    @property
    def unsettled(self) -> int:
        """Number of poses at which the heading still moved at the timeout."""
        return sum(not pose.settled.is_settled for pose in self.held)

    @property
    def unconfirmed(self) -> int:
        """Number of headings that were dropped because their neighbours contradict them."""
        return sum(pose.settled.unconfirmed for pose in self.held)


@dataclass(frozen=True, slots=True)
class SelfCalibration:
    """Result of the firmware's self-calibration in the tumbles."""

    duration_s: float
    """Duration of all tumbles."""
    calibrated_after_s: float | None
    """Time from the start of the first tumble until the firmware reported that it is calibrated; None if it never
    did."""


def samples_of(board: Board) -> Reals:
    """Return the samples of the firmware's self-calibration, in hiltest's axes, shape (n, 3) [counts].

    If the rig names its buffer, these are its contents when the latest solution began; otherwise, the samples in its
    packets. Empty without either.
    """
    frame = frame_of(board.output.rig)
    if board.costs and (samples := board.costs.samples()) is not None:
        return np.array([frame.vector(counts) for counts in samples], dtype=np.float64).reshape(-1, 3)
    held = [counts for decoder in board.output.decoders.values() for counts in getattr(decoder, "buffer", {}).values()]
    return np.array([frame.vector(counts) for counts in held], dtype=np.float64).reshape(-1, 3)


def frame_of(rig: Rig) -> Frame:
    """Return the convention of the firmware's axes and angles, as the rig declares it."""
    assert rig.device is not None
    frame = FRAMES[rig.device.frame]
    return frame if rig.device.heading is None else replace(frame, clockwise=rig.device.heading == "clockwise")


def tumble_until_calibrated(board: Board, turntable: Turntable, *, progress: Progress | None = None) -> SelfCalibration:
    """Tumble the board as often as the rig says, then rest; the firmware calibrates itself.

    Raises
    ------
    PoorCoverageError
        When the firmware reports that it is not calibrated.
    """
    output, tell = board.output, progress or silent
    device = output.device
    turntable.rest()
    board.sleep(device.converge_s)
    output.send(Moment.BEFORE_TUMBLE)
    began_s, after_s = board.now_s(), None
    for _ in range(device.tumbles):
        end_s = board.now_s() + turntable.tumble(device.tumble_s)
        while (left_s := end_s - board.now_s()) > 1e-9:
            observations = output.observe(min(_LOOK_S, left_s))
            if after_s is None and is_calibrated(observations):
                after_s = board.now_s() - began_s
            tell("tumble [s]", round(board.now_s() - began_s), round(device.tumbles * device.tumble_s))
    duration_s = board.now_s() - began_s
    output.send(Moment.AFTER_TUMBLE)
    turntable.rest()
    observations = output.observe(max(device.converge_s, device.window_s))
    if after_s is None and is_calibrated(observations):
        after_s = board.now_s() - began_s
    if after_s is None and Quantity.CALIBRATED in board.offers:
        raise PoorCoverageError(
            f"the firmware has not calibrated its magnetometer in {format_count(device.tumbles, 'tumble')} of "
            f"{device.tumble_s:g} s; "
            "give it more under [device]: tumbles, tumble_s"
        )
    return SelfCalibration(duration_s, after_s)


def is_calibrated(observations: Sequence[Observation]) -> bool:
    """Return whether the firmware reports that it is calibrated."""
    return any(
        float(observation.values[Quantity.CALIBRATED][0]) != 0.0
        for observation in observations
        if Quantity.CALIBRATED in observation.values
    )


def measure_headings(
    board: Board,
    turntable: Turntable,
    poses: Sequence[Pose],
    *,
    longest_s: float | None = None,
    progress: Progress | None = None,
) -> CompassHeadings:
    """Turn the board to each pose, wait until its heading has settled, and compare it with the table's angle.

    For a table that an operator turns, see `hold_by_hand`.

    Parameters
    ----------
    poses
        Poses of the table.
    longest_s
        Longest wait for a heading; by default the rig's.
    """
    rig, tell = board.output.rig, progress or silent
    frame, yaw_deg = frame_of(rig), rig.mounting.yaw_deg if rig.mounting else 0.0
    held: dict[int, HeldPose] = {}

    def hold(index: int, achieved: Achieved, settled: Settled) -> None:
        attitude = Pose(wrap_360(achieved.heading_deg + yaw_deg), achieved.pitch_deg, achieved.roll_deg)
        held[index] = HeldPose(
            poses[index],
            attitude,
            settled,
            field_ut=_mean(settled, Quantity.MAGNETOMETER_CALIBRATED, frame.vector),
            gravity_g=_mean(settled, _gravity(board), frame.gravity),
            read_ut=_read_ut(board, settled, attitude, frame),
        )

    if isinstance(turntable, OperatorTurntable):
        hold_by_hand(board, turntable, poses, frame, hold, longest_s=longest_s)
    else:
        for index, pose in enumerate(poses):
            achieved = turntable.turn_to(pose, known_angle=index)
            board.output.send(Moment.POSE)
            hold(index, achieved, wait_until_settled(board, frame, longest_s))
            tell("known angles", index + 1, len(poses))
    skipped = tuple(pose for index, pose in enumerate(poses) if index not in held)
    headings = _headings(tuple(held[index] for index in sorted(held)), belief_of(board.output.latest, frame), board)
    return replace(headings, skipped=skipped)


def _headings(held: tuple[HeldPose, ...], belief: Belief, board: Board) -> CompassHeadings:
    reference_deg = np.array([pose.attitude.heading_deg for pose in held])
    answered = {FIRMWARE: [pose.settled.heading_deg for pose in held]}
    own = [_heading(pose.gravity_g, pose.field_ut) for pose in held]
    if None not in own:
        answered[ECOMPASS] = [heading_deg for heading_deg in own if heading_deg is not None]
    applied = [_heading(pose.gravity_g, _corrected_field(pose, belief.fit)) for pose in held]
    if None not in applied:
        answered[CALIBRATED] = [heading_deg for heading_deg in applied if heading_deg is not None]
    error_deg = {
        source: np.array([heading_error_deg(*pair) for pair in zip(headings, reference_deg.tolist(), strict=True)])
        for source, headings in answered.items()
    }
    tilts = _tilts(held, board)
    errors = [
        abs(wrap_180(a - b))
        for answered_tilt, true_tilt in tilts
        for a, b in zip(answered_tilt, true_tilt, strict=True)
    ]
    return CompassHeadings(
        held,
        reference_deg,
        {source: np.array(values) for source, values in answered.items()},
        error_deg,
        belief,
        max(errors, default=None),
        _contradictions(held, answered[FIRMWARE], tilts, board.output.rig),
    )


def _contradictions(
    held: tuple[HeldPose, ...], answered_deg: list[float], tilts: Sequence[_Tilt], rig: Rig
) -> dict[str, str]:
    assert rig.device is not None
    reference_deg, frame = [pose.attitude.heading_deg for pose in held], frame_of(rig)
    vectors = [(pose.gravity_g, pose.field_ut) for pose in held]
    complete = [(gravity, field) for gravity, field in vectors if gravity is not None and field is not None]
    reasons = {
        "heading": other_way(answered_deg, reference_deg, frame),
        "still": standing_still(answered_deg, reference_deg),
        "vectors": other_frame(complete, reference_deg, rig.device.frame, frame) if len(complete) == len(held) else "",
        "tilt": other_tilt(*zip(*tilts, strict=True)) if tilts else "",
    }
    return {name: reason for name, reason in reasons.items() if reason}


def _tilts(held: tuple[HeldPose, ...], board: Board) -> list[_Tilt]:
    """Return reported and true pitch and roll at each pose that has them."""
    if board.output.device.frame != "ned":
        return []
    angles = [(_angle(pose.settled, Quantity.PITCH), _angle(pose.settled, Quantity.ROLL)) for pose in held]
    return [
        ((pitch, roll), (pose.attitude.pitch_deg, pose.attitude.roll_deg))
        for (pitch, roll), pose in zip(angles, held, strict=True)
        if pitch is not None and roll is not None
    ]


def _angle(settled: Settled, quantity: Quantity) -> float | None:
    """Return the mean of an angle over the last window."""
    angles = [
        float(observation.values[quantity][0]) for observation in settled.window if quantity in observation.values
    ]
    return circular_mean_deg(angles) if angles else None


def _heading(gravity_g: Reals | None, field_ut: Reals | None) -> float | None:
    if gravity_g is None or field_ut is None:
        return None
    try:
        return tilt_heading(gravity_g, field_ut).heading_deg
    except DegenerateFieldError:
        return None


def _read_ut(board: Board, settled: Settled, attitude: Pose, frame: Frame) -> Reals | None:
    mean_ut = _mean(settled, Quantity.MAGNETOMETER, frame.vector)
    return board.truth.read_ut(attitude) if mean_ut is None and board.truth is not None else mean_ut


def _corrected_field(held: HeldPose, fit: MagnetometerFit | None) -> Reals | None:
    return None if fit is None or held.read_ut is None else fit.corrected(COUNTS_PER_UT * held.read_ut)


def _gravity(board: Board) -> Quantity:
    return next((quantity for quantity in _GRAVITY if quantity in board.offers), _GRAVITY[0])


def _mean(settled: Settled, quantity: Quantity, converted: Callable[[Reals], Reals]) -> Reals | None:
    vectors = [observation.values[quantity] for observation in settled.window if quantity in observation.values]
    return converted(np.mean(vectors, axis=0)) if vectors else None


def belief_of(latest: Mapping[Quantity, Reals], frame: Frame) -> Belief:
    """Return the firmware's calibration from its latest values."""

    def number(quantity: Quantity) -> float | None:
        return float(latest[quantity][0]) if quantity in latest else None

    def vector(quantity: Quantity) -> Reals | None:
        return frame.vector(latest[quantity]) if quantity in latest else None

    inverse = latest.get(Quantity.INVERSE_SOFT_IRON)
    return Belief(
        vector(Quantity.HARD_IRON),
        None if inverse is None else frame.matrix(inverse),
        vector(Quantity.GYROSCOPE_BIAS),
        number(Quantity.FIELD_STRENGTH),
        number(Quantity.DIP),
        number(Quantity.FIT_ERROR),
    )
