"""Collect calibration points while the board tumbles."""

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
from hiltest.procedures.coverage import hole_in_words, sphere_coverage
from hiltest.procedures.cycles import upload_pairs
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.turntables import Turntable
from hiltest.rig import Rig

Counts = NDArray[np.int16]

# Slowest magnetometer rate of the supported parts at their rated noise.
_RATE_HZ = 80.0
# Factor for the samples that are missed while points are read back between chunks.
_MARGIN = 1.5
# Points of a slow table between two coverage reports: 1.5 s of a hand's tumble.
_REPORT_EVERY = 10
# Largest delay of a point on a motor table's path: half a second of 24. A later point is left for another tumble; a
# host that needs more tumbles than this is too slow to measure with.
_MISSED = 0.02
_TUMBLES = 10
_LOOK_S = 0.01
# Factor on a line with faults. Reading back takes a tenth of the points' time, so a faultless line has a factor of
# 1.10.
_LATE = 1.15
# Factor on the duration by the controller's rates.
_PATIENCE = 10.0
# Below this share of the sphere nothing holds an ellipsoid: `hiltest.verdict.causes` calls it poor coverage.
_LEAST_COVERAGE = 0.5
_GOLDEN_SECTION = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Tumble:
    """Points of a tumble, in the order of the board's buffer."""

    points: Counts
    accelerometer: Counts
    """Shape (n, 3). Magnetometer counts, and the accelerometer sample taken with each."""
    field_ut: float
    """Declared strength of the local field."""
    overruns: int
    """Number of samples that the sensor overwrote before they were read."""
    duration_s: float
    """Time of the board's clock from the first request to the last answer."""
    taken: NDArray[np.intp]
    """Shape (n,). Rank of each point in time."""
    cycles_per_point: float | None = None
    """Cycles of the requests that collected them, without sleep and interrupts; None if the board cannot observe
    them."""

    @property
    def coverage(self) -> float:
        """Part of the sphere outside the largest uncovered cap, 0 to 1."""
        return self.coverage_of(len(self.points))

    def coverage_of(self, n: int) -> float:
        """Return the coverage of the first n points."""
        return sphere_coverage(self.points[:n], field_ut=self.field_ut)


def collect_tumble(
    board: Board,
    turntable: Turntable,
    *,
    points: int = 300,
    chunk: int = 100,
    refuse: Callable[[Tumble], str] = lambda tumble: "",
    progress: Progress | None = None,
    sleep: Callable[[float], None] | None = None,
) -> Tumble:
    """Tumble the board while it collects points, and read them back.

    Parameters
    ----------
    board
        Board whose point buffer is cleared first.
    points
        Number of points, at most the capacity of the board's buffer.
    chunk
        Points per request. Within a chunk the points are consecutive samples; progress
        and coverage are reported after each.
    refuse
        Returns why a tumble does not suffice, empty if it does; an operator is then asked for another one.
    sleep
        Waits for a number of seconds [s] of the board's clock, between the points of a slow table;
        by default the board's own.

    Returns
    -------
    Tumble
        Points in the board's order: with a table that turns as fast as the sensor measures, the first n of them are the
        first n samples. A slower table, such as a hand, completes its turn only at the end: then points are taken one
        at a time over the whole turn, and uploaded again in an order whose first n, for any n, are spread evenly over
        it.

    Raises
    ------
    SensorAbsentError
        When the board has no magnetometer.
    TurntableError
        When ten tumbles of a motor table are not enough for all points, or ten of a simulated one on a line with faults
        that is late in each.
    PoorCoverageError
        When `points` exceeds the board's buffer.
    SensorFaultError
        When an intact sensor cannot give one of the points.
    """
    board.sensor(SensorKind.MAGNETOMETER)
    if points > board.identity.max_points:
        raise PoorCoverageError(f"{points} points asked for; the board's buffer holds {board.identity.max_points}")
    wait, late = sleep or board.sleep, 0
    while late < _TUMBLES:
        tumble, was_late = _one_tumble(board, turntable, points, chunk, progress or silent, wait)
        late += was_late
        reason = "" if was_late else refuse(tumble)
        if not was_late and not (reason and turntable.again(reason)):
            return tumble
    raise TurntableError(
        f"in each of {_TUMBLES} tumbles a request or its answer was late, so the points do not match the positions "
        "of the table. Check the line: cable, ground and baud rate"
    )


def poor_coverage(tumble: Tumble, rig: Rig) -> str:
    """Describe a tumble that covers less of the sphere than the rig's limit, or half without one; empty if it suffices.

    Points from which calibrators get fewer count as those fewer.
    """
    limit = rig.limits.get("tumble.coverage")
    least = _LEAST_COVERAGE if limit is None or limit.min is None else limit.min / 100.0
    n, field = rig.procedure.calibration_points, rig.field
    if (coverage := tumble.coverage_of(n)) >= least:
        return ""
    hole = hole_in_words(tumble.points[:n], field_ut=tumble.field_ut, dip_deg=field.dip_deg)
    return f"the tumble covers {coverage:.0%} of the sphere, at least {least:.0%} is needed: {hole}"


def _one_tumble(
    board: Board, turntable: Turntable, points: int, chunk: int, progress: Progress, wait: Callable[[float], None]
) -> tuple[Tumble, bool]:
    """Tumble the board once; return its points, and whether they were late for a table that does not wait."""
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
        if not slow or collected.stored % _REPORT_EVERY == 0 or collected.stored == points:
            collected.read_back()
    tumble = collected.tumble(board.now_s() - began_s)
    if slow:
        return _spread_over_time(board, tumble, tumble.taken), False
    late = not board.line_is_exact and tumble.duration_s > _LATE * points / _RATE_HZ
    return tumble, late


