"""A comparison in words: the numbers of one measurement, and all of it in one sentence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import PurePath
from shlex import quote

from hiltest.measurement import EXACT, Outcome, Tolerance, is_direction
from hiltest.run_record.comparison import Answer, BaseKind, Change, Comparison, Difference, Revision, Side
from hiltest.text import format_count, format_number, join_words
from hiltest.verdict.evidence import Seed

SHOWN = (Change.WORSE, Change.GONE, Change.BETTER, Change.NEW, Change.CHANGED)
"""Changes that are listed, in this order; unchanged measurements and those not taken are only counted."""

_NAMED_AT_MOST = 2
_COMMIT_DIGITS = 12  # enough to distinguish any two commits of a repository
_SEEDS_AT_MOST = 3
_MOST_PERCENT = 1000.0
"""Larger percentages are cut: with a base near zero they say nothing, and the difference is shown as well."""


def revision(source: Revision | None) -> str:
    """Return the known parts of the sources of a run: label, commit and branch.

    Examples
    --------
    ``v1.2-rc1, commit 0123456789ab, branch main``
    """
    if source is None:
        return ""
    commit = f"commit {source.commit[:_COMMIT_DIGITS]}" if source.commit else ""
    return ", ".join(filter(None, (source.label, commit, f"branch {source.branch}" if source.branch else "")))


def build(side: Side) -> str:
    """Return the build of the numbers of a side; a baseline may contain several.

    Examples
    --------
    ``build 8fc8, with 2 measurements accepted from build 17ab and 1 measurement accepted from build 90cd``
    """
    accepted = [
        f"{part.measurements} measurement{'s' * (part.measurements != 1)} accepted from build {part.build_id}"
        for part in side.accepted
    ]
    of_firmware = f"build {side.build_id}" if side.build_id else "no firmware"
    return of_firmware + (f", with {' and '.join(accepted)}" if accepted else "")


def numbers(difference: Difference) -> str:
    """Return a measurement's value before and now, the change, and its limit.

    Examples
    --------
    ``11 061 -> 11 161 cycles (+100, +0.9 %; limit at most 12 500)``
    """
    was, now = (format_number(value) for value in (difference.base, difference.new))
    if difference.base is None or difference.new is None:
        values = was if difference.new is None else now
    else:
        values = f"{was} -> {now}"
    details = "; ".join(filter(None, (moved(difference), _limit(difference), difference.note)))
    return f"{values} {_plural_unit(difference.unit)}".rstrip() + (f" ({details})" if details else "")


def held_to(tolerance: Tolerance, unit: str) -> str:
    """Return how far a measurement may move and still count as unchanged.

    Examples
    --------
    ``0.01 deg and 1 %``, or ``exact``
    """
    absolute = f"{format_number(tolerance.absolute)} {_plural_unit(unit)}".rstrip() if tolerance.absolute else ""
    relative = f"{100.0 * tolerance.relative:g} %" if tolerance.relative else ""
    return " and ".join(filter(None, (absolute, relative))) or "exact"


def seen_from(difference: Difference) -> str:
    """Return the smallest change in degrees that the comparison detects in 4 of 5 cases; empty for any other unit.

    Examples
    --------
    ``seen from 0.0123 deg on``
    """
    if not difference.seen or difference.unit != "deg":
        return ""
    return f"seen from {format_number(difference.seen, 3)} deg on"


def entry(difference: Difference) -> str:
    """Return a measurement's name and numbers; for a changed setting of a sensor the change in words."""
    return difference.note if difference.is_changed_setting else f"{difference.name} {numbers(difference)}"


def moved(difference: Difference) -> str:
    """Return by how much a measurement moved, in its unit and as a multiple of its tolerance; empty without a pair.

    If the tolerance is exact, the multiple is replaced by a percentage of the base.
    """
    if difference.delta is None:
        return ""
    words = _format_signed(difference.delta)
    share = moved_percent(difference)
    if difference.tolerance != EXACT:
        words += (
            f", {format_number(difference.weight, 2)} times its tolerance" if math.isfinite(difference.weight) else ""
        )
    elif share is not None and abs(share) <= _MOST_PERCENT and (difference.base or 0.0) * (difference.new or 0.0) > 0:
        words += f", {percent(share)}"
    if difference.interval is not None:
        low, high = difference.interval
        words += f", 95 % {_format_signed(low)} to {_format_signed(high)}"
    return words


