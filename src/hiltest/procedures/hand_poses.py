"""Known angles set by hand: the operator is asked for each, with the board's reading beside the question."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import chain, pairwise
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.calibration.accelerometer import MOVED_SPREAD_MG
from hiltest.errors import OperatorAbsentError, TurntableError
from hiltest.orientation.angles import Pose, rotation_body_from_ned, wrap_180
from hiltest.procedures.followed_turn import FollowedTurn
from hiltest.procedures.hand_checks import LEAST_TURN_DEG, setting_errors_deg, turn_fault
from hiltest.procedures.questions import Glance, Question
from hiltest.procedures.turntables import AXES_IN_WORDS, QUESTIONS, Achieved, OperatorTurntable, heading_of
from hiltest.text import format_count, join_words

Reals = NDArray[np.float64]

STILL_WITHIN_S = 20.0
"""Longest wait for the board to stand still [s]; after it the question is repeated."""
# The norm of three normal variables of variance 1 is larger in 2 of 10 000 cases.
_STILL_SIGMAS = 4.4
# rms of one reading of a still accelerometer, as in the six faces; a larger measured spread takes precedence.
_ACCELEROMETER_NOISE_MG = 1.3
_NAMED_AT_MOST = 3
BEGINS_ANEW = "A run that is stopped begins anew: this firmware does not say whether it is then the same.\n"
"""Note before the first question about firmware that does not identify its build or its calibration."""
_KEEPS = "keep the reading (k)"
_ORDERS = (
    f"{AXES_IN_WORDS} Pitch + lifts the nose, roll + lowers the right side.\n"
    "Enter takes the heading at the angle that is asked for, a number says which angle was really reached; "
    "r takes the last one again, s skips, b goes back, q stops.\n"
)


class Wish(Enum):
    """An operator's command instead of the requested pose."""

    REDO = "redo"
    SKIP = "skip"
    BACK = "back"
    STOP = "quit"
    KEEP = "keep"


def wish_of(answer: str) -> Wish | None:
    """Return the wish that an answer names, by its word or first letter; None for other answers."""
    word = answer.strip().lower()
    return next((wish for wish in Wish if word in (wish.value, wish.value[0])), None)


class PoseWalk:
    """Walk through numbered poses: forward to the next open one, or back and again by the operator's choice.

    Attributes
    ----------
    taken : list of int
        Poses in the order of their latest capture.
    skipped : set of int
    offered : list of int
        Taken poses that are requested once more, in this order.
    at : int or None
        Requested pose; None if none is open.
    decision : str
        Reason why no further pose is needed; empty while they are.
    """

    def __init__(self, of: int, earlier: Iterable[int] = (), order: Sequence[int] = (), decision: str = "") -> None:
        self.of, self.decision = of, decision
        self._order = order or range(of)
        self.taken = list(earlier)
        self.skipped: set[int] = set()
        self.offered: list[int] = []
        self.at = self._open()

    @property
    def left(self) -> int:
        """Number of open poses."""
        return sum(index not in self.taken and index not in self.skipped for index in range(self.of))

    def take(self) -> None:
        """Mark the pose as taken, again if it was before, and go on to the next open one."""
        if self.at is not None:
            self.taken = [*(index for index in self.taken if index != self.at), self.at]
            self.skipped.discard(self.at)
        self.at = self._open(done=self.at)

    def skip(self) -> None:
        """Skip the pose; one that was taken before is kept."""
        if self.at is not None and self.at not in self.taken:
            self.skipped.add(self.at)
        self.at = self._open(done=self.at)

    def offer(self, poses: Iterable[int]) -> None:
        """Request taken poses once more."""
        self.offered = list(poses)
        self.at = self._open()

    def back(self) -> None:
        """Go to the pose before, taken or not."""
        self.at = max(0, (self.of if self.at is None else self.at) - 1)

    def redo(self) -> None:
        """Go to the pose that was taken last."""
        if self.taken:
            self.at = self.taken[-1]

    def _open(self, done: int | None = None) -> int | None:
        self.offered = [index for index in self.offered if index != done]
        needed = () if self.decision else self._order
        new = (index for index in needed if index not in self.taken and index not in self.skipped)
        return next(chain(self.offered, new), None)


Taken = TypeVar("Taken")