def collect_until(board: Board, end_s: float, *, points: int, progress: Progress | None = None) -> Tumble:
    """Collect points evenly over the time until an instant of the board's clock, whoever turns the board.

    Parameters
    ----------
    board
        Board whose point buffer is cleared first.
    end_s
        The instant [s]; if the line is too slow, there are fewer points by then.
    points
        Maximum number of points.

    Raises
    ------
    SensorAbsentError
        When the board has no magnetometer.
    """
    board.sensor(SensorKind.MAGNETOMETER)
    board.session.request(ClearPoints())
    collected = _Collected(board, min(points, board.identity.max_points), progress or silent)
    began_s = board.now_s()
    each_s = (end_s - began_s) / collected.total
    while collected.stored < collected.total and board.now_s() < end_s - each_s / 2.0:
        board.sleep(max(0.0, began_s + each_s * collected.stored - board.now_s()))
        collected.add(1)
    collected.read_back()
    return collected.tumble(board.now_s() - began_s)


def _collect_by_position(
    collected: _Collected, turntable: Turntable, takes_s: float, wait: Callable[[float], None]
) -> list[float]:
    """Take the points at equal steps of the tumble's path, and return their places in the order of time.

    The table reports its position, because the clocks of a busy host, a board and a table may differ. Places that a
    slow host misses are left for another tumble, because late points would all be at one place.
    """
    missing, places = [number / collected.total for number in range(collected.total)], []
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
            if collected.stored % _REPORT_EVERY == 0 or collected.stored == collected.total:
                collected.read_back()
        missing = later
        if not missing:
            return places
    raise TurntableError(
        f"only {collected.stored} of {collected.total} points in {_TUMBLES} tumbles of {takes_s:.0f} s: the table "
        "does not follow its path, or this machine or the line is too slow for single points"
    )


@contextmanager
def held_as_taken(board: Board, tumble: Tumble) -> Iterator[None]:
    """Put the points on the board in the order of time, and restore the tumble's order afterwards."""
    in_time = np.argsort(tumble.taken)
    if np.array_equal(in_time, np.arange(len(in_time))):
        yield
        return
    upload_pairs(board, tumble.points[in_time], tumble.accelerometer[in_time])
    yield
    upload_pairs(board, tumble.points, tumble.accelerometer)


class _Collected:
    """Points so far: stored on the board, and read back."""

    def __init__(self, board: Board, points: int, tell: Progress) -> None:
        self.stored = self._overruns = self._back = 0
        self.total, self.now_s = points, board.now_s
        self._board, self._tell = board, tell
        self._magnetometer: list[Counts] = []
        self._accelerometer: list[Counts] = []
        self._cycles: int | None = 0

    def add(self, count: int) -> None:
        timeout_us = round(2e6 * count / _RATE_HZ + 1e6)
        reply = self._board.session.request(Collect(count, timeout_us=timeout_us))
        self._overruns += reply.overruns
        cost = self._board.request_cost()
        self._cycles = None if cost is None or self._cycles is None else self._cycles + cost.awake_cycles
        if reply.stored != self.stored + count:
            self._board.session.refuse_reset()
            raise FirmwareContradictionError(
                f"the firmware contradicts itself: it held {self.stored} points, was asked for {count} more, and holds "
                f"{reply.stored}"
            )
        self.stored = reply.stored

    def read_back(self) -> None:
        """Fetch the points since the last call, and report their coverage of the sphere."""
        for first in range(self._back, self.stored, MAX_POINTS_READ):
            back = self._board.session.request(Points(first, min(MAX_POINTS_READ, self.stored - first)))
            self._magnetometer.append(back.magnetometer)
            self._accelerometer.append(back.accelerometer)
        self._back = self.stored
        coverage = sphere_coverage(np.concatenate(self._magnetometer), field_ut=self._board.declared.field_ut)
        self._tell(f"tumble, {100 * coverage:.0f} % of the sphere", self.stored, self.total)

    def tumble(self, duration_s: float) -> Tumble:
        magnetometer, accelerometer = np.concatenate(self._magnetometer), np.concatenate(self._accelerometer)
        self._board.protocol.sample_checks.tumble(magnetometer, accelerometer)
        return Tumble(
            magnetometer,
            accelerometer,
            self._board.declared.field_ut,
            self._overruns,
            duration_s,
            np.arange(self.stored),
            None if self._cycles is None else self._cycles / self.stored,
        )


def evenly_spread(n: int) -> NDArray[np.intp]:
    """Return 0 to n - 1 in an order whose prefixes are all spread evenly."""
    # Multiples of the golden ratio modulo 1 are spread evenly for any count: the rank of the i-th one is its place.
    return np.argsort(np.argsort(np.arange(n) * _GOLDEN_SECTION % 1.0))


def _spread_over_time(board: Board, tumble: Tumble, places: ArrayLike) -> Tumble:
    """Upload the points again, in an order whose prefixes are all spread evenly over their places."""
    order = np.argsort(places, kind="stable")[evenly_spread(len(tumble.points))]
    spread = replace(tumble, points=tumble.points[order], accelerometer=tumble.accelerometer[order], taken=order)
    upload_pairs(board, spread.points, spread.accelerometer)
    return spread
