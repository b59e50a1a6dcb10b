"""What is said of a stream: counts, rates and losses, whatever the line did to single packets."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from hiltest.interfaces.packet_fields import Packet
from hiltest.interfaces.packet_stream import PacketDecoder
from hiltest.interfaces.packet_summary import BoardClock, StreamSummary, summary_of
from hiltest.interfaces.packets import (
    AnglesPacket,
    DebugPacket,
    KalmanPacket422,
    KalmanPacket500,
    MagneticPacket7,
    MagneticPacket422,
    RatePacket,
    Release,
    encode,
)

STEP_US = 25_000


def stream(bursts: int, *, first_us: int = 0) -> list[Packet]:
    """Angles and angular rate, 40 a second."""
    return [
        packet
        for n in range(bursts)
        for packet in (
            AnglesPacket(2 * n % 256, (first_us + n * STEP_US) % 2**32, 1, 2, 3),
            RatePacket((2 * n + 1) % 256, (first_us + n * STEP_US) % 2**32, (1, 2, 3)),
        )
    ]


def summed(packets: Iterable[Packet], piece: int = 1000) -> StreamSummary:
    """Sum up packets that come in pieces, since what is kept from one to the next counts too."""
    summary, decoder, wire = StreamSummary(), PacketDecoder(), b"".join(map(encode, packets))
    for begin in range(0, len(wire), piece):
        summary.add(decoder.feed(wire[begin : begin + piece]))
    return summary


def test_clean_packets_are_counted_with_their_rate() -> None:
    summary = summed(stream(161))
    assert {kind: count for kind, count in summary.counts.items() if count} == {AnglesPacket: 161, RatePacket: 161}
    assert summary.rate_hz(AnglesPacket) == 40.0
    assert summary.rate_hz(DebugPacket) is None
    assert (summary.missing, summary.lost_bytes, summary.clock.resets) == (0, 0, 0)


def test_a_clock_that_begins_again_at_0_is_no_reset() -> None:
    summary = summed(stream(81, first_us=2**32 - 1_000_000))
    assert (summary.clock.elapsed_us, summary.clock.resets) == (2_000_000, 0)


def test_a_board_that_was_reset_is_said_and_its_time_goes_on() -> None:
    summary = summed([*stream(81, first_us=10_000_000), *stream(81)])
    assert summary.clock.resets == 1
    assert summary.clock.elapsed_us == pytest.approx(4_000_000, abs=2 * STEP_US)


def test_a_gap_of_minutes_counts_as_time_that_passed() -> None:
    summary = summed([*stream(81), *stream(81, first_us=300_000_000)])
    assert (summary.clock.elapsed_us, summary.clock.resets) == (302_000_000, 0)


@pytest.mark.parametrize("at", [0, 1, 40, 80])
@pytest.mark.parametrize("time_us", [0, 4_000_000_000, 1_400_000, 30_000_000])
def test_one_damaged_stamp_changes_neither_time_nor_rate(at: int, time_us: int) -> None:
    clock, stamps = BoardClock(), [1_000_000 + n * STEP_US for n in range(81)]
    stamps[at] = time_us
    for stamp in stamps:
        clock.advance(stamp)
    # At the ends a small damage cannot be told from a step; in between nothing remains of it.
    assert clock.elapsed_us == pytest.approx(2_000_000, abs=0 if at == 40 else 1_000_000)
    assert clock.resets == 0


@pytest.mark.parametrize("lost", [1, 3, 200])
def test_packets_that_are_missing_are_counted_by_their_numbers(lost: int) -> None:
    packets = stream(400)
    assert summed(packets[:301] + packets[301 + lost :]).missing == lost


def test_a_damaged_number_is_no_missing_packet() -> None:
    packets = stream(20)
    packets[20] = AnglesPacket(77, 10 * STEP_US, 1, 2, 3)
    assert summed(packets, 10_000).missing == 0


@pytest.mark.parametrize(
    ("packets", "releases"),
    [
        ([], []),
        ([DebugPacket(0, 720, 1)], [Release.V4_22, Release.V5_00, Release.V7]),
        ([MagneticPacket422(0, 1, 1, 1, (1, 1, 1))], [Release.V4_22, Release.V5_00]),
        ([MagneticPacket422(0, 1, 1, 1, (1, 1, 1)), KalmanPacket422(1, *((1, 1, 1),) * 3)], [Release.V4_22]),
        (
            [KalmanPacket422(0, *((1, 1, 1),) * 3), MagneticPacket7(1, 1, 1, 1, 1, (1, 1, 1))],
            [Release.V4_22, Release.V7],
        ),
        (
            [KalmanPacket500(0, *((1, 1, 1),) * 5, 1, (1, 1, 1), (1, 1, 1)), MagneticPacket7(1, 1, 1, 1, 1, (1, 1, 1))],
            [Release.V7],
        ),
    ],
)
def test_the_release_is_told_from_the_kinds_that_came(packets: list[Packet], releases: list[Release]) -> None:
    assert summed(packets).releases() == releases


def test_a_packet_that_lost_two_bytes_is_none_of_an_older_release() -> None:
    magnetic = [MagneticPacket7(n, 1, 1, 1, 1, (1, 1, 1)) for n in range(4)]
    wires = list(map(encode, magnetic))
    wires[1] = wires[1][:3] + wires[1][5:]
    summary, release = summary_of(b"".join(wires))
    assert release is Release.V7
    assert summary.kinds == (MagneticPacket7,)
    assert (summary.counts[MagneticPacket7], summary.lost_bytes, summary.missing) == (3, len(wires[1]) - 2, 1)
