"""Known angles of firmware that answers requests: the mean of new samples and a heading per calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hiltest.boards.board import Board
from hiltest.calibration.accelerometer import NOMINAL, AccelerometerFit
from hiltest.errors import LIKELY_CAUSE, DeviceError, FirmwareContradictionError, SensorAbsentError
from hiltest.link.accelerometer import GetAccelerometer
from hiltest.link.gyroscope import LogGyroscope
from hiltest.link.messages import Average, GetCalibration
from hiltest.link.replies import (
    DPS_PER_COUNT,
    G_PER_COUNT,
    MICROTESLA_PER_COUNT,
    SAMPLE_RATE_HZ,
    AverageReply,
    CalibrationReply,
    SensorKind,
    SlotHeading,
)
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.orientation.angles import Pose, heading_error_deg, wrap_180
from hiltest.orientation.heading_models import Poses, Stage, fit_causes
from hiltest.procedures.calibrate import UNCALIBRATED
from hiltest.procedures.fewest_poses import FewestPoses
from hiltest.procedures.hand_poses import (
    STILL_WITHIN_S,
    PoseJournal,
    PoseReader,
    Readings,
    StoredPoses,
    TakenAngles,
    moved,
    place_of,
)
from hiltest.procedures.heading_statistics import rms
from hiltest.procedures.known_angles import KnownAngles, Reals, take_known_angles
from hiltest.procedures.progress import Progress
from hiltest.procedures.questions import Glance, attitude_by
from hiltest.procedures.turntables import Achieved, Turntable

LARGEST_ROUNDING_DEG = 0.002
"""A heading in float32 is within 3e-5 degrees of float64; a difference of eighty times that means another
computation."""
# Interval between two compared averages [s], at which a hand that turns the table at 3 degrees per second is detected.
_APART_S = 0.3
# Readings per display update while a question waits: a tenth of a second.
_LIVE_READINGS = 8


@dataclass(frozen=True, slots=True, eq=False)
class RequestedAngles(KnownAngles):
    """Headings that the board answered at known angles, per calibration."""

    pitch_deg: dict[str, Reals]
    roll_deg: dict[str, Reals]
    """Shape (n,). Pitch and roll from the board, per calibration with its accelerometer calibration."""
    tilt_error_deg: dict[str, Reals]
    """Shape (n, 2). Answered pitch and roll minus the turntable's, in (-180, 180]."""
    magnetometer: Reals
    accelerometer: Reals
    """Shape (n, 3). Means of the board at each pose [counts], from which its headings are computed."""
    accelerometer_fits: dict[str, AccelerometerFit]
    """Accelerometer calibration in the slot of each calibration."""
    calibrations: dict[str, CalibrationReply]
    """Magnetometer calibrations on the board."""
    readings: int
    """Readings of each mean."""
    magnetometer_sigma_counts: float | None
    """rms noise of one axis of one reading, from the spreads at all poses; None if each mean is of one reading."""

    def accelerometer_norm_rms_mg(self, name: str) -> float:
        """Return the deviation of gravity under a calibration from 1 g, rms over the poses [mg]."""
        return self.norm_rms_mg(self.accelerometer_fits[name])

    def norm_rms_mg(self, fit: AccelerometerFit) -> float:
        """Return the deviation of gravity from 1 g under any accelerometer calibration, rms over the poses [mg]."""
        gravity_g = fit.gravity_g(self.accelerometer)
        # hypot is not correctly rounded on all platforms; run.json keeps 9 digits of it.
        return rms([1000.0 * (math.hypot(*vector) - 1.0) for vector in gravity_g.tolist()])

    def max_tilt_error_deg(self, name: str) -> float:
        """Return the largest error of pitch or roll over the poses [deg], which depends on the accelerometer only."""
        return float(np.abs(self.tilt_error_deg[name]).max())


