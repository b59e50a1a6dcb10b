"""Turntables that set a known angle: simulated, or an operator with prompts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Stage
from hiltest.calibration.still_pose import FACES, Face
from hiltest.errors import OperatorAbsentError
from hiltest.link.gyroscope import Axis
from hiltest.orientation.angles import Pose, wrap_360
from hiltest.procedures.questions import Glance, Question

LEVEL = Pose(0.0, 0.0, 0.0)
#: Table poses in which a body axis is straight down: nose down, right side down, level.
AXIS_DOWN = {Axis.X: Pose(0.0, -90.0, 0.0), Axis.Y: Pose(0.0, 0.0, 90.0), Axis.Z: LEVEL}
_MOUNTED = {Axis.X: "nose down", Axis.Y: "right side down", Axis.Z: "flat"}
#: Standstill of a table after `Turntable.turn` returns [s]: the board's FIFO starts in 0.07 s, and its first samples
#: show the standstill.
BEFORE_TURN_S = 0.4
#: Standstill at the end [s].
AFTER_TURN_S = 0.3
#: Description of a board on each face.
FACE_WORDS = {
    Face.PLUS_X: "nose down",
    Face.MINUS_X: "nose up",
    Face.PLUS_Y: "right side down",
    Face.MINUS_Y: "left side down",
    Face.PLUS_Z: "level",
    Face.MINUS_Z: "upside down",
}
# Six sides and eight corners, 3 s each, and a margin at the start.
HAND_TUMBLE_S = 45.0
# Duration of the motion for a filter test by a hand or a motor.
SWAY_S = 24.0
AXES_IN_WORDS = "Axes of the board: x points to its nose, y to its right side, z through it, down when it is level."
#: Number of consecutive invalid answers after which the operator counts as absent.
QUESTIONS = 3


#: Shows a tumble: all points of the magnetometer, and the latest of the accelerometer, shape (n, 3) each [counts].
ShowPoints: TypeAlias = Callable[[NDArray[np.int16], NDArray[np.int16]], None]


def ignore_points(_points: object, _accelerometer: object) -> None:
    """Show no points."""


@dataclass(frozen=True, slots=True)
class Achieved:
    """Pose that a turntable reached, and its uncertainty [deg]."""

    heading_deg: float
    pitch_deg: float
    roll_deg: float
    uncertainty_deg: float

    def attitude(self, mounting_yaw_deg: float = 0.0) -> Pose:
        """Return the attitude of the board, which is turned on the table by its mounting."""
        return Pose(wrap_360(self.heading_deg + mounting_yaw_deg), self.pitch_deg, self.roll_deg)


class Turntable(Protocol):
    """A table that turns the board; its angle is the reference for headings."""

    name: str
    uncertainty_deg: float

    def turn_to(self, pose: Pose, *, known_angle: int | None = None) -> Achieved:
        """Turn to a pose, stand still there, and return the pose that was reached.

        Parameters
        ----------
        pose
            Pose of the table, without the mounting of the board.
        known_angle
            Index of the known angle; None for another pose.
        """

    def turn_to_face(self, face: Face) -> None:
        """Put the board on one of its six faces, and stand still there."""

    def tumble(self, duration_s: float) -> float:
        """Start a tumble, and return its duration [s] without waiting.

        Parameters
        ----------
        duration_s
            Minimum time for the sensor. A slower table returns its own duration, and points are then collected over all
            of it.
        """

    def tumbled(self) -> float | None:
        """Return the completed part of the tumble, by the table's position; None if the table does not know it."""

    def sway(self) -> float:
        """Start to turn and tilt the board from the pose of `rest`, at tens of degrees per second, without waiting.

        Returns
        -------
        float
            Time until the board is at rest again [s].
        """

    def rest(self) -> None:
        """Stand level and still."""

    def mount(self, axis: Axis) -> None:
        """Stand still with a body axis straight down, the axis of a later `turn`."""

    def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
        """Start to turn about the vertical, and return the required sampling time [s] without waiting.

        Parameters
        ----------
        axis
            Axis that `mount` has pointed down.
        degrees
            Positive is clockwise seen from above.
        rate_dps
            Rate of the table; it stands still for the first `BEFORE_TURN_S`, and at the end of the time.
        """

    def again(self, why: str) -> bool:
        """Report why a position of the board was refused; return whether it is set again.

        An operator can improve it; motors would reach the same position.
        """

    def close(self) -> None:
        """Close its port, if it has one."""


