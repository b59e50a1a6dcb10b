"""Definition of a study, and the measurement of its blocks.

A study answers a question from a paper or from an engineer. Its instances are divided into blocks, each of one
condition (a noise level, a number of points, ...). The result of a block depends only on the plan and the number of the
block, and consists of numbers: `measure_block` can run anywhere and in any order, and its result can be saved as JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TypeAlias

from hiltest.calibration.own import FileCalibrator
from hiltest.measurement import Measurement
from hiltest.report.svg import Figure
from hiltest.run_record.run import Run, Table

Numbers: TypeAlias = Sequence[float | int]
EQUAL = " = "
"""Text between the names of methods with the same results in one row."""


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
    conditions: Conditions | None = None
    """Conditions for the study `choose`."""
    methods: tuple[str, ...] = ()
    """Methods of one's own, by the names of `hiltest.studies.methods`."""
    files: tuple[FileCalibrator, ...] = ()
    """Those of the methods that are functions of files, FILE:FUNCTION."""

    def names(self, of_the_study: Sequence[str]) -> tuple[str, ...]:
        """Return the names of a study's methods, and those of one's own after them."""
        return tuple(dict.fromkeys((*of_the_study, *self.methods)))


@dataclass(frozen=True, slots=True)
class Block:
    """Instances `first` to ``first + count - 1`` of the condition with a number."""

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
    reproduced: bool | None
    """None if the instances are too few to decide."""
    because: str
    """Reason why it is reproduced or not."""


@dataclass(frozen=True, slots=True)
class Conclusion:
    """Result of a study."""

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
    """Largest number of instances of a block, such that a worker needs some seconds."""
    measure: Callable[[Plan, Block], Numbers] = field(repr=False)
    """Function that returns the numbers of a block of a plan."""
    conclude: Callable[[Plan, Sequence[Sequence[Numbers]]], Conclusion] = field(repr=False)
    """Function that returns the conclusion from the numbers of all blocks, by condition and block."""
    draw: Callable[[Run, Table], Figure] = field(repr=False)
    """Function that returns the plot of a finished record, from its table."""
    unprinted: str = ""
    """Sentence on figures that the papers do not print; empty if the plot has the printed ones."""
    most_points: int = 100_000
    """Largest number of points of a plan."""


def study_of(name: str) -> Study:
    """Return the study with a name in `NAMES`."""
    study: Study = import_module(f"{__package__}.{name}").STUDY
    return study


def blocks_of(plan: Plan) -> list[Block]:
    """Return the blocks of a plan; the index of a block is its number."""
    return list(_blocks(plan, study_of(plan.study)))


def _blocks(plan: Plan, study: Study) -> Iterator[Block]:
    for condition in range(study.conditions):
        for first in range(0, plan.instances, study.block):
            yield Block(condition, first, min(study.block, plan.instances - first))


def measure_block(plan: Plan, number: int) -> Numbers:
    """Measure one block of a plan."""
    return study_of(plan.study).measure(plan, blocks_of(plan)[number])
