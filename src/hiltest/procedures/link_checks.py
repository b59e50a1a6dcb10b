"""Link checks: payloads arrive intact, damaged frames are dropped, no request is executed twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from hiltest.boards.board import Board
from hiltest.errors import DeviceError, ProtocolError
from hiltest.link.framing import DELIMITER, ESCAPE, MAX_PAYLOAD, Frame, encode_frame
from hiltest.link.messages import MAX_POINTS_READ, MAX_UPLOAD, ClearPoints, LinkStatistics, Points, Upload
from hiltest.link.replies import Status
from hiltest.link.request import REPLY_BIT, decode_reply
from hiltest.procedures.cycles import upload_points

T = TypeVar("T")

# Code of a command that does not exist.
_UNKNOWN_COMMAND = 0x7F
# Sizes around every boundary of the frame format; the bytes are those that stuffing changes.
_PAYLOAD_SIZES = (0, 1, 2, 3, 4, 5, 7, 8, 9, 63, 64, 65, 255, 256, 257, 1023, MAX_PAYLOAD)
_POINT_NUMBERS = (1, 2, 3, 5, 10, 21, 42, MAX_POINTS_READ, MAX_UPLOAD)
# Number of attempts on a line that can have noise. With 0.03 % of the bytes flipped, the longest frame, of 2066 bytes,
# is damaged every second time: ten times in a row in one of a thousand checks.
_TRIES = 10
# Counts whose bytes are 7D and 7E in all combinations.
_AWKWARD_COUNTS = (0x7D7E, 0x7E7D, 0x7E7E, 0x7D7D, 0x5E7D, 0x5D7D)


@dataclass(frozen=True, slots=True)
class LinkCheck:
    """Result of a link check."""

    echoed: int
    """Payload sizes that arrived intact, as the board reported or returned them."""
    wrong: int
    """Number of other sizes that the board refused or changed in an intact frame, which noise cannot cause."""
    expected: int
    """Number of tried sizes."""
    damaged_sent: int
    damaged_counted: int
    """Number of frames with one wrong bit, and of those that the firmware reports as dropped."""
    damaged_answered: int
    """Number of damaged frames that were answered: must be 0."""
    repeated_answered: bool
    """True if a request sent twice with one sequence number got the same answer twice."""
    executed_once: bool
    """True if it was executed once."""
    uart_overruns: int
    """Bytes that the firmware lost in overruns since its reset."""
    noise: str
    """Failures that a repetition cured, which the line caused, not the firmware. Empty on a line without noise, such as
    a virtual board's."""


class _Line:
    """A line on which noise is distinguished from firmware faults by repetition.

    Attributes
    ----------
    healed : int
        Number of failures that a later attempt cured.
    """

    def __init__(self, board: Board) -> None:
        self._tries = 1 if board.line_is_exact else _TRIES
        self.healed = 0

    def ask(self, probe: Callable[[], T | None]) -> T | None:
        """Return the result of a probe, repeated while it is None."""
        for number in range(self._tries):
            result = probe()
            if result is not None:
                self.healed += number > 0
                return result
        return None


def check_link(board: Board) -> LinkCheck:
    """Exercise the link.

    Parameters
    ----------
    board
        Board whose point buffer is replaced.

    Raises
    ------
    BenchError, ProtocolError
        When the link is too bad to be checked.
    """
    line, began = _Line(board), len(board.session.attempts)
    heard = [line.ask(partial(_arrives_whole, board, size)) for size in _PAYLOAD_SIZES]
    heard += [_reads_back(board, number) for number in _POINT_NUMBERS]
    damage = _Damage(board)
    line.ask(damage.send)
    repeated = line.ask(lambda: _repeat(board))
    same_answer, executed_once = repeated or (False, False)
    noise = board.session.noise(began)
    if line.healed:
        noise = f"{line.healed} checks passed when they were repeated" + (f", {noise}" if noise else "")
    return LinkCheck(
        echoed=heard.count(True),
        wrong=heard.count(False),
        expected=len(heard),
        damaged_sent=damage.sent,
        damaged_counted=damage.counted,
        damaged_answered=damage.answered,
        repeated_answered=same_answer,
        executed_once=executed_once,
        uart_overruns=board.session.request(LinkStatistics()).uart_overruns,
        noise=f"the line is noisy: {noise}" if noise else "",
    )


