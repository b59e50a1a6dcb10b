"""Campaigns: one run for each of several seeds, and their common verdict."""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hiltest.boards.bench import packaged_build_id
from hiltest.campaigns.sent_bench import run_there, sent_bench
from hiltest.errors import ConfigError, SchedulerError
from hiltest.measurement import Measurement, Outcome, identify, round_significant
from hiltest.report.campaign_markdown import SeedLine, Spread, campaign_markdown
from hiltest.report.comparison_text import print_changes, say_how_to_keep
from hiltest.report.console import standard_output
from hiltest.report.job_summary import annotation, append_to_job_summary
from hiltest.report.terminal import coverage_line, shown_path
from hiltest.run_record.comparison import Comparison
from hiltest.run_record.exit_codes import PYTEST_WINS, WORDS, ExitCode, comparison_code
from hiltest.run_record.failures import missed_only_limits
from hiltest.run_record.files import (
    CAMPAIGN_FILE,
    COVERAGE_FILE,
    OLDER_FOLDER,
    SEED_FOLDERS,
    SEEDS_FILE,
    write_asked_for,
    write_atomically,
    write_document,
)
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import CoverageRecord, Run, Verdict
from hiltest.session.gate import PACKAGED, Gate, read_gate
from hiltest.session.older_firmware import (
    UNCOVERED,
    UNJUDGED,
    coverage_in,
    last_words,
    older_options,
    run_command,
)
from hiltest.session.record_folder import remove_record_in, remove_runs
from hiltest.session.settings import make_folder, run_options
from hiltest.studies.jobs import compute_pieces
from hiltest.text import join_words
from hiltest.verdict.calibrators import UNCALIBRATED, WORST_HEADING
from hiltest.verdict.evidence import Evidence, allow_misses, evidence_of, evidence_of_seeds, no_evidence
from hiltest.verdict.wording import format_seeds
from hiltest.virtual.coverage.lcov import Coverage, from_lcov, refuse_file, to_lcov

SEEDS_SCHEMA = "hiltest.seeds/1"

_NAMED_AT_MOST = 4
_KEPT = "the records of finished seeds are kept"
# Exit codes of a run that has not begun, or was interrupted.
_NOT_BEGUN = (ExitCode.USAGE_ERROR, ExitCode.INTERRUPTED)
# Order of precedence of exit codes, as for the tests of one run.
_WORST_FIRST = (*PYTEST_WINS, ExitCode.WRONG_FIRMWARE, ExitCode.CONNECTION_LOST, ExitCode.NOT_EVALUATED)


@dataclass(frozen=True, slots=True)
class MadeWith:
    """Firmware, rig and options of a run, which determine its numbers together with the seed."""

    firmware: str
    build_id: str
    cycle_model: str
    rig: str
    rig_sha256: str


@dataclass(frozen=True, slots=True)
class SeedResult:
    """Result of one seed's run. `sentence` is its verdict, or its last output without one.

    `excusable` is True for a failure by missed limits only.
    """

    seed: int
    exit_code: int
    sentence: str
    measurements: tuple[Measurement, ...] = ()
    made_with: MadeWith | None = None
    evidence: Evidence | None = None
    excusable: bool = False


@dataclass(frozen=True, slots=True)
class Seeds:
    """``seeds.json``: a campaign over several seeds."""

    exit_code: int
    """Exit code of the seeds, without a comparison."""
    made_with: list[MadeWith]
    """Firmware, build, cycle model and rig of the runs."""
    seeds: list[SeedLine]
    measurements: list[Spread]
    """Smallest, median and largest value of each measurement."""
    comparison: Comparison | None
    """Comparison with the base; null if none was named."""