class SimulatedTurntable:
    """The table of a virtual board's world: exact, and as fast as its motors.

    Parameters
    ----------
    stage
        Stage of the board.
    uncertainty_deg
        Declared uncertainty of the reference.
    """

    name = "simulated"

    def __init__(self, stage: Stage, *, uncertainty_deg: float) -> None:
        self._stage = stage
        self.uncertainty_deg = uncertainty_deg

    def turn_to(self, pose: Pose, *, known_angle: int | None = None) -> Achieved:
        """Turn, and let the virtual clock run until the table stands."""
        self._stage.turn_to(pose, known_angle=known_angle)
        return Achieved(pose.heading_deg, pose.pitch_deg, pose.roll_deg, self.uncertainty_deg)

    def turn_to_face(self, face: Face) -> None:
        """Turn until the face is down, with the world's misalignment."""
        self._stage.turn_to(face.pose, face=face)

    def tumble(self, duration_s: float) -> float:
        """Go to the first pose of a tumble and start it; the sensor sets its pace, unless the rig limits it."""
        return self._stage.tumble(duration_s)

    def tumbled(self) -> None:
        """Return None: the simulation's clock needs no position."""

    def sway(self) -> float:
        """Start the sway; return its duration [s]."""
        return self._stage.sway()

    def rest(self) -> None:
        """Stand level, heading north."""
        self._stage.turn_to(LEVEL)

    def mount(self, axis: Axis) -> None:
        """Tilt the board until the axis is down."""
        self._stage.turn_to(AXIS_DOWN[axis])

    def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
        """Turn at a constant rate."""
        return self._stage.turn_round(degrees, rate_dps=rate_dps, after_s=BEFORE_TURN_S) + AFTER_TURN_S

    def again(self, why: str) -> bool:
        """Refuse: the motors would reach the same position."""
        return False

    def close(self) -> None:
        """Do nothing: the table belongs to the board."""


