"""Cycles of solutions that functions compute in slices."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from hiltest.errors import ConfigError
from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.calls.slice_recorder import RecordedSolution, SliceRecorder
from hiltest.virtual.processor.call_summary import Call, Solution, SolutionSummary, sum_solutions, summarise_solutions
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.program.elf import FirmwareImage

_PLACE = re.compile(r"(?P<symbol>[A-Za-z_$][\w$.]*)\s*(?:\+\s*(?P<offset>0[xX][0-9a-fA-F]+|\d+))?")
_SIZES = (1, 2, 4)


class EndsWhen(Enum):
    """Condition on a word in memory that is true only at the return of a solution's last slice."""

    ZERO = "zero"
    CHANGED = "changed"


@dataclass(frozen=True, slots=True)
class SolutionEnd:
    """Criterion for the end of a solution."""

    word: str | int
    """Variable with an optional offset (``progress`` or ``sfg+0xa80``), or an address."""
    when: EndsWhen = EndsWhen.ZERO
    """Condition: the word is 0, if it is a state or a count of remaining slices; or it has changed since the previous
    return, if it is a count of solutions."""
    size: int = 4
    """Size of the word [bytes]: 1, 2 or 4."""

    def address(self, image: FirmwareImage) -> int:
        """Return the address of the word.

        Raises
        ------
        ConfigError
            If there is no such variable, or it does not contain the word.
        """
        if isinstance(self.word, int):
            return self.word
        match = _PLACE.fullmatch(self.word)
        symbol = image.symbols.get(match["symbol"]) if match else None
        if match is None or symbol is None or symbol.is_function:
            raise ConfigError(
                f"{image.name}: {self.word!r} is not a variable; write the name of a variable, or name and offset in "
                "bytes as in state+0x10"
            )
        offset = int(match["offset"] or "0", 0)
        if self.size not in _SIZES or offset + self.size > symbol.size:
            raise ConfigError(
                f"{image.name}: {self.size} bytes at {self.word} are not 1, 2 or 4 bytes within the {symbol.size} "
                f"bytes of {symbol.name}"
            )
        return symbol.address + offset


class SolutionWatch:
    """Counter of slices, by solution; see `VirtualCortexM4.watch_solutions`.

    Parameters
    ----------
    processor
        Processor that is not running.
    functions
        Functions that are called once for each slice; their calls together compute a solution.

    Raises
    ------
    ConfigError
        If a function or variable does not exist, or if a function is already watched with another word.

    Notes
    -----
    Solutions that began before `begin` are ignored, and so is the current one.
    """

    def __init__(self, processor: Processor, functions: Iterable[str], end: SolutionEnd) -> None:
        self._end = end
        self._memory = processor.memory
        self._address = end.address(processor.image)
        self._functions = tuple(functions)
        self._watch = CallWatch(processor, self._functions)
        self._watch.record_word(self._address, end.size)
        self._snapshots = SliceRecorder(processor, self._watch, self._ends)
        self.begin()

    def begin(self) -> None:
        """Ignore solutions that began before now."""
        self._watch.begin()
        self._before = int.from_bytes(self._memory.read(self._address, self._end.size), "little")
        self._snapshots.begin(self._before, is_whole=self._starts_whole)

    def _ends(self, slice_: Call, before: int) -> bool:
        return slice_.word == 0 if self._end.when is EndsWhen.ZERO else slice_.word != before

    @property
    def solutions(self) -> list[Solution]:
        slices = sorted(call for name in self._functions for call in self._watch.calls(name))
        return sum_solutions(slices, self._ends, before=self._before, is_whole=self._starts_whole)

    @property
    def _starts_whole(self) -> bool:
        return self._watch.began == 0 or (self._end.when is EndsWhen.ZERO and self._before == 0)

    @property
    def summary(self) -> SolutionSummary:
        """Statistics of the solutions since `begin`."""
        return summarise_solutions(self.solutions)

    @property
    def stack(self) -> int | None:
        """Largest stack use of a slice [bytes]; None if it is unknown."""
        sizes = map(self._watch.stack, self._functions)
        return max((size for size in sizes if size is not None), default=None)

    def latest(self) -> RecordedSolution | None:
        """Return the latest complete solution since `begin`, which can be repeated; None if there is none."""
        return self._snapshots.latest()
