"""A calibrator that runs on the host, in a process of its own with limits on time and memory."""

from __future__ import annotations

import contextlib
import select
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType

import numpy as np

from hiltest.errors import ConfigError
from hiltest.judge import host_worker
from hiltest.judge.answers import Answer
from hiltest.judge.worlds import World

TIMEOUT_S = 10.0
"""Longest time of one calibration."""
_START_S = 60.0  # a Python module may import much
_ANSWER = struct.Struct("<12d")
_MOST_OUTPUT = 400  # bytes of standard error in a message
_LONGEST_LINE = 10_000


class HostCalibrator:
    """A calibrator in a shared library or a Python file.

    Parameters
    ----------
    name
        Name in tables.
    file
        Shared library of this machine, or a file ``.py``.
    function
        Function of the contract in ``hiltest_judge.h``, or a Python function that takes samples, and maybe
        accelerations, of shape (n, 3) and returns hard iron and soft iron, or None to refuse.
    takes_pairs
        True if it takes accelerations, too.

    Raises
    ------
    ConfigError
        If the file cannot be loaded or has no such function.
    """

    cycle_model = ""
    flash_bytes: int | None = None

    def __init__(self, name: str, file: Path, function: str, *, takes_pairs: bool, built_by: str = "") -> None:
        if not file.is_file():
            raise ConfigError(f"{file}: no such file")
        self.name, self.built_by, self._takes_pairs = name, built_by, takes_pairs
        self._output = tempfile.TemporaryFile()  # noqa: SIM115
        command = [sys.executable, "-m", host_worker.__name__, str(file.resolve()), function, str(int(takes_pairs))]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._output)
        self._rest = b""
        try:
            self._line("to start", _START_S)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> HostCalibrator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._output):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def answer(self, world: World) -> Answer:
        """Calibrate from the samples of a world.

        Raises
        ------
        ConfigError
            If the function fails, ends the process, or takes more than `TIMEOUT_S`.
        """
        inputs = [world.samples_ut, world.accelerations_g] if self._takes_pairs else [world.samples_ut]
        request = f"{len(world.samples_ut)}\n".encode() + b"".join(item.astype("<f4").tobytes() for item in inputs)
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the missing answer is reported
            self._process.stdin.write(request)
            self._process.stdin.flush()
        where = f"in world {world.name}"
        status, microseconds = self._line(where, TIMEOUT_S).split()
        numbers = _ANSWER.unpack(self._bytes(_ANSWER.size, where, TIMEOUT_S))
        if int(status) == host_worker.WRITES_OUTSIDE:
            raise ConfigError(f"{self.name} writes outside hard_iron and soft_iron {where}")
        return Answer(
            int(status) == host_worker.REFUSED,
            np.array(numbers[:3]),
            np.array(numbers[3:]).reshape(3, 3),
            host_us=float(microseconds),
        )

    def _line(self, where: str, timeout_s: float) -> str:
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self._rest and len(self._rest) < _LONGEST_LINE:
            self._receive(where, deadline, timeout_s)
        line, _, self._rest = self._rest.partition(b"\n")
        text = line.decode(errors="replace")
        if text.startswith("error "):
            raise ConfigError(f"{self.name} fails {where}: {text.removeprefix('error ')}{self._printed()}")
        return text

    def _bytes(self, count: int, where: str, timeout_s: float) -> bytes:
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
            raise ConfigError(f"{self.name} takes more than {timeout_s:g} s {where}")
        content = stream.read1(1 << 16)  # type: ignore[attr-defined]
        if not content:
            code = self._process.wait()
            with contextlib.suppress(ValueError):
                raise ConfigError(f"{self.name} ends with {signal.Signals(-code).name} {where}{self._printed()}")
            raise ConfigError(f"{self.name} ends the process with exit code {code} {where}{self._printed()}")
        self._rest += content

    def _printed(self) -> str:
        """Return the end of the process's standard error, for messages."""
        self._output.seek(0)
        text = self._output.read()[-_MOST_OUTPUT:].decode(errors="replace").strip()
        return f"; it printed: {text}" if text else ""
