"""Known-angle procedure: the board answers its heading at headings that the turntable knows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import Pose, heading_error_deg, rotation_body_from_ned, wrap_180, wrap_360
from hiltest.boards.board import Board
from hiltest.calibration.accelerometer import NOMINAL, AccelerometerFit
from hiltest.errors import DeviceError, FirmwareContradictionError
from hiltest.link.accelerometer import GetAccelerometer
from hiltest.link.messages import Average, GetCalibration
from hiltest.link.replies import AverageReply, CalibrationReply, SensorKind, SlotHeading
from hiltest.orientation import DegenerateFieldError, tilt_heading
from hiltest.procedures.calibrate import UNCALIBRATED, UNCALIBRATED_SLOT
from hiltest.procedures.hand_poses import PoseJournal, missing_in_words, place_of, take_by_hand
from hiltest.procedures.heading_statistics import HeadingSummary, rms, summarise
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.turntables import Achieved, OperatorTurntable, Turntable

Reals = NDArray[np.float64]

LARGEST_ROUNDING_DEG = 0.002
"""A heading in float32 is within 3e-5 degrees of the same in float64: eighty times that is another computation."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownAngles:
    """Headings answered at known angles, per calibration."""

    poses: tuple[Pose, ...]
    """As asked of the turntable."""
    attitudes: tuple[Pose, ...]
    """Of the board: what the turntable reached, and the declared mounting yaw."""
    reference_deg: Reals
    """Shape (n,). Heading of these attitudes."""
    uncertainty_deg: float
    """Uncertainty of the turntable's angle."""
    mounting_yaw_deg: float
    """What was declared, and nothing else was taken off."""
    readings: int
    """New samples averaged at each pose."""
    heading_deg: dict[str, Reals]
    error_deg: dict[str, Reals]
    """Shape (n,). Answer, and answer minus reference in (-180, 180], per calibration."""
    pitch_deg: dict[str, Reals]
    roll_deg: dict[str, Reals]
    """Shape (n,). As the board answered them, per calibration: each has its accelerometer's."""
    tilt_error_deg: dict[str, Reals]
    """Shape (n, 2). Answered pitch and roll minus what the turntable reached, in (-180, 180]."""
    magnetometer: Reals
    accelerometer: Reals
    """Shape (n, 3). Means that the board took at each pose [counts]; its headings are from these."""
    accelerometer_fits: dict[str, AccelerometerFit]
    """The accelerometer calibration that the board holds beside each calibration."""
    calibrations: dict[str, CalibrationReply]
    """The magnetometer calibrations that the board holds."""
    skipped: tuple[Pose, ...] = ()
    """Known angles that an operator left out; nothing here is of them."""

    @property
    def not_measured(self) -> str:
        """Which known angles are missing, in words; empty where all were taken. A limit is of all of them."""
        return missing_in_words(self.skipped, len(self.poses))

    def in_body(self, vector_ned: Sequence[float]) -> Reals:
        """Return what a vector of the earth frame is along the board's axes at each pose, shape (n, 3)."""
        return np.array([rotation_body_from_ned(attitude) @ np.array(vector_ned) for attitude in self.attitudes])

    @property
    def level(self) -> NDArray[np.bool_]:
        """Mask of the level poses, shape (n,)."""
        return np.array([pose.pitch_deg == 0.0 and pose.roll_deg == 0.0 for pose in self.poses])

    def accelerometer_norm_rms_mg(self, name: str) -> float:
        """Return how far gravity under a calibration is from 1 g, rms over the poses [mg]."""
        return self.norm_rms_mg(self.accelerometer_fits[name])

    def norm_rms_mg(self, fit: AccelerometerFit) -> float:
        """Return the same under any accelerometer calibration, in a slot or not [mg]."""
        gravity_g = fit.gravity_g(self.accelerometer)
        # hypot is correctly rounded neither everywhere nor alike; run.json keeps 9 digits of it.
        return rms([1000.0 * (math.hypot(*each) - 1.0) for each in gravity_g.tolist()])

    def max_tilt_error_deg(self, name: str) -> float:
        """Return the largest error of pitch or roll over the poses [deg]; the accelerometer alone makes it."""
        return float(np.abs(self.tilt_error_deg[name]).max())

    def summary(self, name: str) -> HeadingSummary:
        """Return the statistics of one calibration."""
        return summarise(self.error_deg[name], self.reference_deg, level=self.level)

    def max_level_deg(self, name: str) -> float:
        """Return the largest error over the level poses."""
        return summarise(self.error_deg[name][self.level], self.reference_deg[self.level]).max_deg


