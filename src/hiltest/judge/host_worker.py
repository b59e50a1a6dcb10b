"""Process that calls functions of a user on the host: those of a shared library, or Python functions.

A request to a calibrator is a line with the number of samples, and the samples as little-endian float32, in the mode
``pairs`` followed by the accelerations. The answer is a line ``status microseconds`` and twelve float64: hard iron and
soft iron. A request to a filter is a line ``n rate stride``, and n rows of rate, gravity and field; the answer is the
line ``status microseconds`` with the time of an update, and a row of four float64 for each stride: the quaternion, or
the heading and NaN. A line that begins with ``error`` has a message instead. Lines that functions print go to standard
error.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

CALIBRATE, PAIRS, FILTER = "calibrate", "pairs", "filter"
TABLE = ".toml"
"""End of the name of a table, which may be in the place of a function's name."""
REFUSED, WRITES_OUTSIDE = 1, 2
_MOST_BYTES = 4 << 30  # of address space
_GUARD, _GUARDS = -1.2345678e30, 8

_Result = tuple[int, float, Any]
_Filter = Callable[[float], tuple[Callable[..., Any], Callable[[], Any]]]
"""Makes a filter for a rate [Hz]: a function that updates it, and one that reads it."""


def main(file: str, function: str, mode: str) -> None:
    """Answer requests on standard input until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        run = _request_runner(file, function, mode)
        _reply(answers, "ready")
    except (Exception, SystemExit) as error:
        _reply(answers, f"error {type(error).__name__}: {error}")
        return
    while header := sys.stdin.buffer.readline():
        try:
            status, microseconds, numbers = run(header)
        except (Exception, SystemExit) as error:
            _reply(answers, f"error {type(error).__name__}: {error}")
            continue
        _reply(answers, f"{status} {microseconds:.3f}", np.asarray(numbers, "<f8").tobytes())


def _request_runner(file: str, function: str, mode: str) -> Callable[[bytes], _Result]:
    is_python = file.endswith(".py")
    if function.endswith(TABLE):
        from hiltest.judge.foreign_library import open_library

        foreign, machine = open_library(Path(file), Path(function))

        def calibrate_foreign(inputs: list[Any]) -> _Result:
            """Call the functions of the table."""
            refused, *answer = foreign.calibrate(*inputs)
            return REFUSED if refused else 0, 1e6 * machine.taken_s, np.concatenate([part.ravel() for part in answer])

        def make_foreign(rate_hz: float) -> tuple[Callable[..., Any], Callable[[], Any]]:
            """Start the filter of the table anew."""
            foreign.start(rate_hz)
            return lambda *values: foreign.update(*values[:3]), foreign.read

        if mode == FILTER:
            return functools.partial(_run_filter, make_foreign)
        return functools.partial(_run_calibrator, calibrate_foreign, 2)
    if mode == FILTER:
        make = _python_filter(Path(file), function) if is_python else _library_filter(file)
        return functools.partial(_run_filter, make)
    calibrate = _python_function(Path(file), function) if is_python else _library_function(file, function)
    return functools.partial(_run_calibrator, calibrate, 2 if mode == PAIRS else 1)


# -- calibrators ---------------------------------------------------------------------------------------------------


def _run_calibrator(calibrate: Callable[[list[Any]], _Result], inputs: int, header: bytes) -> _Result:
    return calibrate([_read(int(header), 3) for _ in range(inputs)])


def _library_function(file: str, name: str) -> Callable[[list[Any]], _Result]:
    called = getattr(ctypes.CDLL(file), name)
    called.restype = ctypes.c_int

    def calibrate(inputs: list[Any]) -> _Result:
        """Call the function with guards behind its outputs."""
        hard_iron, soft_iron = (np.full(size + _GUARDS, _GUARD, np.float32) for size in (3, 9))
        hard_iron[:3] = soft_iron[:9] = 0.0
        originals = [numbers.copy() for numbers in inputs]
        pointers = [numbers.ctypes.data_as(ctypes.c_void_p) for numbers in (*inputs, hard_iron, soft_iron)]
        began = time.perf_counter()
        status = called(*pointers[:-2], ctypes.c_int(len(inputs[0])), *pointers[-2:])
        microseconds = 1e6 * (time.perf_counter() - began)
        guards = np.concatenate([hard_iron[3:], soft_iron[9:]])
        is_outside = (guards != np.float32(_GUARD)).any()
        if is_outside or any(not np.array_equal(*pair) for pair in zip(inputs, originals, strict=True)):
            return WRITES_OUTSIDE, microseconds, np.zeros(12)
        return REFUSED if status else 0, microseconds, np.concatenate([hard_iron[:3], soft_iron[:9]])

    return calibrate


def _python_function(file: Path, name: str) -> Callable[[list[Any]], _Result]:
    called = getattr(_module(file), name)

    def calibrate(inputs: list[Any]) -> _Result:
        """Call the function with float64 arrays; None is a refusal."""
        arrays = [numbers.astype(np.float64) for numbers in inputs]
        began = time.perf_counter()
        result = called(*arrays)
        microseconds = 1e6 * (time.perf_counter() - began)
        if result is None:
            return REFUSED, microseconds, np.full(12, np.nan)
        if not isinstance(result, (tuple, list)) or len(result) != 2:
            raise TypeError(f"{name} returned no pair of hard iron and soft iron, and not None to refuse")
        hard_iron, soft_iron = (_real(part) for part in result)
        if hard_iron.shape != (3,) or soft_iron.shape != (3, 3):
            raise TypeError(
                f"{name} returned shapes {hard_iron.shape} and {soft_iron.shape}, not (3,) of the hard iron and (3, 3) "
                "of the soft iron"
            )
        return 0, microseconds, np.concatenate([hard_iron, soft_iron.ravel()])

    return calibrate


def _real(part: Any) -> Any:
    """Return numbers as float64; complex ones, as the root of a negative eigenvalue is, become NaN."""
    numbers = np.asarray(part)
    return np.where(numbers.imag == 0, numbers.real, np.nan).astype(np.float64)


# -- filters -------------------------------------------------------------------------------------------------------


def _run_filter(make: _Filter, header: bytes) -> _Result:
    """Update a new filter with all rows of a request, and read it after each stride."""
    count, stride = (int(word) for word in header.split()[::2])
    rate_hz = float(header.split()[1])
    rows = _read(count, 9)
    update, read = make(rate_hz)
    taken_s, answers = 0.0, np.full((count // stride, 4), np.nan)
    for index, row in enumerate(rows):
        began = time.perf_counter()
        update(row[:3], row[3:6], row[6:], 1.0 / rate_hz)
        taken_s += time.perf_counter() - began
        if (index + 1) % stride == 0:
            result = read()
            answer = np.atleast_1d(np.asarray(result, dtype=np.float64))
            if result is None or answer.shape not in ((1,), (4,)):
                shape = None if result is None else answer.shape
                raise TypeError(f"the answer has shape {shape}, not () of a heading or (4,) of a quaternion")
            answers[index // stride, : len(answer)] = answer
    return 0, 1e6 * taken_s / count, answers


def _library_filter(file: str) -> _Filter:
    library = ctypes.CDLL(file)
    begin, change = library.filter_init, library.filter_update
    begin.argtypes = [ctypes.c_float]
    change.argtypes = [*[ctypes.c_void_p] * 3, ctypes.c_float]
    quaternion = np.zeros(4, np.float32)

    def read_quaternion() -> Any:
        """Return the quaternion."""
        library.filter_quaternion(quaternion.ctypes.data_as(ctypes.c_void_p))
        return quaternion.copy()

    read: Callable[[], Any] = read_quaternion
    if not hasattr(library, "filter_quaternion"):
        read = library.filter_heading
        library.filter_heading.restype = ctypes.c_float

    def make(rate_hz: float) -> tuple[Callable[..., Any], Callable[[], Any]]:
        """Start the filter anew."""
        begin(rate_hz)
        return lambda *values: change(*(vector.ctypes.data for vector in values[:3]), values[3]), read

    return make


def _python_filter(file: Path, name: str) -> _Filter:
    kind = getattr(_module(file), name)

    def make(rate_hz: float) -> tuple[Callable[..., Any], Callable[[], Any]]:
        """Return methods of a new object: `update` with float64 arrays, and `quaternion` or `heading`."""
        new = kind(rate_hz)
        read = getattr(new, "quaternion", None) or new.heading
        return lambda *values: new.update(*(vector.astype(np.float64) for vector in values[:3]), values[3]), read

    return make


def _module(file: Path) -> Any:
    sys.path.insert(0, str(file.parent.resolve()))
    described = importlib.util.spec_from_file_location(file.stem, file)
    assert described is not None
    assert described.loader is not None
    module = importlib.util.module_from_spec(described)
    sys.modules[file.stem] = module
    described.loader.exec_module(module)
    return module


def _read(count: int, columns: int) -> Any:
    content = sys.stdin.buffer.read(count * columns * 4)
    return np.frombuffer(content, "<f4").reshape(count, columns).copy()


def _reply(answers: BinaryIO, line: str, content: bytes = b"") -> None:
    answers.write(line.replace("\n", " ").encode() + b"\n" + content)
    answers.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