class OperatorTurntable:
    """A person with a turntable, guided by prompts.

    Parameters
    ----------
    prompt
        Shows a text and returns the line that was typed, as `input` does.
    uncertainty_deg
        Uncertainty of setting and reading the table's scale.
    tumble_s
        Duration of a tumble by hand.
    shows_coverage
        True if the coverage of the sphere is shown meanwhile.
    look
        Returns the board as its sensors show it while a question without a known angle waits; None for questions
        without it.
    may_look
        True if the board may be read while a question waits: a recording has no place for it.
    show_points
        Shows a tumble.
    remark
        Text before the first question; empty or whole lines.
    """

    name = "operator"

    def __init__(
        self,
        *,
        prompt: Callable[[str], str],
        uncertainty_deg: float,
        tumble_s: float = HAND_TUMBLE_S,
        shows_coverage: bool = True,
        look: Callable[[], Glance] | None = None,
        may_look: bool = True,
        show_points: ShowPoints = ignore_points,
        remark: str = "",
    ) -> None:
        self._prompt, self._remark = prompt, remark
        self._look = look
        self.may_look, self.show_points = may_look, show_points
        self._shows_coverage = shows_coverage
        self._tumble_s = tumble_s
        self.uncertainty_deg = uncertainty_deg

    def turn_to(self, pose: Pose, *, known_angle: int | None = None) -> Achieved:
        """Ask for a pose; the operator may enter the heading that was actually reached.

        Raises
        ------
        OperatorAbsentError
            When nobody answers, or three consecutive answers are not angles.
        """
        number = "" if known_angle is None else f"pose {known_angle + 1}: "
        question = (
            f"{number}turn to heading {pose.heading_deg:g}, pitch {pose.pitch_deg:+g}, roll {pose.roll_deg:+g} "
            "and let it stand still. Enter when there, or type the heading reached: "
        )
        for _ in range(QUESTIONS):
            heading_deg = heading_of(self.ask(question, pose), pose.heading_deg)
            if heading_deg is not None:
                return self.achieved(pose, heading_deg)
        raise OperatorAbsentError(f"{QUESTIONS} answers were no heading between -360 and 360: is an operator there?")

    def achieved(self, pose: Pose, heading_deg: float) -> Achieved:
        """Return the reached pose at the operator's heading."""
        return Achieved(heading_deg, pose.pitch_deg, pose.roll_deg, self.uncertainty_deg)

    def turn_to_face(self, face: Face) -> None:
        """Ask for the board to be put on a face, square and on a level surface."""
        axes = f"{AXES_IN_WORDS}\n" if face is FACES[0] else ""
        self.ask(
            f"{axes}face {FACES.index(face) + 1} of 6: put the board {FACE_WORDS[face]}, square on a level surface, "
            "and let go of it. Enter when it lies still: ",
            face.pose,
        )

    def tumble(self, duration_s: float) -> float:
        """Ask the operator to tumble the board, at the pace of a hand."""
        takes_s = max(duration_s, self._tumble_s)
        self.ask(
            f"take the board in your hand, away from iron. Turn it all round for {takes_s:.0f} s: each of its six "
            f"sides and eight corners down once, about {takes_s / 15:.0f} s each. "
            f"{'How much of the sphere is seen is shown. ' if self._shows_coverage else ''}Enter to begin: "
        )
        return takes_s

    def tumbled(self) -> None:
        """Return None: a hand has no position."""

    def sway(self) -> float:
        """Ask the operator to turn and tilt the board, at the pace of a hand."""
        self.ask(
            f"turn the level board once round and on, tilting it by about 20 degrees to all sides meanwhile, and lay "
            f"it down again: all within {SWAY_S:.0f} s. Enter to begin: "
        )
        return SWAY_S

    def rest(self) -> None:
        """Ask for the board to lie still."""
        self.ask("put the board down level and leave it still; Enter when it is: ", LEVEL)

    def mount(self, axis: Axis) -> None:
        """Ask for the board to stand on the table, the axis down."""
        self.ask(
            f"put the board on the table {_MOUNTED[axis]}, its {axis.name.lower()} axis straight down, the table at "
            "its mark, and let it stand still. Enter when it does: ",
            AXIS_DOWN[axis],
        )

    def turn(self, axis: Axis, degrees: float, *, rate_dps: float) -> float:
        """Ask for the table to be turned by hand, with time for a late start and a slow turn."""
        turn_s = abs(degrees) / rate_dps
        takes_s = 2.0 * turn_s + 4.0
        way = "clockwise" if degrees > 0.0 else "anticlockwise"
        self.ask(
            f"press Enter, wait a second, then turn the table {way} (seen from above) by {abs(degrees):g} deg, back to "
            f"the mark where that is all round, in about {turn_s:.0f} s, and leave it; there are {takes_s:.0f} s. "
            "Enter to begin: "
        )
        return takes_s

    def again(self, why: str) -> bool:
        """Put the reason before the next question, which asks for the position once more."""
        self._remark = f"{why}.\n"
        return True

    def close(self) -> None:
        """Do nothing: there is no port."""

    def ask(self, question: str, pose: Pose | None = None) -> str:
        """Ask the operator; all questions of a hand-turned table use this method.

        Parameters
        ----------
        pose
            Requested attitude of the board; None if no single one is.

        Raises
        ------
        OperatorAbsentError
            When nobody answers.
        """
        if not isinstance(question, Question):
            question = Question(question, self._look, pose=pose)
        question, self._remark = question.after(self._remark), ""
        try:
            return self._prompt(question)
        except EOFError:
            raise OperatorAbsentError.asked(question) from None


def heading_of(answer: str, asked_deg: float) -> float | None:
    """Parse an answer as a heading [deg]: the requested one if it is empty; None if it is not a heading."""
    if not answer.strip():
        return asked_deg
    try:
        heading_deg = float(answer)
    except ValueError:
        return None
    return heading_deg if math.isfinite(heading_deg) and abs(heading_deg) <= 360.0 else None