class RequestReader(PoseReader[AverageReply]):
    """Reads a board that answers requests, at known angles.

    Parameters
    ----------
    slots
        Slots of the calibrations, by name.
    readings
        New samples of each sensor to average at each pose.
    mounting_yaw_deg
        Declared turn of the board on the table.
    """

    can_go_on = may_glance = has_known_scale = True

    def __init__(self, board: Board, slots: Mapping[str, int], readings: int, mounting_yaw_deg: float) -> None:
        super().__init__(board, mounting_yaw_deg)
        self._slots, self._readings = slots, readings
        self._mask = sum(1 << slot for slot in slots.values())
        calibrated = (slot for name, slot in slots.items() if name != UNCALIBRATED)
        self._shown = next(calibrated, next(iter(slots.values()), None))
        self._before: AverageReply | None = None
        self._follows = True

    def read_ut(self, reading: AverageReply) -> Reals:
        """Return the mean of the raw magnetometer, shape (3,) [uT]."""
        return MICROTESLA_PER_COUNT * reading.magnetometer.mean

    def moved_between(self, before: AverageReply, after: AverageReply) -> str:
        """Describe how field or gravity differ between two readings; empty if they are equal within their noise."""
        return movement(before, after, self._board.declared.magnetometer_sigma_ut)

    def read(self, pose: Pose) -> AverageReply:
        """Return the means and headings of a board that stands.

        Raises
        ------
        DeviceError
            When the board refuses a heading; the message names the pose.
        """
        reply = self._board.session.request(Average(self._readings, self._mask))
        self._check(pose, reply)
        return reply

    def read_when_still(self, pose: Pose) -> tuple[AverageReply | None, str]:
        """Average until two consecutive averages agree; return the last one, or None and the motion."""
        board = self._board
        ends_s = board.now_s() + STILL_WITHIN_S
        before = board.session.request(Average(self._readings, self._mask))
        while True:
            times_s, rates_dps = self._rates(math.ceil(_APART_S * SAMPLE_RATE_HZ))
            self.turn.add(times_s, rates_dps)
            if not len(times_s):
                board.sleep(_APART_S)
            reply = board.session.request(Average(self._readings, self._mask))
            motion = movement(before, reply, board.declared.magnetometer_sigma_ut)
            if not motion:
                self.turn.stand(times_s, rates_dps)
                self._check(pose, reply)
                return reply, ""
            if board.now_s() > ends_s:
                return None, motion
            before = reply

    def glance(self) -> Glance:
        """Return the board now: its heading under the first calibration, its attitude, and whether it moves."""
        self.turn.add(*self._rates())
        reply = self._board.session.request(Average(_LIVE_READINGS, 0 if self._shown is None else 1 << self._shown))
        self.turn.add(*self._rates())
        sigma_ut = self._board.declared.magnetometer_sigma_ut
        moves = self._before is None or movement(self._before, reply, sigma_ut)
        self._before = reply
        attitude = None if self._shown is None else reply.headings[self._shown].attitude
        noise = [
            f"{unit * float(sensor.spread.max()):.1f} {name}"
            for sensor, unit, name in (
                (reply.magnetometer, MICROTESLA_PER_COUNT, "uT"),
                (reply.accelerometer, 1000.0 * G_PER_COUNT, "mg"),
            )
            if sensor.spread is not None
        ]
        return Glance(
            attitude.heading_deg if attitude else None,
            bool(moves),
            attitude or attitude_by(reply.accelerometer.mean.tolist(), None),
            ", ".join(noise),
        )

    def _rates(self, samples: int = 0) -> tuple[Reals, Reals]:
        """Return times [s] and rates [deg/s] of the gyroscope's next samples, by default of all that wait.

        They are empty without a gyroscope.
        """
        if self._follows:
            try:
                self._board.sensor(SensorKind.GYROSCOPE)
                reply = self._board.session.request(LogGyroscope(samples, go_on=True))
                ages_s = np.arange(len(reply.samples))[::-1] / SAMPLE_RATE_HZ
                return reply.span.last_s - ages_s, np.array(DPS_PER_COUNT * reply.samples, dtype=np.float64)
            except (DeviceError, SensorAbsentError):
                self._follows = False  # the turn is a help for the operator, and no result
        return np.empty(0), np.empty((0, 3))

    def stored_poses(self, journal: PoseJournal) -> StoredPoses[AverageReply]:
        """Return the poses of a journal that were captured under the present calibrations, with all their headings."""
        numbers = {}
        for name, slot in self._slots.items():
            calibration = self._board.session.request(GetCalibration(slot))
            fit = self._board.session.request(GetAccelerometer(slot))
            parts = (calibration.soft_iron, calibration.hard_iron, fit.gain, fit.offset)
            numbers[name] = np.concatenate([part.ravel() for part in parts]).tolist()
        poses, message = journal.earlier(numbers)
        slots = set(self._slots.values())
        complete = {index: place for index, place in poses.items() if index >= 0 and set(place[1].headings) == slots}
        return StoredPoses(complete, message, journal.keep)

    def _check(self, pose: Pose, reply: AverageReply) -> None:
        for name, slot in self._slots.items():
            _attitude(reply.headings[slot], name, pose)


