"""One commit of a firmware: built, run on the bench, and compared with the good commit.

``git bisect run`` calls ``python -m hiltest.campaigns.judged_commit FOLDER`` in its working tree; the exit code is 0
for a commit that is not worse, 1 for one that is worse, and 125 for one that is skipped.
"""

from __future__ import annotations

import hashlib
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path

import click

from hiltest.errors import ConfigError, HiltestError, nearest_hint
from hiltest.json_files import adapter, json_line, read_as
from hiltest.processes import follow_parent, interrupt_by_signals
from hiltest.report.comparison_text import printable
from hiltest.run_record.comparison import Answer, Change, Comparison, Difference
from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.files import write_document
from hiltest.run_record.reader import read_record
from hiltest.session.older_firmware import UNCOVERED, UNJUDGED, last_words, run_command
from hiltest.text import join_words
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence_reader import read_evidence
from hiltest.verdict.wording import entry, reasons

_SETTINGS_FILE, _JUDGED_FILE = "bisection.json", "judged.jsonl"
_DIGITS = 12  # of a commit and of a digest: enough to distinguish any two of a repository
_NAMED_AT_MOST = 2
# A virtual board has no cable that could fail: the firmware hangs, faults, or speaks another protocol.
_ENDED_BY_FIRMWARE = (ExitCode.CONNECTION_LOST, ExitCode.WRONG_FIRMWARE)
# Variables of git for programs that it starts; they refer to its own working tree, and a build may use another one.
_OF_GIT = frozenset({"GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_PREFIX"})


class CommitResult(StrEnum):
    """Result for a commit."""

    NOT_WORSE = "not worse"
    WORSE = "worse"
    SKIPPED = "skipped"


CODES = {CommitResult.NOT_WORSE: 0, CommitResult.WORSE: 1, CommitResult.SKIPPED: 125}
"""Exit codes as ``git bisect run`` reads them."""


@dataclass(frozen=True, slots=True)
class JudgedCommit:
    """A commit and its comparison with the good one."""

    commit: str
    author: str
    author_date: str
    subject: str
    """Properties of the commit according to git; the date is in ISO 8601."""
    found: CommitResult
    because: str
    """Measurements that got worse, the reason why it was skipped, or the measurements that decided."""
    record: str
    """Folder of its run, relative to the command's folder; empty if nothing ran."""
    seconds: float
    """Time for building and running; 0 if both results were remembered."""

    @property
    def name(self) -> str:
        """Short hash and subject."""
        return f"{self.commit[:_DIGITS]} {printable(self.subject)}"


@dataclass(frozen=True, slots=True)
class Bisection:
    """Settings that are the same for all commits."""

    here: str
    """Folder of the command, whose ``hil/`` judges the firmware."""
    tree: str
    """Folder of the separate working tree."""
    prefix: str
    """Folder of the command inside the repository; empty at its root."""
    out: str
    """Folder of builds and runs."""
    build: tuple[str, ...]
    """Build command: one word for a shell, or a program and its arguments."""
    firmware: str
    """File that the build command makes, relative to the command's folder."""
    options: tuple[str, ...]
    """Options of pytest."""
    runs: tuple[str, ...]
    """Options of ``hiltest run`` for a campaign; empty for one run."""
    bench: str
    """Digest of everything else that a run depends on."""
    measures: tuple[str, ...] = ()
    """Names of the measurements that decide; ``*`` matches anything. Empty if all of them decide."""
    good: str = ""
    """Folder of the record of the good commit; empty before it was made."""

    def shown(self, path: Path) -> str:
        """Return a path as one would type it in the command's folder."""
        return str(path.relative_to(self.here)) if path.is_relative_to(self.here) else str(path)

    def write(self) -> None:
        """Write the settings for the processes that ``git bisect run`` starts."""
        write_document(Path(self.out) / _SETTINGS_FILE, self)


def read_bisection(out: Path) -> Bisection:
    """Read the settings that `Bisection.write` wrote."""
    return read_as(out / _SETTINGS_FILE, Bisection, otherwise="bisect again: hiltest bisect")


def git(tree: str, *arguments: str) -> str:
    """Return the output of git in a working tree, without the last line break.

    Raises
    ------
    ConfigError
        If git is missing, or fails.
    """
    try:
        done = subprocess.run(
            ["git", "-C", tree, *arguments],
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            env=environment_outside_git(),
        )
    except OSError as error:
        raise ConfigError(f"cannot start git: {error.strerror}; install it") from error
    if done.returncode:
        raise ConfigError(f"git {arguments[0]}: {last_words(done.stderr or done.stdout)}")
    return done.stdout.removesuffix("\n")


def environment_outside_git() -> dict[str, str]:
    """Return the environment without the variables that describe git's own working tree."""
    return {name: value for name, value in os.environ.items() if name not in _OF_GIT}


