"""Search for the first commit that is worse: ``git bisect run`` in a separate working tree."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from hiltest.campaigns.judged_commit import (
    Bisection,
    CommitResult,
    JudgedCommit,
    environment_outside_git,
    forget_judged,
    git,
    judge,
    judged_commits,
)
from hiltest.campaigns.sent_bench import digest_of_bench
from hiltest.errors import ConfigError, HiltestError
from hiltest.processes import run_child
from hiltest.run_record.comparison import Comparison
from hiltest.run_record.exit_codes import ExitCode
from hiltest.session.older_firmware import last_words
from hiltest.session.record_folder import sole_command
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence_reader import read_evidence

_TREE = "tree"


@dataclass(frozen=True, slots=True)
class FirstWorse:
    """Result of a bisection."""

    good: JudgedCommit
    bad: JudgedCommit
    """The two commits that the bisection began with."""
    steps: tuple[JudgedCommit, ...]
    """Commits in between that were judged, in order."""
    candidates: tuple[JudgedCommit, ...]
    """One of these is the first commit that is worse; if there are several, the others were skipped. Newest first."""
    before: JudgedCommit
    """Nearest commit before the candidates that is not worse."""
    against_good: Comparison
    against_before: Comparison
    """Comparisons of the newest candidate, which is worse."""

    @property
    def exit_code(self) -> ExitCode:
        """0 if there is one answer."""
        return ExitCode.OK if len(self.candidates) == 1 else ExitCode.NOT_EVALUATED

    @property
    def skipped(self) -> tuple[JudgedCommit, ...]:
        """Commits that could not be judged, in order."""
        return tuple(step for step in self.steps if step.found is CommitResult.SKIPPED)


def first_worse(
    good: str,
    bad: str,
    build: Sequence[str],
    *,
    firmware: str,
    out: Path,
    options: Sequence[str],
    runs: Sequence[str] = (),
    measures: Sequence[str] = (),
) -> FirstWorse:
    """Find the first commit that made a measurement worse than at a good one.

    Parameters
    ----------
    good, bad
        Commits, as git names them. The good commit is an ancestor of the bad one.
    build
        Build command: one word for a shell, or a program and its arguments.
    firmware
        File that the build command makes.
    out
        Folder of builds, runs and the saved progress.
    options
        Options of pytest for every run.
    runs
        Options of ``hiltest run`` for a campaign.
    measures
        Measurements that decide; ``*`` matches anything. All of them by default.

    Raises
    ------
    ConfigError
        If no such commit exists, the good commit is not good, or the bad one is not worse.
    """
    folder = Path.cwd()
    prefix = git(str(folder), "rev-parse", "--show-prefix")
    commits = [_commit(str(folder), name) for name in (good, bad)]
    _check_order(str(folder), good, bad, *commits)
    with sole_command(out), _working_tree(str(folder), out.resolve() / _TREE, commits[0]) as tree:
        bisection = Bisection(
            str(folder),
            str(tree),
            prefix,
            str(out.resolve()),
            tuple(build),
            firmware,
            tuple(options),
            tuple(runs),
            digest_of_bench((*options, *runs)),
            tuple(measures),
        )
        forget_judged(out)
        good_commit = judge(bisection, "good: ")
        if good_commit.found is not CommitResult.NOT_WORSE:
            way_out = "" if measures else ", or the measurement to judge (--measure)"
            raise ConfigError(f"{good_commit.name} is not a good commit: {good_commit.because}; name another{way_out}")
        bisection = replace(bisection, good=good_commit.record)
        git(str(tree), "checkout", "--quiet", "--detach", commits[1])
        bad_commit = judge(bisection, "bad: ")
        if bad_commit.found is not CommitResult.WORSE:
            relation = "is not worse than" if bad_commit.found is CommitResult.NOT_WORSE else "cannot be compared with"
            raise ConfigError(
                f"{bad_commit.name} {relation} {good_commit.name}: {bad_commit.because}; name another bad commit"
            )
        bisection.write()
        _bisect(bisection, *commits)
        return _conclude(bisection, good_commit, bad_commit)


def _commit(folder: str, name: str) -> str:
    try:
        return git(folder, "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}")
    except ConfigError as error:
        raise ConfigError(f"{name}: this repository has no such commit") from error


def _check_order(folder: str, good: str, bad: str, good_commit: str, bad_commit: str) -> None:
    if good_commit == bad_commit:
        raise ConfigError(f"{good} and {bad} are the same commit")
    base = ""
    with suppress(ConfigError):
        base = git(folder, "merge-base", good_commit, bad_commit)
    if base != good_commit:
        hint = f"; try their common ancestor {base[:12]}" if base and base != bad_commit else ""
        hint = f"; {bad} is an ancestor of {good}: exchange them" if base == bad_commit else hint
        raise ConfigError(f"{good} is not an ancestor of {bad}{hint}")


@contextmanager
def _working_tree(folder: str, tree: Path, commit: str) -> Iterator[Path]:
    """Check a commit out into a working tree beside the user's, so that its bisection is separate, too."""
    _remove(folder, tree)  # an earlier command may have been killed
    if tree.exists():
        raise ConfigError(f"{tree} exists and is not a working tree of this repository; name another --out")
    git(folder, "worktree", "add", "--quiet", "--force", "--detach", str(tree), commit)
    try:
        yield tree
    finally:
        _remove(folder, tree)


def _remove(folder: str, tree: Path) -> None:
    with suppress(ConfigError):
        git(folder, "worktree", "remove", "--force", "--force", str(tree))


def _bisect(bisection: Bisection, good: str, bad: str) -> None:
    git(bisection.tree, "bisect", "start", bad, good)
    step = [sys.executable, "-m", "hiltest.campaigns.judged_commit", bisection.out]
    command = ["git", "-C", bisection.tree, "bisect", "run", *step]
    done = run_child(command, environment=environment_outside_git(), shows_errors=True)
    remaining = _remaining_commits(bisection)
    skipped = {judged.commit for judged in judged_commits(Path(bisection.out)) if judged.found is CommitResult.SKIPPED}
    if any(commit not in skipped for commit in remaining[1:]):
        raise HiltestError(
            f"git bisect run ended with {done.returncode}: {last_words(done.stdout)}; repeat the command to continue "
            f"with the results in {bisection.out}"
        )


def _remaining_commits(bisection: Bisection) -> list[str]:
    """Return the commits of which one is the first that is worse, newest first; the newest one is worse."""
    good = git(bisection.tree, "for-each-ref", "--format=^%(refname)", "refs/bisect/good-*").split()
    return git(bisection.tree, "rev-list", "--topo-order", "refs/bisect/bad", *good).split()


def _conclude(bisection: Bisection, good_commit: JudgedCommit, bad_commit: JudgedCommit) -> FirstWorse:
    judged = {judged_commit.commit: judged_commit for judged_commit in judged_commits(Path(bisection.out))}
    remaining = _remaining_commits(bisection)
    first = judged[remaining[0]]
    parents = git(bisection.tree, "rev-parse", f"{remaining[-1]}^@").split()
    judged_parents = (judged[parent] for parent in parents if parent in judged)
    before = next((parent for parent in judged_parents if parent.found is CommitResult.NOT_WORSE), good_commit)
    now = read_evidence(Path(first.record))
    against = [compare(read_evidence(Path(base.record)), now, together=True) for base in (good_commit, before)]
    candidates = tuple(judged[commit] for commit in remaining)
    return FirstWorse(good_commit, bad_commit, tuple(judged.values())[2:], candidates, before, *against)
