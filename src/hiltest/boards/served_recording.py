"""The line of a recorded run for any serial program: it returns the recorded answers with the recorded delays."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import NoReturn

from hiltest.boards.output_interface import POLLED
from hiltest.boards.served_lines import PortLine
from hiltest.errors import BenchError, DivergenceError, ProtocolError
from hiltest.link.framing import Frame, FrameDecoder, encode_frame
from hiltest.link.messages import Identify, Sync
from hiltest.link.request import REPLY_BIT, decode_reply
from hiltest.link.trace_text import frames_in_words
from hiltest.link.transcript import Direction, Transcript, TranscriptEntry
from hiltest.virtual.part.unique_id import REPLAYED_UNIQUE_ID

_DELIMITER = b"\x7e"
_STEP_S = 0.002
_AT_A_LOOK = 1 << 16
_NONCE = slice(1, 5)  # in the payload of an answer to SYNC, after the status


class ServedRecording:
    """The board's end of a recorded line.

    The program must send the bytes of the recorded host, except for the nonce of SYNC, which is returned to it. The
    board's unique id is `REPLAYED_UNIQUE_ID`, so that numbers of a recording cannot pass as a board's. A recording of
    firmware with its own protocol has neither, and is returned unchanged.

    Parameters
    ----------
    transcript
        Transcript of a recorded run.
    path
        File that it was read from, for messages.
    """

    def __init__(self, transcript: Transcript, path: Path) -> None:
        self._path = path
        calls = (entry.call["call"] for entry in transcript.entries if entry.call is not None)
        self._has_frames = POLLED not in calls  # otherwise lines or packets of another protocol
        self._entries = [
            (line, test, entry)
            for line, test, entry in transcript.placed()
            if _is_break(entry) or (entry.data and entry.direction is not Direction.MARK)
        ]
        self.begin(0.0)

    def begin(self, now_s: float) -> None:
        """Start again for another program."""
        self._at = 0
        self._heard = bytearray()
        self._nonce = b""
        self._asked_s = now_s  # time of the latest request, now and in the recording
        self._recorded_s = self._entries[0][2].time_s if self._entries else 0.0

    @property
    def over(self) -> bool:
        """True if the recording is at its end."""
        return self._at == len(self._entries)

    def hear(self, data: bytes, now_s: float) -> None:
        """Take bytes from the program.

        Raises
        ------
        DivergenceError
            When they differ from the recording.
        """
        self._heard += data
        while self._heard and (self.over or self._next.direction is Direction.TO_BOARD):
            if self.over:
                self._raise_divergence("is at its end")
            length = self._request_length(self._next.data)
            if not length:
                return
            del self._heard[:length]
            self._asked_s, self._recorded_s = now_s, self._next.time_s
            self._at += 1

    def say(self, now_s: float) -> bytes:
        """Return the bytes that the board has sent by now.

        Raises
        ------
        BenchError
            When the recorded line broke at this point.
        """
        output = bytearray()
        while not self.over and self._next.direction is not Direction.TO_BOARD:
            answer, changed = [], b""
            if self._has_frames:
                answer = [entry for _, _, entry in takewhile(_is_from_board, self._entries[self._at :])]
                changed = self._adapt_answer(b"".join(entry.data for entry in answer))
            due = answer[-1] if changed else self._next
            if due.time_s - self._recorded_s > now_s - self._asked_s:
                break
            if due.call is not None:
                why = due.call["raises"]["text"]
                raise BenchError(f"{self._path}:{self._entries[self._at][0]}: the recorded line broke here: {why}")
            output += changed or due.data
            self._at += len(answer) if changed else 1
            self.hear(b"", now_s)
        return bytes(output)

    @property
    def _next(self) -> TranscriptEntry:
        return self._entries[self._at][2]

    def _request_length(self, recorded: bytes) -> int:
        """Return the length of the recorded request in the received bytes; 0 while it is incomplete."""
        if self._heard.startswith(recorded):
            return len(recorded)
        if recorded.startswith(self._heard):
            return 0
        end = self._heard.find(_DELIMITER, 1)
        theirs, ours = _sync(bytes(self._heard[: end + 1])), _sync(recorded)
        if ours is not None and (end < 0 or theirs is not None):
            self._nonce = theirs.payload if theirs is not None else b""
            return end + 1
        self._raise_divergence(f"had {frames_in_words(recorded)}")

    def _adapt_answer(self, answer: bytes) -> bytes:
        """Return an answer with the program's nonce and the replay's unique id; nothing if it has neither."""
        frames = FrameDecoder().feed(answer)
        output, has_changed = b"", False
        for frame in frames:
            if not isinstance(frame, Frame):
                return b""
            payload = frame.payload
            if frame.type == Sync.code | REPLY_BIT and len(self._nonce) == len(payload[_NONCE]):
                payload = payload[:1] + self._nonce + payload[5:]
            elif frame.type == Identify.code | REPLY_BIT:
                payload = _replayed_identity(payload)
            has_changed = has_changed or payload != frame.payload
            output += encode_frame(Frame(frame.type, frame.sequence, payload))
        return output if has_changed else b""

    def _raise_divergence(self, recorded: str) -> NoReturn:
        line, test, entry = self._entries[min(self._at, len(self._entries) - 1)]
        asked = f"the program sends {frames_in_words(bytes(self._heard))}"
        raise DivergenceError(f"{self._path}:{line}", asked, recorded, time_s=entry.time_s, test=test)


def serve_recorded(
    recording: ServedRecording, line: PortLine, tell: Callable[[str], None], ended: Callable[[float], bool]
) -> None:
    """Serve a recording to the programs on a line, each from its beginning, until one reaches its end.

    Parameters
    ----------
    tell
        Receives progress messages.
    ended
        Returns whether to stop early, given the time served so far [s].

    Raises
    ------
    BenchError
        When the recorded line breaks, or the program's bytes differ from the recording.
    """
    began_s = time.monotonic()
    was_connected, unsent = False, b""
    while not ended(time.monotonic() - began_s):
        select.select(line.sources(), [], [], _STEP_S)
        data, now_s = line.receive(_AT_A_LOOK), time.monotonic()
        if line.connected != was_connected:
            was_connected, unsent = line.connected, b""
            tell(f"board: client {'connected' if was_connected else 'gone'}")
            if was_connected:
                recording.begin(now_s)
            elif recording.over:
                tell("the recording is at its end")
                return
        if was_connected or data:
            recording.hear(data, now_s)
            unsent += recording.say(now_s)
            unsent = unsent[line.send(unsent) :]


def _is_from_board(entry: tuple[int, str, TranscriptEntry]) -> bool:
    return entry[2].direction is Direction.TO_HOST


def _is_break(entry: TranscriptEntry) -> bool:
    call = entry.call
    if call is None or call["call"] not in ("read", "write"):
        return False
    return isinstance(call.get("raises"), dict) and "text" in call["raises"]


def _sync(data: bytes) -> Frame | None:
    """Return the frame of a request to synchronise, None when it is anything else."""
    frames = FrameDecoder().feed(data)
    if len(frames) == 1 and isinstance(frames[0], Frame) and frames[0].type == Sync.code:
        return frames[0]
    return None


def _replayed_identity(payload: bytes) -> bytes:
    """Return the payload of an identity with the unique id of a replay."""
    try:
        identity = decode_reply(Identify(), payload)
    except (ProtocolError, BenchError):
        return payload
    return payload.replace(_as_sent(identity.unique_id), _as_sent(REPLAYED_UNIQUE_ID), 1)


def _as_sent(unique_id: bytes) -> bytes:
    return b"".join(unique_id[at : at + 4][::-1] for at in range(0, len(unique_id), 4))
