"""The first commit that is worse: ``git bisect run`` in a working tree of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from hiltest.errors import ConfigError, HiltestError
from hiltest.record.comparison import Comparison
from hiltest.record.exit_codes import ExitCode
from hiltest.runs.folders import sole_command
from hiltest.runs.judged_commit import (
    Bisection,
    Found,
    JudgedCommit,
    forget_judged,
    git,
    judge,
    judged_commits,
    without_git,
)
from hiltest.runs.older_firmware import last_words
from hiltest.runs.sent_bench import digest_of_bench
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence_reader import read_evidence

_TREE = "tree"


@dataclass(frozen=True, slots=True)
class FirstWorse:
    """The end of a bisection."""

    good: JudgedCommit
    bad: JudgedCommit
    """The two that it began with."""
    steps: tuple[JudgedCommit, ...]
    """Those between that were judged, in this order."""
    candidates: tuple[JudgedCommit, ...]
    """One of these is the first that is worse: just one, or all others among them were skipped. Newest first."""
    before: JudgedCommit
    """The nearest commit before all of these that is not worse."""
    against_good: Comparison
    against_before: Comparison
    """Of the newest candidate, which is worse."""

    @property
    def exit_code(self) -> ExitCode:
        """0 where there is one answer."""
        return ExitCode.OK if len(self.candidates) == 1 else ExitCode.NOT_EVALUATED

    @property
    def skipped(self) -> tuple[JudgedCommit, ...]:
        """Those that could not be judged, in this order."""
        return tuple(step for step in self.steps if step.found is Found.SKIPPED)


def first_worse(
    good: str, bad: str, build: Sequence[str], *, firmware: str, out: Path, options: Sequence[str],
    runs: Sequence[str] = (), measures: Sequence[str] = (),
) -> FirstWorse:
    """Find the first commit after a good one that is worse than it.

    Parameters
    ----------
    good, bad
        Commits, as git names them. The good one is an ancestor of the bad one.
    build
        Build command: one word for a shell, or a program and its arguments.
    firmware
        What it builds.
    out
        Folder of what is built and run, and remembered.
    options
        For pytest, of every run.
    runs
        Options of ``hiltest run`` for a campaign.
    measures
        Measurements that decide, ``*`` matches anything; all of them by default.

    Raises
    ------
    ConfigError
        If there is no such commit, the good one is not good, or the bad one not worse.
    """
    here = Path.cwd()
    prefix = git(str(here), "rev-parse", "--show-prefix")
    commits = [_commit(str(here), each) for each in (good, bad)]
    _check_order(str(here), good, bad, *commits)
    with sole_command(out), _working_tree(str(here), out.resolve() / _TREE, commits[0]) as tree:
        bisection = Bisection(
            str(here), str(tree), prefix, str(out.resolve()), tuple(build), firmware, tuple(options), tuple(runs),
            digest_of_bench((*options, *runs)), tuple(measures),
        )  # fmt: skip
        forget_judged(out)
        of_good = judge(bisection, "good: ")
        if of_good.found is not Found.NOT_WORSE:
            way_out = "" if measures else ", or the measurement to look at (--measure)"
            raise ConfigError(f"{of_good.name} is no good commit: {of_good.because}; name another{way_out}")
        bisection = replace(bisection, good=of_good.record)
        git(str(tree), "checkout", "--quiet", "--detach", commits[1])
        of_bad = judge(bisection, "bad: ")
        if of_bad.found is not Found.WORSE:
            what = "is not worse than" if of_bad.found is Found.NOT_WORSE else "cannot be compared with"
            raise ConfigError(f"{of_bad.name} {what} {of_good.name}: {of_bad.because}; name another bad commit")
        bisection.write()
        _bisect(bisection, *commits)
        return _end(bisection, of_good, of_bad)


def _commit(here: str, name: str) -> str:
    try:
        return git(here, "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}")
    except ConfigError as error:
        raise ConfigError(f"{name}: no commit of this repository has this name") from error


def _check_order(here: str, good: str, bad: str, of_good: str, of_bad: str) -> None:
    if of_good == of_bad:
        raise ConfigError(f"{good} and {bad} are one commit")
    base = ""
    with suppress(ConfigError):
        base = git(here, "merge-base", of_good, of_bad)
    if base != of_good:
        hint = f"; they have {base[:12]} in common, which may be a good one" if base and base != of_bad else ""
        hint = f"; {bad} is one of {good}: exchange them" if base == of_bad else hint
        raise ConfigError(f"{good} is no ancestor of {bad}{hint}")


@contextmanager
def _working_tree(here: str, tree: Path, commit: str) -> Iterator[Path]:
    """Check a commit out into a working tree beside the user's; its bisection is none of the user's either."""
    _remove(here, tree)  # an earlier command may have been killed
    if tree.exists():
        raise ConfigError(f"{tree} is in the way: it is no working tree of this repository; name another --out")
    git(here, "worktree", "add", "--quiet", "--force", "--detach", str(tree), commit)
    try:
        yield tree
    finally:
        _remove(here, tree)


def _remove(here: str, tree: Path) -> None:
    with suppress(ConfigError):
        git(here, "worktree", "remove", "--force", "--force", str(tree))


def _bisect(bisection: Bisection, good: str, bad: str) -> None:
    git(bisection.tree, "bisect", "start", bad, good)
    step = [sys.executable, "-m", "hiltest.runs.judged_commit", bisection.out]
    done = subprocess.run(
        ["git", "-C", bisection.tree, "bisect", "run", *step], stdout=subprocess.PIPE, text=True, errors="replace",
        check=False, env=without_git(),
    )  # fmt: skip
    left = _left(bisection)
    skipped = {each.commit for each in judged_commits(Path(bisection.out)) if each.found is Found.SKIPPED}
    if any(each not in skipped for each in left[1:]):
        raise HiltestError(f"git bisect run ended with {done.returncode}: {last_words(done.stdout)}; the same command "
                           f"goes on with what {bisection.out} has")  # fmt: skip


def _left(bisection: Bisection) -> list[str]:
    """Return the commits of which one is the first that is worse, newest first; the first of them is worse."""
    good = git(bisection.tree, "for-each-ref", "--format=^%(refname)", "refs/bisect/good-*").split()
    return git(bisection.tree, "rev-list", "--topo-order", "refs/bisect/bad", *good).split()


def _end(bisection: Bisection, of_good: JudgedCommit, of_bad: JudgedCommit) -> FirstWorse:
    judged = {judged_commit.commit: judged_commit for judged_commit in judged_commits(Path(bisection.out))}
    left = _left(bisection)
    first = judged[left[0]]
    parents = git(bisection.tree, "rev-parse", f"{left[-1]}^@").split()
    before = next((judged[each] for each in parents if each in judged and judged[each].found is Found.NOT_WORSE),
                  of_good)  # fmt: skip
    now = read_evidence(Path(first.record))
    against = [compare(read_evidence(Path(each.record)), now, together=True) for each in (of_good, before)]
    return FirstWorse(
        of_good, of_bad, tuple(judged.values())[2:], tuple(judged[each] for each in left), before, *against
    )