def judge(bisection: Bisection, say: str = "") -> JudgedCommit:
    """Build the commit that is checked out, run it, and compare it with the good commit.

    Parameters
    ----------
    say
        Text before the commit on its progress line.
    """
    commit, author, date, subject = git(bisection.tree, "show", "-s", "--format=%H%n%an%n%aI%n%s", "HEAD").split("\n")
    click.echo(f"{say}{commit[:_DIGITS]} {printable(subject)}", nl=False, err=True)
    began_s = time.monotonic()
    record, is_remembered = "", False
    try:
        elf, was_built = _build_firmware(bisection, commit)
        record, was_run, cut_short = _run(bisection, commit, elf)
        is_remembered = was_built and was_run
        if cut_short and not bisection.measures:
            result, because = CommitResult.WORSE, cut_short
        else:
            result, because = judge_comparison(_compare_with_good(bisection, record), bisection.measures)
    except _CannotBeJudged as error:
        result, because = CommitResult.SKIPPED, str(error)
    finally:
        _clean_tree(bisection.tree)
    took_s = 0.0 if is_remembered else time.monotonic() - began_s
    click.echo(f": {result}, {because}", nl=False, err=True)
    commit_result = JudgedCommit(commit, author, date, subject, result, because, record, round(took_s, 1))
    with (Path(bisection.out) / _JUDGED_FILE).open("a", encoding="utf-8") as file:
        file.write(json_line(asdict(commit_result)) + "\n")
    click.echo(" [remembered]" if is_remembered else f" [{took_s:.0f} s]", err=True)
    return commit_result


def judged_commits(out: Path) -> Iterator[JudgedCommit]:
    """Yield the commits that were judged since `forget_judged`, in this order."""
    for line in (out / _JUDGED_FILE).read_text(encoding="utf-8").splitlines():
        judged: JudgedCommit = adapter(JudgedCommit).validate_json(line)
        yield judged


def forget_judged(out: Path) -> None:
    """Empty the list of judged commits; builds and runs stay."""
    (out / _JUDGED_FILE).write_text("", encoding="utf-8")


def judge_comparison(comparison: Comparison, measures: Sequence[str]) -> tuple[CommitResult, str]:
    """Return whether a commit is worse than the good one, and the reason.

    Parameters
    ----------
    comparison
        Comparison of the commit with the good one.
    measures
        Names of the measurements that decide; ``*`` matches anything. Without any, a commit is worse if it may not be
        merged according to ``hiltest compare``.
    """
    if not measures:
        result = {Answer.NOT: CommitResult.WORSE, Answer.MAY: CommitResult.NOT_WORSE}.get(
            comparison.answer, CommitResult.SKIPPED
        )
        return result, ("it cannot be compared: " if result is CommitResult.SKIPPED else "") + reasons(comparison)
    if worse := worse_in(comparison, measures):
        return CommitResult.WORSE, join_words([entry(difference) for difference in worse], _NAMED_AT_MOST)
    named = {
        pattern: [difference for difference in comparison.differences if fnmatchcase(difference.name, pattern)]
        for pattern in measures
    }
    decide = {difference.name: difference for matches in named.values() for difference in matches}.values()
    seeds = len(comparison.base.seeds) or 1
    without = [
        pattern for pattern, matches in named.items() if not any(difference.seeds == seeds for difference in matches)
    ]
    without += [difference.name for difference in decide if difference.base is not None and difference.seeds < seeds]
    if without:
        names = [difference.name for difference in comparison.differences]
        why = next(iter((*comparison.obstacles, *comparison.failed)), nearest_hint(without[0], names))
        return CommitResult.SKIPPED, f"it has no value of {join_words(without, _NAMED_AT_MOST)}: {why}"
    return CommitResult.NOT_WORSE, join_words([entry(difference) for difference in decide], _NAMED_AT_MOST)


def worse_in(comparison: Comparison, measures: Sequence[str]) -> list[Difference]:
    """Return the measurements that got worse among those that decide, in order of concern."""
    worse = comparison.differences_with(Change.WORSE)
    return [
        difference
        for difference in worse
        if not measures or any(fnmatchcase(difference.name, pattern) for pattern in measures)
    ]


class _CannotBeJudged(Exception):
    """The commit does not build, or its run left no record."""


