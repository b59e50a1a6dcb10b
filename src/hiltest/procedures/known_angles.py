"""Known-angle procedure: compares the board's heading with the turntable's angle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration.accelerometer import NOMINAL, AccelerometerFit
from hiltest.errors import DeviceError, FirmwareContradictionError
from hiltest.link.accelerometer import GetAccelerometer
from hiltest.link.messages import Average, GetCalibration
from hiltest.link.replies import AverageReply, CalibrationReply, SensorKind, SlotHeading
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.orientation.angles import Pose, heading_error_deg, rotation_body_from_ned, wrap_180, wrap_360
from hiltest.procedures.calibrate import UNCALIBRATED, UNCALIBRATED_SLOT
from hiltest.procedures.hand_poses import PoseJournal, missing_in_words, place_of, take_by_hand
from hiltest.procedures.heading_statistics import HeadingSummary, rms, summarise
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.turntables import Achieved, OperatorTurntable, Turntable

Reals = NDArray[np.float64]

LARGEST_ROUNDING_DEG = 0.002
"""A heading in float32 is within 3e-5 degrees of float64; a difference of eighty times that means another
computation."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownAngles:
    """Headings answered at known angles, per calibration."""

    poses: tuple[Pose, ...]
    """Requested poses of the turntable."""
    attitudes: tuple[Pose, ...]
    """Attitudes of the board: reached poses with the declared mounting yaw."""
    reference_deg: Reals
    """Shape (n,). Headings of these attitudes."""
    uncertainty_deg: float
    """Uncertainty of the turntable's angle."""
    mounting_yaw_deg: float
    """Declared mounting yaw; nothing else was subtracted."""
    readings: int
    """Number of new samples averaged at each pose."""
    heading_deg: dict[str, Reals]
    error_deg: dict[str, Reals]
    """Shape (n,). Answer, and answer minus reference in (-180, 180], per calibration."""
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
    skipped: tuple[Pose, ...] = ()
    """Known angles that an operator skipped; the other fields exclude them."""

    @property
    def not_measured(self) -> str:
        """Missing known angles, in words; empty without any. A limit applies to the complete set."""
        return missing_in_words(self.skipped, len(self.poses))

    def in_body(self, vector_ned: Sequence[float]) -> Reals:
        """Return a vector of the earth frame in the board's axes at each pose, shape (n, 3)."""
        return np.array([rotation_body_from_ned(attitude) @ np.array(vector_ned) for attitude in self.attitudes])

    @property
    def level(self) -> NDArray[np.bool_]:
        """Mask of the level poses, shape (n,)."""
        return np.array([pose.pitch_deg == 0.0 and pose.roll_deg == 0.0 for pose in self.poses])

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

    def summary(self, name: str) -> HeadingSummary:
        """Return the statistics of one calibration."""
        return summarise(self.error_deg[name], self.reference_deg, level=self.level)

    def max_level_deg(self, name: str) -> float:
        """Return the largest error over the level poses."""
        return summarise(self.error_deg[name][self.level], self.reference_deg[self.level]).max_deg


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
) -> KnownAngles:
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

    Raises
    ------
    SensorAbsentError
        When magnetometer or accelerometer is missing.
    DeviceError
        When the board refuses a heading; the message names the pose.
    FirmwareContradictionError
        When a heading contradicts the answered calibration and means.
    """
    tell = progress or silent
    for kind in (SensorKind.MAGNETOMETER, SensorKind.ACCELEROMETER):
        board.sensor(kind)

    def check(pose: Pose, answer: AverageReply) -> None:
        for name, slot in slots.items():
            _attitude(answer.headings[slot], name, pose)

    if isinstance(turntable, OperatorTurntable):
        earlier, message = journal.earlier(_calibration_numbers(board, slots)) if journal else ({}, "")
        poses_by_index = take_by_hand(
            board,
            turntable,
            poses,
            readings=readings,
            slots=tuple(slots.values()),
            check=check,
            shown=next((slot for name, slot in slots.items() if name != UNCALIBRATED), UNCALIBRATED_SLOT),
            earlier=earlier,
            keep=journal.keep if journal else lambda *_: None,
            say=message,
        )
    else:
        mask, poses_by_index = sum(1 << slot for slot in slots.values()), {}
        for index, pose in enumerate(poses):
            tell("known angles", index, len(poses))
            achieved = turntable.turn_to(pose, known_angle=index)
            poses_by_index[index] = achieved, board.session.request(Average(readings, mask))
            check(pose, poses_by_index[index][1])
        tell("known angles", len(poses), len(poses))
    known_angles = _known_angles(
        poses,
        poses_by_index,
        slots,
        mounting_yaw_deg,
        readings,
        fits={name: board.session.request(GetAccelerometer(slot)) for name, slot in slots.items()},
        calibrations={name: board.session.request(GetCalibration(slot)) for name, slot in slots.items()},
    )
    for name in slots:
        _check_arithmetic(known_angles, name)
    return known_angles


def _calibration_numbers(board: Board, slots: Mapping[str, int]) -> dict[str, list[float]]:
    """Return the parameters of the calibrations on the board."""
    numbers = {}
    for name, slot in slots.items():
        calibration, fit = board.session.request(GetCalibration(slot)), board.session.request(GetAccelerometer(slot))
        parts = (calibration.soft_iron, calibration.hard_iron, fit.gain, fit.offset)
        numbers[name] = np.concatenate([part.ravel() for part in parts]).tolist()
    return numbers


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


def _check_arithmetic(known_angles: KnownAngles, name: str) -> None:
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
    known_angles: KnownAngles, calibration: CalibrationReply, fit: AccelerometerFit, index: int | None = None
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


def _mistake(known_angles: KnownAngles, name: str) -> str:
    """Return the known mistake that explains all answered headings to within rounding; empty without one."""
    try:
        right = _headings_under(known_angles, known_angles.calibrations[name], known_angles.accelerometer_fits[name])
        added = wrap_180(known_angles.heading_deg[name][0] - right[0])
        mistakes: dict[str, Callable[[], Reals]] = {
            f"a constant {added:+.3g} degrees is added to each heading": lambda: right + added,
            "each heading has the opposite sense of rotation": lambda: -right,
            **_mistaken_tilts(known_angles, name),
            **{
                f"the calibration is stale, it is that of {other!r}": partial(
                    _headings_under, known_angles, calibration, known_angles.accelerometer_fits[name]
                )
                for other, calibration in known_angles.calibrations.items()
                if other != name
            },
        }
        return next(
            (f"; {words}" for words, headings in mistakes.items() if _matches(headings, known_angles, name)), ""
        )
    except DegenerateFieldError:
        return ""


def _mistaken_tilts(known_angles: KnownAngles, name: str) -> dict[str, Callable[[], Reals]]:
    calibration, fit = known_angles.calibrations[name], known_angles.accelerometer_fits[name]
    level = replace(known_angles, accelerometer=np.tile([0.0, 0.0, 1.0], (len(known_angles.poses), 1)))
    upwards = AccelerometerFit(-fit.gain, fit.offset)
    return {
        "tilt compensation is missing": partial(_headings_under, level, calibration, NOMINAL),
        "the calibration of the accelerometer is left out": partial(
            _headings_under, known_angles, calibration, NOMINAL
        ),
        "gravity has the opposite sign": partial(_headings_under, known_angles, calibration, upwards),
    }


def _matches(headings: Callable[[], Reals], known_angles: KnownAngles, name: str) -> bool:
    pairs = zip(known_angles.heading_deg[name].tolist(), headings().tolist(), strict=True)
    return all(abs(heading_error_deg(*pair)) <= LARGEST_ROUNDING_DEG for pair in pairs)


def _known_angles(
    asked: Sequence[Pose],
    by_index: Mapping[int, tuple[Achieved, AverageReply]],
    slots: Mapping[str, int],
    mounting_yaw_deg: float,
    readings: int,
    *,
    fits: dict[str, AccelerometerFit],
    calibrations: dict[str, CalibrationReply],
) -> KnownAngles:
    poses = [asked[index] for index in by_index]
    achieved, answers = [position for position, _ in by_index.values()], [answer for _, answer in by_index.values()]
    attitudes = {
        name: [_attitude(answer.headings[slot], name, pose) for answer, pose in zip(answers, poses, strict=True)]
        for name, slot in slots.items()
    }
    references = [wrap_360(place.heading_deg + mounting_yaw_deg) for place in achieved]
    headings = {name: [attitude.heading_deg for attitude in tilts] for name, tilts in attitudes.items()}
    return KnownAngles(
        poses=tuple(poses),
        attitudes=tuple(
            Pose(reference, place.pitch_deg, place.roll_deg)
            for reference, place in zip(references, achieved, strict=True)
        ),
        reference_deg=np.array(references),
        uncertainty_deg=max(place.uncertainty_deg for place in achieved),
        mounting_yaw_deg=mounting_yaw_deg,
        readings=readings,
        heading_deg={name: np.array(values) for name, values in headings.items()},
        error_deg={
            name: np.array([heading_error_deg(*pair) for pair in zip(values, references, strict=True)])
            for name, values in headings.items()
        },
        pitch_deg={name: np.array([tilt.pitch_deg for tilt in tilts]) for name, tilts in attitudes.items()},
        roll_deg={name: np.array([tilt.roll_deg for tilt in tilts]) for name, tilts in attitudes.items()},
        tilt_error_deg={name: _tilt_errors_deg(tilts, achieved) for name, tilts in attitudes.items()},
        magnetometer=np.array([answer.magnetometer.mean for answer in answers], dtype=np.float64),
        accelerometer=np.array([answer.accelerometer.mean for answer in answers], dtype=np.float64),
        accelerometer_fits=fits,
        calibrations=calibrations,
        skipped=tuple(pose for index, pose in enumerate(asked) if index not in by_index),
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
