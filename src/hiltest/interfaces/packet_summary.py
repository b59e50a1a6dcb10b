"""Summary of a stream of packets: counts, rates, and losses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hiltest.interfaces.packet_fields import Packet, TimedPacket
from hiltest.interfaces.packet_stream import PacketBatch, PacketTable, batches
from hiltest.interfaces.packets import KINDS, DebugPacket, Release

_US_PER_S = 1_000_000
_CLOCK = 1 << 32
# Bursts come 25 or 40 times a second. A longer step is a gap, a reset, or a damaged time stamp.
_LONGEST_STEP_US = _US_PER_S


class BoardClock:
    """The board's time from its stamps, which wrap to 0 after 71.6 minutes.

    A stamp that fits neither the one before nor the one after is damaged, and counts as no time.

    Attributes
    ----------
    elapsed_us : int
        Time since the first stamp. The unknown time before a reset counts as 0.
    resets : int
        Number of times that the time went back.
    """

    def __init__(self) -> None:
        self.elapsed_us = 0
        self.resets = 0
        self._last: int | None = None
        self._doubted: int | None = None

    def advance(self, time_us: int) -> float:
        """Add the next stamp; return the time since the first one [s]."""
        if self._last is not None and abs(step := _step_us(self._last, time_us)) <= _LONGEST_STEP_US:
            self._go(step, time_us)
        elif self._doubted is not None and abs(step := _step_us(self._doubted, time_us)) <= _LONGEST_STEP_US:
            jump = _step_us(self._last, self._doubted) if self._last is not None else 0
            self.resets += jump < 0
            self._go(max(jump, 0) + step, time_us)
        else:
            self._doubted = time_us
        return self.elapsed_us / _US_PER_S

    def _go(self, step_us: int, time_us: int) -> None:
        self.elapsed_us += step_us
        self._last, self._doubted = time_us, None


def _step_us(begin_us: int, end_us: int) -> int:
    """Return the shortest signed difference of two stamps, as the clock wraps."""
    return (end_us - begin_us + _CLOCK // 2) % _CLOCK - _CLOCK // 2


class StreamSummary:
    """Counts over the batches of a stream.

    Attributes
    ----------
    counts : dict of type of Packet to int
        Packets by kind.
    lost_bytes : int
        Bytes that belong to no packet.
    missing : int
        Minimum number of missing packets by their sequence numbers, which wrap after 256.
    clock : BoardClock
        The board's time.
    firmware : int or None
        Number of the firmware in the last debug packet: 422, 500, 720.
    """

    def __init__(self) -> None:
        self.counts: dict[type[Packet], int] = dict.fromkeys(KINDS, 0)
        self.lost_bytes = 0
        self.missing = 0
        self.clock = BoardClock()
        self.firmware: int | None = None
        self._last_number: int | None = None

    def add(self, batch: PacketBatch) -> None:
        """Count a batch."""
        self.lost_bytes += batch.lost_bytes
        for table in batch.tables:
            self.counts[table.kind] += len(table.rows)
            if table.kind is DebugPacket:
                self.firmware = int(table.rows["firmware"][-1])
        for time_us in _stamps(batch):
            self.clock.advance(time_us)
        self._count_missing(batch)

    @property
    def kinds(self) -> tuple[type[Packet], ...]:
        """Kinds of received packets, by type."""
        return tuple(sorted((kind for kind, count in self.counts.items() if count), key=lambda kind: kind.type))

    def rate_hz(self, kind: type[Packet]) -> float | None:
        """Return the rate of a kind by the board's time [Hz]; None without time stamps."""
        elapsed_s = self.clock.elapsed_us / _US_PER_S
        return (self.counts[kind] - 1) / elapsed_s if elapsed_s and self.counts[kind] > 1 else None

    def releases(self) -> list[Release]:
        """Return the releases that explain most packets: more than one if their kinds are the same."""
        sent = {release: sum(self.counts[kind] for kind in release.value) for release in Release}
        return [release for release, count in sent.items() if count and count == max(sent.values())]

    def release(self) -> Release | None:
        """Return the release; None while the packets do not determine it."""
        releases = self.releases()
        return releases[0] if len(releases) == 1 else None

    def _count_missing(self, batch: PacketBatch) -> None:
        numbers = batch.numbers().astype(np.int64)
        if numbers.size:
            before = [] if self._last_number is None else [self._last_number]
            numbers = np.concatenate([before, numbers]).astype(np.int64)
            # A number that does not fit between consecutive neighbours is damaged, not a sign of missing packets.
            places = np.flatnonzero((numbers[2:] - numbers[:-2]) % 256 == 2)
            numbers[places + 1] = numbers[places] + 1
            self.missing += int(((np.diff(numbers) - 1) % 256).sum())
            self._last_number = int(numbers[-1]) % 256


def summary_of(data: bytes) -> tuple[StreamSummary, Release | None]:
    """Return the summary of a recording, and its release if the packets determine it.

    Packets of other releases then count as damaged, and so as lost.
    """
    summary = _summarise(data, None)
    release = summary.release()
    foreign = release is not None and not set(summary.kinds) <= set(release.value)
    return (_summarise(data, release) if foreign else summary), release


def _summarise(data: bytes, release: Release | None) -> StreamSummary:
    summary = StreamSummary()
    for batch in batches(data, release):
        summary.add(batch)
    return summary


def _stamps(batch: PacketBatch) -> Iterator[int]:
    """Yield the distinct time stamps of a batch in the order of arrival."""
    timed: list[PacketTable] = [table for table in batch.tables if issubclass(table.kind, TimedPacket)]
    if timed:
        order = np.argsort(np.concatenate([table.at for table in timed]))
        stamps = np.concatenate([table.rows["time_us"] for table in timed])[order]
        changes = np.flatnonzero(np.diff(stamps)) + 1
        yield int(stamps[0])
        yield from stamps[changes].tolist()
