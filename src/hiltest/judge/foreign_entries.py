"""Calibrators and filters of images whose functions have a foreign signature."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hiltest.calibration.fit import Array
from hiltest.errors import BoardFault, ConfigError, nearest_hint
from hiltest.judge.answers import Answer, Cloud
from hiltest.judge.filters import ImageFilter
from hiltest.judge.foreign_calls import BoundCall, ForeignCalls
from hiltest.judge.image_calibrator import TIMEOUT_S
from hiltest.judge.signature_table import ReadTable
from hiltest.virtual.board.cortex_m4 import VirtualCortexM4
from hiltest.virtual.board.loading import load_running
from hiltest.virtual.calls.calling import CallResult
from hiltest.virtual.counts.profiling import CallProfile
from hiltest.virtual.profiling.image import ProfiledImage
from hiltest.virtual.program.elf import load_image


class _CoreMachine:
    """The emulated core; the first judged call after a reset is profiled if there is a `profiled` image."""

    follows_pointers = True

    def __init__(self, board: VirtualCortexM4, profiled: ProfiledImage | None = None) -> None:
        self._board, self._profiled = board, profiled
        memory = board.processor.memory
        self.read, self.write = memory.read, memory.write
        self.results: list[CallResult] = []

    def reset(self) -> None:
        load_running(self._board.processor.memory, self._board.image)
        self.results.clear()

    def call(self, call: BoundCall, arguments: Sequence[Any], *, counted: bool) -> int | float | None:
        is_profiled = counted and not self.results and self._profiled is not None
        execute = self._profiled.call if is_profiled and self._profiled else self._board.call
        result = execute(call.function, *arguments, timeout_s=TIMEOUT_S, keeps_ram=True)
        if counted:
            self.results.append(result)
        return result.value


class ForeignCalibrator:
    """A calibrator of an image, as a table describes it.

    Parameters
    ----------
    name, file, built_by, part
        As of an `ImageCalibrator`.
    table
        The table, and its file.

    Raises
    ------
    ConfigError
        If the table does not fit the image.
    """

    def __init__(self, name: str, file: Path, table: ReadTable, *, built_by: str = "", part: str | None = None) -> None:
        image = load_image(file)
        self.name, self.built_by = name, built_by or image.compiler_flags
        self.flash_bytes: int | None = sum(len(segment.data) for segment in image.segments)
        profiled = ProfiledImage(file, part=part)
        self._machine = _CoreMachine(profiled.board, profiled)
        self._calls = ForeignCalls(*table, image, self._machine)
        self.cycle_model = ""

    def answer(self, cloud: Cloud) -> Answer:
        """Calibrate from samples; the errors are those of `ImageCalibrator.answer`."""
        try:
            answer = self._calls.calibrate(cloud.samples_ut, cloud.accelerations_g)
        except BoardFault as fault:
            raise fault.located(f"{self.name} {cloud.where}") from fault
        except ConfigError as error:
            raise ConfigError(f"{error} {cloud.where}") from error
        first, *further = self._machine.results
        assert isinstance(first, CallProfile)
        self.cycle_model = first.cycle_model
        cycles = sum(result.cycles for result in self._machine.results)
        stack = max(result.stack_bytes or 0 for result in self._machine.results)
        return Answer(*answer, cycles=cycles, band=None if further else first.band, stack_bytes=stack)


class ForeignFilter(ImageFilter):
    """A filter of an image, as a table describes it."""

    def __init__(self, name: str, file: Path, table: ReadTable, *, built_by: str = "") -> None:
        self._update = table[0].functions[0]
        super().__init__(name, file, built_by=built_by)
        self._machine = _CoreMachine(self._board)
        self._calls = ForeignCalls(*table, self._board.image, self._machine)

    def _check(self, symbols: Iterable[str]) -> None:
        if self._update not in symbols:
            raise ConfigError(f"{self.name} has no function {self._update}; {nearest_hint(self._update, [*symbols])}")

    def _start(self, rate_hz: float) -> None:
        self._calls.start(rate_hz)

    def _follow(self, rate: Array, gravity: Array, field: Array, dt: float) -> CallResult:
        self._calls.update(rate, gravity, field)
        return self._machine.results.pop()

    def _read(self) -> Any:
        return self._calls.read()
