"""Wait until what a board says has settled: found from what it says, not guessed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hiltest.angles import circular_mean_deg, wrap_180
from hiltest.boards.compass import CompassBoard
from hiltest.device.frames import Frame
from hiltest.device.quantities import Observation, Quantity
from hiltest.errors import DeviceTimeoutError

SETTLED_DEG = 0.1
"""Headings of two windows that are so near are one heading."""
STANDARD_ERRORS = 2.0
"""Or so near by their own noise."""


@dataclass(frozen=True, slots=True)
class Settled:
    """What a board said at the end of its wait.

    Attributes
    ----------
    heading_deg : float
        Mean of the last window, from magnetic north, clockwise.
    is_settled : bool
        False where it still moved when the longest time was over.
    took_s : float
        From the beginning to the end of the last window.
    window : sequence of Observation
        All that was said in it.
    """

    heading_deg: float
    is_settled: bool
    took_s: float
    window: Sequence[Observation]


def wait_until_settled(board: CompassBoard, frame: Frame, longest_s: float | None = None) -> Settled:
    """Listen until two windows in a row agree in their mean heading, or the longest time is over.

    Parameters
    ----------
    board : CompassBoard
        Standing still; it offers a heading.
    frame : Frame
        In which its headings are.
    longest_s : float, optional
        By default the rig's.

    Raises
    ------
    DeviceTimeoutError
        When a whole window brings no heading.
    """
    device, began_s = board.device, board.now_s()
    longest_s = device.settle_s if longest_s is None else longest_s
    before: list[float] = []
    while True:
        window = board.observe(device.window_s)
        headings_deg = [
            frame.heading_deg(float(each.values[Quantity.HEADING][0]))
            for each in window if Quantity.HEADING in each.values
        ]  # fmt: skip
        if not headings_deg:
            raise DeviceTimeoutError("a heading", device.window_s, board.clock, board.position())
        took_s = board.now_s() - began_s
        settled = bool(before) and agree(before, headings_deg)
        if settled or took_s + device.window_s > longest_s:
            return Settled(circular_mean_deg(headings_deg), settled, took_s, window)
        before = headings_deg


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
    squares = math.fsum(wrap_180(each - mean_deg) ** 2 for each in headings_deg)
    return math.sqrt(squares / (len(headings_deg) - 1) / len(headings_deg))
