"""Packets in a stream: found however it is cut, whatever is between them, and whatever happened to one of them."""

from __future__ import annotations

import csv
from collections.abc import Callable
from itertools import accumulate, product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.interfaces.conftest import ANY_PACKET

from hiltest.interfaces.packet_fields import Packet
from hiltest.interfaces.packet_stream import PIECE, PacketDecoder, batches
from hiltest.interfaces.packets import (
    AnglesPacket,
    DebugPacket,
    KalmanPacket500,
    MagneticPacket7,
    MainPacket,
    RatePacket,
    Release,
    encode,
)

STREAM: list[Packet] = [
    MainPacket(0x7E, 0x7E7D7E7D, (1, 2, 3), (0x7E7E, 0x7D7D, 4), (5, 6, 7), (30_000, 0, 0, 0), 8, 5),
    DebugPacket(0x7F, 720, 0x7D5E),
    AnglesPacket(0x80, 25_000, -1800, 905, 0x5D7D),
    MagneticPacket7(0x81, 1, 2, 3, 4, (5, 6, 0x7E)),
    KalmanPacket500(0x82, *((0x7D7D, 2, 0x5E5E),) * 5, 0x7D5E, (1, 2, 3), (0x5D7E, 4, 5)),
    RatePacket(0x83, 50_000, (1, 2, 3)),
]
WIRES = [encode(packet) for packet in STREAM]
BEGINS = [0, *accumulate(map(len, WIRES))]
RECORDING = b"".join(WIRES)


def decoded(data: bytes, release: Release | None = None) -> list[Packet]:
    return [packet for batch in batches(data, release) for packet in batch.packets()]


def test_a_recording_cut_anywhere_has_every_packet_that_is_whole() -> None:
    for at in range(len(RECORDING) + 1):
        later = [packet for begin, packet in zip(BEGINS, STREAM, strict=False) if begin >= at]
        # A cut just before a packet's last byte leaves a delimiter with which the rest begins.
        assert decoded(RECORDING[at:]) == later, at
        before = [packet for end, packet in zip(BEGINS[1:], STREAM, strict=False) if end <= at]
        assert decoded(RECORDING[:at]) == before, at


def test_lost_bytes_cost_the_packets_that_they_belong_to_and_no_other() -> None:
    packets = [*zip(BEGINS, BEGINS[1:], STREAM, strict=False)]
    for at, lost in product(range(len(RECORDING)), [1, 2, 5]):
        untouched = [packet for begin, end, packet in packets if end <= at or begin >= at + lost]
        came = decoded(RECORDING[:at] + RECORDING[at + lost :], Release.V7)
        assert [packet for packet in came if packet in untouched] == untouched, (at, lost)
        # 7D 5E without its 7D is a body as long as before: without a check value that is a packet.
        kinds = iter(map(type, STREAM))
        assert all(type(packet) in kinds for packet in came), f"{at}, {lost}: none was made of parts of two"


def test_a_packet_with_a_wrong_escape_is_lost_with_its_bytes() -> None:
    for at, byte in product([at for at, byte in enumerate(RECORDING) if byte == 0x7D], [0x00, 0x7D]):
        damaged = bytearray(RECORDING)
        damaged[at + 1] = byte
        (hit,) = (place for place, begin in enumerate(BEGINS[:-1]) if begin <= at < BEGINS[place + 1])
        (batch,) = batches(bytes(damaged))
        assert batch.packets() == STREAM[:hit] + STREAM[hit + 1 :], (at, byte)
        assert batch.lost_bytes == len(WIRES[hit]) - 2, (at, byte)


@given(packets=st.lists(ANY_PACKET, max_size=12), sizes=st.lists(st.integers(1, 60), min_size=1, max_size=9))
def test_pieces_of_any_size_give_the_same_packets(packets: list[Packet], sizes: list[int]) -> None:
    wire = b"".join(map(encode, packets))
    decoder, results, at = PacketDecoder(), [], 0
    while at < len(wire):
        size = sizes[at % len(sizes)]
        batch = decoder.feed(wire[at : at + size])
        assert batch.lost_bytes == 0
        results += batch.packets()
        at += size
    assert results == packets
    assert decoder.unfinished == 0


