"""Loops that lose cycles to misaligned instructions, and remedies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from hiltest.virtual.program.elf import FirmwareImage

LEAST_SHARE = 0.01
"""A loop that loses less than this share of the total is omitted."""


@dataclass(frozen=True, slots=True)
class LoopPlacement:
    """A loop, and the cycles that it loses to misaligned instructions according to the cycle model."""

    function: str
    location: str
    """Source line; empty without debug information."""
    address: int
    last: int
    """Addresses of the first instruction and of the branch back."""
    turns: int
    """Number of times that the branch back was taken."""
    misplaced: int
    wide: int
    """Executions of misaligned instructions of four bytes, and of all instructions of four bytes."""
    cycles: int
    """Cycles that they waited for their fetch, without inner loops."""
    advice: str
    """Change that aligns the instructions that wait most."""


@dataclass(slots=True)
class FetchTally:
    """Executions of an instruction, and the cycles that it waited for its fetch."""

    address: int
    size: int
    executions: int = 0
    late: int = 0

    @property
    def misplaced(self) -> bool:
        """Return whether its four bytes are in two words, both of which have to be fetched."""
        return self.size == 4 and self.address % 4 != 0


Loop = tuple[int, int]
"""Addresses of the first instruction and of the branch back."""


def placements(
    name: str,
    loops: Mapping[Loop, int],
    executed: Mapping[int, FetchTally],
    image: FirmwareImage,
    text_at: Callable[[int], str],
) -> Iterator[LoopPlacement]:
    """Yield the loops of a function in which instructions wait for their fetch.

    Parameters
    ----------
    loops
        Number of times that each branch back was taken.
    executed
        Executed instructions of the function, by address.
    text_at
        Returns the text of the instruction at an address.
    """
    inside: dict[Loop, list[FetchTally]] = {}
    for address, tally in executed.items():
        around = [loop for loop in loops if loop[0] <= address <= loop[1]]
        if around:
            inside.setdefault(min(around, key=lambda loop: loop[1] - loop[0]), []).append(tally)
    for loop, tallies in inside.items():
        wide = [tally for tally in tallies if tally.size == 4]
        late = sum(tally.late for tally in wide)
        if late:
            yield LoopPlacement(
                name,
                image.location_at(loop[0]),
                *loop,
                loops[loop],
                sum(tally.executions for tally in wide if tally.misplaced),
                sum(tally.executions for tally in wide),
                late,
                _advice(loop, tallies, text_at),
            )


def _advice(loop: Loop, tallies: list[FetchTally], text_at: Callable[[int], str]) -> str:
    """Return the change that aligns the run of misaligned instructions that waits most."""
    ends = {tally.address + tally.size: tally for tally in tallies}
    late: Counter[int] = Counter()
    for tally in tallies:
        if tally.late:
            begin = tally.address
            while begin != loop[0] and begin in ends and ends[begin].misplaced:
                begin = ends[begin].address
            late[begin] += tally.late
    (begin, _), *others = late.most_common()
    more = f"; {len(others)} more run{'s' if len(others) > 1 else ''}" if others else ""
    before = None if begin == loop[0] else ends.get(begin)
    if before is None or before.size == 4:
        return f"align {begin:#010x} to a multiple of four (.balign 4, -falign-loops=4){more}"
    return f"encode {text_at(before.address)!r} at {before.address:#010x} in four bytes (.w){more}"
