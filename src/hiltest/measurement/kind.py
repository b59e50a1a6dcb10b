"""A kind of measurement in the catalogue: unit, better direction, tolerance and meaning."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum


class Better(StrEnum):
    """Direction in which a measurement gets better."""

    LOWER = "smaller"
    HIGHER = "larger"
    NEARER_ZERO = "nearer zero"
    NEITHER = "neither"

    def cost(self, value: float) -> float:
        """Return a number that decreases as the value gets better."""
        return abs(value) if self is Better.NEARER_ZERO else -value if self is Better.HIGHER else value


class Section(StrEnum):
    """Section of a report, in the order of the pages."""

    HEADING = "Heading"
    CYCLES = "Cycles"
    STREAMS = "Streaming calibrators"
    FIT = "Magnetometer fit"
    BUDGET = "Heading error for a cycle budget"
    ACCELEROMETER = "Accelerometer"
    GYROSCOPE = "Gyroscope"
    FUSION = "Sensor fusion"
    DRIVING = "While the field is disturbed"
    BOARD = "Board and link"
    STUDIES = "Studies"
    OWN = "Other measurements"


COSTS_TOO_MUCH = "List the cycles by source line: hiltest profile ELF FUNCTION."

NEXT_STEP = {
    Section.HEADING: "Compare the heading errors of all calibrators: a common error comes from the accelerometer, "
    "the mounting or the table, a single one from its fit.",
    Section.CYCLES: COSTS_TOO_MUCH,
    Section.STREAMS: "Check in the report how accuracy depends on the received points, and which points were refused.",
    Section.FIT: "Check the calibrated samples in the report: points in all directions that the model fits leave a "
    "small residual.",
    Section.BUDGET: "Compare the cycles per point: cheaper points, or cheaper sweeps, buy more of them.",
    Section.ACCELEROMETER: "Calibrate the accelerometer again on its six faces, and check the position of each face.",
    Section.GYROSCOPE: "Check the table's angle and the rate of the gyroscope's samples: a turn is their sum.",
    Section.FUSION: "Check heading, accelerometer and gyroscope separately first: the filter mixes their errors.",
    Section.DRIVING: "Find the disturbance that the heading follows: a filter must detect that the field changed.",
    Section.BOARD: "Check the wire trace, then cable, ground and baud rate.",
    Section.STUDIES: "Run the study again with the same seed: its numbers do not depend on the machine.",
    Section.OWN: "For your own measurement, check the line that measured it, which is shown beside it.",
}
"""Next step for a measurement out of its limit with an unknown cause, if its kind does not name another."""


class Reference(Enum):
    """Reference that a measured angle is compared with; a limit cannot be tighter than its uncertainty."""

    NONE = "the board's own numbers"
    TURNTABLE = "the turntable's angle, less the mean error"
    MOUNTED = "the turntable's angle and the declared mounting"


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Tolerance of a comparison: a measurement is unchanged unless it moved by more than both.

    Raises
    ------
    ValueError
        If one is negative, infinite or NaN, since no change could then exceed it.
    """

    absolute: float
    """Absolute part, in the measurement's unit."""
    relative: float
    """Fraction of the base's value, 0.02 for 2 %. With 0 and 0 any change counts."""

    def __post_init__(self) -> None:
        for name, value in (("absolute", self.absolute), ("relative", self.relative)):
            if not 0 <= value < float("inf"):
                raise ValueError(f"{name} must be a finite number, 0 or more, not {value}")

    def covers(self, other: Tolerance) -> bool:
        """Return whether every change within `other` is within this tolerance, too."""
        return self.absolute >= other.absolute and self.relative >= other.relative


EXACT = Tolerance(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Deviation:
    """Standard deviation of a measurement from run to run, and the degrees of freedom that it was estimated with."""

    value: float
    freedom: int


@dataclass(frozen=True, slots=True)
class Allowance:
    """Tolerance for harmless changes."""

    tolerance: Tolerance
    """Tolerance; if runs do not share their noise, the effect of the noise is added."""
    reason: str
    """Reason of the tolerance."""
    better: Better | None = None
    """Better direction, if it differs from the kind's."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of measurement."""

    name: str
    """Name with the subject in braces: ``heading.{calibrator}.max``."""
    unit: str | None
    """Unit; None if the suite decides, as between points and sweeps."""
    better: Better
    allowance: Allowance
    section: Section
    meaning: str
    """Meaning in one sentence."""
    subjects: Mapping[str, Allowance] = field(default_factory=dict)
    """Tolerances of subjects with another noise."""
    accuracy: str = ""
    """Name of the accuracy that a cost is shown beside, with the same subject; empty for other kinds."""
    reference: Reference = Reference.NONE
    compared: bool = True
    """False for a measurement that says nothing about the firmware."""
    direction: bool = False
    """True for a direction [deg]: 330 and 30 are 60 apart, and ratios have no meaning."""
    setting: bool = False
    """True for a register of a sensor: any change is worse."""
    decided_by: str = ""
    """Name of the rms or mean, with the same subject, that decides between runs that do not share their noise, in place
    of a largest number or a median: a largest error is several times as noisy, and a median jumps. May be empty."""
    next_step: str = ""
    """Next step if it is out of its limit; by default `NEXT_STEP` of the section."""


@dataclass(frozen=True, slots=True)
class NamedKind:
    """Kind and subject of a measurement's name; no kind for a user's own."""

    kind: Kind | None
    subject: str = ""

    @property
    def unit(self) -> str | None:
        """The unit; None if the user decides."""
        return self.kind.unit if self.kind else None

    @property
    def allowance(self) -> Allowance | None:
        """Tolerance for noise; None for a user's own measurement."""
        return self.kind.subjects.get(self.subject, self.kind.allowance) if self.kind else None

    @property
    def better(self) -> Better | None:
        """Better direction; None if only a limit determines it."""
        return (self.allowance.better if self.allowance else None) or (self.kind.better if self.kind else None)

    @property
    def section(self) -> Section:
        """Section of the report."""
        return self.kind.section if self.kind else Section.OWN

    @property
    def accuracy(self) -> str:
        """Name of the accuracy that a cost is shown beside; empty if it is no cost of a calibrator."""
        return _name(self.kind.accuracy, self.subject) if self.kind else ""

    @property
    def next_step(self) -> str:
        """Next step if it is out of its limit and no cause is known."""
        step = (self.kind.next_step if self.kind else "") or NEXT_STEP[self.section]
        is_called = bool(self.subject) and self.kind is not None and self.kind.name.startswith("cycles.{")
        return step.replace("FUNCTION", self.subject) if is_called else step

    @property
    def decided_by(self) -> str:
        """Name of the measurement that decides if runs do not share their noise; empty if this one decides itself."""
        return _name(self.kind.decided_by, self.subject) if self.kind else ""


def _name(template: str, subject: str) -> str:
    parts = iter(subject.split("."))
    return re.sub(r"\{\w+\}", lambda _: next(parts), template)
