"""The base of a run, which is read before the run can overwrite it, and compared after its end.

Every pytest run on the machine imports this module: heavy modules are imported only for a comparison.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    from hiltest.run_record.comparison import Comparison
    from hiltest.run_record.run import Table
    from hiltest.session.older_firmware import OlderFirmware
    from hiltest.verdict.evidence import Evidence

NOT_EVALUATED, CUT_SHORT = 22, 24
"""The exit codes, defined here to avoid a heavy import."""


PACKAGED = "The packaged firmware was compared: name yours with --firmware ELF."
"""Remark if no firmware was named: otherwise a user may compare the packaged firmware with itself unknowingly."""


class Gate(NamedTuple):
    """A base, or the reason for its absence: a run with a requested comparison never passes without one."""

    file: str
    """Base as the user named it."""
    base: Evidence | None
    reason: str = ""
    """Reason why there is no base, with a remedy."""
    in_one_session: bool = False
    """True if the base ran in the same session, on the same rig, seeds, points and noise."""

    def compare(self, new: Evidence, *, remark: str = "") -> Comparison:
        """Compare a run, or the runs of several seeds, with the base."""
        from hiltest.verdict.compare import compare, not_compared

        if self.base is None:
            comparison = not_compared(self.file, self.reason, new)
        else:
            comparison = compare(self.base, new, together=self.in_one_session)
        return replace(comparison, remark=" ".join(filter(None, (remark, comparison.remark))))

    def describe(self) -> str:
        """Return the header line: the base that the run is compared with."""
        from hiltest.text import format_count
        from hiltest.verdict.wording import build

        if self.base is None:
            return f"base: {self.reason}"
        side = self.base.side
        if not side.firmware:
            return f"base: {self.file}, without a board"
        runs = format_count(len(side.seeds), "seed") if side.seeds else format_count(len(self.base.measurements), "run")
        return f"base: {self.file}, {build(side)}, {runs}"


def read_gate(place: Path, *, in_one_session: bool = False) -> Gate:
    """Read the base: a baseline file, the record of a run or of a campaign, or a folder with one.

    Parameters
    ----------
    in_one_session
        True if the base has just been run, as the older of two firmwares.

    Raises
    ------
    NothingRecordedError
        If there is no such record, unless its run has just ended without one. Of an unreadable one the gate has the
        reason.
    """
    from hiltest.errors import ConfigError, NothingRecordedError
    from hiltest.verdict.evidence_reader import read_evidence

    try:
        return Gate(str(place), read_evidence(place), in_one_session=in_one_session)
    except ConfigError as error:
        if isinstance(error, NothingRecordedError) and not in_one_session:
            raise
        return Gate(str(place), None, str(error), in_one_session=in_one_session)


class SessionGate:
    """Gate of one session: the requested base, and its state before the first test.

    Parameters
    ----------
    base
        Base of the run; None without a gate.
    source
        Option that named it.
    """

    def __init__(self, base: Path | None, source: str) -> None:
        self._base = base
        self._source = source
        self._older: OlderFirmware | None = None
        self._gate: Gate | None = None

    @property
    def asked_for(self) -> str:
        """The option and the base that it names; empty without one."""
        if self._older is not None:
            return f"--against is {self._older.elf}"
        return f"{self._source} is {self._base}" if self._base is not None else ""

    def unevaluated(self, why: str) -> str:
        """Return the message if no run was recorded to compare; empty without a base."""
        return f"NOT EVALUATED: {self.asked_for}, and {why}, so there is nothing to compare." if self.asked_for else ""

    def compare_with(self, older: OlderFirmware) -> None:
        """Make an older firmware the base, which `run_older` will run."""
        self._older = older
        reason = f"{older.elf} did not run, because this run ended first; correct its fault and repeat"
        self._gate = Gate(str(older.folder), None, reason)

    def read(self) -> None:
        """Read the base before this run overwrites the folder, which may contain it."""
        if self._base is not None and self._gate is None:
            self._gate = read_gate(self._base)

    @property
    def runs_older(self) -> bool:
        """True if an older firmware is the base."""
        return self._older is not None

    def run_older(self, say: Callable[[str], None]) -> None:
        """Run the older firmware, if that is the base."""
        if self._older is not None:
            self._gate = Gate(str(self._older.folder), None, f"{self._older.elf} did not finish; run it again")
            say(f"{self._older.elf} runs first; record: {self._older.record}")
            say(f"{self._older.elf}: {self._older.run()}")
            self._gate = read_gate(self._older.folder, in_one_session=True)

    @property
    def base_poses(self) -> list[Table]:
        """Headings of the base at the known angles, for the record of the run, if there are any."""
        from hiltest.verdict.evidence import BASE_POSES_TABLE

        poses = self._gate.base.poses if self._gate is not None and self._gate.base is not None else None
        return [] if poses is None else [replace(poses, name=BASE_POSES_TABLE)]

    @property
    def missing(self) -> str:
        """Reason why there is no base for the comparison; empty if there is one, or if none was named."""
        return self._gate.reason if self._gate is not None and self._gate.base is None else ""

    def describe(self) -> list[str]:
        """Return the header line, if there is a gate."""
        if self._older is not None:
            return [f"base: {self._older.elf}, which runs first"]
        return [] if self._gate is None else [self._gate.describe()]

    def compare_by(self, *, packaged: bool) -> Callable[[Evidence], Comparison] | None:
        """Return the comparison of a finished run with its base, as a function; None without a gate.

        Parameters
        ----------
        packaged
            True if the packaged firmware ran because none was named.
        """
        return None if self._gate is None else partial(self._gate.compare, remark=PACKAGED if packaged else "")
