"""A kind of measurement in the catalogue: unit, better direction, tolerance and meaning."""

from __future__ import annotations

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
        """Return a number that is lower the better the value is."""
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


COSTS_TOO_MUCH = "See which lines the cycles go to: hiltest profile ELF FUNCTION."

NEXT_STEP = {
    Section.HEADING: "Compare the heading errors of all calibrators: what all share is of the accelerometer, the "
                     "mounting or the table, what one has alone is of its fit.",
    Section.CYCLES: COSTS_TOO_MUCH,
    Section.STREAMS: "See in the report how accuracy goes with the points received, and which points were refused.",
    Section.FIT: "Look at the calibrated samples in the report: points all round that the model fits leave a small "
                 "residual.",
    Section.BUDGET: "Compare the cycles per point: cheaper points, or cheaper sweeps, buy more of them.",
    Section.ACCELEROMETER: "Calibrate the accelerometer again on its six faces, and check how each face lies.",
    Section.GYROSCOPE: "Check the table's angle and the rate of the gyroscope's samples: a turn is their sum.",
    Section.FUSION: "Look first at heading, accelerometer and gyroscope alone: the filter mixes their errors.",
    Section.DRIVING: "See which disturbance the heading follows: a filter has to notice that the field is another one.",
    Section.BOARD: "Look at the wire trace, then at cable, ground and baud rate.",
    Section.STUDIES: "Run the study again with the same seed: its numbers do not depend on the machine.",
    Section.OWN: "For a measurement of your own, look at the line that measured it, which stands beside it.",
}
"""What to do about a measurement out of its limit whose cause is not known, where its kind does not say more."""


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
        If one is negative, infinite or no number: nothing would ever be worse.
    """

    absolute: float
    """In the measurement's unit."""
    relative: float
    """Share of the base's value, 0.02 for 2 %. With 0 and 0 any change counts."""

    def __post_init__(self) -> None:
        for name, value in (("absolute", self.absolute), ("relative", self.relative)):
            if not 0 <= value < float("inf"):
                raise ValueError(f"{name} must be a finite number, 0 or more, not {value}")

    def covers(self, other: Tolerance) -> bool:
        """Say whether whatever stays within `other` stays within this one too."""
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
    """Beside it stands, on a board whose runs do not share their noise, what that noise moves."""
    reason: str
    """Reason of the tolerance."""
    better: Better | None = None
    """Where it is another than the kind's."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of measurement."""

    name: str
    """Name with the subject in braces: ``heading.{calibrator}.max``."""
    unit: str | None
    """None where the suite decides, as between points and sweeps."""
    better: Better
    allowance: Allowance
    section: Section
    meaning: str
    """One sentence."""
    subjects: Mapping[str, Allowance] = field(default_factory=dict)
    """Tolerances of subjects with another noise."""
    accuracy: str = ""
    """For a cost: name of the accuracy that it is shown beside, with the same subject."""
    reference: Reference = Reference.NONE
    compared: bool = True
    """False for what says nothing of the firmware."""
    direction: bool = False
    """Whether it is a direction [deg]: 330 and 30 are 60 apart, and none is a share of another."""
    decided_by: str = ""
    """For the largest of many numbers, or their median: name of their rms or mean, with the same subject. Between
    runs that do not share their noise that decides: a largest error is several times as noisy, a median jumps."""
    next_step: str = ""
    """What to do where it is out of its limit; by default `NEXT_STEP` of the section."""

    def of(self, subject: str) -> str:
        """Return the name of the measurement of a subject."""
        return _name(self.name, subject)


@dataclass(frozen=True, slots=True)
class NamedKind:
    """Kind and subject of a measurement's name; no kind for a user's own."""

    kind: Kind | None
    subject: str = ""

    @property
    def unit(self) -> str | None:
        """The unit; None where the user decides."""
        return self.kind.unit if self.kind else None

    @property
    def allowance(self) -> Allowance | None:
        """Tolerance for noise; None for a user's own."""
        return self.kind.subjects.get(self.subject, self.kind.allowance) if self.kind else None

    @property
    def better(self) -> Better | None:
        """Better direction; None where only a limit says so."""
        return (self.allowance.better if self.allowance else None) or (self.kind.better if self.kind else None)

    @property
    def section(self) -> Section:
        """Section of the report."""
        return self.kind.section if self.kind else Section.OWN

    @property
    def accuracy(self) -> str:
        """Name of the accuracy that a cost is shown beside; empty for what is no cost of a calibrator."""
        return _name(self.kind.accuracy, self.subject) if self.kind else ""

    @property
    def next_step(self) -> str:
        """What to do about it where it is out of its limit and no cause is known."""
        return (self.kind.next_step if self.kind else "") or NEXT_STEP[self.section]

    @property
    def decided_by(self) -> str:
        """Name of what decides in its place where runs do not share their noise; empty where it decides itself."""
        return _name(self.kind.decided_by, self.subject) if self.kind else ""


def _name(template: str, subject: str) -> str:
    head, brace, rest = template.partition("{")
    return head + subject + rest.partition("}")[2] if brace else template
