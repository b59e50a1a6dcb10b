"""Known angles of firmware that reports its heading by itself: at each pose hiltest waits until it has settled."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from hiltest.boards.board import Board
from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import FitStatus, MagnetometerFit
from hiltest.errors import LIKELY_CAUSE, NOT_CALIBRATED, CalibrationError, PoorCoverageError
from hiltest.interfaces.frames import FRAMES, Frame
from hiltest.interfaces.quantities import Moment, Observation, Quantity, values_of
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.orientation.angles import (
    Pose,
    circular_mean_deg,
    heading_error_deg,
    wrap_180,
)
from hiltest.procedures.conventions import other_frame, other_tilt, standing_still
from hiltest.procedures.coverage import sphere_coverage
from hiltest.procedures.hand_poses import STILL_WITHIN_S, PoseReader, Readings, moved
from hiltest.procedures.heading_statistics import HeadingSummary, summarise
from hiltest.procedures.known_angles import KnownAngles, Reals, take_known_angles
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.questions import Glance, attitude_by
from hiltest.procedures.reported_samples import (
    FEWEST_LINES,
    Lines,
    SampleFault,
    describe_samples,
    merge_faults,
)
from hiltest.procedures.settling import COUNTS_PER_G, Settled, wait_until_settled
from hiltest.procedures.turntables import Turntable
from hiltest.rig import COUNTS_PER_UT, Rig
from hiltest.text import format_count

# Pitch and roll [deg]: reported, and true.
_Tilt: TypeAlias = tuple[tuple[float, float], tuple[float, float]]

FIRMWARE = "firmware"
"""Source: the heading that the firmware reports, from its filter."""
ECOMPASS = "ecompass"
"""Source: a heading computed from the firmware's calibrated field and gravity, without its filter."""
CALIBRATED = "calibrated"
"""Source: a heading computed with the firmware's calibration from the raw field."""

#: Quantities that give gravity, the calibrated one first.
_GRAVITY = (Quantity.ACCELEROMETER_CALIBRATED, Quantity.ACCELEROMETER)
# Raw readings come first where motion is looked for: a calibration may change between two windows.
_FIELD_RAW_FIRST = (Quantity.MAGNETOMETER, Quantity.MAGNETOMETER_CALIBRATED)
_GRAVITY_RAW_FIRST = (Quantity.ACCELEROMETER, Quantity.ACCELEROMETER_CALIBRATED)
# Duration of one reading while a question waits [s]: three lines at ten per second.
_GLANCE_S = 0.3
# Change of heading between two readings on a table that turns at 3 degrees per second; the noise of three lines is 0.3.
_TURNED_DEG = 1.0
# Interval between checks of whether the firmware has calibrated itself [s].
_LOOK_S = 1.0
# Part of the sphere above which more tumbles bring no new directions.
_COVERS = 0.85


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

    attitude: Pose
    """Attitude of the board: the reached pose with the declared mounting."""
    settled: Settled
    field_ut: Reals | None
    gravity_g: Reals | None
    """Shape (3,), or None. Means of the firmware's calibrated vectors, in hiltest's axes."""
    reported_ut: Reals | None
    """Shape (3,), or None. Mean of the raw magnetometer as the firmware reports it, in hiltest's axes."""
    reported_g: Reals | None
    """Shape (3,), or None. Mean of the raw accelerometer as the firmware reports it, in hiltest's axes."""
    read_ut: Reals | None
    """Shape (3,), or None. Mean of the raw magnetometer; in a simulated world the noise-free reading if the firmware
    does not report it."""


