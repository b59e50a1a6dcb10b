"""A calibrator that runs on the host, in a process of its own."""

from __future__ import annotations

import struct
from pathlib import Path
from types import TracebackType

import numpy as np

from hiltest.errors import ConfigError
from hiltest.judge import host_worker
from hiltest.judge.answers import Answer, Cloud
from hiltest.judge.host_process import HostProcess

TIMEOUT_S = 10.0
"""Longest time of one calibration."""
_ANSWER = struct.Struct("<12d")


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
        self.name, self.built_by, self.takes_pairs = name, built_by, takes_pairs
        mode = host_worker.PAIRS if takes_pairs else host_worker.CALIBRATE
        self._process = HostProcess(name, file, function, mode)

    def __enter__(self) -> HostCalibrator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.close()

    def answer(self, cloud: Cloud) -> Answer:
        """Calibrate from samples.

        Raises
        ------
        ConfigError
            If the function fails, ends the process, writes outside its outputs, or takes more than `TIMEOUT_S`.
        """
        inputs = [cloud.samples_ut, cloud.accelerations_g] if self.takes_pairs else [cloud.samples_ut]
        request = b"".join(numbers.astype("<f4").tobytes() for numbers in inputs)
        self._process.send(f"{len(cloud.samples_ut)}\n".encode() + request)
        status, microseconds = self._process.read_line(cloud.where, TIMEOUT_S).split()
        numbers = _ANSWER.unpack(self._process.read_bytes(_ANSWER.size, cloud.where, TIMEOUT_S))
        if int(status) == host_worker.WRITES_OUTSIDE:
            raise ConfigError(f"{self.name} writes outside hard_iron and soft_iron {cloud.where}")
        return Answer(
            int(status) == host_worker.REFUSED,
            np.array(numbers[:3]),
            np.array(numbers[3:]).reshape(3, 3),
            host_us=float(microseconds),
        )
