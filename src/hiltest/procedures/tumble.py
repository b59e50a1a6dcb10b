"""Collect calibration points while the board is turned all round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.errors import PoorCoverageError
from hiltest.link.messages import MAX_POINTS_READ, ClearPoints, Collect, Points, SensorKind
from hiltest.procedures.coverage import largest_hole_deg, sphere_coverage
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.turntables import Turntable

Counts = NDArray[np.int16]

# The slowest magnetometer rate of the supported parts at the noise they are rated for.
_RATE_HZ = 80.0
# Reading points back between chunks takes time in which samples pass by.
_MARGIN = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Tumble:
    """Points as the board holds them in its buffer.

    Attributes
    ----------
    points, accelerometer : ndarray of int16, shape (n, 3)
        Magnetometer counts, and the accelerometer sample taken with each.
    field_ut : float
        Strength of the local field, as declared.
    overruns : int
        Samples that the sensor replaced before they were read.
    duration_s : float
        Board time from the first request to the last answer.
    """

    points: Counts
    accelerometer: Counts
    field_ut: float
    overruns: int
    duration_s: float

    @property
    def coverage(self) -> float:
        """Part of the sphere outside of the largest hole, 0 to 1."""
        return self.coverage_of(len(self.points))

    def coverage_of(self, n: int) -> float:
        """Return the coverage of the first n points."""
        return sphere_coverage(self.points[:n], field_ut=self.field_ut)

    def largest_hole_deg_of(self, n: int) -> float:
        """Return the radius of the largest cap of the sphere that the first n points leave empty."""
        return largest_hole_deg(self.points[:n], field_ut=self.field_ut)


def collect_tumble(
    board: Board, turntable: Turntable, *, points: int = 300, chunk: int = 100, progress: Progress | None = None
) -> Tumble:
    """Tumble the board while it collects points, and read them back.

    Parameters
    ----------
    board : Board
        Its point buffer is cleared first.
    turntable : Turntable
    points : int
        How many to collect; at most the board's buffer.
    chunk : int
        Points per request. Within a chunk the points are consecutive samples; progress
        and coverage are told after each.

    Raises
    ------
    SensorAbsentError
        When the board has no magnetometer.
    PoorCoverageError
        When more points are asked for than the board can hold.
    """
    tell = progress or silent
    board.sensor(SensorKind.MAGNETOMETER)
    if points > board.identity.max_points:
        raise PoorCoverageError(f"{points} points asked for; the board's buffer holds {board.identity.max_points}")
    session, field_ut = board.session, board.declared.field_ut
    session.request(ClearPoints())
    turntable.tumble(_MARGIN * points / _RATE_HZ)
    began_s = board.now_s()
    magnetometer: list[Counts] = []
    accelerometer: list[Counts] = []
    stored = overruns = 0
    while stored < points:
        wanted = min(chunk, points - stored)
        reply = session.request(Collect(wanted, timeout_us=round(2e6 * wanted / _RATE_HZ + 1e6)))
        overruns += reply.overruns
        for first in range(stored, reply.stored, MAX_POINTS_READ):
            back = session.request(Points(first, min(MAX_POINTS_READ, reply.stored - first)))
            magnetometer.append(back.magnetometer)
            accelerometer.append(back.accelerometer)
        stored = reply.stored
        seen = sphere_coverage(np.concatenate(magnetometer), field_ut=field_ut)
        tell(f"tumble, {100 * seen:.0f} % of the sphere", stored, points)
    duration_s = board.now_s() - began_s
    return Tumble(np.concatenate(magnetometer), np.concatenate(accelerometer), field_ut, overruns, duration_s)
