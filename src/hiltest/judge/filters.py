"""Filters to judge: functions that are called with each reading of a motion and return an attitude or a heading."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hiltest.boards.bench import default_firmware
from hiltest.calibration.fit import Array
from hiltest.errors import BoardFault, ConfigError
from hiltest.judge import host_worker
from hiltest.judge.host_process import HostProcess
from hiltest.judge.own_calibrators import packaged_compiler
from hiltest.measurement import CycleRange
from hiltest.orientation.motion_recording import MotionRecording
from hiltest.virtual.board.k64f import board_for
from hiltest.virtual.calls.calling import CallResult
from hiltest.virtual.counts.cycle_range import timed_range
from hiltest.virtual.processor.slices import Slice
from hiltest.virtual.program.elf import load_image

FILTER_TIMEOUT_S = 600.0
"""Longest time of a motion on the host."""
READ_HZ = 50.0
"""Answers are read about this often, since the attitude changes little in between."""
INIT, UPDATE, QUATERNION, HEADING = "filter_init", "filter_update", "filter_quaternion", "filter_heading"
_MOST_SLICES = 200  # different counts of updates, whose executed code is kept for the range
_STATE_BYTES = 14 * 4  # attitude_filter_t


@dataclass(frozen=True, slots=True, eq=False)
class FilterAnswers:
    """Answers of a filter to a motion."""

    places: NDArray[np.intp]
    """Shape (m,). Indices of the readings that the answers follow."""
    quaternions: Array | None
    """Shape (m, 4): x, y, z, w from body to NED; None if the filter returns headings only."""
    headings_deg: Array | None
    """Shape (m,); None if it returns quaternions."""
    cycles: Array
    """Cycles of each update; empty if they were not counted."""
    band: CycleRange | None = None
    """Uncertainty range of the update with the median cycles."""
    host_us: float | None = None


class JudgedFilter(Protocol):
    """A filter to judge."""

    @property
    def name(self) -> str:
        """Name in tables."""

    @property
    def built_by(self) -> str:
        """Compiler and flags; empty if none is known."""

    @property
    def cycle_model(self) -> str:
        """Cycle model of the counts; empty without counts."""

    def follow(self, motion: MotionRecording) -> FilterAnswers:
        """Start anew, and follow a motion."""


def readings_of(motion: MotionRecording) -> tuple[Array, Array, Array]:
    """Return rates without the bias of the rest [rad/s], gravity [g, positive down] and field [uT]."""
    rates = motion.gyroscope_rad_s - motion.rest_bias_rad_s()
    return rates, motion.gravity_g, motion.field_ut


def stride_of(motion: MotionRecording) -> int:
    """Return the number of readings for each answer."""
    return max(1, round(motion.rate_hz / READ_HZ))


class ImageFilter:
    """A filter in an image for a Cortex-M4, which the emulated core executes.

    Its variables are kept between calls.

    Raises
    ------
    ConfigError
        If the image lacks a function of the contract.
    """

    _update = UPDATE

    def __init__(self, name: str, file: Path, *, built_by: str = "") -> None:
        image = load_image(file)
        self.name, self.built_by = name, built_by or image.compiler_flags
        self._check(image.symbols)
        self._board = board_for(file)
        placement = "sram" if image.symbols[self._update].address >= self._board.processor.memory.sram.base else "flash"
        self.cycle_model = f"{self._board.processor.profile.name}@{placement}"

    def follow(self, motion: MotionRecording) -> FilterAnswers:
        """Start anew, and follow a motion.

        Raises
        ------
        BoardFault
            If a function faults or does not return.
        """
        vectors = [numbers.astype(np.float32) for numbers in readings_of(motion)]
        stride, count, dt = stride_of(motion), len(vectors[0]), float(np.float32(1.0 / motion.rate_hz))
        cycles, answers = np.empty(count), []
        slices: dict[int, Slice] = {}
        place = 0
        try:
            self._start(motion.rate_hz)
            for place in range(count):
                called = self._follow(vectors[0][place], vectors[1][place], vectors[2][place], dt)
                cycles[place] = called.cycles
                if called.executed is not None and len(slices) < _MOST_SLICES:
                    slices.setdefault(called.cycles, called.executed)
                if (place + 1) % stride == 0:
                    answers.append(self._read())
        except BoardFault as fault:
            raise fault.located(f"{self.name} in the motion {motion.name}, reading {place}") from fault
        is_heading = np.ndim(answers[0]) == 0
        return FilterAnswers(
            _places(count, stride),
            None if is_heading else np.array(answers),
            np.array(answers) if is_heading else None,
            cycles,
            self._band(cycles, slices),
        )

    def _check(self, symbols: Collection[str]) -> None:
        for function in (INIT, UPDATE):
            if function not in symbols:
                raise ConfigError(f"{self.name}: no function {function}; define it as hiltest_judge.h says")
        self._returns_quaternion = QUATERNION in symbols
        if not self._returns_quaternion and HEADING not in symbols:
            raise ConfigError(f"{self.name}: neither {QUATERNION} nor {HEADING}; define one as hiltest_judge.h says")

    def _start(self, rate_hz: float) -> None:
        self._board.call(INIT, float(rate_hz))

    def _follow(self, rate: Array, gravity: Array, field: Array, dt: float) -> CallResult:
        return self._board.call(UPDATE, rate, gravity, field, dt, keeps_ram=True)

    def _read(self) -> Any:
        if not self._returns_quaternion:
            return float(self._board.call(HEADING, keeps_ram=True).value or 0.0)
        quaternion = np.zeros(4, np.float32)
        self._board.call(QUATERNION, quaternion, keeps_ram=True)
        return quaternion.astype(float)

    def _band(self, cycles: Array, slices: dict[int, Slice]) -> CycleRange | None:
        """Return the range of the update with the median cycles; None if its code was not kept."""
        executed = slices.get(median_cycles(cycles))
        if executed is None:
            return None
        empty: list[Slice] = []
        profile = self._board.processor.profile
        return timed_range(profile, self.cycle_model, median_cycles(cycles), ([executed], empty))


def median_cycles(cycles: Array) -> int:
    """Return the lower median of counts, which is the count of an update."""
    return int(np.sort(cycles)[(len(cycles) - 1) // 2])


class OwnFilter(ImageFilter):
    """The attitude filter of the packaged firmware, whose state is an argument."""

    _update = "attitude_filter_update"

    def __init__(self) -> None:
        super().__init__("attitude_filter", default_firmware(), built_by=packaged_compiler())
        self._state = bytearray(_STATE_BYTES)

    def _check(self, symbols: Collection[str]) -> None:
        assert self._update in symbols

    def _start(self, rate_hz: float) -> None:
        self._board.call("attitude_filter_init", self._state, np.zeros(3, np.float32))

    def _follow(self, rate: Array, gravity: Array, field: Array, dt: float) -> CallResult:
        return self._board.call(self._update, self._state, rate, gravity, field, dt)

    def _read(self) -> Any:
        quaternion = np.zeros(4, np.float32)
        self._board.call("attitude_filter_attitude", self._state, quaternion)
        return quaternion.astype(float)


class HostFilter:
    """A filter in a shared library or a Python class, in a process of its own.

    Raises
    ------
    ConfigError
        If the file cannot be loaded, or lacks a function of the contract.
    """

    cycle_model = built_by = ""

    def __init__(self, name: str, file: Path, function: str) -> None:
        self.name = name
        self._process = HostProcess(name, file, function, host_worker.FILTER)

    def __enter__(self) -> HostFilter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.close()

    def follow(self, motion: MotionRecording) -> FilterAnswers:
        """Start anew, and follow a motion.

        Raises
        ------
        ConfigError
            If the filter fails, ends the process, or takes more than `FILTER_TIMEOUT_S`.
        """
        rows = np.hstack(readings_of(motion)).astype("<f4")
        stride = stride_of(motion)
        self._process.send(f"{len(rows)} {motion.rate_hz!r} {stride}\n".encode() + rows.tobytes())
        where = f"in the motion {motion.name}"
        _, microseconds = self._process.read_line(where, FILTER_TIMEOUT_S).split()
        places = _places(len(rows), stride)
        content = self._process.read_bytes(len(places) * 4 * 8, where, FILTER_TIMEOUT_S)
        answers = np.frombuffer(content, "<f8").reshape(-1, 4)
        is_heading = bool(np.isnan(answers[:, 1:]).all())
        return FilterAnswers(
            places,
            None if is_heading else answers,
            answers[:, 0] if is_heading else None,
            np.empty(0),
            host_us=float(microseconds),
        )


def _places(count: int, stride: int) -> NDArray[np.intp]:
    return np.arange(stride - 1, count - count % stride, stride)
