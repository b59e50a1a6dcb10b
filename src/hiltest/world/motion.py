"""Motion of the body over time: holds, turns and a tumble.

All angles are piecewise polynomials and `sin_cos_deg`, so attitude and rate are equal to the last bit on every host.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from hiltest.orientation.angles import Pose, sin_cos_deg, wrap_180, wrap_360
from hiltest.world.earth_field import Vector

#: Every move starts and ends on this grid [s]: the least common multiple of the sampling periods 1/80 s and 1/200 s and
#: of 10 ms. Firmware that is a few cycles slower requests a move a little later and still gets the same motion, in the
#: same phase relative to the sampling instants.
MOVE_GRID_S = 0.05

#: Mean angular speed of a turn about its widest axis [deg/s]; the peak is 15/8 of it.
TURN_SPEED_DPS = 120.0

#: Duration of a turn by zero, so that arrival is always after the command [s].
SHORTEST_TURN_S = 0.1

#: Time in which an aborted move comes to rest [s].
BRAKE_S = 0.25


class MotionSegment(Protocol):
    """One piece of motion."""

    @property
    def start_s(self) -> float:
        """Virtual time at which the piece begins [s]."""

    @property
    def end_s(self) -> float:
        """Virtual time from which the piece holds its last attitude [s]."""

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return the pose and the rates of its three angles [deg/s] at a time within the piece."""


@dataclass(frozen=True, slots=True)
class Turn:
    """A move from rest to rest: each angle changes smoothly by the shorter way."""

    start_s: float
    end_s: float
    begin: Pose
    travel_deg: Vector

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return pose and angle rates; at and after `end_s` the travel is complete."""
        duration_s = self.end_s - self.start_s
        u = (time_s - self.start_s) / duration_s
        if u >= 1.0:
            share, speed = 1.0, 0.0
        else:
            # Quintic from 0 to 1 with zero speed and acceleration at both ends.
            share = u * u * u * (10.0 + u * (6.0 * u - 15.0))
            speed = 30.0 * u * u * (1.0 + u * (u - 2.0)) / duration_s
        heading, pitch, roll = self.travel_deg
        pose = Pose(
            self.begin.heading_deg + share * heading,
            self.begin.pitch_deg + share * pitch,
            self.begin.roll_deg + share * roll,
        )
        return pose, (speed * heading, speed * pitch, speed * roll)


@dataclass(frozen=True, slots=True)
class Brake:
    """An aborted move: each angle continues at its rate, and comes to rest within the piece."""

    start_s: float
    end_s: float
    begin: Pose
    begin_rates_dps: Vector

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return pose and angle rates; from `end_s` on it stands still."""
        duration_s = self.end_s - self.start_s
        u = min(1.0, (time_s - self.start_s) / duration_s)
        # The rate falls as 1 - 3 u^2 + 2 u^3, without a step in the acceleration at the end.
        remaining = 1.0 - u * u * (3.0 - 2.0 * u)
        gone_s = duration_s * u * (1.0 - u * u * (1.0 - 0.5 * u))
        heading, pitch, roll = self.begin_rates_dps
        pose = Pose(
            self.begin.heading_deg + gone_s * heading,
            self.begin.pitch_deg + gone_s * pitch,
            self.begin.roll_deg + gone_s * roll,
        )
        return pose, (remaining * heading, remaining * pitch, remaining * roll)