def run_seeds(
    seeds: Sequence[int],
    options: Sequence[str],
    out: Path,
    *,
    may_fail: int,
    baseline: str | None = None,
    against: str | None = None,
    jobs: int | str | None = None,
    coverage: str | None = None,
) -> int:
    """Run the suites once per seed, several at a time; write ``seeds.json``.

    Parameters
    ----------
    options
        Options of pytest, the same for every seed.
    out
        Folder that receives one folder per seed.
    may_fail
        Number of seeds that may miss a limit; a test that failed for another reason is never excused.
    baseline
        Base to compare all seeds with, paired by seed.
    against
        Older firmware to run on the same seeds first, as the base.
    jobs
        Number of parallel runs, by default one per core; or the address of a dask scheduler, whose workers receive the
        bench.
    coverage
        File of LCOV for the coverage of all seeds together.

    Returns
    -------
    int
        Exit code of the campaign.

    Raises
    ------
    ConfigError
        If `out` cannot be written to, before anything runs; or if the bench cannot be sent.
    HiltestError
        If the remaining seeds cannot be run: see `compute_pieces`.
    """
    jobs = jobs or os.cpu_count() or 1
    gate = read_gate(Path(baseline)) if baseline is not None else None
    # However the campaign ends, records of an earlier one must not pass for its own.
    remove_record_in(out)
    for folder in (*out.glob(SEED_FOLDERS), out / OLDER_FOLDER):
        remove_runs(folder)
    if gate is not None and gate.base is None:
        return _no_base(gate)
    if coverage is not None:
        make_folder(out)
        refuse_file(Path(coverage))
    if against is not None:
        older = _run_all(
            seeds, older_options(options, against), out / OLDER_FOLDER, jobs, "seeds of the older firmware"
        )
        if code := next((result.exit_code for result in older if result.exit_code in _NOT_BEGUN), 0):
            return code
        gate = _older_gate(older, out / OLDER_FOLDER)
    options_of_each = [*options, *UNCOVERED, *(UNJUDGED if gate else ())]
    results = _run_all(seeds, options_of_each, out, jobs, "seeds", covers=coverage is not None)
    if coverage is not None:
        _add_up_coverage(seeds, out, Path(coverage))
    evidence = evidence_of_all(results, str(out))
    if campaign_exit_code(results, may_fail=may_fail) == ExitCode.OK:
        evidence = allow_misses(evidence)
    remark = PACKAGED if _is_packaged(evidence, options) else ""
    comparison = gate.compare(evidence, remark=remark) if gate else None
    return _conclude(results, comparison, out, may_fail=may_fail, options=run_options(options))


def _add_up_coverage(seeds: Sequence[int], out: Path, file: Path) -> None:
    """Write and print the coverage of all seeds that recorded one."""
    coverage = Coverage()
    for path in (_seed_folder(out, seed) / COVERAGE_FILE for seed in seeds):
        if path.is_file():
            coverage.add(from_lcov(path.read_text(encoding="utf-8"), str(path)))
    write_asked_for(file, to_lcov(coverage))
    record = CoverageRecord(shown_path(file.absolute()), coverage.lines, coverage.functions, coverage.branches)
    click.echo(f"{coverage_line(record)}: {record.file}")


def _conclude(
    results: Sequence[SeedResult], comparison: Comparison | None, out: Path, *, may_fail: int, options: str
) -> int:
    """Write and print the verdict over all seeds, and return the exit code."""
    spreads = spreads_of(results)
    _write_seeds(out, results, spreads, comparison, may_fail=may_fail)
    code = campaign_exit_code(results, may_fail=may_fail, comparison=comparison)
    sentence = campaign_sentence(results, spreads, may_fail=may_fail, comparison=comparison)
    verdict = Verdict(_word(results, may_fail=may_fail, comparison=comparison), code, sentence, complete=True)
    page = campaign_markdown(
        verdict,
        _seed_lines(results),
        spreads,
        comparison,
        {measurement.cycle_model for result in results for measurement in result.measurements},
    )
    write_atomically(out / CAMPAIGN_FILE, page)
    if comparison is not None:
        print_changes(standard_output(), comparison, sentence=sentence)
        say_how_to_keep(standard_output(), comparison, str(out), options)
    click.echo(f"{out / SEEDS_FILE}, {CAMPAIGN_FILE}")
    if remark := append_to_job_summary(page, out / CAMPAIGN_FILE):
        click.echo(remark)
    click.echo(annotation(verdict), nl=False)
    click.echo(sentence)
    return code


