"""Collect calibration points while the board is turned all round."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hiltest.boards.board import Board
from hiltest.errors import FirmwareContradictionError, PoorCoverageError, TurntableError
from hiltest.link.messages import MAX_POINTS_READ, ClearPoints, Collect, Points
from hiltest.link.replies import SensorKind
from hiltest.procedures.coverage import sphere_coverage
from hiltest.procedures.cycles import upload_pairs
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.turntables import Turntable

Counts = NDArray[np.int16]

# The slowest magnetometer rate of the supported parts at the noise they are rated for.
_RATE_HZ = 80.0
# Reading points back between chunks takes time in which samples pass by.
_MARGIN = 1.5
# Points of a slow table between two looks at the coverage: 1.5 s of a hand's tumble.
_TOLD_EVERY = 10
# A point of a motor table may be so late on its way: half a second of 24. Then it is left for another tumble, of which
# a machine that needs more than these is none to measure with.
_MISSED = 0.02
_TUMBLES = 10
_LOOK_S = 0.01
# On a line with faults. Reading back takes a tenth of the time of the points, which a faultless one takes 1.10 of.
_LATE = 1.15
# Times what the controller's own rates promise.
_PATIENCE = 10.0
_GOLDEN_SECTION = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Tumble:
    """Points of a tumble, as in the board's buffer."""

    points: Counts
    accelerometer: Counts
    """Shape (n, 3). Magnetometer counts, and the accelerometer sample taken with each."""
    field_ut: float
    """Strength of the local field, as declared."""
    overruns: int
    """Samples that the sensor replaced before they were read."""
    duration_s: float
    """Board time from the first request to the last answer."""
    taken: NDArray[np.intp]
    """Shape (n,). How many of the points were taken before each."""

    @property
    def coverage(self) -> float:
        """Part of the sphere outside of the largest uncovered cap, 0 to 1."""
        return self.coverage_of(len(self.points))

    def coverage_of(self, n: int) -> float:
        """Return the coverage of the first n points."""
        return sphere_coverage(self.points[:n], field_ut=self.field_ut)


def collect_tumble(
    board: Board, turntable: Turntable, *, points: int = 300, chunk: int = 100, progress: Progress | None = None,
    sleep: Callable[[float], None] | None = None,
) -> Tumble:
    """Tumble the board while it collects points, and read them back.

    Parameters
    ----------
    board
        Its point buffer is cleared first.
    points
        How many to collect; at most the board's buffer.
    chunk
        Points per request. Within a chunk the points are consecutive samples; progress
        and coverage are reported after each.
    sleep
        Waits for a number of seconds [s] of the board's clock, between the points of a slow table;
        by default the board's own.

    Returns
    -------
    Tumble
        As the board holds them: the first n of them are the first n samples of a table that
        turns as fast as the sensor measures. A slower one, such as a hand, is not round before its end:
        one point is then taken at a time, over all of its turn, and they are uploaded again in an order
        in which the first n, whatever n, are spread evenly over it.

    Raises
    ------
    SensorAbsentError
        When the board has no magnetometer.
    TurntableError
        When ten tumbles of a motor table are not enough to take them all, or ten of a simulated one on a line with
        faults, that was late in each.
    PoorCoverageError
        When more points are asked for than the board can hold.
    SensorFaultError
        When a point is none that a sound sensor gives.
    """
    board.sensor(SensorKind.MAGNETOMETER)
    if points > board.identity.max_points:
        raise PoorCoverageError(f"{points} points asked for; the board's buffer holds {board.identity.max_points}")
    wait = sleep or board.sleep
    for _ in range(_TUMBLES):
        tumble, was_late = _one_tumble(board, turntable, points, chunk, progress or silent, wait)
        if not was_late:
            return tumble
    raise TurntableError(
        f"in each of {_TUMBLES} tumbles a request or its answer was late: the points are not of the places that the "
        "table went through. Check the line: cable, ground and baud rate"
    )


def _one_tumble(
    board: Board, turntable: Turntable, points: int, chunk: int, progress: Progress, wait: Callable[[float], None]
) -> tuple[Tumble, bool]:
    """Tumble the board once; return its points, and whether they were late for a table that waits for none."""
    board.session.request(ClearPoints())
    fastest_s = _MARGIN * points / _RATE_HZ
    takes_s = turntable.tumble(fastest_s)
    slow = takes_s > fastest_s
    collected = _Collected(board, points, progress)
    began_s = board.now_s()
    if slow and turntable.tumbled() is not None:
        places = _collect_by_position(collected, turntable, takes_s, wait)
        return _spread_over_time(board, collected.tumble(board.now_s() - began_s), places), False
    while collected.stored < points:
        if slow:
            due_s = began_s + takes_s * collected.stored / points
            wait(max(0.0, due_s - board.now_s()))
        collected.add(1 if slow else min(chunk, points - collected.stored))
        if not slow or collected.stored % _TOLD_EVERY == 0 or collected.stored == points:
            collected.read_back()
    tumble = collected.tumble(board.now_s() - began_s)
    if slow:
        return _spread_over_time(board, tumble, tumble.taken), False
    late = not board.line_is_exact and tumble.duration_s > _LATE * points / _RATE_HZ
    return tumble, late