@dataclass(frozen=True, slots=True)
class PoseTour:
    """A tumble through given poses: the table stands at each for half of its time, then turns to the next."""

    start_s: float
    end_s: float
    poses: tuple[Pose, ...]

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return pose and angle rates; at the last pose it stands still."""
        share_s = (self.end_s - self.start_s) / len(self.poses)
        index = min(int((time_s - self.start_s) / share_s), len(self.poses) - 1)
        pose, leaves_s = self.poses[index], self.start_s + (index + 0.5) * share_s
        if index + 1 == len(self.poses) or time_s < leaves_s:
            return pose, (0.0, 0.0, 0.0)
        after = self.poses[index + 1]
        travel = wrap_180(after.heading_deg - pose.heading_deg), after.pitch_deg - pose.pitch_deg
        turn = Turn(leaves_s, leaves_s + share_s / 2.0, pose, (*travel, wrap_180(after.roll_deg - pose.roll_deg)))
        return turn.angles(time_s)


@dataclass(frozen=True, slots=True)
class TumbleMotion:
    """A rotation in which the board sees the field from all sides.

    The body rolls about 1.5 times a second while its nose sweeps slowly over both poles: a spiral. Its numbers come
    from a search, so that any 100 consecutive points at 80 Hz that begin within its first 0.1 s are as good for an
    ellipsoid fit as 100 uniformly random ones (predicted heading error of the worst known angle from noise in the fit:
    0.36 to 0.39 deg, random points 0.31 in the median, 0.42 at worst; coverage figure, largest M_ii/d_i of the direct
    fit on a mid-range anchor, about 1.85). The rate stays below 600 deg/s; at 400 deg/s 1.25 s are too short for more
    than half a sphere (best coverage figure found: 5.4).
    """

    start_s: float
    end_s: float

    def angles(self, time_s: float) -> tuple[Pose, Vector]:
        """Return pose and angle rates on the spiral; after `end_s` it stands still."""
        t = min(time_s, self.end_s) - self.start_s
        sine, cosine = sin_cos_deg(_SWEEP_DPS * t + _SWEEP_PHASE_DEG)
        pose = Pose(_HEADING_DEG + _HEADING_DPS * t, _SWEEP_DEG * sine, _ROLL_DEG + _ROLL_DPS * t)
        if time_s >= self.end_s:
            return pose, (0.0, 0.0, 0.0)
        sweep_dps = _SWEEP_DEG * cosine * math.radians(_SWEEP_DPS)
        return pose, (_HEADING_DPS, sweep_dps, _ROLL_DPS)


_HEADING_DEG, _HEADING_DPS = 143.0, 27.0
_ROLL_DEG, _ROLL_DPS = 132.0, 558.0
_SWEEP_DEG, _SWEEP_DPS, _SWEEP_PHASE_DEG = 111.0, 71.0, 145.0


def next_on_grid(time_s: float) -> float:
    """Return the first multiple of `MOVE_GRID_S` strictly after a time [s]."""
    # A nanosecond of tolerance, because a time on the grid may miss it by an ulp.
    return (math.floor(time_s / MOVE_GRID_S + 1e-9 / MOVE_GRID_S) + 1) * MOVE_GRID_S


def turn_between(begin: Pose, end: Pose, *, start_s: float) -> Turn:
    """Plan a turn whose duration depends on the two poses only, and ends on the grid."""
    travel = (
        wrap_180(end.heading_deg - begin.heading_deg),
        wrap_180(end.pitch_deg - begin.pitch_deg),
        wrap_180(end.roll_deg - begin.roll_deg),
    )
    return travel_from(begin, travel, start_s=start_s)


def travel_from(begin: Pose, travel_deg: Vector, *, start_s: float, duration_s: float = 0.0) -> Turn:
    """Plan a turn by angles of any size, in `duration_s` or longer if the table's speed requires it, on the grid."""
    shortest_s = max(SHORTEST_TURN_S, max(abs(angle) for angle in travel_deg) / TURN_SPEED_DPS)
    return Turn(start_s, _grid_point_after(start_s, max(shortest_s, duration_s)), begin, travel_deg)


def brake_on(turn: Turn, *, start_s: float) -> Brake | None:
    """Plan to brake on the path of a turn from a grid point on; return None if the turn ends as soon by itself."""
    if start_s + BRAKE_S >= turn.end_s:
        return None
    pose, rates_dps = turn.angles(start_s)
    return Brake(start_s, _grid_point_after(start_s, BRAKE_S), pose, rates_dps)


def _grid_point_after(start_s: float, duration_s: float) -> float:
    return (round(start_s / MOVE_GRID_S) + math.ceil(duration_s / MOVE_GRID_S - 1e-9)) * MOVE_GRID_S


def normal_angles(pose: Pose) -> Pose:
    """Return the same pose with heading in [0, 360) and pitch and roll in (-180, 180]."""
    return Pose(wrap_360(pose.heading_deg), wrap_180(pose.pitch_deg), wrap_180(pose.roll_deg))


def body_rate_dps(pose: Pose, angle_rates_dps: Vector) -> Vector:
    """Return the rates about the body axes, as an ideal gyroscope measures them [deg/s].

    Notes
    -----
    Kinematics of z-y'-x'' angles: p = roll' - heading' sin(pitch);
    q = pitch' cos(roll) + heading' sin(roll) cos(pitch);
    r = heading' cos(roll) cos(pitch) - pitch' sin(roll).
    """
    heading, pitch, roll = angle_rates_dps
    sin_p, cos_p = sin_cos_deg(pose.pitch_deg)
    sin_r, cos_r = sin_cos_deg(pose.roll_deg)
    return (
        roll - heading * sin_p,
        pitch * cos_r + heading * sin_r * cos_p,
        heading * cos_r * cos_p - pitch * sin_r,
    )


def angle_rates_dps(pose: Pose, body_rate: Vector) -> Vector:
    """Return the rates of heading, pitch and roll of a body that turns at `body_rate` [deg/s], the inverse.

    With the nose straight up or down heading and roll have the same axis, and roll takes the whole rate.
    """
    p, q, r = body_rate
    sin_p, cos_p = sin_cos_deg(pose.pitch_deg)
    sin_r, cos_r = sin_cos_deg(pose.roll_deg)
    heading = (q * sin_r + r * cos_r) / cos_p if cos_p else 0.0
    return heading, q * cos_r - r * sin_r, p + heading * sin_p