def damaged_frames(sequence: int = 0x55) -> list[bytes]:
    """Return CLEAR_POINTS frames, each with one wrong bit in another byte of its body.

    Bits that would create or destroy a delimiter or an escape are excluded: an extra delimiter cuts the frame in two,
    and both pieces would be counted.
    """
    wire = encode_frame(Frame(ClearPoints.code, sequence, b""))
    frames = []
    for at in range(1, len(wire) - 1):
        choices = [wire[at] ^ (1 << bit) for bit in range(8)]
        if wire[at] != ESCAPE:
            wrong = next(value for value in choices if value not in (DELIMITER, ESCAPE))
            frames.append(wire[:at] + bytes([wrong]) + wire[at + 1 :])
    return frames


def _arrives_whole(board: Board, size: int) -> bool | None:
    """Send a payload under an unknown command, which the firmware refuses by name only in an intact frame."""
    payload = bytes([0x7E, 0x7D, 0x5E, 0x5D])[: min(size, 4)] + bytes(range(256)) * 4
    frame = board.session.numbered(_UNKNOWN_COMMAND, payload[:size])
    reply = board.session.exchange_raw(frame)
    expected = Frame(_UNKNOWN_COMMAND | REPLY_BIT, frame.sequence, bytes([Status.UNKNOWN_COMMAND]))
    return None if reply is None else reply == expected


def _reads_back(board: Board, number: int) -> bool:
    """Upload points made of awkward bytes and read them back."""
    points = np.resize(np.array(_AWKWARD_COUNTS, dtype=np.int16), (number, 3))
    upload_points(board, points)
    back = [
        board.session.request(Points(first, min(MAX_POINTS_READ, number - first))).magnetometer
        for first in range(0, number, MAX_POINTS_READ)
    ]
    return np.array_equal(np.concatenate(back), points)


class _Damage:
    """Frames with one wrong bit each, and the firmware's reaction to the latest trial."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self.sent = self.counted = self.answered = 0

    def send(self) -> bool | None:
        """Send the frames; return None unless each was counted, and none answered."""
        session = self._board.session
        frames = damaged_frames(session.numbered(ClearPoints.code, b"").sequence)
        before = session.request(LinkStatistics()).damaged
        self.sent, self.answered = len(frames), sum(self._is_answered(wire) for wire in frames)
        self.counted = session.request(LinkStatistics()).damaged - before
        return True if self.counted == self.sent and not self.answered else None

    def _is_answered(self, wire: bytes) -> bool:
        self._board.session.send_raw(wire)
        return self._board.session.listen(0.02) is not None


def _repeat(board: Board) -> tuple[bool, bool] | None:
    """Send an upload twice; return whether both answers were equal, and whether it was executed once, or None."""
    session = board.session
    session.request(ClearPoints())
    began, before = len(session.attempts), session.request(LinkStatistics())
    upload = Upload(0, [(1, 2, 3)])
    frame = session.next_frame(upload)
    first, second = session.exchange_raw(frame), session.exchange_raw(frame)
    if first is None or second is None:
        return None
    try:
        stored = decode_reply(upload, first.payload)
        # A second execution would be refused, because the request states that no point is stored yet.
        follow = session.request(Upload(1, [(4, 5, 6)]))
    except (ProtocolError, DeviceError):
        return False, False
    after = session.request(LinkStatistics())
    if session.noise(began):  # a retransmitted request also counts as repeated
        return None
    return first == second and after.repeated == before.repeated + 1, stored == 1 and follow == 2
