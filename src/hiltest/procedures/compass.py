"""The known-angle procedure with firmware that speaks its own language: turn it, wait, and hear where it points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import Pose, circular_mean_deg, heading_error_deg, wrap_180, wrap_360
from hiltest.boards.compass import CompassBoard
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.device.frames import FRAMES, Frame
from hiltest.device.quantities import Moment, Observation, Quantity
from hiltest.errors import PoorCoverageError
from hiltest.orientation import DegenerateFieldError, tilt_heading
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
# Pitch and roll [deg]: as said, and as they are.
_Tilt: TypeAlias = tuple[tuple[float, float], tuple[float, float]]

FIRMWARE = "firmware"
"""The heading that the firmware itself says, its filter and all."""
ECOMPASS = "ecompass"
"""A heading computed from the field and the gravity that the firmware has calibrated, without its filter."""
CALIBRATED = "calibrated"
"""A heading computed by the firmware's calibration from the field as the magnetometer reads it."""
UNCALIBRATED = "uncalibrated"

#: Which of two accelerometer quantities is gravity: the calibrated one where there is one.
_GRAVITY = (Quantity.ACCELEROMETER_CALIBRATED, Quantity.ACCELEROMETER)
# Between two looks at whether the firmware has calibrated itself [s].
_LOOK_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What the firmware believes of its magnetometer and gyroscope, in hiltest's axes; None where it does not say."""

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
        """Its magnetometer calibration; None without a hard iron. Without a soft iron that is the identity."""
        if self.hard_iron_ut is None:
            return None
        inverse = np.eye(3) if self.inverse_soft_iron is None else self.inverse_soft_iron
        return MagnetometerFit(FitStatus.ELLIPSOID, False, 0, inverse, COUNTS_PER_UT * self.hard_iron_ut)


@dataclass(frozen=True, slots=True, eq=False)
class HeldPose:
    """What was heard at one known angle."""

    pose: Pose
    attitude: Pose
    """As asked of the turntable; and of the board: what the table reached, with the declared mounting."""
    settled: Settled
    field_ut: Reals | None
    gravity_g: Reals | None
    """Shape (3,), or None. Means of what the firmware has calibrated, in hiltest's axes."""
    read_ut: Reals | None
    """Shape (3,), or None. Mean of what its magnetometer reads; in a simulated world what it would read without
    noise, where the firmware does not say it."""


@dataclass(frozen=True, slots=True, eq=False)
class CompassHeadings:
    """Headings at known angles, by where they come from."""

    held: tuple[HeldPose, ...]
    reference_deg: Reals
    """Shape (n,). Heading of the board at each."""
    heading_deg: Mapping[str, Reals]
    error_deg: Mapping[str, Reals]
    """Shape (n,). Heading, and heading minus reference in (-180, 180], by source: `FIRMWARE` and others."""
    belief: Belief
    """At the end."""
    tilt_error_deg: float | None
    """Largest error of the firmware's pitch and roll; None where it does not say them, or in another frame than
    NED, whose pitch and roll are other angles."""
    contradictions: Mapping[str, str]
    """Where what the firmware says is far off, and right by another convention than the declared one: that in
    words, of its ``heading``, ``vectors`` and ``tilt``; and that its heading is ``still``."""
    skipped: tuple[Pose, ...] = ()
    """Known angles that an operator has left out."""

    @property
    def not_measured(self) -> str:
        """Which known angles are missing, in words; empty where all were taken. A limit is of all of them."""
        return missing_in_words(self.skipped, len(self.held))

    @property
    def level(self) -> NDArray[np.bool_]:
        """Mask of the level poses, shape (n,)."""
        return np.array([each.pose.pitch_deg == 0.0 and each.pose.roll_deg == 0.0 for each in self.held])

    def under(self, fit: MagnetometerFit) -> HeadingSummary | None:
        """Return the statistics of another calibration of the same readings; None where they are unknown."""
        headings = [_heading(each.gravity_g, _corrected(each, fit)) for each in self.held]
        known = [heading for heading in headings if heading is not None]
        if len(known) < len(headings):
            return None
        errors = [heading_error_deg(*pair) for pair in zip(known, self.reference_deg.tolist(), strict=True)]
        return summarise(errors, self.reference_deg, level=self.level)

    def summary(self, source: str) -> HeadingSummary:
        """Return the statistics of one source."""
        return summarise(self.error_deg[source], self.reference_deg, level=self.level)

    def max_level_deg(self, source: str) -> float | None:
        """Return the largest error of a source over the level poses; None where none was taken."""
        level = self.level
        return summarise(self.error_deg[source][level], self.reference_deg[level]).max_deg if level.any() else None

    @property
    def settle_s(self) -> Reals:
        """How long each pose was waited for [s], shape (n,)."""
        return np.array([each.settled.took_s for each in self.held])

    @property
    def unsettled(self) -> int:
        """At how many poses the heading still moved when the time was over."""
        return sum(not each.settled.is_settled for each in self.held)

    @property
    def unconfirmed(self) -> int:
        """How many headings were left out, since their neighbours contradict them."""
        return sum(each.settled.unconfirmed for each in self.held)


