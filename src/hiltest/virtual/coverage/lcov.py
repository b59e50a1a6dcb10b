"""Coverage of source files, which can be added, and written to and read from LCOV files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from hiltest.errors import ConfigError


class Share(NamedTuple):
    """A count and its total."""

    hit: int
    total: int


@dataclass(slots=True)
class FileCoverage:
    """Counts of one source file."""

    lines: dict[int, int] = field(default_factory=dict)
    """Executions of each line that has code."""
    functions: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Line of each function with its own code, and the number of its calls."""
    branches: dict[tuple[int, int], tuple[int, int]] = field(default_factory=dict)
    """Counts of both directions of each conditional branch, by its line and its number there."""

    def add(self, other: FileCoverage) -> None:
        """Add the counts of another run."""
        for line, count in other.lines.items():
            self.lines[line] = self.lines.get(line, 0) + count
        for name, (line, count) in other.functions.items():
            self.functions[name] = line, self.functions.get(name, (line, 0))[1] + count
        for place, (first, second) in other.branches.items():
            before = self.branches.get(place, (0, 0))
            self.branches[place] = before[0] + first, before[1] + second


@dataclass(slots=True)
class Coverage:
    """Counts of source files, by their names."""

    files: dict[str, FileCoverage] = field(default_factory=dict)

    def add(self, other: Coverage) -> None:
        """Add the counts of another run."""
        for name, file in other.files.items():
            self.files.setdefault(name, FileCoverage()).add(file)

    @property
    def lines(self) -> Share:
        """Lines that were executed."""
        return _share(count > 0 for file in self.files.values() for count in file.lines.values())

    @property
    def functions(self) -> Share:
        """Functions that were entered."""
        return _share(count > 0 for file in self.files.values() for _, count in file.functions.values())

    @property
    def branches(self) -> Share:
        """Conditional branches that took both directions."""
        return _share(all(ways) for file in self.files.values() for ways in file.branches.values())


def _share(hits: Iterable[bool]) -> Share:
    flags = list(hits)
    return Share(sum(flags), len(flags))


def refuse_file(path: Path) -> None:
    """Reject the name of a file that cannot be written.

    Raises
    ------
    ConfigError
        If it is a folder, or is in a folder that does not exist.
    """
    reason = "it is a folder" if path.is_dir() else "" if path.parent.is_dir() else f"there is no folder {path.parent}"
    if reason:
        raise ConfigError(f"cannot write {path}: {reason}; name another file with --coverage")


def to_lcov(coverage: Coverage) -> str:
    """Return the content of an LCOV file, as geninfo(1) describes it."""
    return "\n".join(line for name, file in sorted(coverage.files.items()) for line in _records(name, file)) + "\n"


def _records(name: str, file: FileCoverage) -> Iterator[str]:
    yield "TN:"
    yield f"SF:{name}"
    functions = sorted(file.functions.items(), key=lambda entry: (entry[1][0], entry[0]))
    yield from (f"FN:{line},{function}" for function, (line, _) in functions)
    yield from (f"FNDA:{count},{function}" for function, (_, count) in functions)
    yield f"FNF:{len(functions)}"
    yield f"FNH:{sum(count > 0 for _, (_, count) in functions)}"
    for (line, number), ways in sorted(file.branches.items()):
        for way, count in enumerate(ways):
            yield f"BRDA:{line},{number},{way},{count if any(ways) else '-'}"
    ways_all = [count for ways in file.branches.values() for count in ways]
    yield f"BRF:{len(ways_all)}"
    yield f"BRH:{sum(count > 0 for count in ways_all)}"
    yield from (f"DA:{line},{count}" for line, count in sorted(file.lines.items()))
    yield f"LF:{len(file.lines)}"
    yield f"LH:{sum(count > 0 for count in file.lines.values())}"
    yield "end_of_record"


_FUNCTION = re.compile(r"(\d+),(.+)")


def from_lcov(text: str, name: str) -> Coverage:
    """Read a file from `to_lcov`.

    Parameters
    ----------
    name
        Name of the file, for the message.

    Raises
    ------
    ConfigError
        If the text is not from `to_lcov`.
    """
    coverage, file = Coverage(), FileCoverage()
    for number, line in enumerate(text.splitlines(), 1):
        kind, _, value = line.partition(":")
        try:
            if kind == "SF":
                file = coverage.files.setdefault(value, FileCoverage())
            elif kind in ("FN", "FNDA"):
                match = _FUNCTION.fullmatch(value)
                assert match is not None
                count, function = int(match[1]), match[2]
                file.functions[function] = (count, 0) if kind == "FN" else (file.functions[function][0], count)
            elif kind == "BRDA":
                at, block, way, executions = value.split(",")
                ways = list(file.branches.get((int(at), int(block)), (0, 0)))
                ways[int(way)] = 0 if executions == "-" else int(executions)
                file.branches[int(at), int(block)] = ways[0], ways[1]
            elif kind == "DA":
                at, count_text = value.split(",")[:2]
                file.lines[int(at)] = int(count_text)
        except (AssertionError, ValueError, KeyError, IndexError) as error:
            raise ConfigError(f"{name}:{number}: {line!r} is not an LCOV record; run again") from error
    return coverage