class PoseReader(ABC, Generic[Taken]):
    """Reads a board at known angles, by its interface to the firmware.

    Attributes
    ----------
    can_go_on : bool
        True if a run that was stopped can go on: the board shows that its firmware and calibration are the same.
    may_glance : bool
        True if the board may be read while a question waits.
    has_known_scale : bool
        True if the size of the raw field is the sensor's, not the firmware's word.
    turn : FollowedTurn
        Turn by the gyroscope, which `read_when_still` and `glance` follow.
    """

    can_go_on: bool
    may_glance: bool
    has_known_scale: bool

    def __init__(self, board: Board, mounting_yaw_deg: float) -> None:
        self._board, self._yaw_deg, self.turn = board, mounting_yaw_deg, FollowedTurn()

    def field_at(self, achieved: Achieved) -> Reals:
        """Return the rig's field along the board's axes on a table that has reached a pose, shape (3,) [uT]."""
        return rotation_body_from_ned(achieved.attitude(self._yaw_deg)) @ self._board.declared.field_ned_ut

    def now_s(self) -> float:
        """Return the time of the board's clock [s]."""
        return self._board.now_s()

    @abstractmethod
    def read_ut(self, reading: Taken) -> Reals | None:
        """Return the mean of the raw magnetometer, shape (3,) [uT]; None if the firmware does not report it."""

    @abstractmethod
    def moved_between(self, before: Taken, after: Taken) -> str:
        """Describe how field or gravity differ between two readings; empty if they are equal within their noise."""

    @abstractmethod
    def read(self, pose: Pose) -> Taken:
        """Read the board at a pose where its table stands."""

    @abstractmethod
    def read_when_still(self, pose: Pose) -> tuple[Taken | None, str]:
        """Read the board as soon as it stands; return None and a description of the motion if it does not."""

    @abstractmethod
    def glance(self) -> Glance:
        """Return the board's heading now."""


class PoseJournal(Protocol):
    """Journal of captured poses, from which a run can resume."""

    def earlier(self, held: Mapping[str, Sequence[float]]) -> tuple[dict[int, tuple[Achieved, Any]], str]:
        """Return the stored poses under calibrations with these numbers, and a message for the operator."""

    def keep(self, index: int, measured: tuple[Achieved, Any]) -> None:
        """Store a pose."""


@dataclass(frozen=True, slots=True)
class StoredPoses(Generic[Taken]):
    """Poses that an earlier run captured, and a place for more."""

    readings: Mapping[int, tuple[Achieved, Taken]]
    """Results by the index of the pose."""
    message: str
    """Message for the operator."""
    keep: Callable[[int, tuple[Achieved, Taken]], object]
    """Stores a pose."""


@dataclass(frozen=True, slots=True)
class TakenAngles(Generic[Taken]):
    """Readings at known angles."""

    readings: Mapping[int, tuple[Achieved, Taken]]
    """Results by the index of the pose, in order, without those that an operator skipped."""
    unset: Mapping[int, str] = field(default_factory=dict)
    """Poses, by their number from 1, at which the board was not set as the operator says, each with a description."""
    decision: str = ""
    """Reason why the other poses were not measured; empty if all were requested."""


