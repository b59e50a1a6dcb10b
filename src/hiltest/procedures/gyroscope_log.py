"""Gyroscope log: every sample over any duration, without a gap."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.board import Board
from hiltest.link.gyroscope import LogGyroscope
from hiltest.link.replies import DPS_PER_COUNT, SAMPLE_RATE_HZ, Counts, SensorKind
from hiltest.procedures.progress import Progress, silent
from hiltest.procedures.rest import SamplesLostError

Reals = NDArray[np.float64]

# A reply of 64 samples takes 36 ms on the line, and the FIFO fills in 160 ms, which leaves 120 ms for host and USB.
CHUNK = 64


@dataclass(frozen=True, slots=True, eq=False)
class LogChunk:
    """Some samples of a log."""

    times_s: Reals
    """Shape (n,). Times of the samples, board's clock."""
    counts: Counts
    """Shape (n, 3)."""
    die_temperature_degc: int
    lost: bool
    """True if samples are missing before or among them."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeLog:
    """A log without a gap: rates, shape (n, 3) [deg/s], and the rate of sampling by the board's clock [Hz]."""

    rates_dps: Reals
    rate_hz: float


def log_chunks(board: Board, *, samples: int) -> Iterator[LogChunk]:
    """Yield the gyroscope's samples, chunk by chunk, up to `samples`.

    Raises
    ------
    SensorAbsentError
        When the board has no gyroscope.
    """
    board.sensor(SensorKind.GYROSCOPE)
    until_s, done = -math.inf, 0
    while done < samples:
        n = min(CHUNK, samples - done)
        reply = board.session.request(LogGyroscope(n, go_on=done > 0))
        first_s = reply.span.first_s if done == 0 else until_s + (reply.span.last_s - until_s) / n
        yield LogChunk(
            np.linspace(first_s, reply.span.last_s, n), reply.samples, reply.die_temperature_degc, reply.span.lost
        )
        until_s, done = reply.span.last_s, done + n


def log_gyroscope(board: Board, *, seconds: float, progress: Progress | None = None) -> GyroscopeLog:
    """Log the gyroscope of a still board.

    Raises
    ------
    SamplesLostError
        When the host was too slow for the part's FIFO.
    SensorAbsentError
        When the board has no gyroscope.
    """
    tell = progress or silent
    samples = math.ceil(seconds * SAMPLE_RATE_HZ)
    chunks: list[LogChunk] = []
    for chunk in log_chunks(board, samples=samples):
        if chunk.lost:
            raise SamplesLostError(
                f"samples of the gyroscope were lost {len(chunks) * CHUNK / SAMPLE_RATE_HZ:.1f} s into the log: the "
                "host was too slow. Run again on a machine with less load"
            )
        chunks.append(chunk)
        tell("gyroscope log", min(len(chunks) * CHUNK, samples), samples)
    times_s = np.concatenate([chunk.times_s for chunk in chunks])
    counts = np.concatenate([chunk.counts for chunk in chunks])
    return GyroscopeLog(counts * DPS_PER_COUNT, (len(times_s) - 1) / float(times_s[-1] - times_s[0]))
