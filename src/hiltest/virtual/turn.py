"""A turn of a loop, and the registers that count while turns pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hiltest.virtual.blocks import CodeBlock


@dataclass(frozen=True, slots=True)
class LoopTurn:
    """A turn that has just run, from a block to its next run.

    Attributes
    ----------
    blocks : sequence of (CodeBlock, bool)
        What ran, and whether each jumped away from its end.
    began : int
        Cycle at which the next turn begins.
    period : int
        Cycles of a turn.
    until : int
        Cycle at which something from outside may happen.
    """

    blocks: Sequence[tuple[CodeBlock, bool]]
    began: int
    period: int
    until: int


#: Returns how many turns that follow may be passed over; what they change is changed when it returns. Negative where it
#: cannot tell.
PassOver = Callable[[LoopTurn], int]


@dataclass(frozen=True, slots=True)
class Counting:
    """How a register counts, while no event comes and nothing is written to its peripheral.

    Attributes
    ----------
    at : callable
        Answers with what it shows at a cycle, not before now.
    rises : bool
        Whether it counts upward.
    until : float
        Up to this cycle it only rises, or only falls, and by less than 2**32; not farther.
    size : int
        Width of the register in bytes.
    """

    at: Callable[[int], int]
    rises: bool
    until: float
    size: int = 4
