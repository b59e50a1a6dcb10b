"""Requests and replies over a port: sequence numbers, deadlines, bounded retries.

The clock is the port's own when it has one (`now`): a virtual board's deadlines are virtual, so they are met or missed
in the same way on every host. Wall time then only guards against an endless computation.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeVar

import serial

from hiltest.errors import (
    BoardResetError,
    DeviceTimeoutError,
    LinkLostError,
    OtherFirmwareError,
    ProtocolError,
    SequenceError,
    SyncError,
    VersionMismatchError,
)
from hiltest.link.framing import DamagedFrame, Frame, FrameDecoder, encode_frame
from hiltest.link.messages import PROTOCOL_VERSION, Identify, LinkStatistics, Reset, Sync
from hiltest.link.ports import SerialPort
from hiltest.link.replies import Identity, Status
from hiltest.link.request import REPLY_BIT, Request, decode_reply
from hiltest.link.transcript import Direction, Transcript
from hiltest.text import is_text, legible

R = TypeVar("R")

FIRMWARE_NAME = "hiltest-frdm-k64f"
# Reply deadline: the longest frame takes 0.18 s at 115200 baud in each direction; the rest is for USB and operating
# system.
REPLY_DEADLINE_S = 1.0
ATTEMPTS = 3
# Wall-time limit: a board on a real clock cannot exceed it within its deadlines; a virtual one in an endless
# computation can.
WALL_GUARD_S = 30.0
# Wall time per second of a virtual board's work on a busy machine; it is 0.4 s on an idle one.
_WALL_A_BOARD_SECOND = 4.0
# Number of earlier requests whose late answers are dropped; any other number is an error.
_STALE_SEQUENCES = 16
_HEARD_KEPT = 256
_SHOWN_CHARACTERS = 80


class RequestOutcome(StrEnum):
    """Outcome of an attempt."""

    ANSWERED = "answered"
    TIMEOUT = "timeout"
    ERROR = "error"


def _whole_line(heard: bytes) -> str:
    """Return a complete received line, if there is one: the first and the last may be cut."""
    lines = [line for line in heard.decode("utf-8", errors="replace").splitlines() if line]
    return legible(lines[len(lines) // 2])[:_SHOWN_CHARACTERS] if lines else ""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One attempt of one request."""

    command: str
    sequence: int
    number: int
    """Number of the attempt, from 1."""
    sent_s: float
    ended_s: float
    """Times by the board's clock."""
    outcome: RequestOutcome
    damaged: int
    stale: int
    """Number of frames that arrived meanwhile and were damaged, or answered an earlier request."""