def measure_known_angles(
    board: Board, turntable: Turntable, *, poses: Sequence[Pose], slots: Mapping[str, int],
    mounting_yaw_deg: float, readings: int = 16, progress: Progress | None = None, journal: PoseJournal | None = None,
) -> KnownAngles:
    """Turn to each pose and ask the board for its heading under each calibration.

    Parameters
    ----------
    turntable
        Its angle is the reference; no sensor under test enters it.
    poses
        At least one.
    slots
        Name of each calibration and the slot it is in.
    mounting_yaw_deg
        Declared turn of the board on the table: board heading = table heading + this.
    readings
        New samples of each sensor to average at each pose.
    journal
        Keeps what an operator has set, and has what is there already.

    Raises
    ------
    SensorAbsentError
        When magnetometer or accelerometer is missing.
    DeviceError
        When the board refuses a heading; says at which pose.
    FirmwareContradictionError
        When a heading is not the one that the answered calibration and the answered means give.
    """
    tell = progress or silent
    for kind in (SensorKind.MAGNETOMETER, SensorKind.ACCELEROMETER):
        board.sensor(kind)

    def check(pose: Pose, answer: AverageReply) -> None:
        for name, slot in slots.items():
            _attitude(answer.headings[slot], name, pose)

    if isinstance(turntable, OperatorTurntable):
        earlier, said = journal.earlier(_numbers_of(board, slots)) if journal else ({}, "")
        taken = take_by_hand(
            board, turntable, poses, readings=readings, slots=tuple(slots.values()), check=check,
            shown=next((slot for name, slot in slots.items() if name != UNCALIBRATED), UNCALIBRATED_SLOT),
            earlier=earlier, keep=journal.keep if journal else lambda *_: None, say=said,
        )
    else:
        mask, taken = sum(1 << slot for slot in slots.values()), {}
        for index, pose in enumerate(poses):
            tell("known angles", index, len(poses))
            achieved = turntable.turn_to(pose, known_angle=index)
            taken[index] = achieved, board.session.request(Average(readings, mask))
            check(pose, taken[index][1])
        tell("known angles", len(poses), len(poses))
    found = _known_angles(
        poses, taken, slots, mounting_yaw_deg, readings,
        fits={name: board.session.request(GetAccelerometer(slot)) for name, slot in slots.items()},
        calibrations={name: board.session.request(GetCalibration(slot)) for name, slot in slots.items()},
    )
    for name in slots:
        _check_arithmetic(found, name)
    return found