class _HandReadings(Generic[Taken]):
    """Readings at known angles, each checked against the one before it."""

    def __init__(
        self,
        reader: PoseReader[Taken],
        table: OperatorTurntable,
        poses: Sequence[Pose],
        stored: StoredPoses[Taken] | None,
        order: Sequence[int],
        decide: Callable[[Mapping[int, tuple[Achieved, Taken]]], str],
    ) -> None:
        earlier = {} if stored is None else stored.readings
        self.readings = {index: place for index, place in earlier.items() if index < len(poses)}
        self.walk, self._decide = PoseWalk(len(poses), self.readings, order, decide(self.readings)), decide
        self._reader, self._table, self._poses, self._stored = reader, table, poses, stored
        self._doubted: tuple[int, tuple[Achieved, Taken]] | None = None
        self._doubts = 0
        self._began_s, self._had = reader.now_s(), len(self.walk.taken)
        # True once the operator has kept a doubted reading: then the sensor is wrong, or the check.
        self._trusts = False

    def ask_for_all(self, say: str, stopped: str) -> None:
        """Ask for each pose and capture it, until all are done; poses that stick out are requested once more.

        Parameters
        ----------
        say
            Text before the first question.
        stopped
            Message about a run that the operator stops.

        Raises
        ------
        OperatorAbsentError
            When nobody answers, or three consecutive answers are neither an angle nor a wish.
        KeyboardInterrupt
            When the operator stops.
        TurntableError
            When every pose was skipped.
        """
        walk, poses, message, nonsense = self.walk, self._poses, f"{say}{_ORDERS}", 0
        offered: set[int] = set()
        while True:
            if walk.at is None:
                out = {} if self._trusts else self.unset()
                again = {index: reason for index, reason in out.items() if index not in offered}
                offered |= again.keys()
                walk.offer(again)
                message += "".join(f"pose {index + 1} sticks out: {reason}.\n" for index, reason in again.items())
            at = walk.at
            answer = self._ask(message)
            wish, message = wish_of(answer), ""
            if wish is Wish.STOP:
                raise KeyboardInterrupt(
                    f"the operator stops, with {len(walk.taken)} of {walk.of} known angles taken; {stopped}"
                )
            heading_deg = None if at is None else heading_of(answer, poses[at].heading_deg)
            if wish is Wish.REDO:
                walk.redo()
            elif wish is Wish.BACK:
                walk.back()
            elif wish is Wish.SKIP:
                walk.skip()
                message = f"pose {at + 1} is not measured.\n" if at in walk.skipped and at is not None else ""
            elif at is None and not answer.strip():
                break
            elif at is None or (heading_deg is None and wish is not Wish.KEEP):
                nonsense += 1
                if nonsense == QUESTIONS:
                    raise OperatorAbsentError(
                        f"{QUESTIONS} answers were no heading between -360 and 360: is an operator there?"
                    )
                message = f"{answer.strip()!r} is neither a heading between -360 and 360 nor one of the letters.\n"
                continue
            elif not (message := self._take(at, heading_deg)):
                walk.take()
            nonsense = 0
        if not walk.taken:
            raise TurntableError("every known angle was skipped: there is no heading to judge")

    def _ask(self, message: str) -> str:
        """Ask for the pose of the walk, or at its end, with a message before the question."""
        walk, at = self.walk, self.walk.at
        live = self._glance if self._reader.may_glance and self._table.may_look else None
        no_wishes = {*([Wish.SKIP] if at is None else []), *([] if _KEEPS in message else [Wish.KEEP])}
        wishes = [wish.value for wish in Wish if wish not in no_wishes]
        if at is None:
            return self._table.ask(Question(message + _ask_at_end(walk), live, wishes=wishes))
        pose = self._poses[at]
        return self._table.ask(
            Question(
                message + question_of(at, pose, is_taken=at in walk.offered),
                live,
                pose=pose,
                asked_deg=wrap_180(pose.heading_deg - self._last_pose.heading_deg) if walk.taken else None,
                wishes=wishes,
                takes_heading=True,
            )
        )

    def _take(self, at: int, heading_deg: float | None) -> str:
        """Capture a pose, or keep the doubted reading; return the reason to ask again."""
        if heading_deg is None:
            if self._doubted is None or self._doubted[0] != at:
                return "no reading of this pose was doubted: there is none to keep.\n"
            place, self._trusts = self._doubted[1], True
        else:
            reading, motion = self._reader.read_when_still(self._poses[at])
            if reading is None:
                return f"the board does not stand still: {motion}.\n"
            place = self._table.achieved(self._poses[at], heading_deg), reading
        if not self._trusts and self.walk.taken and (fault := self._turn_fault(self.walk.taken[-1], place)):
            self._doubted, self._doubts = (at, place), self._doubts + 1
            if self._doubts == QUESTIONS:
                raise OperatorAbsentError(f"{QUESTIONS} times in a row {fault}: is an operator there?")
            asked = f"{self._poses[at].heading_deg:g}"
            return (
                f"{fault}. Set the board to heading {asked} and press Enter, or enter the heading of the scale. If the "
                f"scale shows {asked}, {_KEEPS}: then a sensor is wrong.\n"
            )
        self._doubts = 0
        self.readings[at] = place
        self.walk.decision = self._decide(self.readings)
        if self._stored is not None:
            self._stored.keep(at, place)
        self._reader.turn.begin()
        return ""

    def _is_unturned(self, last: tuple[Achieved, Taken], place: tuple[Achieved, Taken]) -> bool:
        """Return whether two readings are equal although the scale says that the board was turned."""
        (before, at_last), (after, reading) = last, place
        turn = rotation_body_from_ned(after.attitude()) @ rotation_body_from_ned(before.attitude()).T
        is_asked = turn.trace() < 1.0 + 2.0 * math.cos(math.radians(LEAST_TURN_DEG))
        is_known = self._reader.read_ut(reading) is not None
        return is_asked and is_known and not self._reader.moved_between(at_last, reading)

    def _turn_fault(self, last: int, place: tuple[Achieved, Taken]) -> str:
        """Describe how a reading contradicts the turn from the last one; empty if it does not."""
        reader, (before, at_last), (after, reading) = self._reader, self.readings[last], place
        if self._is_unturned(self.readings[last], place):
            return f"you did not turn: field and gravity are those of pose {last + 1}, {place_of(self._poses[last])}"
        read = reader.read_ut(at_last), reader.read_ut(reading)
        turned_deg = wrap_180(after.heading_deg - before.heading_deg)
        if (before.pitch_deg, before.roll_deg) != (after.pitch_deg, after.roll_deg):
            return ""
        shown = []
        if read[0] is not None and read[1] is not None and reader.has_known_scale and abs(turned_deg) >= LEAST_TURN_DEG:
            known_fields = reader.field_at(before), reader.field_at(after)
            shown.append(turn_fault(known_fields, (read[0], read[1]), turned_deg))
        if reader.turn.contradicts(before.attitude(), turned_deg):
            shown.append(f"its gyroscope shows {round(reader.turn.turned_deg(before.attitude()) or 0.0):+d}")
        sensors = " and ".join(filter(None, shown))
        turn = f"heading {after.heading_deg:g} is a turn of {turned_deg:+.0f} deg from pose {last + 1}"
        return f"{turn}, but {sensors}" if sensors else ""

    @property
    def _last_pose(self) -> Pose:
        """The pose that was taken last."""
        return self.readings[self.walk.taken[-1]][0].attitude()

    def _glance(self) -> Glance:
        """Return the board as its sensors show it, with its turn since the last known angle."""
        walk, turn = self.walk, self._reader.turn
        glance = self._reader.glance()._replace(progress=self._progress())
        if not walk.taken:
            return glance
        before = self._last_pose
        turned_deg = turn.turned_deg(before)
        is_wrong = walk.at is not None and turn.contradicts(
            before, self._poses[walk.at].heading_deg - before.heading_deg
        )
        stands = not glance.moves and abs(turned_deg or 0.0) >= LEAST_TURN_DEG
        return glance._replace(turned_deg=turned_deg, is_wrong_turn=is_wrong and stands)

    def _progress(self) -> str:
        """Return the progress of the walk, with the estimated remaining time."""
        count = len(self.walk.taken) - self._had
        left_s = (self._reader.now_s() - self._began_s) / count * self.walk.left if count > 0 else 0.0
        time_left = f", {left_s / 60.0:.0f} min left" if left_s >= 90.0 else f", {left_s:.0f} s left" if left_s else ""
        return f"{len(self.walk.taken)} of {self.walk.of}{time_left}"

    def unset(self) -> dict[int, str]:
        """Return the poses at which the board was not set as the operator says, each with a description."""
        unturned = {
            index: f"the readings of poses {before + 1} and {index + 1} are equal"
            for before, index in pairwise(self.walk.taken)
            if self._is_unturned(self.readings[before], self.readings[index])
        }
        order = sorted(self.readings)
        places = [self.readings[index] for index in order]
        fields = [self._reader.read_ut(reading) for _, reading in places]
        if any(field is None for field in fields):
            return unturned
        known_fields = np.array([self._reader.field_at(achieved) for achieved, _ in places])
        gravity = np.array([rotation_body_from_ned(achieved.attitude())[:, 2] for achieved, _ in places])
        faults = {}
        errors_deg = setting_errors_deg(known_fields, gravity, np.array(fields), self._table.uncertainty_deg)
        for row, error_deg in errors_deg.items():
            set_deg = places[row][0].heading_deg
            faults[order[row]] = f"the scale says {set_deg:g}, the field {(set_deg + error_deg) % 360.0:.0f}"
        return faults | unturned


