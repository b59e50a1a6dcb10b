"""Source lines whose cost differs between two builds of a function."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from itertools import zip_longest

from hiltest.virtual.counts.profiling import LineCost


@dataclass(frozen=True, slots=True)
class LineChange:
    """Cost of one source line in an older and a newer build."""

    location: str
    """File and line in the newer build; in the older one if only that executes it."""
    cycles: int
    instructions: int
    base_location: str
    """File and line in the older build; empty if only the newer one executes it."""
    base_cycles: int
    base_instructions: int

    @property
    def delta(self) -> int:
        """Cycles more than in the older build."""
        return self.cycles - self.base_cycles


def line_changes(base: Sequence[LineCost], new: Sequence[LineCost]) -> list[LineChange]:
    """Return the lines that cost more or less in the newer build, the largest change first.

    An edit moves the lines behind it, so lines are aligned within their file by the numbers of executed instructions.
    """
    files = sorted({_file_and_line(line)[0] for line in (*base, *new)})
    changes = [change for file in files for change in _align(_lines_of(file, base), _lines_of(file, new))]
    return sorted(changes, key=lambda change: (-abs(change.delta), change.location))


def _align(base: Sequence[LineCost], new: Sequence[LineCost]) -> Iterator[LineChange]:
    before, after = ([line.instructions for line in side] for side in (base, new))
    for _, first, last, begin, end in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        for old, line in zip_longest(base[first:last], new[begin:end]):
            counts = [(0, 0) if side is None else (side.cycles, side.instructions) for side in (line, old)]
            if counts[0] != counts[1]:
                place = (line or old).location
                yield LineChange(place, *counts[0], old.location if old else "", *counts[1])


def _lines_of(file: str, lines: Sequence[LineCost]) -> list[LineCost]:
    return sorted((line for line in lines if _file_and_line(line)[0] == file), key=_file_and_line)


def _file_and_line(line: LineCost) -> tuple[str, int]:
    file, _, number = line.location.rpartition(":")
    return (file, int(number)) if number.isdecimal() else (line.location, 0)