_NOISE = st.lists(st.sampled_from([0x7E, 0x7D, 0x5E, 0x5D, 1, 2, 3, 6, 0]), max_size=300).map(bytes)


@given(pieces=st.lists(st.one_of(st.binary(max_size=300), _NOISE, ANY_PACKET.map(encode)), max_size=8))
def test_arbitrary_bytes_never_raise_and_each_is_accounted_for(pieces: list[bytes]) -> None:
    decoder, lost, of_packets = PacketDecoder(), 0, 0
    for piece in pieces:
        batch = decoder.feed(piece)
        lost += batch.lost_bytes
        of_packets += sum(len(encode(packet)) - 2 for packet in batch.packets())
        assert decoder.unfinished < 100
    delimiters = b"".join(pieces).count(b"\x7e")
    assert lost + of_packets + decoder.unfinished + delimiters == sum(map(len, pieces))


@given(noise=st.binary(max_size=300), packet=ANY_PACKET)
def test_a_packet_comes_whole_after_any_noise(noise: bytes, packet: Packet) -> None:
    assert decoded(noise + encode(packet))[-1:] == [packet]


def test_text_before_the_first_packet_is_skipped_and_counted() -> None:
    (batch,) = batches(b"ATSRM,2,0\r" + RECORDING)
    assert batch.packets() == STREAM
    assert batch.lost_bytes == 10


@pytest.mark.parametrize("byte", [0x00, 0x7D, 0x7E])
def test_a_line_that_repeats_one_byte_for_ever_keeps_nothing(byte: int) -> None:
    decoder = PacketDecoder()
    assert decoder.feed(RECORDING).packets() == STREAM
    for _ in range(20):
        assert decoder.feed(bytes([byte]) * 10_000).tables == ()
        assert decoder.unfinished < 100
    assert decoder.feed(b"\x7e" + RECORDING).packets() == STREAM


def test_bodies_that_are_longer_than_a_piece_of_the_recording_apart_come_in_order() -> None:
    again = PIECE // len(RECORDING) + 2
    result = list(batches(RECORDING * again))
    assert len(result) == 2
    assert [packet for batch in result for packet in batch.packets()] == STREAM * again
    places = np.sort(np.concatenate([table.at for batch in result for table in batch.tables]))
    assert places.tolist() == [len(RECORDING) * time + at + 1 for time in range(again) for at in BEGINS[:-1]]


def test_every_integer_of_the_truth_comes_out_of_the_recording(shared_data: Callable[[str], Path]) -> None:
    with shared_data("nxp_packets/imu.truth.csv").open(encoding="ascii") as file:
        truth = [[int(cell) for cell in row] for row in list(csv.reader(file))[1:]]
    result = list(batches(shared_data("nxp_packets/imu.bin").read_bytes()))
    assert sum(batch.lost_bytes for batch in result) == 0
    rows = np.concatenate([table.rows for batch in result for table in batch.tables if table.kind is MainPacket])
    assert np.hstack([rows["acceleration"], rows["field"], rows["rate"]]).tolist() == [row[2:] for row in truth]
    one_by_one = [packet for batch in result for packet in batch.packets() if isinstance(packet, MainPacket)]
    assert [[*item.acceleration, *item.field, *item.rate] for item in one_by_one] == [row[2:] for row in truth]


def test_a_table_is_read_in_units() -> None:
    (batch,) = batches(RECORDING)
    by_kind = {table.kind: table for table in batch.tables}
    assert by_kind[MainPacket].scaled_values("acceleration_g").tolist() == [[1 / 8192, 2 / 8192, 3 / 8192]]
    assert by_kind[AnglesPacket].scaled_values("roll_deg").tolist() == [-180.0]
