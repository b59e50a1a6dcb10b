"""How fast a recording of packets is decoded."""

from __future__ import annotations

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hiltest.interfaces.packet_fields import Packet, layout
from hiltest.interfaces.packet_stream import batches
from hiltest.interfaces.packets import AltitudePacket, Release, decode, encode
from hiltest.link.framing import stuff

from .conftest import Report

BURSTS = 2000
# A burst is what a release sends 40 times a second, on a board without a pressure sensor.
SENT = [kind for kind in Release.V7.value[:-1] if kind is not AltitudePacket]


def recording(seed: int) -> bytes:
    """Packets of release 7 whose bytes are all equally likely, so that escapes are frequent."""
    random = np.random.default_rng(seed)
    bodies = (bytes([kind.type]) + random.bytes(layout(kind).size - 1) for _ in range(BURSTS) for kind in SENT)
    return b"".join(encode(decode(stuff(body))) for body in bodies)


@pytest.mark.benchmark(timer=time.process_time)
def test_decoding_a_recording(benchmark: BenchmarkFixture, report: Report) -> None:
    data = recording(1) * 20

    def count() -> int:
        return sum(len(table.rows) for batch in batches(data) for table in batch.tables)

    found = benchmark.pedantic(count, rounds=10, warmup_rounds=1)
    assert found == 20 * BURSTS * len(SENT)
    report(
        "packets: decoding a recording into arrays", len(data) / 1e6 / benchmark.stats.stats.min, "MB/s", "at least 20"
    )


@pytest.mark.benchmark(timer=time.process_time)
def test_decoding_a_recording_packet_by_packet(benchmark: BenchmarkFixture, report: Report) -> None:
    data = recording(1)

    def objects() -> list[Packet]:
        return [packet for batch in batches(data) for packet in batch.packets()]

    found = benchmark.pedantic(objects, rounds=10, warmup_rounds=1)
    assert len(found) == BURSTS * len(SENT)
    report("packets: decoding a recording into objects", len(data) / 1e6 / benchmark.stats.stats.min, "MB/s", "")
