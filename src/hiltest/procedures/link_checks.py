"""Link checks: payloads arrive whole, damaged frames are dropped, no request is done twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltest.boards.board import Board
from hiltest.errors import ProtocolError
from hiltest.link.framing import DELIMITER, ESCAPE, MAX_PAYLOAD, Frame, encode_frame
from hiltest.link.messages import MAX_POINTS_READ, MAX_UPLOAD, ClearPoints, LinkStatistics, Points, Upload
from hiltest.link.replies import Status
from hiltest.link.request import REPLY_BIT, decode_reply
from hiltest.procedures.cycles import upload_points

# A command that no firmware of this protocol has.
_UNKNOWN_COMMAND = 0x7F
# Sizes around every boundary of the frame format; bytes are those that stuffing changes.
_PAYLOAD_SIZES = (0, 1, 2, 3, 4, 5, 7, 8, 9, 63, 64, 65, 255, 256, 257, 1023, MAX_PAYLOAD)
_POINT_NUMBERS = (1, 2, 3, 5, 10, 21, 42, MAX_POINTS_READ, MAX_UPLOAD)
# Counts whose bytes are 7D and 7E in every mixture.
_AWKWARD_COUNTS = (0x7D7E, 0x7E7D, 0x7E7E, 0x7D7D, 0x5E7D, 0x5D7D)


@dataclass(frozen=True, slots=True)
class LinkCheck:
    """Result of a link check.

    Attributes
    ----------
    echoed : int
        Payload sizes that went to the board whole, by its own word or by coming back.
    expected : int
        How many were tried.
    damaged_sent, damaged_counted : int
        Frames with one wrong bit, and how many the firmware says it dropped.
    damaged_answered : int
        Damaged frames that were answered all the same: must be 0.
    repeated_answered : bool
        A request sent twice with one sequence number got the same answer twice.
    executed_once : bool
        And was carried out once.
    uart_overruns : int
        Bytes the firmware lost because it was late, since its reset.
    """

    echoed: int
    expected: int
    damaged_sent: int
    damaged_counted: int
    damaged_answered: int
    repeated_answered: bool
    executed_once: bool
    uart_overruns: int


def check_link(board: Board) -> LinkCheck:
    """Exercise the link.

    Parameters
    ----------
    board : Board
        Its point buffer is replaced.

    Raises
    ------
    BenchError, ProtocolError
        When the link does not even work well enough to be checked.
    """
    before = board.session.request(LinkStatistics())
    echoed = sum(_arrives_whole(board, size) for size in _PAYLOAD_SIZES)
    echoed += sum(_comes_back(board, number) for number in _POINT_NUMBERS)
    damaged = damaged_frames()
    answered = sum(_is_answered(board, wire) for wire in damaged)
    same_answer, executed_once = _repeat(board)
    after = board.session.request(LinkStatistics())
    return LinkCheck(
        echoed=echoed,
        expected=len(_PAYLOAD_SIZES) + len(_POINT_NUMBERS),
        damaged_sent=len(damaged),
        damaged_counted=after.damaged - before.damaged,
        damaged_answered=answered,
        repeated_answered=same_answer and after.repeated == before.repeated + 1,
        executed_once=executed_once,
        uart_overruns=after.uart_overruns,
    )


def damaged_frames() -> list[bytes]:
    """Return CLEAR_POINTS frames, each with one wrong bit in another byte of its body.

    Bits that would make or unmake a delimiter or an escape are left alone: a delimiter too
    many cuts the frame in two, and both pieces would be counted.
    """
    wire = encode_frame(Frame(ClearPoints.code, 0x55, b""))
    frames = []
    for at in range(1, len(wire) - 1):
        choices = [wire[at] ^ (1 << bit) for bit in range(8)]
        if wire[at] != ESCAPE:
            wrong = next(value for value in choices if value not in (DELIMITER, ESCAPE))
            frames.append(wire[:at] + bytes([wrong]) + wire[at + 1 :])
    return frames


def _arrives_whole(board: Board, size: int) -> bool:
    """Send a payload of a size under an unknown command: the frame must be whole to be refused by name."""
    payload = bytes([0x7E, 0x7D, 0x5E, 0x5D])[: min(size, 4)] + bytes(range(256)) * 4
    reply = board.session.exchange_raw(Frame(_UNKNOWN_COMMAND, size % 256, payload[:size]))
    return reply == Frame(_UNKNOWN_COMMAND | REPLY_BIT, size % 256, bytes([Status.UNKNOWN_COMMAND]))


def _comes_back(board: Board, number: int) -> bool:
    """Upload points made of awkward bytes and read them back."""
    points = np.resize(np.array(_AWKWARD_COUNTS, dtype=np.int16), (number, 3))
    upload_points(board, points)
    back = [
        board.session.request(Points(first, min(MAX_POINTS_READ, number - first))).magnetometer
        for first in range(0, number, MAX_POINTS_READ)
    ]
    return np.array_equal(np.concatenate(back), points)


def _is_answered(board: Board, wire: bytes) -> bool:
    board.session.send_raw(wire)
    return board.session.listen(0.02) is not None


def _repeat(board: Board) -> tuple[bool, bool]:
    """Send one upload twice: whether the answers are equal, and whether one point was stored."""
    session = board.session
    session.request(ClearPoints())
    upload = Upload(0, [(1, 2, 3)])
    frame = session.next_frame(upload)
    first, second = session.exchange_raw(frame), session.exchange_raw(frame)
    if first is None or second is None:
        return False, False
    try:
        stored = decode_reply(upload, first.payload)
    except ProtocolError:
        return False, False
    # Done a second time it would be refused, because it says that no point is stored yet.
    follow = session.request(Upload(1, [(4, 5, 6)]))
    return first == second, stored == 1 and follow == 2