def measure_known_angles(
    board: Board,
    turntable: Turntable,
    *,
    poses: Sequence[Pose],
    slots: Mapping[str, int],
    mounting_yaw_deg: float,
    readings: int = 16,
    progress: Progress | None = None,
    journal: PoseJournal | None = None,
    fewest: FewestPoses | None = None,
) -> RequestedAngles:
    """Turn to each pose and ask the board for its heading under each calibration.

    Parameters
    ----------
    turntable
        Turntable whose angle is the reference, independent of the sensors under test.
    poses
        Poses, at least one.
    slots
        Slots of the calibrations, by name.
    mounting_yaw_deg
        Declared turn of the board on the table: board heading = table heading + this.
    readings
        New samples of each sensor to average at each pose.
    journal
        Stores captured poses of an operator, and returns those stored already.
    fewest
        Decides after each pose whether more are needed; None for all poses.

    Raises
    ------
    SensorAbsentError
        When magnetometer or accelerometer is missing.
    DeviceError
        When the board refuses a heading; the message names the pose.
    FirmwareContradictionError
        When a heading contradicts the answered calibration and means.
    """
    for kind in (SensorKind.MAGNETOMETER, SensorKind.ACCELEROMETER):
        board.sensor(kind)
    reader = RequestReader(board, slots, readings, mounting_yaw_deg)
    stored = reader.stored_poses(journal) if journal else None

    def errors_deg(readings: Mapping[int, tuple[Achieved, AverageReply]]) -> dict[str, dict[int, float]]:
        return {
            name: {
                index: heading_error_deg(
                    _attitude(answer.headings[slot], name, poses[index]).heading_deg,
                    achieved.attitude(mounting_yaw_deg).heading_deg,
                )
                for index, (achieved, answer) in readings.items()
            }
            for name, slot in slots.items()
        }

    taken = take_known_angles(
        reader,
        turntable,
        poses,
        progress=progress,
        stored=stored,
        order=fewest.order if fewest else (),
        decide=lambda readings: fewest.decision(errors_deg(readings)) if fewest else "",
    )
    estimates = fewest.estimates(errors_deg(taken.readings)) if fewest and taken.decision else {}
    known_angles = _requested_angles(
        poses,
        taken,
        slots,
        mounting_yaw_deg,
        fits={name: board.session.request(GetAccelerometer(slot)) for name, slot in slots.items()},
        calibrations={name: board.session.request(GetCalibration(slot)) for name, slot in slots.items()},
        estimates=estimates,
    )
    for name in slots:
        _check_arithmetic(known_angles, name)
    return known_angles


def movement(before: AverageReply, after: AverageReply, magnetometer_sigma_ut: float) -> str:
    """Describe how a board moved between two averages; see `moved`."""
    # Means of whole counts have a rounding error, even if the declared noise is small.
    noise_ut = math.hypot(magnetometer_sigma_ut, MICROTESLA_PER_COUNT / math.sqrt(12.0))
    return moved(_stillness(before), _stillness(after), noise_ut)


def _stillness(reply: AverageReply) -> Readings:
    spread = reply.accelerometer.spread
    return Readings(
        reply.n,
        MICROTESLA_PER_COUNT * reply.magnetometer.mean,
        G_PER_COUNT * reply.accelerometer.mean,
        0.0 if spread is None else 1000.0 * G_PER_COUNT * float(spread.max()),
    )


def headings_deg(
    magnetometer: Reals, accelerometer: Reals, soft_iron: Reals, hard_iron: Reals, fit: AccelerometerFit
) -> Reals:
    """Compute headings in float64 from means and a calibration.

    Parameters
    ----------
    magnetometer, accelerometer : shape (n, 3)
        Means [counts], body frame.
    soft_iron : shape (3, 3)
        [1/count].
    hard_iron : shape (3,)
        [counts].

    Returns
    -------
    ndarray, shape (n,)
        Headings in [0, 360) [deg].

    Raises
    ------
    DegenerateFieldError
        When a pose leaves no horizontal field.
    """
    field = (magnetometer - hard_iron) @ soft_iron.T
    pairs = zip(fit.gravity_g(accelerometer), field, strict=True)
    return np.array([tilt_heading(*pair).heading_deg for pair in pairs])


def _check_arithmetic(known_angles: RequestedAngles, name: str) -> None:
    """Refuse headings that contradict the board's calibration and means."""
    for index, (pose, heading) in enumerate(zip(known_angles.poses, known_angles.heading_deg[name], strict=True)):
        try:
            (computed,) = _headings_under(
                known_angles, known_angles.calibrations[name], known_angles.accelerometer_fits[name], index
            )
            contradiction = f"its own calibration and means give {computed:.4f} degrees"
        except DegenerateFieldError as error:
            computed, contradiction = math.inf, f"by its own calibration and means {error}"
        if not abs(wrap_180(heading - computed)) <= LARGEST_ROUNDING_DEG:
            raise FirmwareContradictionError(
                f"the firmware contradicts itself: it answers a heading of {heading:.4f} degrees under {name!r} at "
                f"{place_of(pose)}, and {contradiction}{_mistake(known_angles, name)}"
            )


