"""Replay of a run: questions are answered from a recording, in order; the first different one is a divergence."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from itertools import zip_longest
from pathlib import Path
from types import NoneType
from typing import Any, NoReturn

from hiltest.errors import ConfigError, DivergenceError
from hiltest.link.ports import READ_SLICE_S, SerialPort
from hiltest.link.trace_text import frames_in_words
from hiltest.link.transcript import END, Direction, Transcript, TranscriptEntry
from hiltest.tape.tape import Tape, Taped
from hiltest.tape.values import interface_in, restored, restored_error

_SHOWN_CHARACTERS = 200


class Player(Tape):
    """Tape that replays a run.

    Bytes to the board and calls must equal the recording, in order. The number of reads and clock readings may differ:
    a read returns the recorded bytes until the next question, and then nothing.

    Parameters
    ----------
    transcript
        Transcript of a recorded run.
    path
        File that it was read from, for messages.
    """

    def __init__(self, transcript: Transcript, path: Path) -> None:
        self.clock = transcript.clock
        self._path = path
        self._entries: list[TranscriptEntry] = []
        self._lines: list[int] = []
        self._tests: list[str] = []  # test of each entry
        test = ""
        for line, test, entry in transcript.placed():
            if entry.direction is Direction.MARK:
                continue
            self._entries.append(entry)
            self._lines.append(line)
            self._tests.append(test)
        self._is_whole = test == END
        self._at = 0
        self._time_s = 0.0
        self._test = ""
        self._divergence: DivergenceError | None = None

    def port(self, opened: Callable[[], SerialPort]) -> SerialPort:
        """Return a port that plays the recording; nothing is opened."""
        return _ReplayedPort(self, self.ask("port", {}, str, str))

    def ask(self, name: str, arguments: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Answer a question from the recording."""
        entry = self._question()
        call = None if entry is None else entry.call
        if call is None or call["call"] != name or call.get("given", {}) != arguments:
            self._raise_divergence(f"asks {_question(name, arguments)}")
        self._finish_call(call)
        if "raises" in call:
            raise self._restore(restored_error, call["raises"])
        interface, gives = interface_in(hint), call.get("gives")
        if interface is not None and gives is not None:
            return Taped(self, str(gives), interface, None)
        return self._restore(lambda content: restored(hint, content), gives)

    def ask_if_recorded(self, name: str, arguments: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Answer a question if it is the next one of the recording; otherwise return None."""
        return self.ask(name, arguments, hint, answer) if self._coming_call_name() == name else None

    def check(self, name: str, check: Callable[[], None]) -> None:
        """Raise the error of the recorded check, if it had one."""
        if self._coming_call_name() == name:
            self.ask(name, {}, NoneType, check)

    def begin_test(self, test: str) -> None:
        """Store the name of the current test, for messages."""
        self._test = test

    def end(self) -> str:
        """Return where the run differed, or that the recording continues."""
        if self._divergence is None and (entry := self._question()) is not None:
            self._divergence = self._other("has ended", f"goes on: {_describe(entry)}")
        return "" if self._divergence is None else str(self._divergence)

    def now(self) -> float:
        """Return the recorded clock's time: as read by the run at this point, or else that of the next question."""
        entry = self._next()
        if entry is not None and entry.direction is not Direction.TO_HOST:
            self._at += entry.direction is Direction.CLOCK
            self._time_s = max(self._time_s, entry.time_s)
        return self._time_s

    def read(self) -> bytes:
        """Return the bytes of the recorded read; nothing if the recorded run did not read here."""
        data = self._next_read()
        if data is None:
            self._time_s = self.now() + READ_SLICE_S
        return data or b""

    def listen(self) -> bytes:
        """Return the bytes of the recorded read of a run that listens for a time; the read must be in the recording."""
        data = self._next_read()
        if data is None:
            self._question()
            self._raise_divergence("listens to the board")
        return data

    def _next_read(self) -> bytes | None:
        while (entry := self._next()) is not None and entry.direction is Direction.CLOCK:
            self._at += 1
        if entry is not None and entry.direction is Direction.TO_HOST:
            self._at += 1
            self._time_s = max(self._time_s, entry.time_s)
            return entry.data
        self._raise_if_broken("read")
        return None

    def write(self, data: bytes) -> None:
        """Compare bytes for the board with the recording."""
        entry = self._question()
        if entry is None or entry.direction is not Direction.TO_BOARD or entry.data != data:
            self._raise_divergence(f"sends {frames_in_words(data)}", sent=data)
        self._at += 1
        self._time_s = max(self._time_s, entry.time_s)
        self._raise_if_broken("write")

    def _raise_if_broken(self, operation: str) -> None:
        entry = self._next()
        call = None if entry is None else entry.call
        if call is not None and call["call"] == operation:
            self._finish_call(call)
            raise self._restore(restored_error, call.get("raises"))

    def _next(self) -> TranscriptEntry | None:
        return self._entries[self._at] if self._at < len(self._entries) else None

    def _coming_call_name(self) -> str:
        """Return the name of the call that is the next question, without going to it; empty if it is no call."""
        for at in range(self._at, len(self._entries)):
            entry = self._entries[at]
            if entry.data or entry.call is not None:
                return "" if entry.call is None else str(entry.call["call"])
        return ""

    def _question(self) -> TranscriptEntry | None:
        """Go to the next question of the recording, and skip empty reads."""
        if self._divergence is not None:
            raise self._divergence
        while (entry := self._next()) is not None and not entry.data and entry.call is None:
            self._at += 1
        return entry

    def _finish_call(self, call: Mapping[str, Any]) -> None:
        until = call.get("until", self._entries[self._at].time_s)
        until_s = self._restore(lambda content: restored(float, content), until)
        self._time_s = max(self._time_s, until_s)
        self._at += 1

    def _restore(self, make: Callable[[Any], Any], content: Any) -> Any:
        try:
            return make(content)
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{self._path}:{self._lines[self._at - 1]}: the answer is damaged: {error}") from None

    def _raise_divergence(self, asked: str, *, sent: bytes = b"") -> NoReturn:
        """Raise a divergence, now and for all later questions."""
        entry = self._next()
        if entry is not None:
            recorded = _describe(entry, beside=sent)
        elif self._is_whole:
            recorded = "is at its end"
        else:
            recorded = "has no end mark: it was cut short"
        self._divergence = self._other(asked, recorded)
        raise self._divergence

    def _other(self, asked: str, recorded: str) -> DivergenceError:
        at = min(self._at, len(self._entries) - 1)
        line, test = (self._lines[at], self._tests[at]) if at >= 0 else (1, "")
        time_s = self._entries[at].time_s if at >= 0 else 0.0
        return DivergenceError(
            f"{self._path}:{line}", f"{self._test or 'it'} {asked}", recorded, time_s=time_s, test=test
        )


def _describe(entry: TranscriptEntry, *, beside: bytes = b"") -> str:
    if entry.call is not None:
        return f"asked {_question(str(entry.call['call']), entry.call.get('given', {}))}"
    if entry.direction is Direction.TO_HOST:
        return f"read {len(entry.data)} bytes first"
    words, difference = frames_in_words(entry.data), ""
    if beside and frames_in_words(beside) == words:  # as with a difference in check value or sequence number only
        pairs = enumerate(zip_longest(beside, entry.data))
        difference = f", another from byte {next(at for at, (one, two) in pairs if one != two)} on"
    return f"sent {words}{difference}"


def _question(name: str, arguments: Mapping[str, Any]) -> str:
    text = f"{name}({', '.join(f'{key}={json.dumps(value)}' for key, value in arguments.items())})"
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[: _SHOWN_CHARACTERS - 3]}..."


class _ReplayedPort:
    """A port that plays a recording."""

    def __init__(self, player: Player, name: str) -> None:
        self._player = player
        self.name, self.clock = name, player.clock
        self.timeout = READ_SLICE_S

    def now(self) -> float:
        """Return the time of the recorded clock [s]."""
        return self._player.now()

    def position(self) -> str:
        """Return the recorded description of the firmware's activity."""
        position: str = self._player.ask("position", {}, str, str)
        return position

    @property
    def wrong_speed(self) -> str:
        """Sentence about a line whose ends had different speeds; empty if they were equal or unknown."""
        return self._player.ask_if_recorded("wrong_speed", {}, str, str) or ""

    def read_until(self, expected: bytes) -> bytes:
        """Return the bytes of the recorded read."""
        return self._player.read()

    def read(self, size: int) -> bytes:
        """Return the bytes of the recorded read."""
        return self._player.listen()

    def write(self, data: bytes) -> int:
        """Compare bytes with the recorded ones."""
        self._player.write(data)
        return len(data)

    def reset_input_buffer(self) -> None:
        """Do nothing: dropped bytes are not recorded."""

    def close(self) -> None:
        """Do nothing."""
