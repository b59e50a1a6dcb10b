"""Parts of a study, and the block of it that one worker measures.

A study asks a question of a paper, or of an engineer. Its instances are divided into blocks, each of one condition (a
noise level, a number of points, ...). The result of a block depends only on the plan and the block's number, and it
consists of numbers for JSON: `measure_block` can run anywhere and in any order, and its result can be saved in a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TypeAlias

from hiltest.measurement import Measurement
from hiltest.report.svg import Figure
from hiltest.run_record.run import Run, Table

Numbers: TypeAlias = Sequence[float | int]


@dataclass(frozen=True, slots=True)
class Conditions:
    """An engineer's own conditions, for the study `choose`."""

    field_ut: float = 50.0
    """Field strength [uT]."""
    noise_ut: float = 0.4
    """Standard deviation of a point on each axis [uT]."""
    coverage_percent: float = 50.0
    """Smallest share of the sphere that the points cover [%]."""
    cycles: int | None = None
    """Largest cost of a calibration; None for any."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Parameters of a study."""

    study: str
    seed: int
    instances: int
    """Instances of each condition."""
    points: int
    """Points of each instance; 0 if the study has its own numbers of points."""
    given: Conditions | None = None
    """Conditions for the study that needs them."""


@dataclass(frozen=True, slots=True)
class Block:
    """Instances `first` to ``first + count - 1`` of a condition."""

    condition: int
    first: int
    count: int


@dataclass(frozen=True, slots=True)
class PrintedFigure:
    """A figure that a paper printed, and its measured value."""

    figure: str
    paper: str
    """Description of the figure, and its place in the paper."""
    printed: str
    measured: str
    """Printed and measured value, with units."""
    reproduced: bool
    why: str
    """Reason why it was reproduced, or was not."""


@dataclass(frozen=True, slots=True)
class Conclusion:
    """Conclusion from all blocks."""

    sentence: str
    """The answer in one sentence."""
    measurements: tuple[Measurement, ...]
    table: Table
    """The numbers, one row per condition."""
    printed: tuple[PrintedFigure, ...]


@dataclass(frozen=True, slots=True)
class Study:
    """A study."""

    name: str
    question: str
    """Question in one sentence."""
    conditions: int
    """Number of conditions."""
    instances: int
    points: int
    """Defaults of a plan; see `Plan`."""
    block: int
    """Largest number of instances of a block, which takes a worker some seconds."""
    measure: Callable[[Plan, Block], Numbers] = field(repr=False)
    """Function that returns the numbers of a block of a plan."""
    conclude: Callable[[Plan, Sequence[Sequence[Numbers]]], Conclusion] = field(repr=False)
    """Function that returns the conclusion from the numbers of all blocks, by condition and in order of blocks."""
    draw: Callable[[Run], Figure] = field(repr=False)
    """Function that returns the plot of a finished record."""
    most_points: int = 100_000
    """Largest number of points of a plan."""


def study_of(name: str) -> Study:
    """Return the study of a name in `NAMES`."""
    study: Study = import_module(f"{__package__}.{name}").STUDY
    return study


def blocks_of(plan: Plan) -> list[Block]:
    """Return the blocks of a plan; the number of a block is its index."""
    return list(_blocks(plan, study_of(plan.study)))


def _blocks(plan: Plan, study: Study) -> Iterator[Block]:
    for condition in range(study.conditions):
        for first in range(0, plan.instances, study.block):
            yield Block(condition, first, min(study.block, plan.instances - first))


def measure_block(plan: Plan, number: int) -> Numbers:
    """Measure one block; any machine with the package can do so."""
    return study_of(plan.study).measure(plan, blocks_of(plan)[number])
