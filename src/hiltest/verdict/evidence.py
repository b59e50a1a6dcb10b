"""One side of a comparison: its measurements and their conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256 as sha256_of
from typing import TypeVar

from hiltest.measurement import Measurement, Tolerance
from hiltest.run_record.comparison import Revision, Side
from hiltest.run_record.failures import failed_by_itself
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import Run, Table
from hiltest.text import id_without_repetition
from hiltest.verdict.statistics import mean_value

Seed = int | None
"""Seed; None for a board that simulates nothing, and the number of the run if such a board ran several times."""


ERROR_COLUMN = "error."
"""Beginning of the name of a column with the heading errors of a calibrator."""
POSES_TABLE, BASE_POSES_TABLE = "heading.poses", "heading.base_poses"
"""Tables with the headings at the known angles: of a run, and in a compared run those of its base."""
NO_BOARD = "none"
"""Kind of the board if no test needs one."""
REAL = "real"
"""Kind of a board whose runs share no noise."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions that must be equal on both sides for numbers to be comparable, beside compiler and cycle model."""

    board: str
    """Kind of the board: ``virtual``, ``real``, either with the recording for a replay, or `NO_BOARD`."""
    rig_sha256: str
    """SHA-256 of the rig's conditions; empty in older records, which lack it, and without board and rig."""
    calibrators: tuple[str, ...]
    """Names of the calibrators as the board reports them."""
    sensors: tuple[str, ...]
    """Names of the sensors that were present."""
    protocol_version: int
    compiler_flags: tuple[str, ...]
    """Compiler flags of all units of the firmware; empty without an ELF or its debugging information."""
    poses: str
    """Known angles that were measured: ``all`` or ``level``."""
    suite: str
    """Set of tests: ``gate`` or ``full``."""
    calibrated: bool
    """True if a calibration file was tested, too."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """One measurement that was moved into a baseline, its build and the reason."""

    name: str
    """Name of the measurement; ``*`` if a run was saved over the file."""
    because: str
    when_utc: str
    build_id: str
    """Build that the measurement comes from now."""
    was: float | None
    now: float | None
    """Means over the seeds, before and after; None without a number."""
    was_build_id: str | None = None
    """Build that the measurement came from before; None for a new one, and in older files, which lack it."""
    revision: Revision | None = None
    """Sources that the run was made for."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """One run, or several runs of the same firmware on the same rig that differ in their seed."""

    side: Side
    conditions: Conditions | None
    """Conditions of the run; None if a board was needed and none answered."""
    measurements: Mapping[Seed, Mapping[str, Measurement]]
    """Measurements by name, including volatile ones."""
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)
    """Tolerances that the rig states, by exact name."""
    faults: tuple[str, ...] = ()
    """Reasons why this side cannot be compared, one line each, with a remedy: such as a run that was cut short."""
    crashes: Mapping[str, str] = field(default_factory=dict)
    """Crash behind each of these reasons that is the firmware's fault, which the virtual board repeats."""
    chosen: bool = False
    """True if only chosen tests ran: such a run is comparable with the same choice, and cannot become a baseline."""
    tests_left_out: int = 0
    """Number of tests of the full set that the gate set left out, of several runs the largest."""
    failed: tuple[str, ...] = ()
    """Tests that failed for another reason than a limit, with the reason."""
    may_miss: bool = False
    """True if missed limits are allowed, as on some seeds of many."""
    is_baseline: bool = False
    """True if it was read from a baseline file."""
    builds: Mapping[str, str] = field(default_factory=dict)
    """Builds of measurements that come from another build than `side`, since a baseline accepted them."""
    in_force: Mapping[str, Tolerance] = field(default_factory=dict)
    """Tolerance of every measurement according to the record; empty for older records, which lack it."""
    tests: Mapping[Seed, Mapping[str, TestOutcome]] = field(default_factory=dict)
    """Outcome of every test by its id, for a baseline of those that passed; empty in older files, which lack it."""
    suites: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each file of tests and each conftest.py, by name; empty in older files, which lack it."""
    sealed: bool = True
    """False for a baseline of the format without a digest."""
    record: str = ""
    """SHA-256 of the record that the numbers come from; for a baseline that of the saved run. Empty if unknown."""
    history: tuple[Accepted, ...] = ()
    """Accepted changes of a baseline, oldest first."""
    poses: Table | None = None
    """Headings at the known angles, of several runs those of the first; None without any."""

    @property
    def name(self) -> str:
        """Name for messages: the file, or the firmware of a run that is just ending."""
        firmware = f" of {self.side.firmware} {self.side.version}" if self.side.firmware else ""
        return self.side.file or f"this run{firmware}"


def evidence_of(run: Run, *, file: str = "", sha256: str = "") -> Evidence:
    """Return one run as one side of a comparison.

    Parameters
    ----------
    file, sha256
        File that the run was read from; empty for a run that is just ending.
    """
    board, rig = run.board, run.rig
    side = Side(file=file, sha256=sha256, saved_utc=run.finished_utc, revision=run.revision)
    if board is not None:
        side = replace(
            side,
            firmware=board.firmware,
            version=board.version,
            build_id=board.build_id,
            compiler=board.compiler,
            cycle_model=board.cycle_model,
            firmware_sha256=board.firmware_sha256 or "",
        )
    name_of_rig = f"{rig.name} with faults ({rig.faults})" if rig and rig.faults else rig.name if rig else ""
    side = replace(side, rig=name_of_rig, seeds=() if run.seed is None else (run.seed,))
    incomplete = f"the firmware crashes: {run.crash}" if run.crash else f"the run is incomplete ({run.verdict.outcome})"
    fault = f"{file or 'this run'}: {incomplete}; {'correct the firmware' if run.crash else 'repeat it'}"
    return Evidence(
        side,
        _conditions(run),
        {run.seed: {measurement.name: measurement for measurement in run.measurements}},
        _tolerances(rig.tolerances if rig else {}),
        () if run.verdict.complete else (fault,),
        {fault: run.crash} if run.crash else {},
        run.chosen,
        run.tests_left_out,
        in_force=_tolerances(run.tolerances),
        tests={run.seed: _outcomes(run)},
        failed=failed_by_itself(run),
        suites=run.suites,
        record=sha256,
        poses=run.table(POSES_TABLE),
    )


def _outcomes(run: Run) -> dict[str, TestOutcome]:
    """Return the outcome of each test: of attempts the last counts, of repetitions the worst."""
    repetitions: dict[str, list[TestOutcome]] = {}
    for test, outcome in {test.id: test.outcome for test in run.tests}.items():
        repetitions.setdefault(id_without_repetition(test), []).append(outcome)
    return {test: _worst_outcome(outcomes) for test, outcomes in repetitions.items()}


def evidence_of_seeds(runs: Sequence[Evidence], file: str) -> Evidence:
    """Combine runs that differ in their seed, or of a board that has noise of its own, into one side.

    Parameters
    ----------
    runs
        At least one run.
    file
        Name of the combined side.
    """
    first = runs[0]
    faults = [fault for run in runs for fault in run.faults]
    for run in runs[1:]:
        if run.conditions != first.conditions:
            faults.append(f"{run.name}: other conditions than {first.name}; run all seeds on one rig")
        elif _build(run.side) != _build(first.side):
            faults.append(f"{run.name}: another firmware than {first.name}; run all seeds with one firmware")
    numbered = len(runs) > 1 and first.conditions is not None and first.conditions.board == REAL
    measurements = _merge_by_seed([run.measurements for run in runs], numbered=numbered)
    tests = _merge_by_seed([run.tests for run in runs], numbered=numbered)
    if len(measurements) < sum(len(run.measurements) for run in runs):
        faults.append(f"{file}: a seed appears twice; run the campaign into an empty folder")
    if numbered and len({run.side.sha256 for run in runs}) < len(runs):
        faults.append(f"{file}: a run appears twice, which hides noise; name each run once")
    digest = sha256_of("".join(run.side.sha256 for run in runs).encode()).hexdigest()
    side = replace(
        first.side,
        file=file,
        sha256=digest,
        seeds=tuple(seed for run in runs for seed in run.side.seeds),
        saved_utc=max(run.side.saved_utc for run in runs),
        revision=first.side.revision if len({run.side.revision for run in runs}) == 1 else None,
    )
    failed = tuple(f"{why} {_seeds_in_words(run)}" for run in runs for why in run.failed)
    return Evidence(
        side,
        first.conditions,
        measurements,
        first.tolerances,
        tuple(faults),
        {fault: crash for run in runs for fault, crash in run.crashes.items()},
        any(run.chosen for run in runs),
        max(run.tests_left_out for run in runs),
        failed,
        in_force={name: tolerance for run in reversed(runs) for name, tolerance in run.in_force.items()},
        tests=tests,
        suites=first.suites,
        record=digest,
        poses=first.poses,
    )


_Value = TypeVar("_Value")


def _merge_by_seed(runs: Sequence[Mapping[Seed, _Value]], *, numbered: bool) -> dict[Seed, _Value]:
    """Return the values by seed; for a board that simulates nothing, by the number of the run."""
    if numbered:
        return dict(enumerate((value for run in runs for value in run.values()), start=1))
    return {seed: value for run in runs for seed, value in run.items()}


def _seeds_in_words(run: Evidence) -> str:
    return f"on seed {', '.join(map(str, run.side.seeds))}" if run.side.seeds else f"in {run.name}"


def as_one_run(evidence: Evidence) -> Evidence:
    """Return runs that share no noise as one run: means, with the outcome of a run that gates, if any.

    A measurement or test that one of the runs lacks is omitted; a mean is missing if one of its numbers is.
    """
    runs = list(evidence.measurements.values())
    measurements = (
        {name: [run[name] for run in runs] for name in runs[0] if all(name in run for run in runs)} if runs else {}
    )
    tests = list(evidence.tests.values())
    by_test = (
        {
            test: [outcomes[test] for outcomes in tests]
            for test in tests[0]
            if all(test in outcomes for outcomes in tests)
        }
        if tests
        else {}
    )
    return replace(
        evidence,
        measurements={None: {name: _mean_measurement(values) for name, values in measurements.items()}} if runs else {},
        tests={None: {test: _worst_outcome(values) for test, values in by_test.items()}} if tests else {},
    )


def _mean_measurement(runs: Sequence[Measurement]) -> Measurement:
    values = [run.value for run in runs if run.value is not None]
    shown = next((run for run in runs if run.value is None or run.gates), runs[0])
    return replace(shown, value=mean_value([float(value) for value in values])) if len(values) == len(runs) else shown


def _worst_outcome(outcomes: Sequence[TestOutcome]) -> TestOutcome:
    return next((outcome for outcome in outcomes if outcome is not TestOutcome.PASSED), TestOutcome.PASSED)


def no_evidence(file: str) -> Evidence:
    """Return a side without a record; a comparison with it cannot be evaluated."""
    return Evidence(Side(file=file), None, {})


def allow_misses(campaign: Evidence) -> Evidence:
    """Return a side that may miss limits, as a campaign on some seeds, or a baseline."""
    return replace(campaign, may_miss=True)


def _conditions(run: Run) -> Conditions | None:
    if run.board is None:
        # Such a run is complete only if no test needed a board; its numbers are then valid.
        return (
            Conditions(
                board=NO_BOARD,
                rig_sha256=run.rig.conditions_sha256 if run.rig else "",
                calibrators=(),
                sensors=(),
                protocol_version=0,
                compiler_flags=(),
                poses=run.poses,
                suite=run.suite,
                calibrated=run.calibration is not None,
            )
            if run.verdict.complete
            else None
        )
    recording = run.board.recording
    return Conditions(
        board=f"{run.board.kind} of {recording.sha256[:8]}" if recording else run.board.kind,
        rig_sha256=run.rig.conditions_sha256 if run.rig else "",
        calibrators=run.board.calibrators,
        sensors=tuple(sensor.name for sensor in run.board.sensors if sensor.present),
        protocol_version=run.board.protocol_version,
        compiler_flags=tuple(run.board.compiler_flags.split()),
        poses=run.poses,
        suite=run.suite,
        calibrated=run.calibration is not None,
    )


def _tolerances(content: Mapping[str, tuple[float, float]]) -> dict[str, Tolerance]:
    return {name: Tolerance(*values) for name, values in content.items()}


def _build(side: Side) -> tuple[str, ...]:
    return (side.firmware, side.version, side.build_id, side.compiler, side.cycle_model)
