"""A process that calls functions of a user on the host, with limits on time and memory."""

from __future__ import annotations

import contextlib
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.judge import host_worker

_START_S = 60.0  # a Python module may import much
_MOST_OUTPUT = 400  # bytes of standard error in a message
_LONGEST_LINE = 10_000


class HostProcess:
    """A process of `hiltest.judge.host_worker`.

    Parameters
    ----------
    name
        Name of the judged function, for messages.
    file
        Shared library of this machine, or a file ``.py``.
    function
        Name of the function or, for a filter in Python, of the class.
    mode
        Contract, one of those in `hiltest.judge.host_worker`.

    Raises
    ------
    ConfigError
        If the file cannot be loaded or has no such function.
    """

    def __init__(self, name: str, file: Path, function: str, mode: str) -> None:
        if not file.is_file():
            raise ConfigError(f"{file}: no such file")
        self._name = name
        self._output = tempfile.TemporaryFile()  # noqa: SIM115
        command = [sys.executable, "-m", host_worker.__name__, str(file.resolve()), function, mode]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._output)
        self._rest = b""
        try:
            self.read_line("to start", _START_S)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._output):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def send(self, request: bytes) -> None:
        """Send a request."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the missing answer is reported
            self._process.stdin.write(request)
            self._process.stdin.flush()

    def read_line(self, where: str, timeout_s: float) -> str:
        """Return a line of an answer.

        Parameters
        ----------
        where
            World or motion of the request, for messages.

        Raises
        ------
        ConfigError
            If the function fails, ends the process, or takes longer.
        """
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self._rest and len(self._rest) < _LONGEST_LINE:
            self._receive(where, deadline, timeout_s)
        line, _, self._rest = self._rest.partition(b"\n")
        text = line.decode(errors="replace")
        if text.startswith("error "):
            raise ConfigError(f"{self._name} fails {where}: {text.removeprefix('error ')}{self._printed()}")
        return text

    def read_bytes(self, count: int, where: str, timeout_s: float) -> bytes:
        """Return bytes of an answer; the errors are those of `read_line`."""
        deadline = time.monotonic() + timeout_s
        while len(self._rest) < count:
            self._receive(where, deadline, timeout_s)
        content, self._rest = self._rest[:count], self._rest[count:]
        return content

    def _receive(self, where: str, deadline: float, timeout_s: float) -> None:
        stream = self._process.stdout
        assert stream is not None
        if not select.select([stream], [], [], max(0.0, deadline - time.monotonic()))[0]:
            self._process.kill()
            raise ConfigError(f"{self._name} takes more than {timeout_s:g} s {where}")
        content = stream.read1(1 << 16)  # type: ignore[attr-defined]
        if not content:
            code = self._process.wait()
            with contextlib.suppress(ValueError):
                raise ConfigError(f"{self._name} ends with {signal.Signals(-code).name} {where}{self._printed()}")
            raise ConfigError(f"{self._name} ends the process with exit code {code} {where}{self._printed()}")
        self._rest += content

    def _printed(self) -> str:
        """Return the end of the process's standard error, for messages."""
        self._output.seek(0)
        text = self._output.read()[-_MOST_OUTPUT:].decode(errors="replace").strip()
        return f"; it printed: {text}" if text else ""