def take_by_hand(
    reader: PoseReader[Taken],
    table: OperatorTurntable,
    poses: Sequence[Pose],
    stored: StoredPoses[Taken] | None,
    order: Sequence[int],
    decide: Callable[[Mapping[int, tuple[Achieved, Taken]]], str],
) -> TakenAngles[Taken]:
    """Ask for each pose, wait until the board stands still, and read it; see `_HandReadings.ask_for_all` for errors.

    Parameters
    ----------
    stored
        Poses that an earlier run captured; None if no journal is kept.
    order, decide
        As for `hiltest.procedures.known_angles.take_known_angles`.
    """
    hand = _HandReadings(reader, table, poses, stored, order, decide)
    say = "" if stored is None else stored.message
    if reader.can_go_on:
        hand.ask_for_all(say, "the same command goes on")
    else:
        hand.ask_for_all(BEGINS_ANEW, "the same command begins anew")
    unset = {index + 1: fault for index, fault in hand.unset().items()}
    return TakenAngles(dict(sorted(hand.readings.items())), unset, hand.walk.decision)


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Readings of a board's sensors over an interval; None for unknown ones."""

    n: int
    """Number of readings of each."""
    field_ut: Reals | None
    gravity_g: Reals | None
    """Shape (3,), or None. Means."""
    spread_mg: float
    """Sample deviation of the accelerometer's axis that spreads most."""