def _no_base(gate: Gate) -> int:
    """Print why no seed runs: the base of the comparison is missing."""
    sentence = f"NOT EVALUATED: {gate.reason}. No seed was run."
    code = ExitCode.NOT_EVALUATED
    click.echo(annotation(Verdict(WORDS[code], code, sentence, complete=False)), nl=False)
    click.echo(sentence)
    return code


def _run_all(
    seeds: Sequence[int], options: Sequence[str], out: Path, jobs: int | str, name: str, *, covers: bool = False
) -> list[SeedResult]:
    make_folder(out)
    try:
        return _run_each(seeds, options, out, jobs, name, covers=covers)
    except (KeyboardInterrupt, SchedulerError):  # Ctrl-C reached the seeds on this machine, too, and ended them
        click.echo(_kept_in_words(seeds, out, name))
        raise


def _kept_in_words(seeds: Sequence[int], out: Path, name: str) -> str:
    """Return how many seeds finished before an interruption, and the folders of their records."""
    is_complete = {}
    for folder in (_seed_folder(out, seed) for seed in seeds):
        with suppress(ConfigError):
            is_complete[folder] = read_record(folder).run.verdict.complete
    finished = [str(folder) for folder, complete in is_complete.items() if complete]
    begun = [str(folder) for folder, complete in is_complete.items() if not complete]
    parts = [f"{len(finished)} of {len(seeds)} {name} finished"]
    parts += [f"records in {join_words(finished, _NAMED_AT_MOST)}"] if finished else []
    parts += [f"cut short: {join_words(begun, _NAMED_AT_MOST)}"] if begun else []
    return "; ".join(parts)


def _run_each(
    seeds: Sequence[int], options: Sequence[str], out: Path, jobs: int | str, name: str, *, covers: bool
) -> list[SeedResult]:
    if isinstance(jobs, str):
        ended = _run_remotely(seeds, options, out, jobs, covers=covers)
    else:
        ended = _run_locally(seeds, options, out, jobs, covers=covers)
    console = Console()
    columns = (TextColumn(name), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=len(seeds))
        results = []
        for seed, (exit_code, last_line) in ended:
            results.append(result := _result(seed, exit_code, last_line, _seed_folder(out, seed)))
            progress.advance(task)
            if result.exit_code:
                progress.console.print(f"seed {result.seed}: {result.sentence}", markup=False, soft_wrap=True)
    return sorted(results, key=lambda result: result.seed)


def _run_locally(
    seeds: Sequence[int], options: Sequence[str], out: Path, jobs: int, *, covers: bool
) -> Iterator[tuple[int, tuple[int, str]]]:
    """Run each seed, and yield it with its exit code and its last line of output."""
    return compute_pieces(_run_seed, (tuple(options), out, covers), seeds, jobs, remark=_KEPT, starts_process=True)


def _run_seed(arguments: tuple[tuple[str, ...], Path, bool], seed: int) -> tuple[int, str]:
    """Run one seed in a process of its own, since pytest keeps state that would affect a second run."""
    options, out, covers = arguments
    folder = _seed_folder(out, seed)
    mine = f"--seed={seed}", f"--out={folder}", *coverage_in(folder, covers=covers)
    done = run_command(*mine, "--", *options, folder=folder)
    return done.returncode, last_words(done.stderr or done.stdout)


