"""A comparison of two runs as data: the change of every measurement, and why it could not be evaluated.

Pure: nothing here knows pytest, a board or a file.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hiltest.measurement import Better, Limit, Outcome, Tolerance


class Change(StrEnum):
    """Change of a measurement since the base."""

    BETTER = "better"
    WORSE = "worse"
    NEW = "new"
    """The base has no number of it."""
    GONE = "gone"
    """The base has a number, the new run has none."""
    NOT_TAKEN = "not taken"
    """Gone, in a run that was cut short or ran chosen tests only."""
    UNCHANGED = "unchanged"
    CHANGED = "changed"
    """Beyond its tolerance without a better direction, such as the worst sector; or its limit is looser."""


class Answer(StrEnum):
    """The answer of a comparison."""

    MAY = "may be merged"
    NOT = "not to be merged"
    UNKNOWN = "cannot say whether it may be merged"


class BaseKind(StrEnum):
    """Kind of the base, which decides how a change is accepted into it."""

    BASELINE = "baseline"
    RUN = "run"
    TOGETHER = "older firmware, run together with the newer one"


ONE_OF_EXACT = 0.01
"""Part of the base that counts as one tolerance where the tolerance is exact, to sort changes by size."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One measurement, base against new, paired by seed."""

    name: str
    unit: str
    change: Change
    sense: Better
    base: float | None
    new: float | None
    """Over several seeds: means over the paired ones. None where there is no number."""
    delta: float | None
    """New less base; over several seeds the mean of the paired changes."""
    interval: tuple[float, float] | None
    """95 % interval of the mean paired change, from eight paired seeds up."""
    seeds: int
    """How many pairs, each with a number on both sides."""
    tolerance: Tolerance
    """Where runs do not share their noise, with what that moves."""
    limit: Limit | None
    """The new run's."""
    outcome: str
    """The new run's; over several seeds the one that gates, if any."""
    cycle_model: str
    note: str = ""
    """What the numbers alone do not say."""
    seen: float | None = None
    """Smallest change that this comparison sees in 4 of 5 cases; 0 where it sees every change. None without a
    number on both sides."""

    @property
    def concern(self) -> tuple[bool, bool, float, str]:
        """Sort key: out of its limit first, then with a limit, then by the number of tolerances moved."""
        return self.outcome != Outcome.FAIL, self.limit is None, -self._tolerances_moved, self.name

    @property
    def _tolerances_moved(self) -> float:
        if self.delta is None or self.base is None:
            return 0.0
        relative = self.tolerance.relative or (0.0 if self.tolerance.absolute else ONE_OF_EXACT)
        one = max(self.tolerance.absolute, relative * abs(self.base))
        return abs(self.delta) / one if one else float("inf")


@dataclass(frozen=True, slots=True)
class Revision:
    """Sources that a run was made for: label, commit and branch, each empty where it was not stated."""

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
    """Where it was read from; empty for a run that is compared as it ends."""
    sha256: str = ""
    """Digest of that file, empty where there is none."""
    firmware: str = ""
    version: str = ""
    build_id: str = ""
    compiler: str = ""
    cycle_model: str = ""
    rig: str = ""
    """Name of the rig."""
    seeds: tuple[int, ...] = ()
    saved_utc: str = ""
    """When the run ended, or the baseline was saved or last updated."""
    accepted: tuple[FromBuild, ...] = ()
    """Measurements of a baseline that come from other builds than `build_id`, by build."""
    revision: Revision | None = None
    """Sources that the run was made for."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Base against new."""

    base: Side
    new: Side
    differences: tuple[Difference, ...]
    """Sorted by name."""
    obstacles: tuple[str, ...]
    """Why the gate cannot be evaluated, one line each, with what to do. None of them: it was."""
    sentence: str
    """All of it in one sentence, which begins with the answer."""
    failed: tuple[str, ...] = ()
    """What fails in the new run by itself, whatever the base is: its limits and its tests."""
    unjudged: tuple[str, ...] = ()
    """Limits of the new run that were not evaluated, with the reason."""
    chosen: bool = False
    """Whether only chosen tests ran: the others are unknown."""
    base_kind: BaseKind = BaseKind.RUN
    remark: str = ""
    """Remark for the reader; it decides nothing."""

    def of(self, change: Change) -> tuple[Difference, ...]:
        """Return the measurements with this change, in order of concern."""
        found = (difference for difference in self.differences if difference.change is change)
        return tuple(sorted(found, key=lambda each: each.concern))

    @property
    def answer(self) -> Answer:
        """Whether the change may be merged, may not, or is not known."""
        if self.failed or self.regression:
            return Answer.NOT
        return Answer.MAY if self.evaluated and not self.unjudged else Answer.UNKNOWN

    @property
    def evaluated(self) -> bool:
        """True where nothing kept the comparison from being made."""
        return not self.obstacles

    @property
    def regression(self) -> bool:
        """True where the comparison was made, and something got worse."""
        return self.evaluated and any(difference.change is Change.WORSE for difference in self.differences)
