"""Two ways to run the firmware's stream calibrators: compiled for this machine, and on the virtual board."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltest.calibration import FitStatus, MagnetometerFit
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.calls.calling import CallResult

from .references.direct_stream import MONOMIALS

STATE_BYTES = 0x4000
CELLS = 392
# stream_report_t and, at the start of their states, exact_moments_t and magnetic_buffer_t: the same on both.
REPORT = struct.Struct("<BBH13fHB?If")
SUMS = struct.Struct("<9i25q")
BUFFER = struct.Struct(f"<{3 * CELLS}h{CELLS}IH")


@dataclass(frozen=True)
class Report:
    """What a stream calibrator answers."""

    fit: MagnetometerFit
    held: int
    elements: int
    is_solving: bool
    accepted: int
    fit_error_percent: float

    @property
    def bits(self) -> tuple[object, ...]:
        """All of it, to be compared to the last bit."""
        fit = self.fit
        return (
            fit.status,
            fit.is_sphere,
            fit.iterations,
            fit.soft_iron.tobytes(),
            fit.hard_iron.tobytes(),
            fit.coverage,
            self.held,
            self.elements,
            self.is_solving,
            self.accepted,
            self.fit_error_percent,
        )


class Stream:
    """One stream calibrator and its state; subclasses know where both are."""

    def __init__(self, name: str) -> None:
        self._prefix = name.replace("-", "_")

    def reset(self, *, sliced: bool = False) -> None:
        self._call("reset", int(sliced))

    def add(self, point: Sequence[int]) -> int:
        return self._step("add", point)

    def remove(self, point: Sequence[int]) -> int:
        return self._step("remove", point)

    def report(self) -> Report:
        status, is_sphere, iterations, *rest = REPORT.unpack(self._report(REPORT.size))
        values, (held, elements, is_solving, accepted, fit_error) = rest[:13], rest[13:]
        fit = MagnetometerFit(
            FitStatus(status),
            bool(is_sphere),
            iterations,
            np.array(values[:9]).reshape(3, 3),
            np.array(values[9:12]),
            values[12],
        )
        return Report(fit, held, elements, is_solving, accepted, fit_error)

    def sums(self) -> dict[str, int]:
        """The sums of `direct-stream`."""
        return dict(zip(MONOMIALS, SUMS.unpack(self.state(SUMS.size)), strict=True))

    def points(self) -> list[tuple[int, int, int]]:
        """The points in the buffer of `iterative-stream`, in the order of their cells."""
        values = BUFFER.unpack(self.state(BUFFER.size))
        rows = [values[3 * cell : 3 * cell + 3] for cell in range(CELLS)]
        return [row for row, stored in zip(rows, values[3 * CELLS : 4 * CELLS], strict=True) if stored]

    def moments_about_mean(self, held: int) -> tuple[list[int], list[float]]:
        """The origin that `direct-stream` moves its sums to, and the moments about it."""
        raise NotImplementedError

    def state(self, size: int) -> bytes:
        raise NotImplementedError

    def _call(self, function: str, argument: int) -> None:
        raise NotImplementedError

    def _step(self, function: str, point: Sequence[int]) -> int:
        raise NotImplementedError

    def _report(self, size: int) -> bytes:
        raise NotImplementedError


class HostStream(Stream):
    """Compiled for this machine."""

    def __init__(self, name: str, library: ctypes.CDLL) -> None:
        super().__init__(name)
        self._library = library
        self._state = ctypes.create_string_buffer(STATE_BYTES)

    def state(self, size: int) -> bytes:
        return self._state.raw[:size]

    def moments_about_mean(self, held: int) -> tuple[list[int], list[float]]:
        mean, moments = (ctypes.c_int32 * 3)(), (ctypes.c_float * 35)()
        self._library.exact_moments_about_mean(self._state, held, mean, moments)
        return list(mean), list(moments)

    def _call(self, function: str, argument: int) -> None:
        getattr(self._library, f"{self._prefix}_{function}")(self._state, ctypes.c_bool(argument))

    def _step(self, function: str, point: Sequence[int]) -> int:
        step = getattr(self._library, f"{self._prefix}_{function}")
        step.restype = ctypes.c_uint8  # short enumerations
        return int(step(self._state, (ctypes.c_int16 * 3)(*map(int, point))))

    def _report(self, size: int) -> bytes:
        report = ctypes.create_string_buffer(size)
        getattr(self._library, f"{self._prefix}_report")(self._state, report)
        return report.raw


class BoardStream(Stream):
    """The shipped firmware's, called on a virtual board that did not boot."""

    # In SRAM_U behind everything the image uses, below the stack.
    STATE, POINT, RESULT, MEAN = 0x20020000, 0x20028000, 0x20028020, 0x20028200

    def __init__(self, name: str, board: VirtualK64F) -> None:
        super().__init__(name)
        self._board = board
        self.last: CallResult | None = None
        board.processor.memory.write(self.STATE, bytes(STATE_BYTES))

    def state(self, size: int) -> bytes:
        return self._board.processor.memory.read(self.STATE, size)

    def moments_about_mean(self, held: int) -> tuple[list[int], list[float]]:
        self._board.call("exact_moments_about_mean", self.STATE, held, self.MEAN, self.RESULT)
        memory = self._board.processor.memory
        return list(struct.unpack("<3i", memory.read(self.MEAN, 12))), list(
            struct.unpack("<35f", memory.read(self.RESULT, 140))
        )

    def _call(self, function: str, argument: int) -> None:
        self._board.call(f"{self._prefix}_{function}", self.STATE, argument)

    def _step(self, function: str, point: Sequence[int]) -> int:
        self._board.processor.memory.write(self.POINT, struct.pack("<3h", *map(int, point)))
        self.last = self._board.call(f"{self._prefix}_{function}", self.STATE, self.POINT)
        return int(self.last.value or 0)

    def _report(self, size: int) -> bytes:
        self.last = self._board.call(f"{self._prefix}_report", self.STATE, self.RESULT)
        return self._board.processor.memory.read(self.RESULT, size)
