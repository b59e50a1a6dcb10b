"""Wait until a board's heading has settled, judged from its values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board, BoardKind
from hiltest.errors import DeviceTimeoutError
from hiltest.interfaces.frames import Frame
from hiltest.interfaces.quantities import Observation, Quantity
from hiltest.orientation.angles import circular_mean_deg, wrap_180
from hiltest.rig import COUNTS_PER_UT

SETTLED_DEG = 0.1
"""Largest difference of the headings of two windows that agree."""
STANDARD_ERRORS = 2.0
"""Largest difference in units of their own noise."""
NEIGHBOURS_DEG = 5.0
"""Largest difference of two consecutive headings at rest: noise of 0.7 uT in 20 makes 2 degrees, a changed high byte
25."""
COUNTS_PER_G = 16_384.0
"""Counts of `Board.delivered_fields`."""
# Steps that a format or an integer gives to headings, and the error of a heading below 360 degrees in float32.
_STEPS_DEG = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
_ROUNDING_OF_FLOAT32 = 2e-5
# Margin for a quotient of two times that rounding puts below a whole number.
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class Settled:
    """Board's observations at the end of a wait."""

    heading_deg: float
    """Mean of the last window, from magnetic north, clockwise."""
    is_settled: bool
    """True if it settled before the timeout."""
    took_s: float
    """Time from the start to the end of the last window."""
    window: Sequence[Observation]
    """Observations of the last window."""
    unconfirmed: int = 0
    """Number of headings in all windows that both neighbours contradict; those of a real board were dropped."""
    delivered: Mapping[str, tuple[int, NDArray[np.float64]]] | None = None
    """Number and mean, shape (3,) [uT], of the samples that each magnetometer delivered during the wait; None if the
    board does not observe them."""
    delivered_g: Mapping[str, tuple[int, NDArray[np.float64]]] | None = None
    """The same for each accelerometer [g]."""

    step_deg: float = 0.0
    """Largest usual step of which all headings of the last window are multiples; 0 if there is none."""

    @property
    def samples(self) -> int | None:
        """Number of samples that all magnetometers delivered during the wait; None if unknown."""
        return None if self.delivered is None else sum(count for count, _ in self.delivered.values())


def wait_until_settled(board: Board, frame: Frame, longest_s: float | None = None) -> Settled:
    """Listen until two consecutive windows agree in their mean heading, or until the timeout.

    Parameters
    ----------
    board
        Still board that offers a heading.
    frame
        Convention of its headings.
    longest_s
        Timeout; by default the rig's. The wait lasts for the number of windows that fit into this time, so that it does
        not depend on nanoseconds of clock reading.

    Raises
    ------
    DeviceTimeoutError
        When the board falls silent, or a whole window has no confirmed heading.
    VersionMismatchError
        When its output has no heading.

    Notes
    -----
    Packets and most lines have no check value, and a serial line may change a byte: so a heading without a check value
    counts only if a neighbour confirms it.
    """
    output, began_s, delivered = board.output, board.now_s(), board.delivered_fields()
    device = output.device
    longest_s = device.settle_s if longest_s is None else longest_s
    windows_left = math.floor(longest_s / device.window_s + _ROUNDING)
    before: list[float] = []
    unconfirmed = 0
    while True:
        window = output.observe(device.window_s)
        observations = [observation for observation in window if Quantity.HEADING in observation.values]
        headings_deg = [
            frame.heading_deg(float(observation.values[Quantity.HEADING][0])) for observation in observations
        ]
        if board.origin is BoardKind.REAL:
            count, headings_deg = (
                len(headings_deg),
                confirmed(headings_deg, [observation.checked for observation in observations]),
            )
            unconfirmed += count - len(headings_deg)
        else:  # a virtual line changes no byte, so that the firmware has sent all of them
            unconfirmed += isolated(headings_deg)
        if not headings_deg:
            if unconfirmed:
                raise DeviceTimeoutError("a heading that a neighbour confirms", device.window_s, board.clock)
            raise output.heading_missing(device.window_s, window)
        took_s = board.now_s() - began_s
        settled = bool(before) and agree(before, headings_deg)
        windows_left -= 1
        if settled or windows_left <= 0:
            after = board.delivered_fields()
            field, gravity = (
                _means_since(delivered, after, *unit) for unit in ((COUNTS_PER_UT, False), (COUNTS_PER_G, True))
            )
            mean_deg = circular_mean_deg(headings_deg)
            step_deg = step_of(headings_deg)
            return Settled(mean_deg, settled, took_s, window, unconfirmed, field, gravity, step_deg)
        before = headings_deg


