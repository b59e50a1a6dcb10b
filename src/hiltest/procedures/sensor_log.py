"""Log of selected sensors: samples in the order of arrival, over any duration."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from hiltest.boards.board import Board
from hiltest.link.gyroscope import LogGyroscope
from hiltest.link.messages import Read
from hiltest.link.replies import DPS_PER_COUNT, G_PER_COUNT, MICROTESLA_PER_COUNT, SAMPLE_RATE_HZ, SensorKind
from hiltest.procedures.gyroscope_log import log_chunks

# Samples per request of sensors that are read in turn: 0.05 s each, so that the gyroscope's FIFO of 0.16 s does not
# overflow meanwhile.
_IN_TURN = {SensorKind.MAGNETOMETER: 4, SensorKind.ACCELEROMETER: 10}
# Samples per request of a single sensor: without a FIFO, samples are lost while a reply is on the line.
_ALONE = 64

UNITS = {
    SensorKind.GYROSCOPE: ("dps", DPS_PER_COUNT),
    SensorKind.ACCELEROMETER: ("g", G_PER_COUNT),
    SensorKind.MAGNETOMETER: ("uT", MICROTESLA_PER_COUNT),
}


@dataclass(frozen=True, slots=True)
class LogRow:
    """One sample."""

    time_s: float
    """Time of the sample, board's clock."""
    kind: SensorKind
    values: tuple[float, float, float]
    """Values in the unit of `UNITS`, body frame, uncalibrated."""
    temperature_degc: int
    """Temperature of the sensor's die."""


@dataclass(frozen=True, slots=True)
class LogPart:
    """Some rows in the order of time; `lost` if samples of the gyroscope are missing before or among them."""

    rows: tuple[LogRow, ...]
    lost: bool


def log_sensors(board: Board, kinds: Collection[SensorKind], *, seconds: float) -> Iterator[LogPart]:
    """Yield samples for a duration of the board's clock.

    The gyroscope gives every sample, the others only those during their requests.

    Raises
    ------
    SensorAbsentError
        When the board has not all of the sensors.
    """
    ids = {kind: board.sensor(kind).sensor_id for kind in kinds}
    if ids.keys() == {SensorKind.GYROSCOPE}:
        yield from _log_gyroscope_alone(board, seconds)
    else:
        yield from _log_in_turn(board, ids, seconds)


def _log_gyroscope_alone(board: Board, seconds: float) -> Iterator[LogPart]:
    for chunk in log_chunks(board, samples=math.ceil(seconds * SAMPLE_RATE_HZ)):
        timed = zip(chunk.times_s.tolist(), chunk.counts.tolist(), strict=True)
        rows = (_row(time_s, SensorKind.GYROSCOPE, counts, chunk.die_temperature_degc) for time_s, counts in timed)
        yield LogPart(tuple(rows), chunk.lost)


def _log_in_turn(board: Board, ids: Mapping[SensorKind, int], seconds: float) -> Iterator[LogPart]:
    gyroscope = _GyroscopeInTurn(board) if SensorKind.GYROSCOPE in ids else None
    begin_s: float | None = None
    last_s = -math.inf
    while begin_s is None or last_s - begin_s < seconds:
        rows: list[LogRow] = []
        lost = False
        for kind in ids.keys() - {SensorKind.GYROSCOPE}:
            rows += _read(board, kind, ids[kind], _ALONE if len(ids) == 1 else _IN_TURN[kind])
        if gyroscope is not None:
            more, lost = gyroscope.take()
            rows += more
        rows.sort(key=lambda row: row.time_s)
        begin_s = rows[0].time_s if begin_s is None else begin_s
        last_s = rows[-1].time_s
        yield LogPart(tuple(rows), lost)


def _read(board: Board, kind: SensorKind, sensor_id: int, count: int) -> list[LogRow]:
    reply = board.session.request(Read(sensor_id, count))
    return [
        _row(time_us * 1e-6, kind, counts, reply.die_temperature_degc)
        for time_us, counts in zip(reply.time_us.tolist(), reply.counts.tolist(), strict=True)
    ]


class _GyroscopeInTurn:
    """Reader of gyroscope samples that arrived in the FIFO while others were read."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._goes_on = False
        self.last_s = 0.0

    def take(self) -> tuple[list[LogRow], bool]:
        """Return the samples since the last call, and whether others are lost."""
        reply = self._board.session.request(LogGyroscope(0, self._goes_on))
        before_s = self.last_s if self._goes_on else reply.span.first_s - 1.0 / SAMPLE_RATE_HZ
        step_s = (reply.span.last_s - before_s) / len(reply.samples)
        self._goes_on, self.last_s = True, reply.span.last_s
        rows = [
            _row(before_s + step_s * (index + 1), SensorKind.GYROSCOPE, counts, reply.die_temperature_degc)
            for index, counts in enumerate(reply.samples.tolist())
        ]
        return rows, reply.span.lost


def _row(time_s: float, kind: SensorKind, counts: list[int], temperature_degc: int) -> LogRow:
    scale = UNITS[kind][1]
    x, y, z = (scale * count for count in counts)
    return LogRow(time_s, kind, (x, y, z), temperature_degc)