def _build_firmware(bisection: Bisection, commit: str) -> tuple[Path, bool]:
    """Return the firmware of a commit, and whether it was built by an earlier command."""
    key = hashlib.sha256(repr((bisection.build, bisection.prefix, bisection.firmware)).encode()).hexdigest()
    saved = Path(bisection.out) / "builds" / f"{commit[:_DIGITS]}-{key[:_DIGITS]}{Path(bisection.firmware).suffix}"
    if saved.is_file():
        return saved, True
    saved.parent.mkdir(exist_ok=True)
    folder = Path(bisection.tree) / bisection.prefix
    output_file, log = folder / bisection.firmware, saved.with_suffix(".log")
    if not folder.is_dir():
        raise _CannotBeJudged(f"it has no folder {bisection.prefix}")
    if not git(bisection.tree, "ls-files", "--", str(output_file)):
        output_file.unlink(missing_ok=True)  # a file that another commit built must not pass for this one's
    shell = len(bisection.build) == 1
    with log.open("wb") as output:
        try:
            code = subprocess.run(
                bisection.build[0] if shell else bisection.build,
                shell=shell,
                cwd=folder,
                check=False,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment_outside_git(),
            ).returncode
        except OSError as error:
            raise _CannotBeJudged(f"its build does not start: {bisection.build[0]}: {error.strerror}") from error
    if code:
        raise _CannotBeJudged(f"it does not build: {_complaint(log)} ({bisection.shown(log)})")
    if not output_file.is_file():
        raise _CannotBeJudged(f"its build does not write {bisection.firmware} ({bisection.shown(log)})")
    unfinished = saved.with_suffix(".unfinished")
    shutil.copyfile(output_file, unfinished)
    unfinished.replace(saved)
    return saved, False


def _complaint(log: Path) -> str:
    """Return the first line of a build's output that mentions an error, or else the last line."""
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return printable(next((line for line in lines if "error" in line.lower()), lines[-1] if lines else "no output"))


def _run(bisection: Bisection, commit: str, firmware: Path) -> tuple[str, bool, str]:
    """Run a firmware, unless an earlier run of it is saved.

    Returns
    -------
    record : str
        Folder of the run.
    was_run : bool
        True if it was run by an earlier command.
    cut_short : str
        Last output of firmware that hangs, faults or is another one; empty if the run finished.
    """
    digest = hashlib.sha256(firmware.read_bytes()).hexdigest()
    folder = Path(bisection.out) / "runs" / f"{digest[:_DIGITS]}-{bisection.bench[:_DIGITS]}"
    if _has_whole_record(folder):
        return bisection.shown(folder), True, ""
    options = (
        *bisection.options,
        f"--hil-firmware={firmware}",
        f"--hil-label={commit[:_DIGITS]}",
        *UNJUDGED,
        *UNCOVERED,
    )
    done = run_command(
        *bisection.runs,
        f"--out={folder}",
        "--",
        *options,
        folder=folder,
        cwd=Path(bisection.here),
        environment=environment_outside_git(),
    )
    if done.returncode in (ExitCode.CUT_SHORT, ExitCode.INTERRUPTED):
        raise KeyboardInterrupt
    last_line = printable(last_words(done.stderr or done.stdout).removeprefix("ERROR: "))
    if done.returncode in _ENDED_BY_FIRMWARE:
        return bisection.shown(folder), False, _sentence(folder) or last_line
    if not _has_whole_record(folder):
        raise _CannotBeJudged(f"it does not run: {_sentence(folder) or last_line}")
    return bisection.shown(folder), False, ""


def _sentence(folder: Path) -> str:
    """Return the verdict of a run; empty without one."""
    with suppress(ConfigError):
        return read_record(folder).run.verdict.sentence
    return ""


def _has_whole_record(folder: Path) -> bool:
    with suppress(ConfigError):
        return folder.is_dir() and not read_evidence(folder).faults
    return False


def _compare_with_good(bisection: Bisection, record: str) -> Comparison:
    """Compare with the good commit; both ran on one bench, so compilers and flags may differ."""
    folder = Path(bisection.here)
    return compare(read_evidence(folder / (bisection.good or record)), read_evidence(folder / record), together=True)


def _clean_tree(tree: str) -> None:
    """Undo the build's changes to tracked files, and remove files that are neither tracked nor ignored."""
    git(tree, "reset", "--hard", "--quiet")
    git(tree, "clean", "-ffdq")


def _progress(bisection: Bisection) -> str:
    """Return the number of the step, and the estimated remaining time."""
    before = list(judged_commits(Path(bisection.out)))  # begins with the good and the bad commit
    good = git(bisection.tree, "for-each-ref", "--format=^%(refname)", "refs/bisect/good-*").split()
    variables = dict(
        line.split("=", 1)
        for line in git(bisection.tree, "rev-list", "--bisect-vars", "refs/bisect/bad", *good).splitlines()
    )
    remaining = int(variables["bisect_steps"]) + 1
    done = len(before) - 1
    took_s = [judged.seconds for judged in before if judged.seconds and judged.record]
    mean_s = sum(took_s) / len(took_s) if took_s else math.nan
    time_left = f", {_format_duration(mean_s * remaining)} left" if took_s else ""
    return f"step {done} of about {done - 1 + remaining}{time_left}: "


def _format_duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"


def main(out: Path) -> int:
    """Judge the commit that git has checked out; exit codes from 128 on belong to no commit, and end the bisection."""
    interrupt_by_signals()
    follow_parent()
    try:
        bisection = read_bisection(out)
        return CODES[judge(bisection, _progress(bisection)).found]
    except HiltestError as error:
        click.echo(f"ERROR: {error}", err=True)
        return 255
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