@dataclass(frozen=True, slots=True, eq=False)
class ReportedAngles(KnownAngles):
    """Headings that the firmware reported at known angles: `FIRMWARE` and other sources."""

    held: tuple[HeldPose, ...]
    """Observations at each pose."""
    belief: Belief
    """Firmware's calibration at the end."""
    tilt_error_deg: float | None
    """Largest error of the firmware's pitch and roll; None if it does not report them, or in another frame than NED,
    whose pitch and roll are other angles."""
    contradictions: Mapping[str, str]
    """Descriptions of conventions under which values that are far off by the declared one are right, for ``vectors``
    and ``tilt``; and of a heading that stands ``still``."""

    def under(self, fit: MagnetometerFit) -> HeadingSummary | None:
        """Return the statistics of another calibration of the same readings; None if they are unknown."""
        headings = [_heading(pose.gravity_g, _corrected_field(pose, fit)) for pose in self.held]
        valid_headings = [heading for heading in headings if heading is not None]
        if len(valid_headings) < len(headings):
            return None
        errors = [heading_error_deg(*pair) for pair in zip(valid_headings, self.reference_deg.tolist(), strict=True)]
        return summarise(errors, self.reference_deg, level=self.level)

    def sample_error_ut(self) -> float | None:
        """Return the largest difference between the reported raw field and the samples that the sensor delivered [uT].

        It is that of the magnetometer with the smallest one; None if the board does not observe samples, or the
        firmware does not report its raw field.
        """
        return self._sample_error([(pose.reported_ut, pose.settled.delivered) for pose in self.held])

    def acceleration_error_g(self) -> float | None:
        """Return the same for the reported raw acceleration [g]."""
        return self._sample_error([(pose.reported_g, pose.settled.delivered_g) for pose in self.held])

    def _sample_error(
        self, pairs: Sequence[tuple[Reals | None, Mapping[str, tuple[int, Reals]] | None]]
    ) -> float | None:
        errors: dict[str, list[float]] = {}
        for reported, delivered in pairs:
            if delivered is None or reported is None:
                return None
            for part, (_, mean) in delivered.items():
                errors.setdefault(part, []).append(float(np.abs(reported - mean).max()))
        largest = [max(values) for values in errors.values() if len(values) == len(self.held)]
        return min(largest, default=None)

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
        """Number of headings that their neighbours contradict."""
        return sum(pose.settled.unconfirmed for pose in self.held)


@dataclass(frozen=True, slots=True, eq=False)
class SelfCalibration:
    """Result of the firmware's self-calibration in the tumbles."""

    duration_s: float
    """Duration of all tumbles."""
    calibrated_after_s: float | None
    """Time from the start of the first tumble until the firmware reported that it is calibrated; None if it never
    did."""
    refusal: CalibrationError | None = None
    """Reason why headings cannot be measured, with the next step; None if they can."""
    sample_faults: tuple[SampleFault, ...] = ()
    """Faults of the firmware's raw samples, which are looked for if it has not calibrated itself."""
    readings: Reals | None = None
    """Shape (n, 3) [counts]. Raw field that the firmware reported meanwhile, in hiltest's axes."""

    def field_rows(self) -> list[list[str | float]]:
        """Return minimum, maximum, and centre by a fit, of the raw field [uT]; empty if it is unknown or not fitted."""
        if self.readings is None or len(self.readings) < FEWEST_LINES:
            return []
        fit = fit_direct(self.readings)
        rows = {"minimum": self.readings.min(axis=0), "maximum": self.readings.max(axis=0), "centre": fit.hard_iron}
        return [[name, *(row / COUNTS_PER_UT).tolist()] for name, row in rows.items()] if fit.has_fit else []


def samples_of(board: Board) -> Reals:
    """Return the samples of the firmware's self-calibration, in hiltest's axes, shape (n, 3) [counts].

    If the rig names its buffer, these are its contents when the latest solution began; otherwise, the samples in its
    packets. Empty without either.
    """
    frame = frame_of(board.output.rig)
    if board.costs and (samples := board.costs.samples()) is not None:
        return np.array([frame.raw_field(counts) for counts in samples], dtype=np.float64).reshape(-1, 3)
    held = [counts for decoder in board.output.decoders.values() for counts in getattr(decoder, "buffer", {}).values()]
    return np.array([frame.raw_field(counts) for counts in held], dtype=np.float64).reshape(-1, 3)


