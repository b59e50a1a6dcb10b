"""Process that calls a calibrator on the host: a function of a shared library, or a Python function.

A request is a line ``n pairs`` and the samples, and if pairs is 1 the accelerations, as little-endian float32. The
answer is a line ``status microseconds`` and twelve float64: hard iron and soft iron. A line that begins with ``error``
has a message instead. What the calibrator prints goes to standard error.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import resource
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

REFUSED, WRITES_OUTSIDE = 1, 2
_MOST_BYTES = 4 << 30  # of address space
_GUARD, _GUARDS = -1.2345678e30, 8
_NUMBERS = struct.Struct("<12d")


def main(file: str, function: str, takes_pairs: bool) -> None:
    """Answer requests on standard input until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        calibrate = (
            _python_function(Path(file), function) if file.endswith(".py") else _library_function(file, function)
        )
        _reply(answers, "ready")
    except (Exception, SystemExit) as error:
        _reply(answers, f"error {type(error).__name__}: {error}")
        return
    while header := sys.stdin.buffer.readline():
        count = int(header)
        inputs = [_read(count) for _ in range(1 + takes_pairs)]
        try:
            status, microseconds, numbers = calibrate(inputs)
        except (Exception, SystemExit) as error:
            _reply(answers, f"error {type(error).__name__}: {error}")
            continue
        _reply(answers, f"{status} {microseconds:.3f}", _NUMBERS.pack(*numbers))


_Result = tuple[int, float, Any]


def _library_function(file: str, name: str) -> Callable[[list[Any]], _Result]:
    called = getattr(ctypes.CDLL(file), name)
    called.restype = ctypes.c_int

    def calibrate(inputs: list[Any]) -> _Result:
        """Call the function with guards behind its outputs."""
        hard_iron, soft_iron = (np.full(size + _GUARDS, _GUARD, np.float32) for size in (3, 9))
        hard_iron[:3] = soft_iron[:9] = 0.0
        kept = [numbers.copy() for numbers in inputs]
        pointers = [numbers.ctypes.data_as(ctypes.c_void_p) for numbers in (*inputs, hard_iron, soft_iron)]
        began = time.perf_counter()
        status = called(*pointers[:-2], ctypes.c_int(len(inputs[0])), *pointers[-2:])
        microseconds = 1e6 * (time.perf_counter() - began)
        guards = np.concatenate([hard_iron[3:], soft_iron[9:]])
        is_outside = (guards != np.float32(_GUARD)).any()
        if is_outside or any(not np.array_equal(*pair) for pair in zip(inputs, kept, strict=True)):
            return WRITES_OUTSIDE, microseconds, np.zeros(12)
        return REFUSED if status else 0, microseconds, np.concatenate([hard_iron[:3], soft_iron[:9]]).astype(float)

    return calibrate


def _python_function(file: Path, name: str) -> Callable[[list[Any]], _Result]:
    sys.path.insert(0, str(file.parent.resolve()))
    described = importlib.util.spec_from_file_location(file.stem, file)
    assert described is not None
    assert described.loader is not None
    module = importlib.util.module_from_spec(described)
    sys.modules[file.stem] = module
    described.loader.exec_module(module)
    called = getattr(module, name)

    def calibrate(inputs: list[Any]) -> _Result:
        """Call the function with float64 arrays; None is a refusal."""
        arrays = [numbers.astype(np.float64) for numbers in inputs]
        began = time.perf_counter()
        result = called(*arrays)
        microseconds = 1e6 * (time.perf_counter() - began)
        if result is None:
            return REFUSED, microseconds, np.full(12, np.nan)
        hard_iron, soft_iron = (np.asarray(part, dtype=np.float64) for part in result)
        if hard_iron.shape != (3,) or soft_iron.shape != (3, 3):
            raise TypeError(
                f"{name} returned shapes {hard_iron.shape} and {soft_iron.shape}, not (3,) of the hard iron and (3, 3) "
                "of the soft iron"
            )
        return 0, microseconds, np.concatenate([hard_iron, soft_iron.ravel()])

    return calibrate


def _read(count: int) -> Any:
    content = sys.stdin.buffer.read(count * 3 * 4)
    return np.frombuffer(content, "<f4").reshape(count, 3).copy()


def _reply(answers: BinaryIO, line: str, content: bytes = b"") -> None:
    answers.write(line.replace("\n", " ").encode() + b"\n" + content)
    answers.flush()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3] == "1")
