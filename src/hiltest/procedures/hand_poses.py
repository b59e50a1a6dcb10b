"""Known angles that a hand sets: each is asked for, with what the board says beside the question, until all are in."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.angles import Pose
from hiltest.boards.board import Board
from hiltest.calibration.accelerometer import MOVED_SPREAD_MG
from hiltest.errors import OperatorAbsentError, TurntableError
from hiltest.link.messages import Average
from hiltest.link.replies import G_PER_COUNT, MICROTESLA_PER_COUNT, AverageReply
from hiltest.procedures.turntables import QUESTIONS, Achieved, OperatorTurntable, heading_of
from hiltest.text import format_count, join_words

Reals = NDArray[np.float64]

STILL_WITHIN_S = 20.0
"""So long the board is waited for to stand still [s]; then the pose is asked for again."""
# Between two averages that are compared [s]: a hand that still turns the table by 3 degrees a second is seen.
_APART_S = 0.3
# The norm of three normal variables of variance 1 is larger in 2 of 10 000 cases.
_STILL_SIGMAS = 4.4
# rms of one reading of a still accelerometer, as in the six faces; where readings spread by more, that counts.
_ACCELEROMETER_NOISE_MG = 1.3
# Readings of one look at the board while a question waits: a tenth of a second.
_LIVE_READINGS = 8
_NAMED_AT_MOST = 3
_ORDERS = (
    "Enter takes the heading at the angle that is asked for, a number says which angle was really reached; "
    "r takes the last one again, s skips, b goes back, q stops.\n"
)


class Wish(Enum):
    """What an operator wants instead of the pose that is asked for."""

    REDO = "redo"
    SKIP = "skip"
    BACK = "back"
    STOP = "quit"


def wish_of(answer: str) -> Wish | None:
    """Return the wish that an answer is, by its word or first letter; None where it is none."""
    word = answer.strip().lower()
    return next((each for each in Wish if word in (each.value, each.value[0])), None)


class Question(str):
    """A question, and what is shown beside it until it is answered.

    Attributes
    ----------
    live : callable
        Returns what is to be shown now; it may ask the board, and is not called where nothing can be drawn.
    """

    live: Callable[[], str]

    def __new__(cls, text: str, live: Callable[[], str]) -> Question:
        """Make a text that carries `live`."""
        made = super().__new__(cls, text)
        made.live = live
        return made


class PoseWalk:
    """Way through numbered poses: forward to the next that is open, and back and again as the operator likes.

    Attributes
    ----------
    taken : list of int
        In the order in which they were taken last.
    skipped : set of int
    at : int or None
        The pose that is asked for; None when none is open.
    """

    def __init__(self, of: int, taken: Iterable[int] = ()) -> None:
        self.of = of
        self.taken = list(taken)
        self.skipped: set[int] = set()
        self.at = self._open()

    @property
    def left(self) -> int:
        """Number of open poses."""
        return sum(each not in self.taken and each not in self.skipped for each in range(self.of))

    def take(self) -> None:
        """Take the pose, once more if it was taken before, and go on to the next that is open."""
        if self.at is not None:
            self.taken = [*(each for each in self.taken if each != self.at), self.at]
            self.skipped.discard(self.at)
        self.at = self._open()

    def skip(self) -> None:
        """Leave the pose out; one that was taken before stays as it was."""
        if self.at is not None and self.at not in self.taken:
            self.skipped.add(self.at)
        self.at = self._open()

    def back(self) -> None:
        """Go to the pose before, taken or not."""
        self.at = max(0, (self.of if self.at is None else self.at) - 1)

    def redo(self) -> None:
        """Go to the pose that was taken last."""
        if self.taken:
            self.at = self.taken[-1]

    def _open(self) -> int | None:
        return next((each for each in range(self.of) if each not in self.taken and each not in self.skipped), None)


Taken: TypeAlias = tuple[Achieved, AverageReply]


class PoseJournal(Protocol):
    """Keeps poses as they are taken, for a run that goes on with them."""

    def earlier(self, held: Mapping[str, Sequence[float]]) -> tuple[dict[int, Taken], str]:
        """Return the poses that are there already under calibrations with these numbers, and what is to be said."""

    def keep(self, index: int, taken: Taken) -> None:
        """Keep a pose."""


def walk_by_hand(
    table: OperatorTurntable, poses: Sequence[Pose], earlier: Iterable[int], *, take: Callable[[int, float], str],
    look: Callable[[], str] | None, now_s: Callable[[], float], say: str = "",
    stopped: str = "the same command goes on",
) -> None:  # fmt: skip
    """Ask for each pose, and have it taken, until all are in.

    Parameters
    ----------
    earlier
        Poses that are there already.
    take
        Gets the pose that was reached, by its index and its heading [deg], and returns what still moves there; empty
        where it was taken.
    look
        Returns what the board says now; None where nothing stands beside a question.
    now_s
        The board's clock.
    say
        What stands before the first question.
    stopped
        What becomes of a run that the operator stops.

    Raises
    ------
    OperatorAbsentError
        When no one answers, or three answers in a row are neither an angle nor a wish.
    KeyboardInterrupt
        When the operator stops.
    TurntableError
        When every pose was skipped.
    """
    walk = PoseWalk(len(poses), earlier)
    pace = _Pace(walk, now_s)
    said, nonsense = f"\n{say}{_ORDERS}", 0
    while True:
        at = walk.at
        text = said + (_asked_at_the_end(walk) if at is None else question_of(at, poses[at]))
        answer = table.ask(text if look is None else Question(text, lambda: f"{look()}; {pace()}"))
        wish, said = wish_of(answer), ""
        if wish is Wish.STOP:
            raise KeyboardInterrupt(
                f"the operator stops, with {len(walk.taken)} of {walk.of} known angles taken; {stopped}"
            )
        if wish is Wish.REDO:
            walk.redo()
        elif wish is Wish.BACK:
            walk.back()
        elif wish is Wish.SKIP:
            walk.skip()
            said = f"pose {at + 1} is not measured.\n" if at in walk.skipped and at is not None else ""
        elif at is None:
            if not answer.strip():
                break
        elif (heading_deg := heading_of(answer, poses[at].heading_deg)) is None:
            nonsense += 1
            if nonsense == QUESTIONS:
                raise OperatorAbsentError(
                    f"{QUESTIONS} answers were no heading between -360 and 360: is an operator there?"
                )
            continue
        elif moved := take(at, heading_deg):
            said = f"the board does not stand still: {moved}.\n"
        else:
            walk.take()
        nonsense = 0
    if not walk.taken:
        raise TurntableError("every known angle was skipped: there is no heading to judge")


def take_by_hand(
    board: Board, table: OperatorTurntable, poses: Sequence[Pose], *, readings: int, slots: Sequence[int], shown: int,
    check: Callable[[Pose, AverageReply], object], earlier: Mapping[int, Taken], keep: Callable[[int, Taken], object],
    say: str = "",
) -> dict[int, Taken]:
    """Ask for each pose, wait until the board stands still there, and average its readings; raises as `walk_by_hand`.

    Parameters
    ----------
    readings
        New samples of each sensor to average.
    slots
        Calibrations that the board answers headings under.
    shown
        The one whose heading stands beside a question.
    check
        Raises where an answer is not to be taken.
    earlier
        Poses that are there already.
    keep
        Gets each pose as it is taken.
    say
        What stands before the first question.

    Returns
    -------
    dict of int to (Achieved, AverageReply)
        By the index of the pose, in their order; those that were skipped are missing.
    """
    found = {
        index: taken for index, taken in earlier.items()
        if 0 <= index < len(poses) and set(taken[1].headings) == set(slots)
    }
    mask = sum(1 << slot for slot in slots)

    def take(at: int, heading_deg: float) -> str:
        reply, moved = wait_until_still(board, readings, mask)
        if reply is not None:
            check(poses[at], reply)
            found[at] = table.achieved(poses[at], heading_deg), reply
            keep(at, found[at])
        return moved

    walk_by_hand(table, poses, found, take=take, look=_Look(board, shown), now_s=board.now_s, say=say)
    return dict(sorted(found.items()))


def wait_until_still(board: Board, readings: int, slot_bitmask: int) -> tuple[AverageReply | None, str]:
    """Average again and again, until an average is as the one before; return it, or None and what still moves.

    Parameters
    ----------
    slot_bitmask
        As `Average` has it.
    """
    ends_s = board.now_s() + STILL_WITHIN_S
    before = board.session.request(Average(readings, slot_bitmask))
    while True:
        board.sleep(_APART_S)
        reply = board.session.request(Average(readings, slot_bitmask))
        moved = movement(before, reply, board.declared.magnetometer_sigma_ut)
        if not moved:
            return reply, ""
        if board.now_s() > ends_s:
            return None, moved
        before = reply


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What a board's sensors read for a while; None of one that is not known."""

    n: int
    """Readings of each."""
    field_ut: Reals | None
    gravity_g: Reals | None
    """Shape (3,), or None. Means."""
    spread_mg: float
    """Sample deviation of the accelerometer's axis that spreads most."""


