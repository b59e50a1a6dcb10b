"""What the board's serial receiver makes of bytes that come at any instant, in any piece, while anything runs."""

from __future__ import annotations

import random
import struct

import pytest

from hiltest.link.framing import DamagedFrame, Frame, FrameDecoder, encode_frame
from hiltest.link.messages import PROTOCOL_VERSION
from hiltest.link.replies import Status

from .bench import CLEAR_POINTS, READ, SYNC, UPLOAD, Bench, bench_with

BUFFER_BYTES = 4096
BYTE_S = 10 / 115_200
VERSION = PROTOCOL_VERSION.to_bytes(2, "little")
MAG3110 = 0
SAMPLE_S = 1 / 80


@pytest.fixture(scope="module")
def bench() -> Bench:
    return bench_with("i2c1")


def sync(sequence: int, nonce: int) -> bytes:
    return encode_frame(Frame(SYNC, sequence, struct.pack("<I", nonce)))


def some_piece(chance: random.Random, sequence: int) -> bytes:
    """One of what a line can bring: mostly requests."""
    whole = sync(sequence, chance.choice([0x7E7E7E7E, 0x7D7D7D7D, 0x5D7E5E7D, chance.getrandbits(32)]))
    damaged = bytearray(whole)
    damaged[chance.randrange(1, len(whole) - 1)] ^= 1 << chance.randrange(8)
    part = whole[: chance.randrange(len(whole))]
    return chance.choice([whole, whole, whole[1:], bytes(damaged), part, b"\x7e", b"\x7e\x7e", chance.randbytes(30)])


def replies_to(bench: Bench, pieces: list[tuple[bytes, float]]) -> list[Frame | DamagedFrame]:
    """Send pieces with pauses [s], and return what the board says until it has nothing more to say."""
    for piece, pause_s in pieces:
        bench.send(piece)
        bench.board.run_until(bench.board.time_s + len(piece) * BYTE_S + pause_s)
    bench.board.run_until(bench.board.time_s + 0.2)
    return FrameDecoder().feed(bench.board.uart0.host_read(bench.board.uart0.host_waiting))


@pytest.mark.parametrize("seed", range(6))
def test_every_frame_of_a_stream_cut_anywhere_is_answered_in_order(bench: Bench, seed: int) -> None:
    chance = random.Random(seed)
    stream = b"\x7e" + b"".join(some_piece(chance, sequence) for sequence in range(60)) + b"\x7e"
    feed = FrameDecoder().feed(stream)
    asked = [packet for packet in feed if isinstance(packet, Frame)]
    _, damaged_before, overruns_before, _ = bench.counters()
    cuts = sorted(chance.sample(range(1, len(stream)), 40))
    pieces = [stream[start:end] for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    # Pauses around the one byte time after which the line counts as idle and the FIFO is emptied.
    replies = replies_to(bench, [(piece, chance.uniform(0, 3 * BYTE_S)) for piece in pieces])
    answers = [(SYNC | 0x80, frame.sequence, b"\x00" + frame.payload + VERSION) for frame in asked]
    assert [(item.type, item.sequence, item.payload) for item in replies if isinstance(item, Frame)] == answers
    assert len(answers) >= 15
    _, damaged, overruns, _ = bench.counters()
    assert damaged - damaged_before == len(feed) - len(asked)
    assert overruns == overruns_before


def test_requests_back_to_back_are_all_answered(bench: Bench) -> None:
    stream = b"".join(sync(sequence, sequence * 0x01010101)[:-1] for sequence in range(100)) + b"\x7e"
    replies = replies_to(bench, [(stream, 0.0)])
    nonces = [struct.unpack_from("<BI", item.payload)[1] for item in replies if isinstance(item, Frame)]
    assert nonces == [sequence * 0x01010101 for sequence in range(100)]


def test_delimiters_alone_mean_nothing(bench: Bench) -> None:
    before = bench.counters()
    assert replies_to(bench, [(b"\x7e", 0.01), (b"\x7e" * 1000, 0.01), (b"\x7e", 0.01)]) == []
    assert bench.counters() == (before[0] + 1, *before[1:])


def test_a_line_that_never_ends_a_frame_fills_nothing(bench: Bench) -> None:
    before = bench.counters()
    assert replies_to(bench, [(b"U" * (5 * BUFFER_BYTES), 0.0)]) == []
    frames, damaged, overruns, _ = bench.counters()
    assert (frames, damaged, overruns) == (before[0] + 1, before[1] + 1, before[2])


def test_bytes_that_find_the_buffer_full_are_counted(bench: Bench) -> None:
    before = bench.counters()
    samples, too_many = 64, 900
    assert (BUFFER_BYTES + too_many) * BYTE_S < (samples - 1) * SAMPLE_S
    bench.send(encode_frame(Frame(READ, 1, struct.pack("<BBI", MAG3110, samples, 1_000_000))))
    bench.send(b"U" * (BUFFER_BYTES + too_many))
    reply = bench.receive()
    assert reply is not None
    assert reply.payload[0] == Status.OK
    frames, damaged, overruns, _ = bench.counters()
    assert (frames, damaged) == (before[0] + 2, before[1] + 1)
    assert overruns - before[2] == too_many


def test_nobody_is_woken_for_a_part_of_a_frame(bench: Bench) -> None:
    """The interrupts take 23 instructions a byte; a look of the server at each of them would add more than 20."""
    before = bench.board.instructions
    replies_to(bench, [(b"U" * 1000, 0.0)])
    assert (bench.board.instructions - before) / 1000 < 30
    bench.send(b"\x7e")


def test_a_received_byte_costs_little(bench: Bench) -> None:
    """A virtual board's wall time is mostly instructions: 46 a byte with interrupts, check, execution and reply."""
    bench.ask(CLEAR_POINTS)
    frame = encode_frame(Frame(UPLOAD, 77, struct.pack("<HB", 0, 160) + bytes(range(96)) * 10))
    before = bench.board.instructions
    (reply,) = replies_to(bench, [(frame, 0.0)])
    assert isinstance(reply, Frame)
    assert reply.payload == b"\x00\xa0\x00"
    assert (bench.board.instructions - before) / len(frame) < 55
    bench.ask(CLEAR_POINTS)