def _headings_under(
    known_angles: RequestedAngles, calibration: CalibrationReply, fit: AccelerometerFit, index: int | None = None
) -> Reals:
    """Compute the headings of all poses, or of one, under two calibrations."""
    rows = slice(None) if index is None else slice(index, index + 1)
    return headings_deg(
        known_angles.magnetometer[rows],
        known_angles.accelerometer[rows],
        calibration.soft_iron,
        calibration.hard_iron,
        fit,
    )


def _mistake(known_angles: RequestedAngles, name: str) -> str:
    """Return the known mistake that explains all answered headings to within rounding; empty without one."""
    calibration, fit = known_angles.calibrations[name], known_angles.accelerometer_fits[name]
    others = {
        "the calibration of the accelerometer is left out": (calibration, NOMINAL),
        **{
            f"the calibration is stale, it is that of {other!r}": (stale, fit)
            for other, stale in known_angles.calibrations.items()
            if other != name
        },
    }
    try:
        for words, used in others.items():
            pairs = zip(known_angles.heading_deg[name], _headings_under(known_angles, *used), strict=True)
            if all(abs(heading_error_deg(*pair)) <= LARGEST_ROUNDING_DEG for pair in pairs):
                return f"; {words}"
    except DegenerateFieldError:
        return ""
    poses = Poses(
        (known_angles.magnetometer - calibration.hard_iron) @ calibration.soft_iron.T,
        fit.gravity_g(known_angles.accelerometer),
        known_angles.heading_deg[name],
        LARGEST_ROUNDING_DEG,
        stages=[stage for stage in Stage if stage is not Stage.FIELD],
    )
    bugs = fit_causes(poses)
    return f"{LIKELY_CAUSE}{bugs.words}. Check {bugs.places}." if bugs.is_complete else ""


def _requested_angles(
    asked: Sequence[Pose],
    taken: TakenAngles[AverageReply],
    slots: Mapping[str, int],
    mounting_yaw_deg: float,
    *,
    fits: dict[str, AccelerometerFit],
    calibrations: dict[str, CalibrationReply],
    estimates: Mapping[str, Mapping[str, tuple[float, float]]],
) -> RequestedAngles:
    by_index = taken.readings
    poses = [asked[index] for index in by_index]
    achieved, answers = [position for position, _ in by_index.values()], [answer for _, answer in by_index.values()]
    spreads = [answer.magnetometer.spread for answer in answers if answer.magnetometer.spread is not None]
    attitudes = {
        name: [_attitude(answer.headings[slot], name, pose) for answer, pose in zip(answers, poses, strict=True)]
        for name, slot in slots.items()
    }
    return RequestedAngles(
        poses=tuple(poses),
        attitudes=tuple(place.attitude(mounting_yaw_deg) for place in achieved),
        heading_deg={name: np.array([tilt.heading_deg for tilt in tilts]) for name, tilts in attitudes.items()},
        skipped=tuple(pose for index, pose in enumerate(asked) if index not in by_index),
        unset=taken.unset,
        decision=taken.decision,
        estimates=estimates,
        pitch_deg={name: np.array([tilt.pitch_deg for tilt in tilts]) for name, tilts in attitudes.items()},
        roll_deg={name: np.array([tilt.roll_deg for tilt in tilts]) for name, tilts in attitudes.items()},
        tilt_error_deg={name: _tilt_errors_deg(tilts, achieved) for name, tilts in attitudes.items()},
        magnetometer=np.array([answer.magnetometer.mean for answer in answers], dtype=np.float64),
        accelerometer=np.array([answer.accelerometer.mean for answer in answers], dtype=np.float64),
        accelerometer_fits=fits,
        calibrations=calibrations,
        readings=answers[0].n,
        magnetometer_sigma_counts=float(np.sqrt(np.mean(np.square(spreads)))) if spreads else None,
    )


def _tilt_errors_deg(attitudes: Sequence[Pose], achieved: Sequence[Achieved]) -> Reals:
    return np.array(
        [
            [wrap_180(tilt.pitch_deg - place.pitch_deg), wrap_180(tilt.roll_deg - place.roll_deg)]
            for tilt, place in zip(attitudes, achieved, strict=True)
        ]
    )


def _attitude(heading: SlotHeading, name: str, pose: Pose) -> Pose:
    if heading.attitude is None:
        raise DeviceError(
            "AVERAGE",
            heading.status.name,
            f"no heading with calibration {name!r} at {place_of(pose)}",
        )
    return heading.attitude
