"""Saved worst cases, which can be replayed; the files are untrusted JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from hiltest import __version__
from hiltest.budgets import WORST_INPUT
from hiltest.errors import ConfigError
from hiltest.json_files import json_text, read_as
from hiltest.studies.board_calibrators import BoardCalibrators
from hiltest.studies.worst_case.argument_ranges import refuse_files
from hiltest.studies.worst_case.point_sets import MOST_POINTS, PointSets
from hiltest.studies.worst_case.search import Call, SearchResult
from hiltest.virtual.profiling.arguments import parse_argument
from hiltest.virtual.profiling.image import ProfiledImage

SCHEMA: Literal["hiltest.worst-case/1"] = "hiltest.worst-case/1"

_OTHERWISE = "search again: hiltest profile worst"
_LONGEST = 60  # characters of displayed arguments
_COUNTS = np.iinfo(np.int16)


@dataclass(frozen=True, slots=True)
class WorstCase:
    """Result of a search: the most cycles of a function, and the input that causes them."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "strict": True}
    schema: Literal["hiltest.worst-case/1"]
    function: str
    """A calibrator by its name on the link, or a function of the ELF."""
    cycles: int
    """Cycles; for a calibrator as the firmware reports them, minus those of an empty call."""
    cycle_model: str
    """Cycle model of the count."""
    elf: str
    """Name of the searched ELF file."""
    elf_sha256: str
    hiltest: str
    """Version of hiltest."""
    seed: int
    calls: int
    """Seed of the search."""
    points: tuple[tuple[int, int, int], ...] = ()
    """Points of the calibrator [counts]; empty for another function."""
    arguments: tuple[str, ...] = ()
    """Arguments of a function for `hiltest profile`; empty for a calibrator."""

    def __post_init__(self) -> None:
        if not self.function.isprintable() or not self.function:
            raise ValueError(f"function {self.function!r} is not a name")
        if bool(self.points) == bool(self.arguments):
            raise ValueError("there must be either points or arguments")
        if len(self.points) > MOST_POINTS:
            raise ValueError(f"{len(self.points)} points, but the firmware stores {MOST_POINTS}")
        if any(not _COUNTS.min <= count <= _COUNTS.max for point in self.points for count in point):
            raise ValueError("a point is out of the range of int16")
        if self.cycles < 0 or self.calls < 1:
            raise ValueError("cycles must be at least 0, and calls at least 1")
        refuse_files(self.arguments)

    @property
    def description(self) -> str:
        """Function and input, shortened for display."""
        input_text = f"{len(self.points)} points" if self.points else " ".join(self.arguments)
        return f"{self.function}({input_text if len(input_text) <= _LONGEST else f'{input_text[:_LONGEST]}...'})"

    @property
    def counts(self) -> NDArray[np.int16]:
        """The points, shape (n, 3) [counts]."""
        return np.array(self.points, dtype=np.int16).reshape(-1, 3)

    def replay(self, elf: Path) -> tuple[Call, str]:
        """Call the function of an ELF with the saved input; return the call and its cycle model."""
        if self.points:
            calibrators = BoardCalibrators(elf)
            if self.function not in calibrators.names:
                names = ", ".join(calibrators.names) or "no calibrators"
                raise ConfigError(f"{elf}: no calibrator {self.function!r}; the file has {names}")
            call = PointSets(calibrators, self.function, len(self.points)).call(self.counts)
            return call, calibrators.cycle_model
        profile = ProfiledImage(elf).call(self.function, *map(parse_argument, self.arguments))
        return Call(profile.cycles, profile.value, counts=True), profile.cycle_model


def worst_case(
    result: SearchResult[Any], saved_input: Mapping[str, Any], elf: Path, function: str, seed: int
) -> WorstCase:
    """Return the worst case of a search; the call is repeated to record its cycle model."""
    case = WorstCase(
        SCHEMA, function, result.call.cycles, "", elf.name, digest(elf), __version__, seed, result.calls, **saved_input
    )
    call, cycle_model = case.replay(elf)
    if call.cycles != case.cycles:
        raise ConfigError(
            f"{function} takes {call.cycles} cycles when repeated, but took {case.cycles}: it depends on external "
            "state, so its worst case cannot be saved"
        )
    return replace(case, cycle_model=cycle_model)


def digest(elf: Path) -> str:
    """Return the SHA-256 of a file."""
    return sha256(elf.read_bytes()).hexdigest()


def to_json(case: WorstCase) -> str:
    """Return the content of the file."""
    return json_text(case, numbers_in_line=True) + "\n"


def load_worst_case(path: Path) -> WorstCase:
    """Read and check a file.

    Raises
    ------
    ConfigError
        If the file cannot be read, or is not a saved worst case; the message has the reason.
    """
    return read_as(path, WorstCase, SCHEMA, otherwise=_OTHERWISE, budget=WORST_INPUT)
