"""Cycles of functions that work in slices, by the solution that they come to."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from hiltest.errors import ConfigError
from hiltest.virtual.calls.call_watch import CallWatch
from hiltest.virtual.calls.kept_slices import KeptSlices, KeptSolution
from hiltest.virtual.processor.call_summary import Call, Solution, SolutionSummary, solutions_summarised, solved
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.program.elf import FirmwareImage

_PLACE = re.compile(r"(?P<symbol>[A-Za-z_$][\w$.]*)\s*(?:\+\s*(?P<offset>0[xX][0-9a-fA-F]+|\d+))?")
_SIZES = (1, 2, 4)


class EndsWhen(Enum):
    """What a word in memory shows at the return of a solution's last slice, and at no other."""

    ZERO = "zero"
    CHANGED = "changed"


@dataclass(frozen=True, slots=True)
class SolutionEnd:
    """How to tell that a solution is complete."""

    word: str | int
    """A variable, and where in it: ``progress`` or ``sfg+0xa80``; or an address."""
    when: EndsWhen = EndsWhen.ZERO
    """What is looked for: 0, as of a state or a count of slices, or another value than at the return before, as of
    a count of solutions."""
    size: int = 4
    """Bytes of the word: 1, 2 or 4."""

    def address(self, image: FirmwareImage) -> int:
        """Return where the word is.

        Raises
        ------
        ConfigError
            There is no such variable, or the word is not within it.
        """
        if isinstance(self.word, int):
            return self.word
        match = _PLACE.fullmatch(self.word)
        symbol = image.symbols.get(match["symbol"]) if match else None
        if match is None or symbol is None or symbol.is_function:
            raise ConfigError(
                f"{image.name}: {self.word!r} is no variable; write the name of one, or that and an offset in bytes, "
                "as in state+0x10"
            )
        offset = int(match["offset"] or "0", 0)
        if self.size not in _SIZES or offset + self.size > symbol.size:
            raise ConfigError(
                f"{image.name}: {self.size} bytes at {self.word} are not 1, 2 or 4 bytes of the {symbol.size} of "
                f"{symbol.name}"
            )
        return symbol.address + offset


class SolutionWatch:
    """Sums up slices by solution; made by `VirtualCortexM4.watch_solutions`.

    Parameters
    ----------
    processor
        The emulator must not be running.
    functions
        What is called once for each slice; those of several functions together make a solution.

    Raises
    ------
    ConfigError
        No such function or variable, or one of the functions is watched for another word already.

    Notes
    -----
    A solution that had begun before `begin` is left out, as is the one under way.
    """

    def __init__(self, processor: Processor, functions: Iterable[str], end: SolutionEnd) -> None:
        self._end = end
        self._memory = processor.memory
        self._address = end.address(processor.image)
        self._functions = tuple(functions)
        self._watch = CallWatch(processor, self._functions)
        self._watch.look_at(self._address, end.size)
        self._kept = KeptSlices(processor, self._watch, self._ends)
        self.begin()

    def begin(self) -> None:
        """Leave the solutions out that began before now."""
        self._watch.begin()
        self._before = int.from_bytes(self._memory.read(self._address, self._end.size), "little")
        self._kept.begin(self._before, is_whole=self._starts_whole)

    def _ends(self, slice_: Call, before: int) -> bool:
        return slice_.left == 0 if self._end.when is EndsWhen.ZERO else slice_.left != before

    @property
    def solutions(self) -> list[Solution]:
        """Solutions since `begin`."""
        slices = sorted(call for name in self._functions for call in self._watch.calls(name))
        return solved(slices, self._ends, before=self._before, is_whole=self._starts_whole)

    @property
    def _starts_whole(self) -> bool:
        return self._watch.began == 0 or (self._end.when is EndsWhen.ZERO and self._before == 0)

    @property
    def summary(self) -> SolutionSummary:
        """What the solutions since `begin` come to."""
        return solutions_summarised(self.solutions)

    @property
    def stack(self) -> int | None:
        """Bytes that the deepest slice so far took; None where that is not known."""
        return max((each for each in map(self._watch.stack, self._functions) if each is not None), default=None)

    def latest(self) -> KeptSolution | None:
        """Return the solution that was completed last since `begin`, to be computed once more; None without one."""
        return self._kept.latest()