class Session:
    """The host's end of the link.

    Parameters
    ----------
    port
        Open. The session closes it.
    transcript
        Receives every byte, in both directions, except those of `refuse_reset`.
    nonce_seed
        Seed of the nonces, for a reproducible run. On a line that other programs have used, omit it: then they are
        random.

    Attributes
    ----------
    on_reply : callable
        Called with each request and the data of its reply, before `request` returns it.
    """

    def __init__(
        self,
        port: SerialPort,
        *,
        transcript: Transcript | None = None,
        nonce_seed: int | None = None,
        reply_deadline_s: float = REPLY_DEADLINE_S,
        attempts: int = ATTEMPTS,
    ) -> None:
        self._port = port
        own_clock: Callable[[], float] | None = getattr(port, "now", None)
        self.clock: str = getattr(port, "clock", "virtual" if own_clock else "wall")
        self.now: Callable[[], float] = own_clock or time.monotonic
        self.transcript = transcript
        if transcript is not None and not transcript.clock:
            transcript.clock = self.clock
        self.attempts: list[Attempt] = []
        self.protocol_version = 0
        self._reply_deadline_s = reply_deadline_s
        self._attempts_allowed = attempts
        self._nonces = random.Random(nonce_seed) if nonce_seed is not None else random.SystemRandom()
        self._decoder = FrameDecoder()
        self._sequence = 0
        self._heard = bytearray()
        self.on_reply: Callable[[Request[Any], object], None] = lambda _request, _reply: None
        self._damaged = 0
        self._stale = 0
        self._answered = 0  # replies since the latest check of the board's count of executed requests
        self._carried_out = 0

    @property
    def retried(self) -> int:
        """Number of requests that were sent more than once."""
        return sum(attempt.number == 2 for attempt in self.attempts)

    def close(self) -> None:
        self._port.close()

    def synchronise(self) -> None:
        """Discard all bytes on the line until the board returns this session's nonce.

        Raises
        ------
        SyncError
            When it does not return the nonce.
        VersionMismatchError
            When it has another protocol version, or prints text.
        """
        self._port.reset_input_buffer()
        self._decoder.reset()
        self._heard.clear()
        for number in range(1, self._attempts_allowed + 1):
            # A fresh nonce each time, because an old answer must not pass for a new one.
            request = Sync(self._nonces.getrandbits(32))
            frame = Frame(request.code, 0, request.payload())
            payload = self._attempt(request, frame, number, self._reply_deadline_s, resync=True)
            if payload is not None:
                self.protocol_version = int.from_bytes(payload[5:7], "little")
                self._answered, self._carried_out = 1, 0
                break
        else:
            heard = bytes(self._heard)
            if is_text(heard):
                raise VersionMismatchError(
                    f"nothing on {self._port.name} answers in hiltest's protocol, but it sends text: "
                    f"{_whole_line(heard)!r}. Firmware with its own output needs a rig, which hiltest start ELF "
                    "proposes"
                )
            wrong_speed = getattr(self._port, "wrong_speed", "")
            raise SyncError(self._port.name, heard, self._attempts_allowed, wrong_speed)
        if self.protocol_version != PROTOCOL_VERSION:
            raise VersionMismatchError(
                f"the firmware speaks protocol version {self.protocol_version}, hiltest {PROTOCOL_VERSION}. "
                "Flash the firmware of this hiltest (hiltest flash), or install the hiltest of that firmware."
            )
        self._sequence = 0

    def identify(self, *, firmware_name: str = FIRMWARE_NAME) -> Identity:
        """Ask for the identity of the firmware, and check that it is the expected one.

        Raises
        ------
        OtherFirmwareError
            When it is other firmware.
        """
        identity = self.request(Identify())
        if identity.name != firmware_name:
            raise OtherFirmwareError(
                f"the board runs firmware {identity.name!r} ({identity.version}, build {identity.build_id}), "
                f"not {firmware_name!r}"
            )
        return identity

    def request(self, message: Request[R], *, deadline_s: float | None = None) -> R:
        """Send a request and return the data of its reply.

        Parameters
        ----------
        deadline_s
            Deadline of each attempt; by default the session's plus the board's time for the request.

        Raises
        ------
        DeviceError
            When the board answers with an error status.
        DeviceTimeoutError
            When no attempt is answered in time.
        LinkLostError
            When the port breaks.
        ProtocolError
            When the reply does not fit this request.
        """
        allowed_s = self._reply_deadline_s + message.board_time_s if deadline_s is None else deadline_s
        frame = self.next_frame(message)
        for number in range(1, self._attempts_allowed + 1):
            payload = self._attempt(message, frame, number, allowed_s)
            if payload is not None:
                self._answered += 1
                if isinstance(message, Reset):
                    self._answered = self._carried_out = 0
                reply = decode_reply(message, payload)
                self.on_reply(message, reply)
                return reply
        raise DeviceTimeoutError(message.command, allowed_s, self.clock, self._firmware_activity(), self.noise())

    def refuse_reset(self) -> None:
        """Check that the board was not reset since it was synchronised.

        The board counts the requests that it has executed since its start, each once regardless of repetitions: after a
        reset the count is below the number of answers.

        Raises
        ------
        BoardResetError
            When it was reset, for any reason.
        """
        if self._answered:
            with self._pause_transcript():
                counted = self.request(LinkStatistics())
            carried_out, expected = counted.frames - counted.repeated, self._carried_out + self._answered
            if carried_out < expected:
                raise BoardResetError(carried_out, expected)
            self._answered, self._carried_out = 0, carried_out

    @contextmanager
    def _pause_transcript(self) -> Iterator[None]:
        """Exclude an exchange from the transcript, because it follows a test and is not part of it."""
        transcript, self.transcript = self.transcript, None
        try:
            yield
        finally:
            self.transcript = transcript

    def noise(self, since: int = 0) -> str:
        """Describe the bytes that the line has lost or changed since an attempt: failures that a repetition cured.

        Empty without any. Faulty firmware fails in the same way each time.
        """
        attempts = self.attempts[since:]
        again = sum(attempt.number > 1 and attempt.outcome is RequestOutcome.ANSWERED for attempt in attempts)
        damaged = sum(attempt.damaged for attempt in attempts)
        were = "request was" if again == 1 else "requests were"
        return f"{again} {were} answered when sent again, {damaged} damaged frames came" if again else ""

    def next_frame(self, message: Request[R]) -> Frame:
        """Return the frame of a request under the next sequence number, without sending it."""
        return self.numbered(message.code, message.payload())

    def numbered(self, code: int, payload: bytes) -> Frame:
        """Return a frame under the next sequence number, without sending it."""
        self._sequence = (self._sequence + 1) % 256
        return Frame(code, self._sequence, payload)

    def send_raw(self, data: bytes) -> None:
        """Send bytes unchanged: damaged frames, for link checks."""
        self._write(data)

    def listen(self, seconds: float) -> Frame | None:
        """Return the next intact frame; None on a timeout."""
        end_s = self.now() + seconds
        while self.now() < end_s:
            for item in self._receive():
                if isinstance(item, Frame):
                    return item
        return None

    def exchange_raw(self, frame: Frame, *, deadline_s: float = REPLY_DEADLINE_S) -> Frame | None:
        """Send one frame once and return the frame with the same number; None on a timeout."""
        self._write(encode_frame(frame))
        end_s = self.now() + deadline_s
        while (reply := self.listen(end_s - self.now())) is not None:
            if reply.sequence == frame.sequence:
                return reply
        return None

    def _attempt(
        self, message: Request[R], frame: Frame, number: int, allowed_s: float, *, resync: bool = False
    ) -> bytes | None:
        """Send once and wait; return the reply's payload, or None on a timeout."""
        sent_s = self.now()
        self._damaged = self._stale = 0
        outcome = RequestOutcome.ERROR
        try:
            self._write(encode_frame(frame))
            payload = self._await(message, frame.sequence, sent_s + allowed_s, resync)
            outcome = RequestOutcome.TIMEOUT if payload is None else RequestOutcome.ANSWERED
            return payload
        finally:
            ended_s = self.now()
            self.attempts.append(
                Attempt(message.command, frame.sequence, number, sent_s, ended_s, outcome, self._damaged, self._stale)
            )

    def _await(self, message: Request[R], sequence: int, end_s: float, resync: bool) -> bytes | None:
        guard_s = WALL_GUARD_S + _WALL_A_BOARD_SECOND * message.board_time_s
        wall_end_s = time.monotonic() + guard_s
        while self.now() < end_s:
            for item in self._receive():
                if isinstance(item, DamagedFrame):
                    self._damaged += 1
                elif resync:
                    if _is_echo(item, message):
                        return item.payload
                elif self._answers(item, message, sequence):
                    return item.payload
            if self.clock == "virtual" and time.monotonic() > wall_end_s:
                raise DeviceTimeoutError(message.command, guard_s, "wall", self._firmware_activity())
        return None

    def _firmware_activity(self) -> str:
        """Return a description of the firmware's activity, if the port knows it."""
        look: Callable[[], str] | None = getattr(self._port, "position", None)
        return look() if look else ""

    def _answers(self, frame: Frame, message: Request[R], sequence: int) -> bool:
        if frame.sequence != sequence:
            if 0 < (sequence - frame.sequence) % 256 <= _STALE_SEQUENCES:
                self._stale += 1
                return False
            raise SequenceError(sequence, frame.sequence)
        if frame.type != message.code | REPLY_BIT:
            raise ProtocolError(
                f"{message.command} (0x{message.code:02x}) was answered by a frame of type 0x{frame.type:02x}"
            )
        return True

    def _receive(self) -> list[Frame | DamagedFrame]:
        try:
            data = self._port.read_until(b"\x7e")
        except (serial.SerialException, OSError) as error:
            raise LinkLostError(self._port.name, str(error)) from error
        if not data:
            return []
        if self.transcript is not None:
            self.transcript.add(self.now(), Direction.TO_HOST, data)
        self._heard += data[: _HEARD_KEPT - len(self._heard)]
        return self._decoder.feed(data)

    def _write(self, data: bytes) -> None:
        if self.transcript is not None:
            self.transcript.add(self.now(), Direction.TO_BOARD, data)
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise LinkLostError(self._port.name, f"a write of {len(data)} bytes did not go out: {error}") from error
        except (serial.SerialException, OSError) as error:
            raise LinkLostError(self._port.name, str(error)) from error


def _is_echo(frame: Frame, request: Request[R]) -> bool:
    """Return whether a frame returns the nonce of a SYNC request, regardless of its other content."""
    return (
        frame.type == request.code | REPLY_BIT
        and len(frame.payload) == 7
        and (frame.payload[0] == Status.OK and frame.payload[1:5] == request.payload())
    )
