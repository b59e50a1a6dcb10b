"""A turn about the vertical at a constant rate, for the calibration of a gyroscope."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hiltest.orientation.angles import Pose
from hiltest.world.earth_field import Vector
from hiltest.world.motion import MOVE_GRID_S

#: Duration of the acceleration and of the deceleration [s].
RAMP_S = 0.5


@dataclass(frozen=True, slots=True)
class SteadyTurn:
    """A turn of the table from its position: acceleration, constant rate, deceleration."""

    start_s: float
    end_s: float
    """Start and end, virtual time [s]."""
    begin: Pose
    """Initial pose with any tilt: the axis is the vertical, which stays fixed in the body."""
    turn_deg: float
    """Change of heading, of any size; positive is clockwise seen from above."""

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return pose and angle rates; from `end_s` on the turn is complete."""
        rate_dps = self.turn_deg / (self.end_s - self.start_s - RAMP_S)
        elapsed_s, left_s = time_s - self.start_s, self.end_s - time_s
        if left_s <= 0.0:
            gone_deg, share = self.turn_deg, 0.0
        elif elapsed_s < RAMP_S:
            gone_deg, share = rate_dps * _ramp_s(elapsed_s), _rise(elapsed_s)
        elif left_s < RAMP_S:
            gone_deg, share = self.turn_deg - rate_dps * _ramp_s(left_s), _rise(left_s)
        else:
            gone_deg, share = rate_dps * (elapsed_s - 0.5 * RAMP_S), 1.0
        pose = Pose(self.begin.heading_deg + gone_deg, self.begin.pitch_deg, self.begin.roll_deg)
        return pose, (rate_dps * share, 0.0, 0.0)


def steady_turn(begin: Pose, turn_deg: float, *, rate_dps: float, start_s: float) -> SteadyTurn:
    """Plan a turn at a rate, or a little below it: it ends on the grid of moves."""
    steps = math.ceil((abs(turn_deg) / rate_dps + RAMP_S) / MOVE_GRID_S - 1e-9)
    return SteadyTurn(start_s, (round(start_s / MOVE_GRID_S) + steps) * MOVE_GRID_S, begin, turn_deg)


def _rise(time_s: float) -> float:
    """Return the share of the rate during the acceleration, without a step in the acceleration at either end."""
    u = time_s / RAMP_S
    return u * u * (3.0 - 2.0 * u)


def _ramp_s(time_s: float) -> float:
    """Return the integral of `_rise`: the equivalent time at full rate [s]."""
    u = time_s / RAMP_S
    return RAMP_S * u * u * u * (1.0 - 0.5 * u)