def frame_of(rig: Rig) -> Frame:
    """Return the convention of the firmware's axes and angles, as the rig declares it."""
    assert rig.device is not None
    frame = replace(FRAMES[rig.device.frame], chip_to_body=rig.sensors.chip_to_body)
    return frame if rig.device.heading is None else replace(frame, clockwise=rig.device.heading == "clockwise")


def tumble_until_calibrated(board: Board, turntable: Turntable, *, progress: Progress | None = None) -> SelfCalibration:
    """Tumble the board as often as the rig says, then rest; the firmware calibrates itself."""
    output, tell = board.output, progress or silent
    device = output.device
    turntable.rest()
    board.sleep(device.converge_s)
    output.send(Moment.BEFORE_TUMBLE)
    began_s, after_s = board.now_s(), None
    heard: list[Observation] = []
    for _ in range(device.tumbles):
        end_s = board.now_s() + turntable.tumble(device.tumble_s)
        while (left_s := end_s - board.now_s()) > 1e-9:
            observations = output.observe(min(_LOOK_S, left_s), asks=False)
            heard += observations
            if after_s is None and is_calibrated(observations):
                after_s = board.now_s() - began_s
            tell("tumble [s]", round(board.now_s() - began_s), round(device.tumbles * device.tumble_s))
    duration_s = board.now_s() - began_s
    must_say = Quantity.CALIBRATED in board.offers
    faults = sample_faults(board, heard, is_moving=True) if after_s is None and must_say else None
    output.send(Moment.AFTER_TUMBLE)
    turntable.rest()
    observations = output.observe(max(device.converge_s - device.window_s, 0.0), asks=False)
    observations += output.observe(device.window_s)
    if after_s is None and is_calibrated(observations):
        after_s = board.now_s() - began_s
    raw_ut = [frame_of(output.rig).raw_field(value) for value in values_of(heard, Quantity.MAGNETOMETER)]
    readings = COUNTS_PER_UT * np.array(raw_ut).reshape(-1, 3)
    if after_s is not None or not must_say:
        return SelfCalibration(duration_s, after_s, readings=readings)
    refused = f"{NOT_CALIBRATED} in {format_count(device.tumbles, 'tumble')} of {device.tumble_s:g} s"
    if faults:
        return SelfCalibration(duration_s, None, CalibrationError(f"{refused}: its samples are wrong"), faults)
    covered = sphere_coverage(readings, field_ut=output.rig.field.strength_ut) if len(readings) else 0.0
    if faults is not None and covered >= _COVERS:
        cause = f"its fit, since its samples are right and cover {covered:.0%} of the sphere"
        advice = "Check when it accepts its fit"
        return SelfCalibration(duration_s, None, CalibrationError(f"{refused}{LIKELY_CAUSE}{cause}. {advice}."))
    advice = "Give it more under [device]: tumbles, tumble_s"
    return SelfCalibration(duration_s, None, PoorCoverageError(f"{refused}{LIKELY_CAUSE}too few directions. {advice}."))


def sample_faults(
    board: Board, observations: Sequence[Observation], *, is_moving: bool
) -> tuple[SampleFault, ...] | None:
    """Return the faults of the raw samples that firmware reported, the magnetometer's first; None if it reports none.

    Parameters
    ----------
    is_moving
        True if the board was turned through all directions meanwhile.
    """
    frame, delivered, faults = frame_of(board.output.rig), board.delivered_samples(), []
    for sensor, quantity, convert, unit in (
        ("magnetometer", Quantity.MAGNETOMETER, frame.raw_field, (COUNTS_PER_UT, "uT")),
        ("accelerometer", Quantity.ACCELEROMETER, frame.gravity, (COUNTS_PER_G, "g")),
    ):
        readings = [(row.time_s, convert(row.values[quantity])) for row in observations if quantity in row.values]
        if len(readings) < FEWEST_LINES:
            continue
        parts = None
        if delivered is not None:
            parts = [rows for part, rows in delivered.items() if part.endswith(" g") == (unit[1] == "g")]
        times_s, vectors = zip(*readings, strict=True)
        lines = Lines(np.array(times_s), unit[0] * np.array(vectors), parts)
        faults.append(describe_samples(sensor, unit, lines, is_moving=is_moving))
    return merge_faults(*faults) if faults else None