def _means_since(
    before: Mapping[str, list[int]] | None, after: Mapping[str, list[int]] | None, per_unit: float, of_gravity: bool
) -> Mapping[str, tuple[int, NDArray[np.float64]]] | None:
    """Return number and mean of the samples between two looks, by magnetometer or by accelerometer."""
    if before is None or after is None:
        return None
    moved = {
        part: np.array(sums) - before.get(part, [0, 0, 0, 0])
        for part, sums in after.items()
        if part.endswith(" g") == of_gravity
    }
    return {part: (int(sums[0]), sums[1:] / (per_unit * sums[0])) for part, sums in moved.items() if sums[0]}


def step_of(headings_deg: Sequence[float]) -> float:
    """Return the largest step of `_STEPS_DEG` of which all headings are multiples; 0 if there is none."""
    return next((step for step in _STEPS_DEG if all(_is_multiple(value, step) for value in headings_deg)), 0.0)


def _is_multiple(value: float, step: float) -> bool:
    return abs(value / step - round(value / step)) < _ROUNDING_OF_FLOAT32 / step


def confirmed(headings_deg: Sequence[float], checked: Sequence[bool]) -> list[float]:
    """Return the headings with a correct check value, and those that are near the previous or the next one."""
    near = [abs(wrap_180(after - one)) <= NEIGHBOURS_DEG for one, after in pairwise(headings_deg)]
    beside = [before or behind for before, behind in zip([False, *near], [*near, False], strict=True)]
    neighbours = zip(headings_deg, beside, checked, strict=False)  # even without headings `beside` has one element
    return [heading for heading, is_near, is_checked in neighbours if is_near or is_checked]


def isolated(headings_deg: Sequence[float]) -> int:
    """Return the number of headings that both neighbours contradict although these agree with each other."""
    near = [abs(wrap_180(after - one)) <= NEIGHBOURS_DEG for one, after in pairwise(headings_deg)]
    around = [
        abs(wrap_180(after - one)) <= NEIGHBOURS_DEG for one, after in zip(headings_deg, headings_deg[2:], strict=False)
    ]
    return sum(agrees and not one and not other for agrees, (one, other) in zip(around, pairwise(near), strict=True))


def agree(first_deg: Sequence[float], second_deg: Sequence[float]) -> bool:
    """Return whether the means of two windows of headings are the same, by `SETTLED_DEG` or by their noise."""
    mean_deg = circular_mean_deg(first_deg)
    apart_deg = abs(wrap_180(circular_mean_deg(second_deg) - mean_deg))
    error_deg = math.hypot(_standard_error(first_deg), _standard_error(second_deg))
    return apart_deg < max(SETTLED_DEG, STANDARD_ERRORS * error_deg)


def _standard_error(headings_deg: Sequence[float]) -> float:
    """Return the standard error of a mean heading; 0 for a single one, whose noise is unknown."""
    if len(headings_deg) < 2:
        return 0.0
    mean_deg = circular_mean_deg(headings_deg)
    squares = math.fsum(wrap_180(heading_deg - mean_deg) ** 2 for heading_deg in headings_deg)
    return math.sqrt(squares / (len(headings_deg) - 1) / len(headings_deg))
