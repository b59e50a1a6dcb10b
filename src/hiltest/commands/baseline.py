"""``hiltest baseline``: save the numbers of a run to compare later runs with."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hiltest.commands.options import documented
from hiltest.errors import ConfigError
from hiltest.text import format_count, format_number, join_words

if TYPE_CHECKING:
    from hiltest.report.comparison_text import Comparisons
    from hiltest.verdict.baseline import Baseline, BaselineRow

_EXIT_CODES = """
\b
Exit codes:
  0   written
  2   interrupted
  4   usage: a file cannot be read or written, the run is incomplete, no
      measurement has that name, or --accept changes nothing
"""
_REVIEW_EXIT_CODES = """
\b
Exit codes:
  0   every change that lets more pass was accepted by name
  2   interrupted
  4   usage: a file cannot be read, or is not a baseline
  21  a measurement is worse, and was not accepted
  22  a measurement was removed or its tolerance widened, and was not accepted,
      or the baselines cannot be compared
"""
_PATH = click.Path(path_type=Path)


@dataclass(frozen=True, slots=True)
class Saved:
    """A baseline that was saved."""

    file: str
    """File that was written."""
    measurements: int
    """Number of measurements in it."""
    build_id: str
    """Build of the measurements."""
    seeds: tuple[int | None, ...]
    """Seeds of the run; null for a run without a seed."""


@dataclass(frozen=True, slots=True)
class Moved:
    """A measurement that was accepted."""

    name: str
    was: float | None
    now: float | None
    """Values before and after; null for none."""


@dataclass(frozen=True, slots=True)
class Updated:
    """A baseline that was updated."""

    file: str
    """File that was written."""
    moved: tuple[Moved, ...]
    measurements: int
    """Number of measurements in it."""


@click.group()
def baseline() -> None:
    """Save runs as a baseline, or accept changes into one."""


@baseline.command(epilog=_EXIT_CODES)
@documented("hiltest.baseline-save/1")
@click.argument("run", nargs=-1, required=True, type=_PATH)
@click.argument("file", type=_PATH)
def save(run: tuple[Path, ...], file: Path) -> tuple[int, Saved]:
    """Write the measurements of RUN to FILE, except the volatile ones.

    RUN is a run.json, the folder of a run, or the folder of a campaign (hiltest run --seeds). An existing
    baseline is replaced and keeps its history. A run that failed is saved with a warning.

    Save five or more runs of one firmware on a real board: they show how much runs differ by noise alone.
    """
    from hiltest.run_record.run import utc_now
    from hiltest.verdict import compare
    from hiltest.verdict.baseline import baseline_of, renewed
    from hiltest.verdict.evidence import no_evidence
    from hiltest.verdict.evidence_reader import read_runs

    before = _existing_baseline(file)
    runs = read_runs(run)
    saved = baseline_of(runs, utc_now())
    replaced = before.side.build_id if before is not None else saved.side.build_id
    if before is not None:
        saved = renewed(saved, before)
    _write(saved, file)
    click.echo(
        f"{file}: {_count_measurements(len(saved.measurements))} of build {saved.side.build_id}, {_seeds(saved)}"
        + (f", in place of build {replaced}" if replaced != saved.side.build_id else "")
    )
    if failed := compare.compare(no_evidence(""), runs).failed:
        click.echo(f"Warning: the verdict of {runs.name} is FAIL: {join_words(failed, 2)}; {file} has its numbers.")
    return 0, Saved(str(file), len(saved.measurements), saved.side.build_id, saved.seeds)


@baseline.command(epilog=_EXIT_CODES)
@documented("hiltest.baseline-update/1")
@click.option(
    "--accept",
    "names",
    metavar="NAME",
    required=True,
    multiple=True,
    help="Accept this measurement; * matches any text. Repeat the option for several.",
)
@click.option(
    "--because", metavar="TEXT", required=True, help="Give the reason for the change, which the file's history keeps."
)
@click.argument("file", type=_PATH)
@click.argument("run", nargs=-1, required=True, type=_PATH)
def update(file: Path, run: tuple[Path, ...], names: tuple[str, ...], because: str) -> tuple[int, Updated]:
    """Copy the named measurements of RUN into FILE, and keep all others.

    Measurements that RUN no longer makes are removed, unless RUN ran only chosen tests (-k, node ids). If the board
    is real, name as many runs as the baseline has.
    """
    from hiltest.json_files import read_json
    from hiltest.run_record.run import utc_now
    from hiltest.verdict.baseline import accept
    from hiltest.verdict.baseline_file import OTHERWISE, read_baseline
    from hiltest.verdict.evidence_reader import read_runs
    from hiltest.verdict.wording import build

    if not because.strip():
        raise click.BadParameter("give a reason that the next reader understands", param_hint="--because")
    stored = read_json(file, otherwise=OTHERWISE)
    before = read_baseline(stored)
    runs = read_runs(run)
    after = accept(before, runs, names, because=because, when_utc=utc_now())
    moved = after.history[len(before.history) :]
    if not moved:
        named = " ".join(f"--accept {name}" for name in names)
        raise ConfigError(
            f"nothing changes: {file} already has the numbers of {runs.name} for {named}; name another run"
        )
    _write(after, file, stored.content)
    was, now = ({row.name: row for row in side.measurements} for side in (before, after))
    for change in moved:
        edited = _accepted_remark(was.get(change.name), now.get(change.name))
        click.echo(f"{change.name}: {_value(change.was)} -> {_value(change.now)}{edited}")
    click.echo(f"{file}: {_count_measurements(len(moved))} of {len(after.measurements)} updated, {build(after.side)}")
    changes = tuple(Moved(change.name, change.was, change.now) for change in moved)
    return 0, Updated(str(file), changes, len(after.measurements))


@baseline.command(epilog=_REVIEW_EXIT_CODES)
@documented("hiltest.comparison/1")
@click.argument("old", type=_PATH)
@click.argument("new", type=_PATH)
def review(old: Path, new: Path) -> tuple[int, Comparisons]:
    """List the changes from the baseline OLD to its later version NEW, with the reasons of accepted ones.

    In a job of GitHub Actions the list is also appended to the summary.
    """
    from hiltest.report.comparison_text import Comparisons, print_comparison
    from hiltest.report.console import standard_output
    from hiltest.report.job_summary import append_to_job_summary
    from hiltest.report.markdown import comparison_lines
    from hiltest.run_record.exit_codes import comparison_code
    from hiltest.verdict import compare
    from hiltest.verdict.baseline import evidence_from
    from hiltest.verdict.baseline_file import read_baseline

    before, after = (evidence_from(read_baseline(file), str(file), "") for file in (old, new))
    comparison = compare.review(before, after)
    print_comparison(standard_output(), comparison)
    page = "\n".join(comparison_lines(comparison, "Changes to the baseline")) + "\n"
    if remark := append_to_job_summary(page, new):
        click.echo(remark)
    return comparison_code(comparison), Comparisons([comparison], None)


def _existing_baseline(file: Path) -> Baseline | None:
    """Return the existing baseline; None without one."""
    from hiltest.verdict.baseline_file import read_baseline

    try:
        return read_baseline(file, to_replace=True)
    except ConfigError as error:
        if not (os.path.isfile(file) or os.path.isdir(file)):  # a new name, or a device, which stores nothing
            return None
        raise ConfigError(
            f"{file} exists, is not a baseline, and is not overwritten; remove it, or name another file"
        ) from error


def _write(written: Baseline, file: Path, before: object = None) -> None:
    from hiltest.run_record.files import write_asked_for
    from hiltest.verdict.baseline_file import to_json

    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        raise ConfigError(
            f"cannot write {file}: {getattr(error, 'strerror', None) or error}; name another file"
        ) from error
    write_asked_for(file, to_json(written, before))


def _value(value: float | None) -> str:
    return "none" if value is None else format_number(value, 6)


def _accepted_remark(was: BaselineRow | None, now: BaselineRow | None) -> str:
    """Return a remark on limit and tolerance that were accepted with a number; empty if they did not change."""
    from hiltest.verdict.wording import held_to

    if was is None or now is None:
        return ""
    words = f"; limit {was.limit or 'not stated'} -> {now.limit or 'none'}" if was.limit != now.limit else ""
    if now.tolerance is not None and was.tolerance not in (None, now.tolerance):
        words += f"; tolerance {held_to(was.tolerance, was.unit)} -> {held_to(now.tolerance, now.unit)}"
    return words


def _count_measurements(count: int) -> str:
    return f"{count} measurement{'s' * (count != 1)}"


def _seeds(saved: Baseline) -> str:
    if saved.conditions.board == "real":
        return format_count(len(saved.seeds), "run")
    seeds = [str(seed) for seed in saved.seeds if seed is not None]
    return f"seed{'s' * (len(seeds) != 1)} {', '.join(seeds)}" if seeds else "no seed"
