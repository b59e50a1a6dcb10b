"""Questions to an operator, with the board as its sensors show it meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

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

    progress: str = ""
    """Progress of the known angles; empty for other questions."""

    def __str__(self) -> str:
        """Return the text beside the question."""
        motion = "moving" if self.moves else "still"
        if not self.progress:
            return motion
        heading = "no heading" if self.heading_deg is None else f"board {self.heading_deg:.1f} deg"
        turned = "" if self.turned_deg is None else f", turned {round(self.turned_deg):+d}"
        return f"{heading}{turned}, {motion}; {self.progress}"


def attitude_by(gravity: Iterable[float], heading_deg: float | None) -> Pose:
    """Return the attitude of a board that stands, from gravity along its axes, shape (3,), in any unit.

    A board on its nose or tail has no roll.
    """
    x, y, z = gravity
    across = math.hypot(y, z)
    roll_deg = math.degrees(math.atan2(y, z)) if across > _LEAST_ACROSS * abs(x) else 0.0
    return Pose(heading_deg or 0.0, math.degrees(math.atan2(-x, across)), roll_deg)


class Question(str):
    """A question, with the board as it is beside it until the answer."""

    live: Callable[[], object] | None = None
    """Returns the text beside it, or a `Glance`; it may query the board, and is not called without a terminal or page.
    None if the board may not be asked."""
    pose: Pose | None = None
    """Requested attitude of the board; None if no single one is."""
    asked_deg: float | None = None
    """Turn about the vertical from the last known angle to the requested one, the short way round."""
    wishes: Sequence[str] = ()
    """Answers beside Enter, in words."""
    takes_heading: bool = False
    """True if the answer may be a heading."""

    def __new__(cls, text: str, live: Callable[[], object] | None = None, **attributes: Any) -> Question:
        """Create a text with the attributes."""
        question = super().__new__(cls, text)
        vars(question).update(attributes, live=live)
        return question

    def after(self, remark: str) -> Question:
        """Return the question with a text before it."""
        return Question(remark + self, **vars(self))