def is_calibrated(observations: Sequence[Observation]) -> bool:
    """Return whether the firmware reports that it is calibrated."""
    return any(float(value[0]) != 0.0 for value in values_of(observations, Quantity.CALIBRATED))


class ReportReader(PoseReader[Settled]):
    """Reads a board that reports its heading by itself, at known angles.

    Parameters
    ----------
    longest_s
        Longest wait for a heading; by default the rig's.
    """

    can_go_on = has_known_scale = False

    def __init__(self, board: Board, longest_s: float | None = None) -> None:
        super().__init__(board, _mounting_yaw_deg(board.output.rig))
        self._output, self._longest_s = board.output, longest_s
        self._frame = frame_of(board.output.rig)
        self._before: Sequence[Observation] = ()
        self.may_glance = board.output.may_be_overheard

    def read_ut(self, reading: Settled) -> Reals | None:
        """Return the mean of the reported raw magnetometer, shape (3,) [uT]; None if the firmware has none."""
        return _mean(reading, Quantity.MAGNETOMETER, np.asarray)

    def moved_between(self, before: Settled, after: Settled) -> str:
        """Describe how field or gravity differ between two readings; empty if they are equal within their noise."""
        return self._movement(before.window, after.window)

    def read(self, pose: Pose) -> Settled:
        """Wait until the heading of a board that stands has settled."""
        self._output.send(Moment.POSE)
        return wait_until_settled(self._board, self._frame, self._longest_s)

    def read_when_still(self, pose: Pose) -> tuple[Settled | None, str]:
        """Wait until the board stands still, and then until its heading has settled; or describe the motion.

        Field and gravity show whether it stands, if the firmware reports them. The heading cannot, because it is under
        test: if it drifts in a filter or never settles, that is a finding.
        """
        window_s, ends_s = self._output.device.window_s, self._board.now_s() + STILL_WITHIN_S
        before = self._output.observe(window_s)
        self.turn.add(*self._rates(before))
        while True:
            after = self._output.observe(window_s)
            self.turn.add(*self._rates(after))
            motion = self._movement(before, after)
            if not motion:
                settled = self.read(pose)
                motion = self._movement(after, settled.window)
                if not motion:
                    self.turn.stand(*self._rates(settled.window))
                    return settled, ""
                after = list(settled.window)
            if self._board.now_s() > ends_s:
                return None, motion
            before = after

    def glance(self) -> Glance:
        """Return the board's heading now, and whether it moves: by its vectors, or else by its heading."""
        before, self._before = self._before, self._output.observe(_GLANCE_S)
        self.turn.add(*self._rates(self._before))
        pair = self._headings(before), self._headings(self._before)
        heading_deg = circular_mean_deg(pair[1]) if pair[1] else None
        if min(_stillness(observations).n for observations in (before, self._before)):
            moves = bool(self._movement(before, self._before))
        else:
            moves = not all(pair)
            moves = moves or abs(wrap_180(circular_mean_deg(pair[1]) - circular_mean_deg(pair[0]))) > _TURNED_DEG
        gravity = _vectors(self._before, _GRAVITY)
        attitude = gravity is not None and attitude_by(self._frame.gravity(gravity.mean(axis=0)), heading_deg)
        return Glance(heading_deg, moves, attitude or None)

    def _rates(self, observations: Sequence[Observation]) -> tuple[Reals, Reals]:
        """Return times [s] and rates [deg/s] of the gyroscope, in hiltest's axes; empty if it is not reported."""
        quantity = Quantity.GYROSCOPE
        rows = [
            (row.time_s, self._frame.vector(row.values[quantity])) for row in observations if quantity in row.values
        ]
        return np.array([time_s for time_s, _ in rows]), np.array([rate for _, rate in rows]).reshape(-1, 3)

    def _movement(self, before: Sequence[Observation], after: Sequence[Observation]) -> str:
        """Describe how the board moved between two windows; empty if it stood, or the firmware reports no vectors.

        Notes
        -----
        The noise of the field is the declared one of one reading; firmware that averages has less. With 0.4 uT, ten
        readings per window and a horizontal field of 22.8 uT, a turn by 2 degrees between windows is detected.
        """
        pair = _stillness(before), _stillness(after)
        noise_ut = self._output.rig.sensors.magnetometer_noise_ut
        return moved(*pair, noise_ut) if min(readings.n for readings in pair) else ""

    def _headings(self, observations: Sequence[Observation]) -> list[float]:
        headings = values_of(observations, Quantity.HEADING)
        return [self._frame.heading_deg(float(value[0])) for value in headings]


