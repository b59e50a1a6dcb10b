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
    """An engineer's own conditions, which `choose` is asked about.

    Attributes
    ----------
    field_ut : float
        Field strength [uT].
    noise_ut : float
        Standard deviation of a point on each axis [uT].
    coverage_percent : float
        The points cover at least so much of the sphere [%].
    cycles : int or None
        What a calibration may cost; None for any number.
    """

    field_ut: float = 50.0
    noise_ut: float = 0.4
    coverage_percent: float = 50.0
    cycles: int | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """What is asked of a study.

    Attributes
    ----------
    study : str
    seed : int
    instances : int
        For each condition.
    points : int
        Of each instance; 0 where the study has its own numbers of points.
    given : Given, optional
        For the study that asks for conditions.
    """

    study: str
    seed: int
    instances: int
    points: int
    given: Given | None = None


@dataclass(frozen=True, slots=True)
class Block:
    """Instances `first` to ``first + count - 1`` of a condition."""

    condition: int
    first: int
    count: int


@dataclass(frozen=True, slots=True)
class PrintedFigure:
    """A figure that a paper printed, and what came of it here.

    Attributes
    ----------
    what, where : str
        What it is a figure of, and its place in the paper.
    printed, measured : str
        With their units.
    reproduced : bool
    why : str
        Why it is, or why it is not.
    """

    what: str
    where: str
    printed: str
    measured: str
    reproduced: bool
    why: str


@dataclass(frozen=True, slots=True)
class Conclusion:
    """What all blocks together say.

    Attributes
    ----------
    sentence : str
        The answer in one sentence.
    measurements : tuple of Measurement
    table : Table
        The numbers, a row for each condition.
    printed : tuple of PrintedFigure
    """

    sentence: str
    measurements: tuple[Measurement, ...]
    table: Table
    printed: tuple[PrintedFigure, ...]


@dataclass(frozen=True, slots=True)
class Study:
    """A study.

    Attributes
    ----------
    name : str
    question : str
        One sentence.
    conditions : int
        How many there are.
    instances, points : int
        Of a plan that does not say; see there.
    block : int
        Most instances of a block: what takes a worker seconds.
    measure : callable
        Returns the numbers of a block of a plan.
    conclude : callable
        Returns the conclusion of the numbers of all blocks, by condition and in the order of the blocks.
    draw : callable
        Returns the plot of a finished record.
    most_points : int
        Of a plan.
    """

    name: str
    question: str
    conditions: int
    instances: int
    points: int
    block: int
    measure: Callable[[Plan, Block], Numbers] = field(repr=False)
    conclude: Callable[[Plan, Sequence[Sequence[Numbers]]], Conclusion] = field(repr=False)
    draw: Callable[[Run], Figure] = field(repr=False)
    most_points: int = 100_000


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