def movement(before: AverageReply, after: AverageReply, magnetometer_sigma_ut: float) -> str:
    """Describe how a board moved between two averages; as `moved`."""
    # Means of whole counts are not exact, however small a noise is declared.
    noise_ut = math.hypot(magnetometer_sigma_ut, MICROTESLA_PER_COUNT / math.sqrt(12.0))
    return moved(_readings(before), _readings(after), noise_ut)


def _readings(reply: AverageReply) -> Readings:
    spread = reply.accelerometer.spread
    return Readings(
        reply.n, MICROTESLA_PER_COUNT * reply.magnetometer.mean, G_PER_COUNT * reply.accelerometer.mean,
        0.0 if spread is None else 1000.0 * G_PER_COUNT * float(spread.max()),
    )  # fmt: skip


def moved(before: Readings, after: Readings, noise_ut: float) -> str:
    """Describe how a board moved in two times, beyond the noise of their readings; empty where it stood.

    Parameters
    ----------
    noise_ut
        rms of one axis of one reading of the field.

    Notes
    -----
    A turn about the vertical shows in the field alone: with 0.4 uT a reading, 16 readings and a horizontal field of
    22.8 uT one of 1.6 degrees from one average to the next.
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


class _Pace:
    """How far a walk is, and how long the rest of it will take at this pace."""

    def __init__(self, walk: PoseWalk, now_s: Callable[[], float]) -> None:
        self._walk, self._now_s = walk, now_s
        self._began_s, self._had = now_s(), len(walk.taken)

    def __call__(self) -> str:
        """Say it in few words."""
        return f"{len(self._walk.taken)} of {self._walk.of}{self._left()}"

    def _left(self) -> str:
        taken = len(self._walk.taken) - self._had
        if taken <= 0 or not self._walk.left:
            return ""
        left_s = (self._now_s() - self._began_s) / taken * self._walk.left
        return f", {left_s / 60.0:.0f} min left" if left_s >= 90.0 else f", {left_s:.0f} s left"


def said_beside(heading_deg: float | None, *, moves: bool) -> str:
    """Return what a board says while a question waits."""
    heading = "no heading" if heading_deg is None else f"board {heading_deg:.1f} deg"
    return f"{heading}, {'moving' if moves else 'still'}"


class _Look:
    """The board's heading while a question waits, and whether it moves."""

    def __init__(self, board: Board, slot: int) -> None:
        self._board, self._slot = board, slot
        self._before: AverageReply | None = None

    def __call__(self) -> str:
        """Ask the board, and say it in few words."""
        reply = self._board.session.request(Average(_LIVE_READINGS, 1 << self._slot))
        moves = self._before is None or movement(self._before, reply, self._board.declared.magnetometer_sigma_ut)
        self._before = reply
        attitude = reply.headings[self._slot].attitude
        return said_beside(attitude.heading_deg if attitude else None, moves=bool(moves))


def place_of(pose: Pose) -> str:
    """Return a pose in words."""
    return f"heading {pose.heading_deg:g}, pitch {pose.pitch_deg:+g}, roll {pose.roll_deg:+g}"


def missing_in_words(skipped: Sequence[Pose], taken: int) -> str:
    """Say which known angles are missing beside those that were taken; empty where none is. A limit is of all."""
    places = join_words([place_of(each) for each in skipped], _NAMED_AT_MOST)
    return f"{len(skipped)} of {len(skipped) + taken} known angles not measured: {places}" if skipped else ""


def question_of(index: int, pose: Pose) -> str:
    """Return what is asked of an operator at a known angle."""
    return f"pose {index + 1}: turn to {place_of(pose)} and let it stand still.\n  Enter, heading, r, s, b or q: "


def _asked_at_the_end(walk: PoseWalk) -> str:
    numbers = join_words([str(each + 1) for each in sorted(walk.skipped)], _NAMED_AT_MOST)
    skipped = f"; {format_count(len(walk.skipped), 'pose')} not measured: {numbers}" if walk.skipped else ""
    return (
        f"{len(walk.taken)} of {walk.of} known angles are taken{skipped}.\n"
        "  Enter to go on (r takes the last again, b goes back, q stops): "
    )
