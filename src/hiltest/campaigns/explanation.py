"""Explanation of a run: cause and evidence of its verdict, and the source lines whose cost changed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote

from hiltest.boards import BoardKind, VirtualBench, default_firmware
from hiltest.budgets import ELF, RIG
from hiltest.errors import ConfigError
from hiltest.json_files import read_bounded
from hiltest.measurement import Measurement, identify
from hiltest.rig import Rig
from hiltest.rig.rig_file import parse_rig
from hiltest.run_record.comparison import Change, Difference
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Run
from hiltest.studies.board_calibrators import BoardCalibrators
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence_reader import read_evidence
from hiltest.verdict.summary import summarise
from hiltest.virtual.counts.profiling import profile_running
from hiltest.virtual.profiling.line_changes import LineChange, line_changes

_ORDER = (Change.WORSE, Change.GONE, Change.CHANGED, Change.BETTER, Change.NEW, Change.NOT_TAKEN)
_MOST_FUNCTIONS = 4
_AWAKE = "cycles.awake.share"
_ALIKE = (
    "no line of these calibrators costs more or less on their 100 points; the change shows at other points, such as "
    "those of spread and worst_found"
)


@dataclass(frozen=True, slots=True)
class ChangedFunction:
    """A function in two builds: a calibrator's with the same points, or one that the rig counts in the same tumble."""

    calibrator: str
    """Calibrator, or name of the function under ``[cycles]`` of the rig; ``awake`` for the whole firmware."""
    function: str
    cycles: int
    base_cycles: int
    """Cycles of the call, or mean of all calls in the tumble, interrupts included."""
    cycle_model: str
    lines: tuple[LineChange, ...]
    """Lines that cost more or less than in the base, the largest change first."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Cause and evidence of the verdict on a run."""

    sentence: str
    """Verdict of the run, or summary of its comparison with `--baseline`."""
    causes: tuple[str, ...]
    """Likely causes, that of the worst failure first."""
    next_steps: tuple[str, ...]
    failures: tuple[Measurement, ...]
    """Measurements out of their limits, one of each calibrator first."""
    changes: tuple[Difference, ...]
    """Measurements that changed since the base, the worse ones first."""
    functions: tuple[ChangedFunction, ...]
    """Functions whose cycles changed; empty if `remark` has a reason."""
    remark: str
    """Reason why no source lines are known; empty otherwise."""


def explain(run: Path, baseline: Path | None, firmware: Path | None, against: Path | None) -> Explanation:
    """Explain a run.

    Parameters
    ----------
    run
        Folder of a run, or its ``run.json``.
    baseline
        Record of a run or baseline to compare with; by default the run's own comparison is explained.
    firmware, against
        ELF of the run, and of the base; by default the packaged one, if it has the same digest.

    Raises
    ------
    ConfigError
        If a record cannot be read, or an ELF is not the one that the run executed.
    BoardFault
        If a calibrator faults or hangs when it is called for its lines.
    """
    record = read_record(run).run
    if baseline is not None:
        record = replace(record, comparison=compare(read_evidence(baseline), read_evidence(run)))
    comparison, summary = record.comparison, summarise(record)
    changes = [difference for change in _ORDER if comparison for difference in comparison.differences_with(change)]
    functions, remark = _changed_functions(record, changes, firmware, against)
    steps = [step for step in summary.advice if not (functions and "hiltest explain" in step)]
    return Explanation(
        comparison.sentence if comparison and baseline else record.verdict.sentence,
        summary.causes,
        tuple(step.replace(" ELF ", f" {_named_elf(record, firmware)} ") for step in steps),
        tuple(failure.measurement for failure in summary.failures),
        tuple(changes),
        functions,
        remark,
    )