def _run_remotely(
    seeds: Sequence[int], options: Sequence[str], out: Path, scheduler: str, *, covers: bool
) -> Iterator[tuple[int, tuple[int, str]]]:
    """Run each seed on another machine, and store its record on this one."""
    for seed, ended in compute_pieces(run_there, sent_bench(options, covers=covers), seeds, scheduler, remark=_KEPT):
        ended.write(_seed_folder(out, seed))
        yield seed, (ended.exit_code, ended.last_line)


def _is_packaged(evidence: Evidence, options: Sequence[str]) -> bool:
    """Return whether the packaged firmware ran because no option or variable named one."""
    named = os.environ.get("HIL_FIRMWARE") or any(option.startswith("--hil-firmware") for option in options)
    if named or not evidence.side.build_id:
        return False
    return evidence.side.build_id == packaged_build_id()  # an ini file may have named another one


def _older_gate(results: Sequence[SeedResult], out: Path) -> Gate:
    """Return the seeds of the older firmware as the base for the newer one."""
    _write_seeds(out, results, spreads_of(results), None)
    evidence = evidence_of_all(results, str(out))
    if not evidence.measurements:
        return Gate(str(out), None, f"{out}: no seed of the older firmware left a record: {results[0].sentence}")
    return Gate(str(out), evidence, in_one_session=True)


def evidence_of_all(results: Sequence[SeedResult], file: str) -> Evidence:
    """Combine the seeds into one side of a comparison; reasons for missing records become its faults, each once."""
    evidence = [result.evidence for result in results if result.evidence is not None]
    missing: dict[str, list[int]] = {}
    for result in results:
        if result.evidence is None:
            missing.setdefault(result.sentence, []).append(result.seed)
    faults = (f"{file}: no record{format_seeds(seeds)}: {sentence}" for sentence, seeds in missing.items())
    whole = evidence_of_seeds(evidence, file) if evidence else no_evidence(file)
    return replace(whole, faults=(*whole.faults, *faults))


def campaign_exit_code(results: Sequence[SeedResult], *, may_fail: int, comparison: Comparison | None = None) -> int:
    """Return the exit code: a code of any seed but 0 and 1, then 1 unless allowed, then that of the comparison.

    A crash that the base does not have is a failure (1).
    """
    codes = [result.exit_code for result in results]
    if comparison and comparison.failed and all(code in (0, 1, ExitCode.CONNECTION_LOST) for code in codes):
        return int(ExitCode.FAILED)
    for code in _WORST_FIRST:
        if code in codes:
            return int(code)
    failed = codes.count(1) > may_fail or bool(_inexcusable_seeds(results))
    other = next((code for code in codes if code not in (0, 1)), int(failed))
    return other if other or comparison is None else int(comparison_code(comparison))


def campaign_sentence(
    results: Sequence[SeedResult], spreads: Sequence[Spread], *, may_fail: int, comparison: Comparison | None = None
) -> str:
    """Return the result of the comparison, the number of seeds that passed, and the worst headings."""
    passed = sum(result.exit_code == 0 for result in results)
    failed = [result.seed for result in results if result.exit_code]
    which = f" (not: {_seed_list(failed)})" if failed else ""
    number = "all of them" if may_fail >= len(results) else may_fail
    allowed = f", {number} may fail" if may_fail else ""
    if may_fail and (inexcusable := _inexcusable_seeds(results)):
        allowed += f", but only by a limit (not: {_seed_list(inexcusable)})"
    headings = [
        f"{spread.name} median {spread.median:.2f}, worst {spread.max:.2f} {spread.unit}"
        for spread in spreads
        if (named := identify(spread.name)).kind is WORST_HEADING and named.subject != UNCALIBRATED
    ]
    word = _word(results, may_fail=may_fail, comparison=comparison).upper()
    sentence = "; ".join([f"{passed} of {len(results)} seeds pass{which}{allowed}", *headings]) + f": {word}."
    return sentence if comparison is None else f"{comparison.sentence} {sentence}"