def moved(before: Readings, after: Readings, noise_ut: float) -> str:
    """Describe how a board moved between two intervals, beyond the noise of their readings; empty if it stood.

    Parameters
    ----------
    noise_ut
        rms of one axis of one reading of the field.

    Notes
    -----
    A turn about the vertical only changes the field: with 0.4 uT per reading, 16 readings and a horizontal field of
    22.8 uT, 1.6 degrees between averages are detected.
    """
    spread_mg = max(_ACCELEROMETER_NOISE_MG, before.spread_mg, after.spread_mg)
    if spread_mg > MOVED_SPREAD_MG:
        return f"its accelerometer spreads by {spread_mg:.1f} mg rms, at rest by {_ACCELEROMETER_NOISE_MG}"
    of_means = _STILL_SIGMAS * math.sqrt(1.0 / before.n + 1.0 / after.n)
    if before.gravity_g is not None and after.gravity_g is not None:
        gravity_mg = 1000.0 * float(np.linalg.norm(after.gravity_g - before.gravity_g))
        if gravity_mg > of_means * spread_mg:
            return f"gravity changed by {gravity_mg:.1f} mg"
    if before.field_ut is not None and after.field_ut is not None:
        field_ut = float(np.linalg.norm(after.field_ut - before.field_ut))
        if field_ut > of_means * noise_ut:
            return f"the field changed by {field_ut:.1f} uT"
    return ""


def place_of(pose: Pose) -> str:
    """Return a pose in words."""
    return f"heading {pose.heading_deg:g}, pitch {pose.pitch_deg:+g}, roll {pose.roll_deg:+g}"


def missing_in_words(skipped: Sequence[Pose], count: int) -> str:
    """List the missing known angles in words; empty without any. A limit applies to the complete set."""
    places = join_words([place_of(pose) for pose in skipped], _NAMED_AT_MOST)
    return f"{len(skipped)} of {len(skipped) + count} known angles not measured: {places}" if skipped else ""


def question_of(index: int, pose: Pose, *, is_taken: bool = False) -> str:
    """Return the question to an operator at a known angle; skipping keeps the result of one that `is_taken`."""
    skips = "s (keeps the earlier result)" if is_taken else "s"
    return f"pose {index + 1}: turn to {place_of(pose)} and let it stand still.\n  Enter, heading, r, {skips}, b or q: "


def _ask_at_end(walk: PoseWalk) -> str:
    numbers = join_words([str(index + 1) for index in sorted(walk.skipped)], _NAMED_AT_MOST)
    skipped = f"; {format_count(len(walk.skipped), 'pose')} not measured: {numbers}" if walk.skipped else ""
    decision = f"{walk.decision}.\n" if walk.decision else ""
    return (
        f"{decision}{len(walk.taken)} of {walk.of} known angles are taken{skipped}.\n"
        "  Enter to go on (r takes the last again, b goes back, q stops): "
    )