@dataclass(frozen=True, slots=True)
class SelfCalibration:
    """How the firmware calibrated itself while the board was turned all round."""

    duration_s: float
    """All tumbles together."""
    calibrated_after_s: float | None
    """From the first tumble's beginning until the firmware said that it is calibrated; None when it never did, or
    does not say."""


def samples_of(board: CompassBoard) -> Reals:
    """Return the samples that the firmware has calibrated itself from, in hiltest's axes, shape (n, 3) [counts].

    Where the rig names its buffer, those that it held when its latest solution began; else those that its packets have
    shown. Empty where it says neither.
    """
    frame = frame_of(board.rig)
    if board.costs and (found := board.costs.samples()) is not None:
        return np.array([frame.vector(counts) for counts in found], dtype=np.float64).reshape(-1, 3)
    held = [counts for interface in board.interfaces.values() for counts in getattr(interface, "buffer", {}).values()]
    return np.array([frame.vector(counts) for counts in held], dtype=np.float64).reshape(-1, 3)


def frame_of(rig: Rig) -> Frame:
    """Return the convention of the firmware's axes and angles, as the rig declares it."""
    assert rig.device is not None
    frame = FRAMES[rig.device.frame]
    return frame if rig.device.heading is None else replace(frame, clockwise=rig.device.heading == "clockwise")


def tumble_until_calibrated(
    board: CompassBoard, turntable: Turntable, *, progress: Progress | None = None
) -> SelfCalibration:
    """Turn the board all round as often as the rig says, and lie still behind it; the firmware calibrates itself.

    Raises
    ------
    PoorCoverageError
        When the firmware says whether it is calibrated, and is not.
    """
    device, tell = board.device, progress or silent
    turntable.rest()
    board.sleep(device.converge_s)
    board.send(Moment.BEFORE_TUMBLE)
    began_s, after_s = board.now_s(), None
    for _ in range(device.tumbles):
        end_s = board.now_s() + turntable.tumble(device.tumble_s)
        while (left_s := end_s - board.now_s()) > 1e-9:
            said = board.observe(min(_LOOK_S, left_s))
            if after_s is None and is_calibrated(said):
                after_s = board.now_s() - began_s
            tell("tumble [s]", round(board.now_s() - began_s), round(device.tumbles * device.tumble_s))
    duration_s = board.now_s() - began_s
    board.send(Moment.AFTER_TUMBLE)
    turntable.rest()
    said = board.observe(max(device.converge_s, device.window_s))
    if after_s is None and is_calibrated(said):
        after_s = board.now_s() - began_s
    if after_s is None and Quantity.CALIBRATED in board.offers:
        raise PoorCoverageError(
            f"the firmware has not calibrated its magnetometer in {format_count(device.tumbles, 'tumble')} of "
            f"{device.tumble_s:g} s; "
            "give it more under [device]: tumbles, tumble_s"
        )
    return SelfCalibration(duration_s, after_s)


def is_calibrated(said: Sequence[Observation]) -> bool:
    """Say whether the firmware says that it is calibrated."""
    return any(float(each.values[Quantity.CALIBRATED][0]) != 0.0 for each in said if Quantity.CALIBRATED in each.values)


def measure_headings(
    board: CompassBoard, turntable: Turntable, poses: Sequence[Pose], *, longest_s: float | None = None,
    progress: Progress | None = None,
) -> CompassHeadings:
    """Turn the board to each pose, wait until its heading has settled, and compare it with the table's angle.

    An operator is asked as `hold_by_hand` has it.

    Parameters
    ----------
    poses
        Of the table.
    longest_s
        Longest that a heading is waited for; by default the rig's.
    """
    frame, tell = frame_of(board.rig), progress or silent
    yaw_deg = board.rig.mounting.yaw_deg if board.rig.mounting else 0.0
    held: dict[int, HeldPose] = {}

    def hold(index: int, there: Achieved, settled: Settled) -> None:
        attitude = Pose(wrap_360(there.heading_deg + yaw_deg), there.pitch_deg, there.roll_deg)
        held[index] = HeldPose(
            poses[index], attitude, settled, field_ut=_mean(settled, Quantity.MAGNETOMETER_CALIBRATED, frame.vector),
            gravity_g=_mean(settled, _gravity(board), frame.gravity),
            read_ut=_read_ut(board, settled, attitude, frame),
        )  # fmt: skip

    if isinstance(turntable, OperatorTurntable):
        hold_by_hand(board, turntable, poses, frame, hold, longest_s=longest_s)
    else:
        for index, pose in enumerate(poses):
            there = turntable.turn_to(pose, known_angle=index)
            board.send(Moment.POSE)
            hold(index, there, wait_until_settled(board, frame, longest_s))
            tell("known angles", index + 1, len(poses))
    skipped = tuple(pose for index, pose in enumerate(poses) if index not in held)
    found = _headings(tuple(held[index] for index in sorted(held)), belief_of(board.latest, frame), board)
    return replace(found, skipped=skipped)


