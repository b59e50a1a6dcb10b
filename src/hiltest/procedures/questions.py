"""Questions to an operator, with the board as its sensors show it meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from hiltest.orientation.angles import Pose

_LEAST_ACROSS = 0.1  # below it the noise of a sensor would turn the drawn board


class Glance(NamedTuple):
    """The board as its sensors show it while a question waits."""

    heading_deg: float | None
    """Heading from magnetic north; empty if the board has no heading."""
    moves: bool
    """True if the board moves."""
    attitude: Pose | None = None
    """Attitude by its own sensors; its heading is 0 if it is unknown."""
    noise: str = ""
    """rms noise of its sensors with their units; empty if unknown."""
    turned_deg: float | None = None
    """Turn about the vertical since the last known angle, by the gyroscope; None if unknown."""
    is_wrong_turn: bool = False
    """True if the board stands after another turn than the requested one."""

    def __str__(self) -> str:
        """Return the text beside the question."""
        heading = "no heading" if self.heading_deg is None else f"board {self.heading_deg:.1f} deg"
        turned = "" if self.turned_deg is None else f", turned {round(self.turned_deg):+d}"
        return f"{heading}{turned}, {'moving' if self.moves else 'still'}"


def attitude_by(gravity: Iterable[float], heading_deg: float | None) -> Pose:
    """Return the attitude of a board that stands, from gravity along its axes, shape (3,), in any unit.

    A board on its nose or tail has no roll.
    """
    x, y, z = gravity
    across = math.hypot(y, z)
    roll_deg = math.degrees(math.atan2(y, z)) if across > _LEAST_ACROSS * abs(x) else 0.0
    return Pose(heading_deg or 0.0, math.degrees(math.atan2(-x, across)), roll_deg)


class Live(str):
    """The text beside a question at one moment, with the glance that it describes."""

    glance: Glance

    def __new__(cls, text: str, glance: Glance) -> Live:
        """Create a text with its glance."""
        live = super().__new__(cls, text)
        live.glance = glance
        return live


class Question(str):
    """A question, with a live text beside it until the answer.

    Attributes
    ----------
    live : callable or None
        Returns the live text; it may query the board, and is not called without a terminal or page. None if the board
        may not be asked.
    pose : Pose or None
        Requested attitude of the board; None if no single one is.
    asked_deg : float or None
        Turn about the vertical from the last known angle to the requested one, the short way round.
    wishes : sequence of str
        Answers beside Enter, in words.
    takes_heading : bool
        True if the answer may be a heading.
    """

    def __new__(
        cls,
        text: str,
        live: Callable[[], str] | None = None,
        *,
        pose: Pose | None = None,
        asked_deg: float | None = None,
        wishes: Sequence[str] = (),
        takes_heading: bool = False,
    ) -> Question:
        """Create a text with the attributes."""
        question = super().__new__(cls, text)
        question.live, question.pose, question.asked_deg = live, pose, asked_deg
        question.wishes, question.takes_heading = wishes, takes_heading
        return question

    def after(self, remark: str) -> Question:
        """Return the question with a text before it."""
        question = Question(remark + self)
        vars(question).update(vars(self))
        return question

    live: Callable[[], str] | None
    pose: Pose | None
    asked_deg: float | None
    wishes: Sequence[str]
    takes_heading: bool
