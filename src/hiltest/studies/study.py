"""What a study is, and the piece of it that one worker does.

A study asks a question of a paper, or an engineer's own. Its instances are cut into blocks, each of one condition (a
noise level, a number of points, ...). What a block gives is a function of the plan and the block's number alone, and it
is numbers that JSON holds: `measure_block` can be sent anywhere, done in any order and kept in a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TypeAlias

from hiltest.measurement import Measurement
from hiltest.record.run import Run, Table
from hiltest.report.svg import Figure

Numbers: TypeAlias = Sequence[float | int]


@dataclass(frozen=True, slots=True)
class Given:
    """An engineer's own conditions, which `choose` is asked about."""

    field_ut: float = 50.0
    """Field strength [uT]."""
    noise_ut: float = 0.4
    """Standard deviation of a point on each axis [uT]."""
    coverage_percent: float = 50.0
    """The points cover at least so much of the sphere [%]."""
    cycles: int | None = None
    """What a calibration may cost; None for any number."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is asked of a study."""

    study: str
    seed: int
    instances: int
    """For each condition."""
    points: int
    """Of each instance; 0 where the study has its own numbers of points."""
    given: Given | None = None
    """For the study that asks for conditions."""


@dataclass(frozen=True, slots=True)
class Block:
    """Instances `first` to ``first + count - 1`` of a condition."""

    condition: int
    first: int
    count: int


@dataclass(frozen=True, slots=True)
class PrintedFigure:
    """A figure that a paper printed, and what came of it here."""

    what: str
    where: str
    """What it is a figure of, and its place in the paper."""
    printed: str
    measured: str
    """With their units."""
    reproduced: bool
    why: str
    """Why it is, or why it is not."""


@dataclass(frozen=True, slots=True)
class Conclusion:
    """What all blocks together say."""

    sentence: str
    """The answer in one sentence."""
    measurements: tuple[Measurement, ...]
    table: Table
    """The numbers, a row for each condition."""
    printed: tuple[PrintedFigure, ...]


@dataclass(frozen=True, slots=True)
class Study:
    """A study."""

    name: str
    question: str
    """One sentence."""
    conditions: int
    """How many there are."""
    instances: int
    points: int
    """Of a plan that does not say; see there."""
    block: int
    """Most instances of a block: what takes a worker seconds."""
    measure: Callable[[Plan, Block], Numbers] = field(repr=False)
    """Returns the numbers of a block of a plan."""
    conclude: Callable[[Plan, Sequence[Sequence[Numbers]]], Conclusion] = field(repr=False)
    """Returns the conclusion of the numbers of all blocks, by condition and in the order of the blocks."""
    draw: Callable[[Run], Figure] = field(repr=False)
    """Returns the plot of a finished record."""
    most_points: int = 100_000
    """Of a plan."""


def study_of(name: str) -> Study:
    """Return the study of a name in `NAMES`."""
    found: Study = import_module(f"{__package__}.{name}").STUDY
    return found


def blocks_of(plan: Plan) -> list[Block]:
    """Return the blocks of a plan; the number of a block is its place among them."""
    return list(_blocks(plan, study_of(plan.study)))


def _blocks(plan: Plan, study: Study) -> Iterator[Block]:
    for condition in range(study.conditions):
        for first in range(0, plan.instances, study.block):
            yield Block(condition, first, min(study.block, plan.instances - first))


def measure_block(plan: Plan, number: int) -> Numbers:
    """Do one block; whoever has the package can."""
    return study_of(plan.study).measure(plan, blocks_of(plan)[number])
