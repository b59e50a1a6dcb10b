"""The three motors of a virtual board's turntable: queued moves, hold, stop, home."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from hiltest.orientation.angles import Pose
from hiltest.world import Vector
from hiltest.world.motion import Brake, MotionSegment, Turn, brake_on, next_on_grid, travel_from

#: Length of the queue of moves, as in Grbl's planner.
CAPACITY = 15
HOME: Vector = (0.0, 0.0, 0.0)


class Bench(Protocol):
    """Axes of a table that turns the board."""

    @property
    def time_s(self) -> float:
        """Virtual time [s]."""

    def next_move_s(self) -> float:
        """Return the earliest start of a move that is planned now [virtual s]."""

    def begin_move(self, move: MotionSegment) -> None:
        """Start a move."""


@dataclass(frozen=True, slots=True)
class _Move:
    target_deg: Vector | None  # None for home, the short way
    feed_dpm: float | None  # None for the motors' fastest


class TableAxes:
    """Heading, pitch and roll motors. Angles accumulate over whole turns; all start and stop together.

    Parameters
    ----------
    bench
        Bench whose table stands level, heading north.

    Attributes
    ----------
    held : bool
        True if no move starts until `resume`.
    homing : bool
        True if homing is in progress.
    """

    def __init__(self, bench: Bench) -> None:
        self.held = False
        self.homing = False
        self._bench = bench
        self._waiting: deque[_Move] = deque()
        self._under_way: _Move | None = None
        self._segment: Turn | Brake | None = None
        self._stands_at: Vector = HOME

    @property
    def time_s(self) -> float:
        """Virtual time [s]."""
        return self._bench.time_s

    @property
    def turning(self) -> bool:
        """True if an axis is in motion."""
        return self._segment is not None

    @property
    def busy(self) -> bool:
        """True if an axis is in motion, or will be."""
        return self.turning or bool(self._waiting)

    @property
    def full(self) -> bool:
        """True if no further move can wait."""
        return len(self._waiting) >= CAPACITY

    @property
    def last_target_deg(self) -> Vector:
        """Angles at the end of all moves."""
        for move in (*reversed(self._waiting), self._under_way):
            if move is not None:
                return move.target_deg or HOME
        return self.now()[0] if self._segment is None else _triple(self._segment.angles(self._segment.end_s)[0])

    def now(self) -> tuple[Vector, float]:
        """Return the three angles [deg], and their combined rate [deg/s]."""
        if self._segment is None:
            return self._stands_at, 0.0
        # A move begins on the world's time grid, some milliseconds ahead.
        pose, rates_dps = self._segment.angles(max(self.time_s, self._segment.start_s))
        return _triple(pose), math.hypot(*rates_dps)

    def add(self, target_deg: Vector, *, feed_dpm: float | None) -> None:
        """Queue a move to angles; `feed_dpm` is its mean rate, None for the fastest."""
        if target_deg != self.last_target_deg:
            self._waiting.append(_Move(target_deg, feed_dpm))
        self.advance()

    def home(self) -> None:
        """Go to level and north the short way, and count the angles from there."""
        self.homing = True
        self._waiting.append(_Move(None, None))
        self.advance()

    def hold(self) -> None:
        """Stop the motion; current and waiting moves stay queued for `resume`."""
        self.held = True
        if self._brake() and self._under_way is not None:
            self._waiting.appendleft(self._under_way)
            self._under_way = None

    def resume(self) -> None:
        """Continue after `hold`."""
        self.held = False
        self.advance()

    def stop(self) -> None:
        """Stop the motion, and drop current and waiting moves."""
        self.held = self.homing = False
        self._waiting.clear()
        if self._brake():
            self._under_way = None

    def advance(self) -> None:
        """Finish moves that are over by now, and begin the next."""
        if self._segment is not None and self.time_s >= self._segment.end_s:
            self._arrive(self._segment)
        if self._segment is None and self._waiting and not self.held:
            self._begin(self._waiting.popleft())

    def _begin(self, move: _Move) -> None:
        target = move.target_deg or _nearest_turn(self._stands_at)
        travel = _difference(target, self._stands_at)
        duration_s = math.hypot(*travel) / (move.feed_dpm / 60.0) if move.feed_dpm else 0.0
        start_s = self._bench.next_move_s()
        self._under_way = move
        self._go(travel_from(Pose(*self._stands_at), travel, start_s=start_s, duration_s=duration_s))

    def _arrive(self, segment: Turn | Brake) -> None:
        self._stands_at = _triple(segment.angles(segment.end_s)[0])
        move, self._under_way, self._segment = self._under_way, None, None
        if move is None:
            return
        # The sum of begin and travel may miss the target by a rounding.
        self._stands_at = move.target_deg or HOME
        if move.target_deg is None:
            self.homing = False

    def _brake(self) -> bool:
        """Start to decelerate; return False if there is no motion, or it ends as soon by itself."""
        if not isinstance(self._segment, Turn):
            return False
        start_s = max(next_on_grid(self.time_s), self._segment.start_s)
        brake = brake_on(self._segment, start_s=start_s)
        if brake is not None:
            self._go(brake)
        return brake is not None

    def _go(self, segment: Turn | Brake) -> None:
        self._segment = segment
        self._bench.begin_move(segment)


def _triple(pose: Pose) -> Vector:
    return pose.heading_deg, pose.pitch_deg, pose.roll_deg


def _difference(target_deg: Vector, begin_deg: Vector) -> Vector:
    heading, pitch, roll = (to - since for to, since in zip(target_deg, begin_deg, strict=True))
    return heading, pitch, roll


def _nearest_turn(angles_deg: Vector) -> Vector:
    heading, pitch, roll = (360.0 * round(angle / 360.0) for angle in angles_deg)
    return heading, pitch, roll