def _headings(held: tuple[HeldPose, ...], belief: Belief, board: CompassBoard) -> CompassHeadings:
    reference_deg = np.array([each.attitude.heading_deg for each in held])
    answered = {FIRMWARE: [each.settled.heading_deg for each in held]}
    own = [_heading(each.gravity_g, each.field_ut) for each in held]
    if None not in own:
        answered[ECOMPASS] = [each for each in own if each is not None]
    applied = [_heading(each.gravity_g, _corrected(each, belief.fit)) for each in held]
    if None not in applied:
        answered[CALIBRATED] = [each for each in applied if each is not None]
    error_deg = {
        source: np.array([heading_error_deg(*pair) for pair in zip(headings, reference_deg.tolist(), strict=True)])
        for source, headings in answered.items()
    }
    tilts = _tilts(held, board)
    errors = [abs(wrap_180(a - b)) for said, known in tilts for a, b in zip(said, known, strict=True)]
    return CompassHeadings(
        held, reference_deg, {source: np.array(each) for source, each in answered.items()}, error_deg, belief,
        max(errors, default=None), _contradictions(held, answered[FIRMWARE], tilts, board.rig),
    )


def _contradictions(
    held: tuple[HeldPose, ...], answered_deg: list[float], tilts: Sequence[_Tilt], rig: Rig
) -> dict[str, str]:
    assert rig.device is not None
    reference_deg, frame = [each.attitude.heading_deg for each in held], frame_of(rig)
    vectors = [(each.gravity_g, each.field_ut) for each in held]
    known = [(gravity, field) for gravity, field in vectors if gravity is not None and field is not None]
    found = {
        "heading": other_way(answered_deg, reference_deg, frame),
        "still": standing_still(answered_deg, reference_deg),
        "vectors": other_frame(known, reference_deg, rig.device.frame, frame) if len(known) == len(held) else "",
        "tilt": other_tilt(*zip(*tilts, strict=True)) if tilts else "",
    }
    return {name: said for name, said in found.items() if said}


def _tilts(held: tuple[HeldPose, ...], board: CompassBoard) -> list[_Tilt]:
    """Return pitch and roll at each pose that has them, as the firmware says them and as they are."""
    if board.device.frame != "ned":
        return []
    said = [(_angle(each.settled, Quantity.PITCH), _angle(each.settled, Quantity.ROLL)) for each in held]
    return [
        ((pitch, roll), (each.attitude.pitch_deg, each.attitude.roll_deg))
        for (pitch, roll), each in zip(said, held, strict=True) if pitch is not None and roll is not None
    ]


def _angle(settled: Settled, quantity: Quantity) -> float | None:
    """Return the mean of an angle over the last window."""
    angles = [float(each.values[quantity][0]) for each in settled.window if quantity in each.values]
    return circular_mean_deg(angles) if angles else None


def _heading(gravity_g: Reals | None, field_ut: Reals | None) -> float | None:
    if gravity_g is None or field_ut is None:
        return None
    try:
        return tilt_heading(gravity_g, field_ut).heading_deg
    except DegenerateFieldError:
        return None


def _read_ut(board: CompassBoard, settled: Settled, attitude: Pose, frame: Frame) -> Reals | None:
    said = _mean(settled, Quantity.MAGNETOMETER, frame.vector)
    return board.truth.read_ut(attitude) if said is None and board.truth is not None else said


def _corrected(held: HeldPose, fit: MagnetometerFit | None) -> Reals | None:
    return None if fit is None or held.read_ut is None else fit.corrected(COUNTS_PER_UT * held.read_ut)


def _gravity(board: CompassBoard) -> Quantity:
    return next((each for each in _GRAVITY if each in board.offers), _GRAVITY[0])


def _mean(settled: Settled, quantity: Quantity, converted: Callable[[Reals], Reals]) -> Reals | None:
    vectors = [each.values[quantity] for each in settled.window if quantity in each.values]
    return converted(np.mean(vectors, axis=0)) if vectors else None


def belief_of(latest: Mapping[Quantity, Reals], frame: Frame) -> Belief:
    """Return what the firmware believes, from what it said last."""
    def number(quantity: Quantity) -> float | None:
        return float(latest[quantity][0]) if quantity in latest else None

    def vector(quantity: Quantity) -> Reals | None:
        return frame.vector(latest[quantity]) if quantity in latest else None

    inverse = latest.get(Quantity.INVERSE_SOFT_IRON)
    return Belief(
        vector(Quantity.HARD_IRON), None if inverse is None else frame.matrix(inverse),
        vector(Quantity.GYROSCOPE_BIAS), number(Quantity.FIELD_STRENGTH), number(Quantity.DIP),
        number(Quantity.FIT_ERROR),
    )
