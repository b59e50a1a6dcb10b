"""One side of a comparison: its measurements, and what they depend on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256 as sha256_of
from typing import TypeVar

from hiltest.errors import ConfigError
from hiltest.measurement import Measurement, Tolerance
from hiltest.record.comparison import Side
from hiltest.record.failures import failed_by_itself
from hiltest.record.outcomes import TestOutcome
from hiltest.record.run import Run
from hiltest.verdict.statistics import mean_value

Seed = int | None
"""None for a board that simulates nothing; where it has run several times, the number of the run."""


NO_BOARD = "none"
"""Kind of the board where no test needs one."""
REAL = "real"
"""Kind of the board whose runs share no noise."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions that must be the same on both sides for numbers to be comparable, beside compiler and cycle model."""

    board: str
    """Its kind: ``virtual`` or ``real``, of a replay with the recording that it is of, or `NO_BOARD`."""
    rig_sha256: str
    """SHA-256 of the rig's conditions; empty in a record from before they were kept, and without board and rig."""
    calibrators: tuple[str, ...]
    """As the board names them."""
    sensors: tuple[str, ...]
    """Those that were there, by name."""
    protocol_version: int
    compiler_flags: tuple[str, ...]
    """Compiler flags of all units of the firmware; empty where there is no ELF, or none with debugging information."""
    poses: str
    """Known angles that were measured: ``all`` or ``level``."""
    suite: str
    """Set of tests: ``gate`` or ``full``."""
    calibrated: bool
    """Whether a calibration file was tested too."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """One run, or several runs of the same firmware on the same rig that differ in their seed."""

    side: Side
    conditions: Conditions | None
    """None when no board answered that was to."""
    measurements: Mapping[Seed, Mapping[str, Measurement]]
    """Measurements by name, the volatile ones too."""
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)
    """Tolerances that the rig states, by exact name."""
    faults: tuple[str, ...] = ()
    """Why this side is no evidence, one line each, with what to do: such as a run that was cut short."""
    chosen: bool = False
    """Whether only chosen tests ran: it is like a run with the same choice, and nothing to keep."""
    failed: tuple[str, ...] = ()
    """What else than a limit makes it no pass by itself: tests that failed, with the reason."""
    may_miss: bool = False
    """Whether limits that were missed were allowed to be, as on some seeds of many."""
    is_baseline: bool = False
    """Whether it was read from a baseline file."""
    builds: Mapping[str, str] = field(default_factory=dict)
    """Build of each measurement that is of another one than `side`: a baseline may have accepted some."""
    in_force: Mapping[str, Tolerance] = field(default_factory=dict)
    """Tolerance of every measurement, as the record states it; empty in one from before it was kept."""
    tests: Mapping[Seed, Mapping[str, TestOutcome]] = field(default_factory=dict)
    """Outcome of every test by its id, of a baseline those that passed; empty where that was not kept."""

    @property
    def name(self) -> str:
        """Name for messages: its file, or the firmware of a run that is just ending."""
        firmware = f" of {self.side.firmware} {self.side.version}" if self.side.firmware else ""
        return self.side.file or f"this run{firmware}"


def evidence_of(run: Run, *, file: str = "", sha256: str = "") -> Evidence:
    """Return one run as one side of a comparison.

    Parameters
    ----------
    file, sha256
        Where it was read from; empty for a run that is just ending.
    """
    board, rig = run.board, run.rig
    side = Side(file=file, sha256=sha256, saved_utc=run.finished_utc, revision=run.revision)
    if board is not None:
        side = replace(
            side, firmware=board.firmware, version=board.version, build_id=board.build_id, compiler=board.compiler,
            cycle_model=board.cycle_model,
        )
    name_of_rig = f"{rig.name} with faults ({rig.faults})" if rig and rig.faults else rig.name if rig else ""
    side = replace(side, rig=name_of_rig, seeds=() if run.seed is None else (run.seed,))
    name = file or "this run"
    of_rig = _tolerances("rig.tolerances", run.rig.tolerances if run.rig else {}, name)
    fault = f"{name}: the run is not complete ({run.verdict.outcome}); run all of it again"
    return Evidence(
        side, _conditions(run), {run.seed: {measurement.name: measurement for measurement in run.measurements}}, of_rig,
        () if run.verdict.complete else (fault,), run.chosen, failed_by_itself(run),
        in_force=_tolerances("tolerances", run.tolerances, name),
        tests={run.seed: {test.id: test.outcome for test in run.tests}},  # the last attempt counts
    )


def evidence_of_seeds(runs: Sequence[Evidence], file: str) -> Evidence:
    """Put runs that differ in their seed, or of a board that has noise of its own, together as one side.

    Parameters
    ----------
    runs
        At least one.
    file
        What to call them.
    """
    first = runs[0]
    faults = [fault for run in runs for fault in run.faults]
    for each in runs[1:]:
        if each.conditions != first.conditions:
            faults.append(f"{each.name}: under other conditions than {first.name}; run all seeds on one rig")
        elif _build(each.side) != _build(first.side):
            faults.append(f"{each.name}: of another firmware than {first.name}; run all seeds with one")
    numbered = len(runs) > 1 and first.conditions is not None and first.conditions.board == REAL
    measurements = _by_seed([run.measurements for run in runs], numbered=numbered)
    tests = _by_seed([run.tests for run in runs], numbered=numbered)
    if len(measurements) < sum(len(run.measurements) for run in runs):
        faults.append(f"{file}: a seed stands there twice; run the campaign into an empty folder")
    if numbered and len({run.side.sha256 for run in runs}) < len(runs):
        faults.append(f"{file}: one run stands there twice, which says nothing about noise; name each run once")
    digest = sha256_of("".join(run.side.sha256 for run in runs).encode()).hexdigest()
    side = replace(
        first.side, file=file, sha256=digest, seeds=tuple(seed for run in runs for seed in run.side.seeds),
        saved_utc=max(run.side.saved_utc for run in runs),
        revision=first.side.revision if len({run.side.revision for run in runs}) == 1 else None,
    )
    chosen = any(run.chosen for run in runs)
    failed = tuple(f"{why} {_of_run(run)}" for run in runs for why in run.failed)
    return Evidence(
        side, first.conditions, measurements, first.tolerances, tuple(faults), chosen, failed,
        in_force={name: each for run in reversed(runs) for name, each in run.in_force.items()}, tests=tests,
    )


_Found = TypeVar("_Found")


def _by_seed(runs: Sequence[Mapping[Seed, _Found]], *, numbered: bool) -> dict[Seed, _Found]:
    """Return what was found on each seed; of a board that simulates nothing by the number of the run."""
    if numbered:
        return dict(enumerate((found for run in runs for found in run.values()), start=1))
    return {seed: found for run in runs for seed, found in run.items()}


def _of_run(run: Evidence) -> str:
    return f"on seed {', '.join(map(str, run.side.seeds))}" if run.side.seeds else f"in {run.name}"


def as_one_run(evidence: Evidence) -> Evidence:
    """Return runs that share no noise as one run: means, with the outcome of the run that gates, if any.

    A measurement or a test that one of several runs lacks is missing, and a number that it lacks is none.
    """
    runs = list(evidence.measurements.values())
    made = {name: [run[name] for run in runs] for name in runs[0] if all(name in run for run in runs)} if runs else {}
    tests = list(evidence.tests.values())
    passed = {test: [each[test] for each in tests] for test in tests[0] if all(test in each for each in tests)} \
        if tests else {}
    return replace(
        evidence, measurements={None: {name: _mean_of(each) for name, each in made.items()}} if runs else {},
        tests={None: {test: _worst_of(each) for test, each in passed.items()}} if tests else {},
    )


def _mean_of(runs: Sequence[Measurement]) -> Measurement:
    values = [run.value for run in runs if run.value is not None]
    shown = next((run for run in runs if run.value is None or run.gates), runs[0])
    return replace(shown, value=mean_value([float(each) for each in values])) if len(values) == len(runs) else shown


def _worst_of(outcomes: Sequence[TestOutcome]) -> TestOutcome:
    return next((outcome for outcome in outcomes if outcome is not TestOutcome.PASSED), TestOutcome.PASSED)


def no_evidence(file: str) -> Evidence:
    """Return a side without a record; a comparison with it is not evaluated."""
    return Evidence(Side(file=file), None, {})


def with_misses_allowed(campaign: Evidence) -> Evidence:
    """Return the runs of a campaign that may miss a limit on some seeds, and has."""
    return replace(campaign, may_miss=True)


def _conditions(run: Run) -> Conditions | None:
    if run.board is None:
        # A run without one is whole only where no test needed it: its numbers are as good as any.
        return Conditions(
            board=NO_BOARD, rig_sha256=run.rig.conditions_sha256 if run.rig else "", calibrators=(), sensors=(),
            protocol_version=0, compiler_flags=(), poses=run.poses, suite=run.suite,
            calibrated=run.calibration is not None,
        ) if run.verdict.complete else None
    recording = run.board.recording
    return Conditions(
        board=f"{run.board.kind} of {recording.sha256[:8]}" if recording else run.board.kind,
        rig_sha256=run.rig.conditions_sha256 if run.rig else "",
        calibrators=run.board.calibrators, sensors=tuple(sensor.name for sensor in run.board.sensors if sensor.present),
        protocol_version=run.board.protocol_version, compiler_flags=tuple(run.board.compiler_flags.split()),
        poses=run.poses, suite=run.suite, calibrated=run.calibration is not None,
    )


def _tolerances(place: str, content: Mapping[str, tuple[float, float]], file: str) -> dict[str, Tolerance]:
    found = {}
    for name, each in content.items():
        try:
            found[name] = Tolerance(*each)
        except ValueError as error:
            raise ConfigError(f"{file}: {place}.{name}: {error}; run it again: hiltest run") from error
    return found


def _build(side: Side) -> tuple[str, ...]:
    return (side.firmware, side.version, side.build_id, side.compiler, side.cycle_model)