def _numbers_of(board: Board, slots: Mapping[str, int]) -> dict[str, list[float]]:
    """Return all numbers of the calibrations that the board holds."""
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
        In [0, 360) [deg].

    Raises
    ------
    DegenerateFieldError
        When a pose leaves no horizontal field.
    """
    field = (magnetometer - hard_iron) @ soft_iron.T
    pairs = zip(fit.gravity_g(accelerometer), field, strict=True)
    return np.array([tilt_heading(*pair).heading_deg for pair in pairs])


def _check_arithmetic(found: KnownAngles, name: str) -> None:
    """Refuse headings that do not follow from the calibration and the means that the board answered."""
    for index, (pose, heading) in enumerate(zip(found.poses, found.heading_deg[name], strict=True)):
        try:
            (computed,) = _headings_under(found, found.calibrations[name], found.accelerometer_fits[name], index)
            told = f"its own calibration and means give {computed:.4f} degrees"
        except DegenerateFieldError as error:
            computed, told = math.inf, f"by its own calibration and means {error}"
        if not abs(wrap_180(heading - computed)) <= LARGEST_ROUNDING_DEG:
            raise FirmwareContradictionError(
                f"the firmware contradicts itself: it answers a heading of {heading:.4f} degrees under {name!r} at "
                f"{place_of(pose)}, and {told}{_mistake(found, name)}"
            )


def _headings_under(
    found: KnownAngles, calibration: CalibrationReply, fit: AccelerometerFit, index: int | None = None
) -> Reals:
    """Compute the headings of all poses, or of one, under two calibrations."""
    rows = slice(None) if index is None else slice(index, index + 1)
    return headings_deg(
        found.magnetometer[rows], found.accelerometer[rows], calibration.soft_iron, calibration.hard_iron, fit
    )


def _mistake(found: KnownAngles, name: str) -> str:
    """Name the mistake that gives all answered headings, to within rounding; empty where no known one does."""
    try:
        right = _headings_under(found, found.calibrations[name], found.accelerometer_fits[name])
        added = wrap_180(found.heading_deg[name][0] - right[0])
        mistakes: dict[str, Callable[[], Reals]] = {
            f"a constant {added:+.3g} degrees is added to each heading": lambda: right + added,
            "each heading is counted the wrong way round": lambda: -right,
            **_mistaken_tilts(found, name),
            **{
                f"the calibration is stale, it is that of {other!r}": partial(
                    _headings_under, found, calibration, found.accelerometer_fits[name]
                )
                for other, calibration in found.calibrations.items() if other != name
            },
        }
        return next((f"; {words}" for words, headings in mistakes.items() if _same(headings, found, name)), "")
    except DegenerateFieldError:
        return ""


def _mistaken_tilts(found: KnownAngles, name: str) -> dict[str, Callable[[], Reals]]:
    calibration, fit = found.calibrations[name], found.accelerometer_fits[name]
    level = replace(found, accelerometer=np.tile([0.0, 0.0, 1.0], (len(found.poses), 1)))
    upwards = AccelerometerFit(-fit.gain, fit.offset)
    return {
        "tilt compensation is missing": partial(_headings_under, level, calibration, NOMINAL),
        "the calibration of the accelerometer is left out": partial(_headings_under, found, calibration, NOMINAL),
        "gravity has the opposite sign": partial(_headings_under, found, calibration, upwards),
    }


def _same(headings: Callable[[], Reals], found: KnownAngles, name: str) -> bool:
    pairs = zip(found.heading_deg[name].tolist(), headings().tolist(), strict=True)
    return all(abs(heading_error_deg(*pair)) <= LARGEST_ROUNDING_DEG for pair in pairs)


def _known_angles(
    asked: Sequence[Pose], taken: Mapping[int, tuple[Achieved, AverageReply]], slots: Mapping[str, int],
    mounting_yaw_deg: float, readings: int, *,
    fits: dict[str, AccelerometerFit], calibrations: dict[str, CalibrationReply],
) -> KnownAngles:
    poses = [asked[index] for index in taken]
    achieved, answers = [there for there, _ in taken.values()], [answer for _, answer in taken.values()]
    attitudes = {
        name: [_attitude(answer.headings[slot], name, pose) for answer, pose in zip(answers, poses, strict=True)]
        for name, slot in slots.items()
    }
    references = [wrap_360(place.heading_deg + mounting_yaw_deg) for place in achieved]
    headings = {name: [attitude.heading_deg for attitude in each] for name, each in attitudes.items()}
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
        pitch_deg={name: np.array([tilt.pitch_deg for tilt in each]) for name, each in attitudes.items()},
        roll_deg={name: np.array([tilt.roll_deg for tilt in each]) for name, each in attitudes.items()},
        tilt_error_deg={name: _tilt_errors_deg(each, achieved) for name, each in attitudes.items()},
        magnetometer=np.array([answer.magnetometer.mean for answer in answers], dtype=np.float64),
        accelerometer=np.array([answer.accelerometer.mean for answer in answers], dtype=np.float64),
        accelerometer_fits=fits,
        calibrations=calibrations,
        skipped=tuple(pose for index, pose in enumerate(asked) if index not in taken),
    )


def _tilt_errors_deg(attitudes: Sequence[Pose], achieved: Sequence[Achieved]) -> Reals:
    return np.array([
        [wrap_180(tilt.pitch_deg - place.pitch_deg), wrap_180(tilt.roll_deg - place.roll_deg)]
        for tilt, place in zip(attitudes, achieved, strict=True)
    ])


def _attitude(heading: SlotHeading, name: str, pose: Pose) -> Pose:
    if heading.attitude is None:
        raise DeviceError(
            "AVERAGE", heading.status.name,
            f"no heading with calibration {name!r} at {place_of(pose)}",
        )
    return heading.attitude