def _changed_functions(
    record: Run, changes: Sequence[Difference], firmware: Path | None, against: Path | None
) -> tuple[tuple[ChangedFunction, ...], str]:
    """Return the functions whose cycles changed, or the reason why they are unknown."""
    comparison = record.comparison
    if comparison is None:
        return (), "the run was compared with nothing; name a --baseline"
    new = _elf_of("--firmware", firmware, comparison.new.firmware_sha256)
    base = _elf_of("--against", against, comparison.base.firmware_sha256)
    subjects = dict.fromkeys(
        identify(change.name).subject for change in changes if change.unit == "cycle" or change.name == _AWAKE
    )
    if not subjects:
        return (), "no cycles changed"
    if new is None or base is None:
        return (), "name the ELFs of the run and of its base: --firmware ELF --against ELF"
    if (rig := _foreign_rig(record)) is not None:
        counted = [(name, rig.cycles[name].functions[0]) for name in subjects if name in rig.cycles]
        watched = dict[str, str | None](counted[:_MOST_FUNCTIONS])
        if not watched or any(change.name == _AWAKE for change in changes):
            watched["awake"] = None
        return tuple(_compare_in_tumble(watched, rig, base, new)), ""
    sides = BoardCalibrators(base), BoardCalibrators(new)
    names = [name for name in subjects if all(name in side.names for side in sides)]
    if not names:
        return (), "cycles of no calibrator changed; hiltest profile calls other functions"
    functions = tuple(_compare_lines(names[:_MOST_FUNCTIONS], *sides))
    return functions, "" if functions else _ALIKE


def _foreign_rig(record: Run) -> Rig | None:
    """Return the rig of a run of foreign firmware on a virtual board, if its file has not changed since the run."""
    if record.rig is None or record.board is None or record.board.kind != BoardKind.VIRTUAL:
        return None
    file = Path(record.rig.file)
    if not file.is_file():
        return None
    content = read_bounded(file, RIG, otherwise="name a rig (TOML)")
    if hashlib.sha256(content).hexdigest() != record.rig.sha256:
        return None
    rig = parse_rig(file, content)
    return None if rig.answers_requests else rig


def _compare_in_tumble(
    functions: Mapping[str, str | None], rig: Rig, base: Path, new: Path
) -> Iterator[ChangedFunction]:
    """Compare functions by their names in the rig; None is all code."""
    benches = [VirtualBench(rig, firmware=firmware) for firmware in (base, new)]
    sides = [profile_running(bench.machine, [*functions.values()], bench.run_in_tumble) for bench in benches]
    for (name, function), before, after in zip(functions.items(), *sides, strict=True):
        lines = tuple(change for change in line_changes(before.lines_of_a_call, after.lines_of_a_call) if change.delta)
        cycles, base_cycles = after.cycles_of_a_call, before.cycles_of_a_call
        yield ChangedFunction(name, function or "all code", cycles, base_cycles, after.cycle_model, lines)


def _compare_lines(names: Sequence[str], base: BoardCalibrators, new: BoardCalibrators) -> Iterator[ChangedFunction]:
    for name in names:
        before, after = base.profile(name), new.profile(name)
        if lines := tuple(line_changes(before.lines, after.lines)):
            yield ChangedFunction(name, after.function, after.cycles, before.cycles, after.cycle_model, lines)


def _named_elf(record: Run, firmware: Path | None) -> str:
    """Return the ELF of a run as an argument of `hiltest profile`; ``ELF`` if only the user knows its file."""
    ran = record.board.firmware_sha256 if record.board else None
    if firmware is not None:
        return quote(str(firmware))
    return "shipped" if ran == hashlib.sha256(default_firmware().read_bytes()).hexdigest() else "ELF"


def _elf_of(option: str, file: Path | None, sha256: str) -> Path | None:
    """Return the ELF with a digest: the named file, or the packaged one; None if that is another one."""
    elf = file or default_firmware()
    is_same = hashlib.sha256(read_bounded(elf, ELF, otherwise="name the ELF that was run")).hexdigest() == sha256
    if file is not None and sha256 and not is_same:
        raise ConfigError(f"{option} {elf}: another file was run, with the SHA-256 {sha256}; name that one")
    return elf if is_same or file is not None else None
