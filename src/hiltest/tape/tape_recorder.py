"""Recording of a run: each question to the bench is asked, and stored with its answer and time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hiltest.errors import HiltestError
from hiltest.link.ports import SerialPort
from hiltest.link.transcript import END, Direction, TranscriptEntry, TranscriptFile
from hiltest.tape.tape import Tape, Taped
from hiltest.tape.values import interface_in, plain, plain_error


class Recorder(Tape):
    """Tape that records a run.

    Parameters
    ----------
    path
        File that grows during the run.
    about
        Description of the run for the header.
    """

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        self._path, self._about = path, about
        self._file: TranscriptFile | None = None
        self._now: Callable[[], float] = time.monotonic
        self._began_s = self._latest_s = 0.0
        self._objects = 0
        self._is_asking = False  # a question within another question is not recorded

    def port(self, opened: Callable[[], SerialPort]) -> SerialPort:
        """Open the board's port, and begin the recording."""
        port = opened()
        own_clock: Callable[[], float] | None = getattr(port, "now", None)
        if own_clock is None:
            self._began_s = time.monotonic()
        self._now = own_clock or self._wall_s
        clock = "virtual" if own_clock else "wall"
        try:
            self._file = TranscriptFile(self._path, clock, self._about)
        except HiltestError:
            port.close()
            raise
        self.ask("port", {}, str, lambda: port.name)
        return _RecordedPort(self, port, clock)

    def ask(self, name: str, arguments: Mapping[str, Any], hint: Any, answer: Callable[[], Any]) -> Any:
        """Ask the bench, and record the question with the answer."""
        if self._is_asking:
            return answer()
        began_s, self._is_asking = self._now(), True
        entry: dict[str, Any] = {"call": name, **({"given": arguments} if arguments else {})}
        try:
            result = answer()
            interface = interface_in(hint)
            if interface is not None and result is not None:
                self._objects += 1
                entry["gives"] = f"{name.rpartition('.')[2]}-{self._objects}"
                result = Taped(self, entry["gives"], interface, result)
            else:
                entry["gives"] = plain(result)
            return result
        except HiltestError as error:
            entry["raises"] = plain_error(error)
            raise
        finally:
            self._is_asking = False
            if {"gives", "raises"} & entry.keys():  # otherwise it was interrupted
                self._add_call(began_s, entry)

    def check(self, name: str, check: Callable[[], None]) -> None:
        """Perform a check, and record its error if it has one."""
        try:
            check()
        except HiltestError as error:
            self._add_call(self._now(), {"call": name, "raises": plain_error(error)})
            raise

    def begin_test(self, test: str) -> None:
        """Mark the start of a test."""
        if self._file is not None:
            self._file.add(TranscriptEntry(self._latest_s, Direction.MARK, test.encode()))

    def flush(self) -> None:
        """Flush the file."""
        if self._file is not None:
            self._file.flush()

    def end(self) -> str:
        """Close the recording."""
        if self._file is not None:
            self._file.add(TranscriptEntry(self._latest_s, Direction.MARK, END.encode()))
            self._file.close()
            self._file = None
        return ""

    def now_s(self, *, is_asked: bool) -> float:
        """Return the time of the board's clock; readings of a wall clock by the run are recorded."""
        time_s = self._now()
        if is_asked and self._began_s and not self._is_asking:
            self.add(time_s, Direction.CLOCK, b"")
        return time_s

    def add(self, time_s: float, direction: Direction, data: bytes) -> None:
        """Record bytes."""
        if self._file is not None and not self._is_asking:
            self._file.add(TranscriptEntry(time_s, direction, data))
            self._latest_s = time_s

    def broken(self, operation: str, error: BaseException) -> None:
        """Record an error of reading or writing the line."""
        if not self._is_asking:
            self._add_call(self._now(), {"call": operation, "raises": plain_error(error)})

    def _add_call(self, began_s: float, call: dict[str, Any]) -> None:
        ended_s = self._now()
        if self._file is not None:
            until = {"until": ended_s} if ended_s != began_s else {}
            self._file.add(TranscriptEntry(began_s, Direction.CALL, call={**call, **until}))
            self._latest_s = ended_s

    def _wall_s(self) -> float:
        return round(time.monotonic() - self._began_s, 6)


class _RecordedPort:
    """A port whose bytes are recorded."""

    def __init__(self, recorder: Recorder, port: Any, clock: str) -> None:
        self._recorder, self._port = recorder, port
        self.name, self.clock = port.name, clock

    def now(self) -> float:
        """Return the time of the board's clock [s]."""
        return self._recorder.now_s(is_asked=True)

    def position(self) -> str:
        """Return a description of the firmware's activity, if the port knows it."""
        look: Callable[[], str] = getattr(self._port, "position", str)
        position: str = self._recorder.ask("position", {}, str, look)
        return position

    @property
    def wrong_speed(self) -> str:
        """Sentence about a line whose ends have different speeds; empty if they are equal or unknown."""
        wrong_speed: str = self._recorder.ask("wrong_speed", {}, str, lambda: getattr(self._port, "wrong_speed", ""))
        return wrong_speed

    @property
    def timeout(self) -> float | None:
        """How long one read may wait [s]."""
        waits_s: float | None = self._port.timeout
        return waits_s

    @timeout.setter
    def timeout(self, seconds: float | None) -> None:
        self._port.timeout = seconds

    def read_until(self, expected: bytes) -> bytes:
        """Return bytes up to and including `expected`, fewer at the end of the read slice."""
        return self._record_read(lambda: self._port.read_until(expected))

    def read(self, size: int) -> bytes:
        """Return the bytes that arrive within the timeout, at most `size`."""
        return self._record_read(lambda: self._port.read(size))

    def _record_read(self, read: Callable[[], bytes]) -> bytes:
        try:
            data = bytes(read())
        except Exception as error:
            self._recorder.broken("read", error)
            raise
        self._recorder.add(self._recorder.now_s(is_asked=False), Direction.TO_HOST, data)
        return data

    def write(self, data: bytes) -> int | None:
        """Send bytes."""
        self._recorder.add(self._recorder.now_s(is_asked=False), Direction.TO_BOARD, data)
        try:
            written: int | None = self._port.write(data)
        except Exception as error:
            self._recorder.broken("write", error)
            raise
        return written

    def reset_input_buffer(self) -> None:
        """Drop the unread bytes."""
        self._port.reset_input_buffer()

    def close(self) -> None:
        """Close the port."""
        self._port.close()