def moved_percent(difference: Difference) -> float | None:
    """Return the change in percent of the base; None without a number, with a base of 0, and for a direction."""
    if difference.delta is None or not difference.base or is_direction(difference.name):
        return None
    return 100.0 * difference.delta / abs(difference.base)


def sentence(comparison: Comparison) -> str:
    """Return a comparison in one sentence: the answer, the base, and the reasons."""
    return f"{answer_in_words(comparison)}: {reasons(comparison)}."


def review_sentence(comparison: Comparison) -> str:
    """Return the comparison of a baseline with its next version in one sentence, which says nothing about a run."""
    if comparison.evaluated and not shown(comparison):
        return "The baseline is unchanged."
    answers = {Answer.MAY: "accepted", Answer.NOT: "not accepted", Answer.UNKNOWN: "not evaluated"}
    return f"The changes to the baseline are {answers[comparison.answer]}: {reasons(comparison)}."


def answer_in_words(comparison: Comparison) -> str:
    """Return the answer and the base.

    Examples
    --------
    ``Not to be merged (against base.json)``, or
    ``May be merged as far as the gate set shows, without 11 tests of the full set (against base.json)``
    """
    extent = ""
    if comparison.answer is Answer.MAY and (comparison.chosen or comparison.tests_left_out):
        extent = " as far as the chosen tests show" if comparison.chosen else " as far as the gate set shows"
        if comparison.tests_left_out:
            extent += f", without {format_count(comparison.tests_left_out, 'test')} of the full set"
    return f"{comparison.answer.capitalize()}{extent} (against {comparison.base.file})"


def reasons(comparison: Comparison, *, beside_failures: bool = False) -> str:
    """Return the reasons of a comparison's answer: failures, obstacles, and changes.

    Parameters
    ----------
    beside_failures
        True if they follow the run's own failures: these are not repeated, and changes are only counted.
    """
    if beside_failures:
        parts = [_first_obstacle(comparison), *_counts(comparison, named=False)]
        return "; ".join(filter(None, parts)) or "nothing measured"
    worse = (
        {entry(difference) for difference in comparison.differences_with(Change.WORSE)}
        if comparison.evaluated
        else set()
    )
    parts = [
        _name_first("failed: ", [text for text in comparison.failed if text not in worse]),
        _first_obstacle(comparison),
        _name_first("not evaluated: ", comparison.unjudged),
        *_counts(comparison),
    ]
    return "; ".join(filter(None, parts)) or "nothing measured"


def counted_by(models: Iterable[str]) -> str:
    """Return the cycle models of the cycles that are shown; empty without any.

    Examples
    --------
    >>> counted_by(["silicon-dwt", "", "cortex-m4-trm/3@sram", "silicon-dwt"])
    'cycles counted by cortex-m4-trm/3@sram and silicon-dwt'
    """
    names = model_names(models)
    return f"cycles counted by {names}" if names else ""


def model_names(models: Iterable[str]) -> str:
    """Return each cycle model once; empty without any."""
    return " and ".join(sorted(set(filter(None, models))))


def models_shown(comparison: Comparison) -> set[str]:
    """Return the cycle models of all cycles that a comparison shows: of changes, and of values out of a limit."""
    return {diff.cycle_model for diff in comparison.differences if diff.change in SHOWN or diff.outcome == Outcome.FAIL}


def format_seeds(seeds: Sequence[Seed]) -> str:
    """Return seeds in words."""
    return f" on seed {join_words([str(seed) for seed in seeds], _SEEDS_AT_MOST)}"


def shown(comparison: Comparison) -> list[tuple[Change, tuple[Difference, ...]]]:
    """Return the groups that are shown, in order, without empty ones."""
    groups = [(change, comparison.differences_with(change)) for change in SHOWN]
    return [(change, differences) for change, differences in groups if differences]


