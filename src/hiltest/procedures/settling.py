"""Wait until what a board says has settled: found from what it says, not guessed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from hiltest.angles import circular_mean_deg, wrap_180
from hiltest.boards.board import BoardKind
from hiltest.boards.compass import CompassBoard
from hiltest.device.frames import Frame
from hiltest.device.quantities import Observation, Quantity
from hiltest.errors import DeviceTimeoutError

SETTLED_DEG = 0.1
"""Headings of two windows that are so near are one heading."""
STANDARD_ERRORS = 2.0
"""Or so near by their own noise."""
NEIGHBOURS_DEG = 5.0
"""Two headings in a row at rest are so near: noise of 0.7 uT in 20 makes 2 degrees, a changed high byte 25."""
# A quotient of two times may lie below its whole number by rounding.
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class Settled:
    """What a board said at the end of its wait."""

    heading_deg: float
    """Mean of the last window, from magnetic north, clockwise."""
    is_settled: bool
    """False where it still moved when the longest time was over."""
    took_s: float
    """From the beginning to the end of the last window."""
    window: Sequence[Observation]
    """All that was said in it."""
    unconfirmed: int = 0
    """Headings of all windows that were left out, since the one before and the one behind contradict them."""


def wait_until_settled(board: CompassBoard, frame: Frame, longest_s: float | None = None) -> Settled:
    """Listen until two windows in a row agree in their mean heading, or the longest time is over.

    Parameters
    ----------
    board
        Standing still; it offers a heading.
    frame
        In which its headings are.
    longest_s
        By default the rig's. The wait lasts for as many windows as fit into this time: their number does not depend on
        the nanoseconds by which a clock is read late.

    Raises
    ------
    DeviceTimeoutError
        When the board fell silent, or no heading of a whole window is confirmed.
    VersionMismatchError
        When what it says holds no heading.

    Notes
    -----
    Packets, and most lines, have no check value, and a serial line may change a byte: over one a heading without counts
    only where a neighbour confirms it.
    """
    device, began_s = board.device, board.now_s()
    longest_s = device.settle_s if longest_s is None else longest_s
    windows_left = math.floor(longest_s / device.window_s + _ROUNDING)
    before: list[float] = []
    unconfirmed = 0
    while True:
        window = board.observe(device.window_s)
        found = [each for each in window if Quantity.HEADING in each.values]
        headings_deg = [frame.heading_deg(float(each.values[Quantity.HEADING][0])) for each in found]
        if board.origin is BoardKind.REAL:
            said, headings_deg = len(headings_deg), confirmed(headings_deg, [each.checked for each in found])
            unconfirmed += said - len(headings_deg)
        if not headings_deg:
            if unconfirmed:
                raise DeviceTimeoutError("a heading that a neighbour confirms", device.window_s, board.clock)
            raise board.heading_missing(device.window_s, window)
        took_s = board.now_s() - began_s
        settled = bool(before) and agree(before, headings_deg)
        windows_left -= 1
        if settled or windows_left <= 0:
            return Settled(circular_mean_deg(headings_deg), settled, took_s, window, unconfirmed)
        before = headings_deg


def confirmed(headings_deg: Sequence[float], checked: Sequence[bool]) -> list[float]:
    """Return the headings that came with a right check value, or are near the one before or behind, if there is one."""
    near = [abs(wrap_180(after - one)) <= NEIGHBOURS_DEG for one, after in pairwise(headings_deg)]
    beside = [before or behind for before, behind in zip([False, *near], [*near, False], strict=True)]
    known = zip(headings_deg, beside, checked, strict=False)  # without headings there is one that is beside none
    return [heading for heading, is_near, is_checked in known if is_near or is_checked]


def agree(first_deg: Sequence[float], second_deg: Sequence[float]) -> bool:
    """Say whether the means of two windows of headings are the same, by `SETTLED_DEG` or by their noise."""
    mean_deg = circular_mean_deg(first_deg)
    apart_deg = abs(wrap_180(circular_mean_deg(second_deg) - mean_deg))
    error_deg = math.hypot(_standard_error(first_deg), _standard_error(second_deg))
    return apart_deg < max(SETTLED_DEG, STANDARD_ERRORS * error_deg)


def _standard_error(headings_deg: Sequence[float]) -> float:
    """Return the standard error of a mean heading; 0 of a single one, of which no noise is known."""
    if len(headings_deg) < 2:
        return 0.0
    mean_deg = circular_mean_deg(headings_deg)
    squares = math.fsum(wrap_180(heading_deg - mean_deg) ** 2 for heading_deg in headings_deg)
    return math.sqrt(squares / (len(headings_deg) - 1) / len(headings_deg))
