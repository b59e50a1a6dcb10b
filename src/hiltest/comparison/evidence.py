"""One side of a comparison: what was measured, and what the numbers rest on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hiltest.comparison.model import Side, Tolerance
from hiltest.measurement import Measurement

Seed = int | None
"""None for a board that simulates nothing."""


NO_BOARD = "none"
"""Kind of the board where no test needs one."""

PASSED = "passed"
"""Outcome of a test."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What must be the same on both sides, beside the compiler and the cycle model, for numbers to be comparable.

    Attributes
    ----------
    board : str
        Its kind: ``virtual``, ``real`` or ``replay``, or `NO_BOARD`.
    rig_sha256 : str
        Of the rig's conditions; empty in a record from before they were kept, and without board and rig.
    calibrators : tuple of str
        As the board names them.
    sensors : tuple of str
        Those that were there, by name.
    compiler_flags : tuple of str
        Of all units of the firmware; empty where there is no ELF, or none with debugging information.
    poses : str
        Known angles that were judged: ``all`` or ``level``.
    suite : str
        Set of tests: ``gate`` or ``full``.
    calibrated : bool
        Whether a calibration file was judged too.
    """

    board: str
    rig_sha256: str
    calibrators: tuple[str, ...]
    sensors: tuple[str, ...]
    protocol_version: int
    compiler_flags: tuple[str, ...]
    poses: str
    suite: str
    calibrated: bool


@dataclass(frozen=True, slots=True)
class Evidence:
    """One run, or several runs of the same firmware on the same rig that differ in their seed.

    Attributes
    ----------
    side : Side
    conditions : Conditions or None
        None when no board answered that was to.
    measurements : mapping of seed to mapping of str to Measurement
        By name; the volatile ones too.
    tolerances : mapping of str to Tolerance
        Of the rig, by exact name.
    in_force : mapping of str to Tolerance
        Of every measurement, as the record states what it was held to; empty in one from before that was kept.
    tests : mapping of seed to mapping of str to str
        Outcome of every test by its id, of a baseline those that passed; empty where that was not kept.
    faults : tuple of str
        Why this side is no evidence, one line each, with what to do: such as a run that was cut short.
    chosen : bool
        Whether only chosen tests ran: it is like a run with the same choice, and nothing to keep.
    failed : tuple of str
        What else than a limit makes it no pass by itself: tests that failed, with the reason.
    may_miss : bool
        Whether limits that were missed were allowed to be, as on some seeds of many.
    is_baseline : bool
        Whether it was read from a baseline file.
    builds : mapping of str to str
        Build of each measurement that is of another one than `side`: a baseline may have accepted some.
    """

    side: Side
    conditions: Conditions | None
    measurements: Mapping[Seed, Mapping[str, Measurement]]
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    chosen: bool = False
    failed: tuple[str, ...] = ()
    may_miss: bool = False
    is_baseline: bool = False
    builds: Mapping[str, str] = field(default_factory=dict)
    in_force: Mapping[str, Tolerance] = field(default_factory=dict)
    tests: Mapping[Seed, Mapping[str, str]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What to call it: its file, or for a run that is just ending its firmware, if it has one."""
        firmware = f" of {self.side.firmware} {self.side.version}" if self.side.firmware else ""
        return self.side.file or f"this run{firmware}"