def percent(value: float) -> str:
    """Return a percentage with two digits, or all before the point; beyond a thousand only a bound."""
    if abs(value) > _MOST_PERCENT or not math.isfinite(value):
        return f"beyond {_format_signed(math.copysign(_MOST_PERCENT, value))} %"
    return f"{value:+.2g} %" if abs(value) < 99.5 else f"{_format_signed(round(value))} %"


def _first_obstacle(comparison: Comparison) -> str:
    if not comparison.obstacles:
        return ""
    more = len(comparison.obstacles) - 1
    others = f" (and {more} more reason{'s' * (more > 1)})" if more else ""
    not_compared = "" if comparison.answer is Answer.UNKNOWN else "not compared: "
    return f"{not_compared}{comparison.obstacles[0].rstrip('.')}{others}"


def _counts(comparison: Comparison, *, named: bool = True) -> list[str]:
    """Return the number of measurements for each change, and name the first that got worse and better."""
    # Measurements that are gone are among the reasons if the comparison was not evaluated.
    without = () if comparison.evaluated else (Change.GONE,)
    kinds = [change for change in (*SHOWN, Change.NOT_TAKEN, Change.UNCHANGED) if change not in without]
    groups = [(change, group) for change in kinds if (group := comparison.differences_with(change))]
    counts = [_count_and_names(change, group) if named else f"{len(group)} {change}" for change, group in groups]
    return [f"apart from that {counts[0]}", *counts[1:]] if comparison.obstacles and counts else counts


def _count_and_names(change: Change, differences: Sequence[Difference]) -> str:
    count = f"{len(differences)} {change}"
    return (
        _name_first(f"{count}: ", [entry(difference) for difference in differences])
        if change in (Change.WORSE, Change.BETTER)
        else count
    )


def _name_first(before: str, texts: Sequence[str]) -> str:
    return f"{before}{join_words(texts, _NAMED_AT_MOST)}" if texts else ""


def _format_signed(value: float) -> str:
    return f"{'+' if value >= 0 else '-'}{format_number(abs(value))}"


def _plural_unit(unit: str) -> str:
    return "cycles" if unit == "cycle" else unit


def _limit(difference: Difference) -> str:
    return "" if difference.limit is None else f"limit {difference.limit}"


def how_to_keep(comparison: Comparison, run: str, options: str | None = None) -> str:
    """Return the command that accepts the improvements into the base, in one line.

    Parameters
    ----------
    run
        Path of the new run, quoted for a shell.
    options
        Options that make ``hiltest run`` run the same on other seeds, quoted for a shell; None if unknown, since a
        record does not name its files.

    Returns
    -------
    str
        Empty if nothing got better, the change must not be merged, or the base is an older firmware's ELF: the
        next run is then compared with this firmware.
    """
    better = comparison.differences_with(Change.BETTER)
    if not better or comparison.answer is not Answer.MAY or comparison.base_kind is BaseKind.TOGETHER:
        return ""
    count = f"{len(better)} better; keep {'them' if len(better) > 1 else 'it'}: "
    if comparison.base_kind is BaseKind.RUN:
        save = f"{count}hiltest baseline save {quote(run)} FILE, and --baseline FILE from then on"
        return "" if comparison.chosen else save
    first, accepted_run = _all_seeds(comparison, run, options)
    names = " ".join(f"--accept {quote(difference.name)}" for difference in better)
    return f"{count}{first}hiltest baseline update {quote(comparison.base.file)} {accepted_run} {names} --because TEXT"


def _all_seeds(comparison: Comparison, run: str, options: str | None) -> tuple[str, str]:
    """Return the command to run first if a seed of the baseline is missing, and the folder to accept from.

    A mean over some of the seeds says nothing. The campaign gets a folder of its own: in the run's folder it would
    replace the record that was just compared.
    """
    seeds = comparison.base.seeds
    if not set(seeds) - set(comparison.new.seeds):
        return "", quote(run)
    as_before, out = ("OPTIONS", "DIR") if options is None else (options, quote(str(PurePath(run) / "seeds")))
    command = " ".join(filter(None, ("hiltest run", as_before, f"--seeds {min(seeds)}..{max(seeds)} --out {out}")))
    action = "run its seeds"
    action += f" with the OPTIONS of the run {quote(run)}" if options is None else ""
    return f"{action}, {command}, then ", out