def _stillness(observations: Sequence[Observation]) -> Readings:
    field, gravity = _vectors(observations, _FIELD_RAW_FIRST), _vectors(observations, _GRAVITY_RAW_FIRST)
    vectors = [vector for vector in (field, gravity) if vector is not None]
    spread_g = gravity.std(axis=0, ddof=1).max() if gravity is not None and len(gravity) > 1 else 0.0
    return Readings(
        min((len(vector) for vector in vectors), default=0),
        None if field is None else field.mean(axis=0),
        None if gravity is None else gravity.mean(axis=0),
        1000.0 * float(spread_g),
    )


def _vectors(observations: Sequence[Observation], quantities: Sequence[Quantity]) -> Reals | None:
    """Return the values of the first quantity that has any, shape (n, 3); None if none has."""
    for quantity in quantities:
        if values := values_of(observations, quantity):
            return np.array(values, dtype=np.float64)
    return None


def measure_reported_angles(
    board: Board,
    turntable: Turntable,
    poses: Sequence[Pose],
    *,
    longest_s: float | None = None,
    progress: Progress | None = None,
) -> ReportedAngles:
    """Turn the board to each pose, wait until its heading has settled, and compare it with the table's angle.

    Parameters
    ----------
    poses
        Poses of the table.
    longest_s
        Longest wait for a heading; by default the rig's.
    """
    rig = board.output.rig
    frame, yaw_deg = frame_of(rig), _mounting_yaw_deg(rig)
    taken = take_known_angles(ReportReader(board, longest_s), turntable, poses, progress=progress)
    readings = taken.readings
    held: list[HeldPose] = []
    for achieved, settled in readings.values():
        attitude = achieved.attitude(yaw_deg)
        held.append(
            HeldPose(
                attitude,
                settled,
                field_ut=_mean(settled, Quantity.MAGNETOMETER_CALIBRATED, frame.vector),
                gravity_g=_mean(settled, _gravity(board), frame.gravity),
                reported_ut=_mean(settled, Quantity.MAGNETOMETER, frame.raw_field),
                reported_g=_mean(settled, Quantity.ACCELEROMETER, frame.gravity),
                read_ut=_read_ut(board, settled, attitude, frame),
            )
        )
    belief = belief_of(board.output.latest, frame)
    headings = _headings_by_source(held, belief)
    tilts = _tilts(held, board)
    return ReportedAngles(
        poses=tuple(poses[index] for index in readings),
        attitudes=tuple(pose.attitude for pose in held),
        heading_deg={source: np.array(values) for source, values in headings.items()},
        skipped=tuple(pose for index, pose in enumerate(poses) if index not in readings),
        unset=taken.unset,
        decision="",
        estimates={},
        held=tuple(held),
        belief=belief,
        tilt_error_deg=max(
            (abs(wrap_180(a - b)) for reported, true in tilts for a, b in zip(reported, true, strict=True)),
            default=None,
        ),
        contradictions=_contradictions(held, headings[FIRMWARE], tilts, rig),
    )