def _inexcusable_seeds(results: Sequence[SeedResult]) -> list[int]:
    """Return the seeds that failed for another reason than a missed limit."""
    return [result.seed for result in results if result.exit_code == 1 and not result.excusable]


def _seed_list(seeds: Sequence[int]) -> str:
    return ", ".join(map(str, seeds[:10])) + (", ..." if len(seeds) > 10 else "")


def _word(results: Sequence[SeedResult], *, may_fail: int, comparison: Comparison | None) -> str:
    """Return the verdict in one word; other exit codes of seeds are a failure of the campaign."""
    of_seeds = campaign_exit_code(results, may_fail=may_fail)
    code = campaign_exit_code(results, may_fail=may_fail, comparison=comparison)
    return WORDS[ExitCode.FAILED] if of_seeds else WORDS[ExitCode(code)]


def spreads_of(results: Sequence[SeedResult]) -> list[Spread]:
    """Return smallest, median and largest value of every measurement with a number, by name."""
    values: dict[str, list[float]] = {}
    failed: dict[str, list[int]] = {}
    units: dict[str, str] = {}
    for result in results:
        for measurement in result.measurements:
            if measurement.volatile:
                continue
            units[measurement.name] = measurement.unit
            if measurement.value is not None:
                values.setdefault(measurement.name, []).append(float(measurement.value))
            if measurement.outcome is Outcome.FAIL:
                failed.setdefault(measurement.name, []).append(result.seed)
    return [
        Spread(
            name,
            units[name],
            len(numbers),
            min(numbers),
            statistics.median(numbers),
            max(numbers),
            tuple(failed.get(name, ())),
        )
        for name, numbers in sorted(values.items())
    ]


def _result(seed: int, exit_code: int, last_line: str, folder: Path) -> SeedResult:
    if exit_code != ExitCode.USAGE_ERROR:  # a run with this code was refused the folder, which another run has
        try:
            stored = read_record(folder)
            run, evidence = stored.run, evidence_of(stored.run, file=str(stored.file.path))
            return SeedResult(
                seed,
                exit_code,
                run.verdict.sentence,
                run.measurements,
                _firmware_and_rig(run),
                evidence,
                excusable=missed_only_limits(run),
            )
        except ConfigError as error:
            if exit_code == ExitCode.OK:  # tests were only collected, for example: nothing shows that the seed passed
                return SeedResult(seed, ExitCode.NOT_EVALUATED, f"{str(error).rstrip('.')}; it wrote: {last_line}")
    return SeedResult(seed, exit_code, last_line)


def _seed_folder(out: Path, seed: int) -> Path:
    return out / f"seed-{seed:04d}"


def _firmware_and_rig(run: Run) -> MadeWith | None:
    if run.board is None or run.rig is None:
        return None
    firmware = f"{run.board.firmware} {run.board.version}"
    return MadeWith(firmware, run.board.build_id, run.board.cycle_model, run.rig.name, run.rig.sha256)


def _write_seeds(
    out: Path,
    results: Sequence[SeedResult],
    spreads: Sequence[Spread],
    comparison: Comparison | None,
    *,
    may_fail: int = 0,
) -> None:
    """Write ``seeds.json``."""
    document = Seeds(
        exit_code=int(campaign_exit_code(results, may_fail=may_fail)),
        made_with=list(dict.fromkeys(result.made_with for result in results if result.made_with)),
        seeds=_seed_lines(results),
        measurements=[_round_numbers(spread) for spread in spreads],
        comparison=comparison,
    )
    write_document(out / SEEDS_FILE, document, SEEDS_SCHEMA)


def _seed_lines(results: Sequence[SeedResult]) -> list[SeedLine]:
    return [SeedLine(result.seed, result.exit_code, result.sentence) for result in results]


def _round_numbers(spread: Spread) -> Spread:
    low, median, high = (round_significant(number) or number for number in (spread.min, spread.median, spread.max))
    return replace(spread, min=low, median=median, max=high)