def collect_until(board: Board, end_s: float, *, points: int, progress: Progress | None = None) -> Tumble:
    """Collect points evenly over the time until an instant of the board's clock, whatever turns the board.

    Parameters
    ----------
    board
        Its point buffer is cleared first.
    end_s
        The instant [s]; fewer points are there by then where the line is too slow for all.
    points
        How many at most.

    Raises
    ------
    SensorAbsentError
        When the board has no magnetometer.
    """
    board.sensor(SensorKind.MAGNETOMETER)
    board.session.request(ClearPoints())
    collected = _Collected(board, min(points, board.identity.max_points), progress or silent)
    began_s = board.now_s()
    each_s = (end_s - began_s) / collected.wanted
    while collected.stored < collected.wanted and board.now_s() < end_s - each_s / 2.0:
        board.sleep(max(0.0, began_s + each_s * collected.stored - board.now_s()))
        collected.add(1)
    collected.read_back()
    return collected.tumble(board.now_s() - began_s)


def _collect_by_position(
    collected: _Collected, turntable: Turntable, takes_s: float, wait: Callable[[float], None]
) -> list[float]:
    """Take the points at even places of the tumble's way, and return the places in the order in which they were taken.

    The table says where it is: the clocks of a machine that is busy, of a board and of a table need not agree. What a
    slow machine misses is for another tumble; points in a row would be of one place.
    """
    missing, places = [number / collected.wanted for number in range(collected.wanted)], []
    for number in range(_TUMBLES):
        if number:
            takes_s = turntable.tumble(takes_s)
        gives_up_s, later = collected.now_s() + _PATIENCE * takes_s, []
        for place in missing:
            while (at := turntable.tumbled() or 0.0) < place and collected.now_s() < gives_up_s:
                wait(_LOOK_S)
            if not place <= at <= place + _MISSED:
                later.append(place)
                continue
            collected.add(1)
            places.append(place)
            if collected.stored % _TOLD_EVERY == 0 or collected.stored == collected.wanted:
                collected.read_back()
        missing = later
        if not missing:
            return places
    raise TurntableError(
        f"only {collected.stored} of {collected.wanted} points in {_TUMBLES} tumbles of {takes_s:.0f} s: the table "
        "does not follow its way, or this machine or the line is too slow to take one point at a time"
    )


@contextmanager
def held_as_taken(board: Board, tumble: Tumble) -> Iterator[None]:
    """Keep the points in the order of their time on the board, and restore that of the tumble afterwards."""
    in_time = np.argsort(tumble.taken)
    if np.array_equal(in_time, np.arange(len(in_time))):
        yield
        return
    upload_pairs(board, tumble.points[in_time], tumble.accelerometer[in_time])
    yield
    upload_pairs(board, tumble.points, tumble.accelerometer)


class _Collected:
    """Points so far: those that the board stored, and those that were read back."""

    def __init__(self, board: Board, points: int, tell: Progress) -> None:
        self.stored = self._overruns = self._back = 0
        self.wanted, self.now_s = points, board.now_s
        self._board, self._tell = board, tell
        self._magnetometer: list[Counts] = []
        self._accelerometer: list[Counts] = []

    def add(self, count: int) -> None:
        timeout_us = round(2e6 * count / _RATE_HZ + 1e6)
        reply = self._board.session.request(Collect(count, timeout_us=timeout_us))
        self._overruns += reply.overruns
        if reply.stored != self.stored + count:
            self._board.session.refuse_reset()
            raise FirmwareContradictionError(
                f"the firmware contradicts itself: it held {self.stored} points, was asked for {count} more, and holds "
                f"{reply.stored}"
            )
        self.stored = reply.stored

    def read_back(self) -> None:
        """Fetch the points that were stored since the last time, and report how much of the sphere they cover."""
        for first in range(self._back, self.stored, MAX_POINTS_READ):
            back = self._board.session.request(Points(first, min(MAX_POINTS_READ, self.stored - first)))
            self._magnetometer.append(back.magnetometer)
            self._accelerometer.append(back.accelerometer)
        self._back = self.stored
        seen = sphere_coverage(np.concatenate(self._magnetometer), field_ut=self._board.declared.field_ut)
        self._tell(f"tumble, {100 * seen:.0f} % of the sphere", self.stored, self.wanted)

    def tumble(self, duration_s: float) -> Tumble:
        magnetometer, accelerometer = np.concatenate(self._magnetometer), np.concatenate(self._accelerometer)
        self._board.sample_checks.tumble(magnetometer, accelerometer)
        return Tumble(
            magnetometer, accelerometer,
            self._board.declared.field_ut, self._overruns, duration_s, np.arange(self.stored),
        )


def evenly_spread(n: int) -> NDArray[np.intp]:
    """Return 0 to n - 1 in an order of which every beginning is spread evenly over all of them."""
    # Multiples of the golden section, modulo 1, are that for any number of them: rank i of 0..n-1 names its place.
    return np.argsort(np.argsort(np.arange(n) * _GOLDEN_SECTION % 1.0))


def _spread_over_time(board: Board, tumble: Tumble, places: ArrayLike) -> Tumble:
    """Upload the points again, in an order whose every beginning is spread evenly over the whole of their places."""
    order = np.argsort(places, kind="stable")[evenly_spread(len(tumble.points))]
    spread = replace(tumble, points=tumble.points[order], accelerometer=tumble.accelerometer[order], taken=order)
    upload_pairs(board, spread.points, spread.accelerometer)
    return spread