def _mounting_yaw_deg(rig: Rig) -> float:
    return rig.mounting.yaw_deg if rig.mounting else 0.0


def _headings_by_source(held: Sequence[HeldPose], belief: Belief) -> dict[str, list[float]]:
    """Return the reported headings, and those computed from the firmware's vectors and calibration if it has them."""
    computed = {
        ECOMPASS: [_heading(pose.gravity_g, pose.field_ut) for pose in held],
        CALIBRATED: [_heading(pose.gravity_g, _corrected_field(pose, belief.fit)) for pose in held],
    }
    headings = {FIRMWARE: [pose.settled.heading_deg for pose in held]}
    for source, values in computed.items():
        if None not in values:
            headings[source] = [value for value in values if value is not None]
    return headings


def _contradictions(
    held: Sequence[HeldPose], answered_deg: list[float], tilts: Sequence[_Tilt], rig: Rig
) -> dict[str, str]:
    assert rig.device is not None
    reference_deg, frame = [pose.attitude.heading_deg for pose in held], frame_of(rig)
    vectors = [(pose.gravity_g, pose.field_ut) for pose in held]
    complete = [(gravity, field) for gravity, field in vectors if gravity is not None and field is not None]
    reasons = {
        "still": standing_still(answered_deg, reference_deg),
        "vectors": other_frame(complete, reference_deg, rig.device.frame, frame) if len(complete) == len(held) else "",
        "tilt": other_tilt(*zip(*tilts, strict=True)) if tilts else "",
    }
    return {name: reason for name, reason in reasons.items() if reason}


def _tilts(held: Sequence[HeldPose], board: Board) -> list[_Tilt]:
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
    angles = [float(value[0]) for value in values_of(settled.window, quantity)]
    return circular_mean_deg(angles) if angles else None


def _heading(gravity_g: Reals | None, field_ut: Reals | None) -> float | None:
    if gravity_g is None or field_ut is None:
        return None
    try:
        return tilt_heading(gravity_g, field_ut).heading_deg
    except DegenerateFieldError:
        return None


def _read_ut(board: Board, settled: Settled, attitude: Pose, frame: Frame) -> Reals | None:
    mean_ut = _mean(settled, Quantity.MAGNETOMETER, frame.raw_field)
    return board.truth.read_ut(attitude) if mean_ut is None and board.truth is not None else mean_ut


def _corrected_field(held: HeldPose, fit: MagnetometerFit | None) -> Reals | None:
    return None if fit is None or held.read_ut is None else fit.corrected(COUNTS_PER_UT * held.read_ut)


def _gravity(board: Board) -> Quantity:
    return next((quantity for quantity in _GRAVITY if quantity in board.offers), _GRAVITY[0])


def _mean(settled: Settled, quantity: Quantity, converted: Callable[[Reals], Reals]) -> Reals | None:
    vectors = values_of(settled.window, quantity)
    return converted(np.mean(vectors, axis=0)) if vectors else None


def belief_of(latest: Mapping[Quantity, Reals], frame: Frame) -> Belief:
    """Return the firmware's calibration from its latest values."""

    def number(quantity: Quantity) -> float | None:
        return float(latest[quantity][0]) if quantity in latest else None

    iron, inverse, bias = (
        latest.get(quantity) for quantity in (Quantity.HARD_IRON, Quantity.INVERSE_SOFT_IRON, Quantity.GYROSCOPE_BIAS)
    )
    return Belief(
        None if iron is None else frame.raw_field(iron),
        None if inverse is None else frame.soft_iron(inverse),
        None if bias is None else frame.vector(bias),
        number(Quantity.FIELD_STRENGTH),
        number(Quantity.DIP),
        number(Quantity.FIT_ERROR),
    )
