"""What a run is judged against: read before the run can write over it, compared with when the run has ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hiltest.comparison.compare import compare, not_compared
from hiltest.comparison.evidence import Evidence
from hiltest.comparison.model import Comparison
from hiltest.comparison.words import build
from hiltest.errors import ConfigError
from hiltest.report.evidence import read_evidence


@dataclass(frozen=True, slots=True)
class Gate:
    """A base, or why there is none: who asks to be judged is never told "pass" for want of one.

    Attributes
    ----------
    file : str
        What was named as the base.
    base : Evidence or None
    reason : str
        Why there is no base, with what to do.
    together : bool
        Whether the base ran in the same session, on the same rig, seeds, points and noise.
    """

    file: str
    base: Evidence | None
    reason: str = ""
    together: bool = False

    def judge(self, new: Evidence) -> Comparison:
        """Compare a run, or the runs of several seeds, with the base."""
        if self.base is None:
            return not_compared(self.file, self.reason, new)
        return compare(self.base, new, together=self.together)

    def describe(self) -> str:
        """Return the header line: what the run is going to be judged against."""
        if self.base is None:
            return f"base: {self.reason}; the run cannot end with a pass"
        side = self.base.side
        seeds = ", ".join(map(str, side.seeds))
        return f"base: {self.file}, firmware {side.firmware} {side.version} {build(side)}, seeds {seeds}"


def read_gate(place: Path, *, together: bool = False) -> Gate:
    """Read the base: a baseline file, the record of a run or of a campaign, or a folder with one.

    Parameters
    ----------
    place : Path
    together : bool, optional
        Whether it has just been run, as the older of two firmwares.
    """
    try:
        return Gate(str(place), read_evidence(place), together=together)
    except ConfigError as error:
        return Gate(str(place), None, str(error), together=together)
