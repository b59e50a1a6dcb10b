"""The true environment of a virtual board: field, gravity, attitude over time, temperature."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from hiltest.orientation.angles import Pose, rotation_rows, wrap_180
from hiltest.state import Restorable
from hiltest.world.distortion import MagneticDistortion
from hiltest.world.disturbances import Disturbances
from hiltest.world.earth_field import GRAVITY_NED_G, EarthField, Vector, apply_rows
from hiltest.world.motion import (
    MOVE_GRID_S,
    MotionSegment,
    PoseTour,
    TumbleMotion,
    Turn,
    body_rate_dps,
    next_on_grid,
    normal_angles,
    turn_between,
)
from hiltest.world.recorded_motion import Playback, Sensed
from hiltest.world.spiral import SPIRAL_S, Cap, Spiral
from hiltest.world.steady_turn import steady_turn
from hiltest.world.temperature import Temperature

# Noise epochs: 0 is the time since power-on; tumbles and known angles have their own, so that their noise does not
# depend on the time of arrival.
_TUMBLE_EPOCH = 1 << 32
_JUDGED_EPOCH = 2 << 32
# Tolerance for rounding of angles after many turns.
_SAME_PLACE_DEG = 1e-6
_STILL: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class WorldState:
    """Field, gravity and rate at one instant, in body components (NED: x forward, y right, z down)."""

    field_body_ut: Vector
    """True geomagnetic field, before any distortion [uT]."""
    gravity_body_g: Vector
    """Gravity, positive down: a level body has (0, 0, +1) [g]."""
    rate_body_dps: Vector
    """Angular rate [deg/s]."""
    pose: Pose
    """True attitude of the board, mounting included."""


class World(Restorable):
    """A bench: a turntable in the earth's field, and a board fixed on it.

    Parameters
    ----------
    field
        Local field.
    mounting_yaw_deg
        Turn of the board (with the wedges that tilt it) on the table, about the vertical: board heading = table heading
        + this, at every tilt [deg].
    temperature
        Temperature of the board.
    pose
        Pose of the table at power-on.
    covered
        Part of the sphere that a tumble covers; by default all of it.
    tumble_poses
        Poses that a tumble visits instead; by default none.
    disturbances
        Changes of the field of the earth and of the body's iron over time.

    Attributes
    ----------
    playback : Playback or None
        Recording that sensors measure instead of this world.
    disturbances : Disturbances or None
        Disturbances from the argument.

    Notes
    -----
    The table stands still from power-on. A move requested at `time_s` starts on the next point of `MOVE_GRID_S` after
    it, or at the end of the previous move, and its duration depends only on the two poses.
    """

    def __init__(
        self,
        field: EarthField,
        *,
        mounting_yaw_deg: float = 0.0,
        temperature: Temperature = Temperature(),  # noqa: B008 - frozen, so it may be shared
        pose: Pose = Pose(0.0),  # noqa: B008
        covered: Cap | None = None,
        tumble_poses: Sequence[Pose] = (),
        disturbances: Disturbances | None = None,
    ) -> None:
        self.field = field
        self.disturbances = disturbances
        self.playback: Playback | None = None
        self._covered = covered
        self._tumble_poses = tuple(tumble_poses)
        self.mounting_yaw_deg = mounting_yaw_deg
        self._temperature = temperature
        self._field_ned_ut = field.ned_ut
        self._table = pose  # pose at the end of the last move
        first = Turn(-MOVE_GRID_S, 0.0, self._table, _STILL)
        self._segments: list[MotionSegment] = [first]
        self._starts: list[float] = [first.start_s]
        self._resting: list[WorldState | None] = [None]
        self._epochs: list[tuple[int, float]] = [(0, 0.0)]
        self._epoch_starts: list[float] = [0.0]
        self._tumbles = 0

    def parts(self) -> tuple[Playback, ...]:
        """Return the recording that is played, if any."""
        return () if self.playback is None else (self.playback,)

    def turn_to(self, pose: Pose, *, time_s: float, known_angle: int | None = None) -> float:
        """Turn the table to a pose and stay there.

        Parameters
        ----------
        pose
            Pose of the table (mounting yaw not included).
        time_s
            Virtual time of the command [s].
        known_angle
            Index of the known angle: from arrival on, noise is a function of it.

        Returns
        -------
        float
            Virtual time of arrival, on the grid [s].
        """
        turn = turn_between(self._table, pose, start_s=self._earliest(time_s))
        self._append(turn, pose)
        self._begin_epoch(0, turn.start_s, origin_s=0.0)
        if known_angle is not None:
            self._begin_epoch(_JUDGED_EPOCH + known_angle, turn.end_s)
        return turn.end_s

    def tumble(self, *, time_s: float, duration_s: float) -> float:
        """Turn to the tumble's first pose, then tumble; return the virtual time of its end [s].

        The tumble itself begins at `last_move_start_s`, `duration_s` (rounded up to the grid) before its end: a board
        should start to collect then. The speed of coverage does not depend on the duration: a longer one continues. To
        cover a part of the sphere, the tumble takes `tumble_takes_s`, regardless of the request.
        """
        first = normal_angles(self._tumble(0.0, MOVE_GRID_S).angles(0.0)[0])
        begin = self._earliest(time_s) if self._table == first else self.turn_to(first, time_s=time_s)
        steps = math.ceil(self.tumble_takes_s(duration_s) / MOVE_GRID_S - 1e-9)
        end = (round(begin / MOVE_GRID_S) + steps) * MOVE_GRID_S
        tumble = self._tumble(begin, end)
        self._append(tumble, normal_angles(tumble.angles(end)[0]))
        self._begin_epoch(_TUMBLE_EPOCH + self._tumbles, begin)
        self._tumbles += 1
        return end

    def turn_round(self, turn_deg: float, *, rate_dps: float, time_s: float) -> float:
        """Turn about the vertical at a constant rate, from a time or the last move's end on; return its end [s]."""
        turn = steady_turn(self._table, turn_deg, rate_dps=rate_dps, start_s=self._earliest(time_s))
        self._append(turn, normal_angles(turn.angles(turn.end_s)[0]))
        self._begin_epoch(0, turn.start_s, origin_s=0.0)
        return turn.end_s

    def follow(self, segment: MotionSegment) -> None:
        """Follow a planned move instead of the rest of the last one.

        Parameters
        ----------
        segment
            Move from the table's pose at its `start_s`, which is in the future and not before the start of the last
            move; angles may differ by whole turns.

        Raises
        ------
        ValueError
            If the table would have to jump.
        """
        planned = segment.angles(segment.start_s)[0]
        last = self._segments[-1]
        present = last.angles(min(segment.start_s, last.end_s))[0]
        steps = (
            planned.heading_deg - present.heading_deg,
            planned.pitch_deg - present.pitch_deg,
            planned.roll_deg - present.roll_deg,
        )
        if segment.start_s < last.start_s or any(abs(wrap_180(step)) > _SAME_PLACE_DEG for step in steps):
            raise ValueError(f"a move from {planned} at {segment.start_s:g} s does not go on from {present}")
        self._append(segment, normal_angles(segment.angles(segment.end_s)[0]))
        self._begin_epoch(0, segment.start_s, origin_s=0.0)

    def tumble_takes_s(self, duration_s: float) -> float:
        """Return the duration of a tumble for a requested `duration_s` [s]; a spiral has its own pace."""
        return duration_s if self._covered is None else SPIRAL_S

    def hold(self, *, time_s: float, known_angle: int | None = None) -> float:
        """Hold the table's pose; return the grid point at which all earlier moves are over [s]."""
        start = self._earliest(time_s)
        if known_angle is not None:
            self._begin_epoch(_JUDGED_EPOCH + known_angle, start)
        return start

    @property
    def last_move_start_s(self) -> float:
        """Virtual time at which the last move begins; for a tumble, the arrival at its first pose [s]."""
        return self._segments[-1].start_s

    def state_at(self, time_s: float) -> WorldState:
        """Return the true state at a virtual time [s], also after the last command."""
        index = bisect_right(self._starts, time_s) - 1
        segment = self._segments[index]
        if time_s < segment.end_s:
            return self._state(*segment.angles(time_s))
        resting = self._resting[index]
        if resting is None:
            resting = self._resting[index] = self._state(segment.angles(segment.end_s)[0], _STILL)
        return resting

    def field_at_part_ut(self, distortion: MagneticDistortion, time_s: float) -> Vector:
        """Return the field at a part at a virtual time, distorted and disturbed, body frame [uT]."""
        state = self.state_at(time_s)
        if self.disturbances is None:
            return distortion.apply(state.field_body_ut)
        return self.disturbances.apply(distortion, state.field_body_ut, time_s, state.pose)

    def temperature_degc(self, time_s: float) -> float:
        """Return the temperature of the board at a virtual time [degC]."""
        return self._temperature.temperature_at(time_s)

    def recorded(self, sensed: Sensed, time_s: float, *, part: str, limit: float) -> Vector | None:
        """Return the recorded reading of a part at its sampling instant, body frame; None without a recording.

        Parameters
        ----------
        time_s
            The instant [s].
        part
            Name of the part's sensor, for people.
        limit
            Range of its axes, in the quantity's unit.
        """
        reading = self.playback.reading(sensed, time_s) if self.playback else None
        if self.playback and reading:
            self.playback.taken(part, reading, time_s, limit=limit, limit_words=f"{limit:g} {sensed.unit}")
        return reading

    def noise_epoch(self, time_s: float) -> tuple[int, float]:
        """Return the noise epoch at a time, and the time its samples are counted from [s]."""
        # The tolerance is that of the sampling instants: an instant on the grid belongs to the epoch that begins there.
        return self._epochs[bisect_right(self._epoch_starts, time_s + 1e-9) - 1]

    def _tumble(self, start_s: float, end_s: float) -> MotionSegment:
        if self._tumble_poses:
            return PoseTour(start_s, end_s, self._tumble_poses)
        if self._covered is None:
            return TumbleMotion(start_s, end_s)
        return Spiral(start_s, end_s, self._covered, self.field, self.mounting_yaw_deg)

    def _earliest(self, time_s: float) -> float:
        return max(next_on_grid(time_s), self._segments[-1].end_s)

    def _append(self, segment: MotionSegment, table: Pose) -> None:
        self._segments.append(segment)
        self._starts.append(segment.start_s)
        self._resting.append(None)
        self._table = table

    def _begin_epoch(self, key: int, start_s: float, *, origin_s: float | None = None) -> None:
        # If two epochs begin at one time, bisect_right returns the later one, which was requested last.
        self._epochs.append((key, start_s if origin_s is None else origin_s))
        self._epoch_starts.append(start_s)

    def _state(self, table: Pose, angle_rates_dps: Vector) -> WorldState:
        pose = Pose(table.heading_deg + self.mounting_yaw_deg, table.pitch_deg, table.roll_deg)
        rows = rotation_rows(pose)
        return WorldState(
            field_body_ut=apply_rows(rows, self._field_ned_ut),
            gravity_body_g=apply_rows(rows, GRAVITY_NED_G),
            rate_body_dps=body_rate_dps(pose, angle_rates_dps),
            pose=normal_angles(pose),
        )
