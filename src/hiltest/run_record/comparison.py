"""A comparison of two runs as data: the change of every measurement, and obstacles to its evaluation.

This module is pure: it knows neither pytest nor a board nor a file.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hiltest.measurement import Better, Limit, Outcome, Tolerance, identify


class Change(StrEnum):
    """Change of a measurement since the base."""

    BETTER = "better"
    WORSE = "worse"
    NEW = "new"
    """The base has no number for it."""
    GONE = "gone"
    """The base has a number, and the new run has none."""
    NOT_TAKEN = "not taken"
    """The number is gone, in a run that was cut short or ran only chosen tests."""
    UNCHANGED = "unchanged"
    CHANGED = "changed"
    """The number moved beyond its tolerance without a better direction, as the worst sector, or its limit is looser."""


class Answer(StrEnum):
    """Answer of a comparison."""

    MAY = "may be merged"
    NOT = "not to be merged"
    UNKNOWN = "cannot say whether it may be merged"


class BaseKind(StrEnum):
    """Kind of the base, which decides how a change is accepted into it."""

    BASELINE = "baseline"
    RUN = "run"
    TOGETHER = "older firmware, run together with the newer one"


ONE_OF_EXACT = 0.01
"""Part of the base that counts as one tolerance when changes are sorted by size, if the tolerance is exact."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One measurement, base against new, paired by seed."""

    name: str
    unit: str
    change: Change
    sense: Better
    base: float | None
    new: float | None
    """Values, over several seeds the means of the paired ones; None without a number."""
    delta: float | None
    """New value minus base; over several seeds the mean of the paired changes."""
    interval: tuple[float, float] | None
    """95 % interval of the mean paired change, from eight paired seeds up."""
    seeds: int
    """Number of pairs, each with a number on both sides."""
    tolerance: Tolerance
    """Tolerance; it includes the effect of noise if runs do not share their noise."""
    limit: Limit | None
    """Limit of the new run."""
    outcome: str
    """Outcome in the new run; over several seeds that of one that gates, if any."""
    cycle_model: str
    note: str = ""
    """Remark that explains the numbers."""
    seen: float | None = None
    """Smallest change that this comparison detects in 4 of 5 cases; 0 if it detects every change, and
    None without a number on both sides."""

    @property
    def concern(self) -> tuple[bool, bool, float, str]:
        """Sort key: settings, measurements out of a limit, then by weight."""
        return not self.is_changed_setting, self.outcome != Outcome.FAIL, -self.weight, self.name

    @property
    def is_changed_setting(self) -> bool:
        """True if it is a register of a sensor with another value than in the base, which may explain other changes."""
        kind = identify(self.name).kind
        return kind is not None and kind.setting and bool(self.delta)

    @property
    def weight(self) -> float:
        """Change as a multiple of the tolerance; if that is exact, in percent of the base."""
        if self.delta is None or self.base is None:
            return 0.0
        relative = self.tolerance.relative or (0.0 if self.tolerance.absolute else ONE_OF_EXACT)
        one = max(self.tolerance.absolute, relative * abs(self.base))
        return abs(self.delta) / one if one else float("inf")


@dataclass(frozen=True, slots=True)
class Revision:
    """Sources that a run was made for: label, commit and branch, each empty if it was not stated."""

    commit: str = ""
    branch: str = ""
    label: str = ""


@dataclass(frozen=True, slots=True)
class FromBuild:
    """Number of measurements that a baseline has accepted from another build than its own."""

    build_id: str
    measurements: int


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a comparison."""

    file: str = ""
    """File that it was read from; empty for a run that is compared as it ends."""
    sha256: str = ""
    """Digest of that file; empty without a file."""
    firmware: str = ""
    version: str = ""
    build_id: str = ""
    compiler: str = ""
    cycle_model: str = ""
    rig: str = ""
    """Name of the rig."""
    seeds: tuple[int, ...] = ()
    saved_utc: str = ""
    """Time at which the run ended, or the baseline was saved or last updated."""
    accepted: tuple[FromBuild, ...] = ()
    """Measurements of a baseline that come from other builds than `build_id`, by build."""
    revision: Revision | None = None
    """Sources that the run was made for."""
    firmware_sha256: str = ""
    """Digest of the firmware's file; empty if unknown, as in older records."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of a new run with a base."""

    base: Side
    new: Side
    differences: tuple[Difference, ...]
    """Differences, sorted by name."""
    obstacles: tuple[str, ...]
    """Reasons why the gate cannot be evaluated, one line each, with a remedy; empty if it was evaluated."""
    sentence: str
    """Summary in one sentence, which begins with the answer."""
    failed: tuple[str, ...] = ()
    """Failures of the new run that do not depend on the base: its limits and its tests."""
    unjudged: tuple[str, ...] = ()
    """Limits of the new run that were not evaluated, with the reason."""
    chosen: bool = False
    """True if only chosen tests ran: the others are unknown."""
    tests_left_out: int = 0
    """Number of tests of the full set that the new run's gate set left out."""
    base_kind: BaseKind = BaseKind.RUN
    remark: str = ""
    """Remark for the reader; it decides nothing."""

    def differences_with(self, change: Change) -> tuple[Difference, ...]:
        """Return the measurements with this change, in order of concern."""
        matching = (difference for difference in self.differences if difference.change is change)
        return tuple(sorted(matching, key=lambda difference: difference.concern))

    @property
    def answer(self) -> Answer:
        """Answer to the question if the change may be merged."""
        if self.failed or self.regression:
            return Answer.NOT
        return Answer.MAY if self.evaluated and not self.unjudged else Answer.UNKNOWN

    @property
    def evaluated(self) -> bool:
        """True if the comparison has no obstacles."""
        return not self.obstacles

    @property
    def regression(self) -> bool:
        """True if the comparison was evaluated and a measurement got worse."""
        return self.evaluated and any(difference.change is Change.WORSE for difference in self.differences)
