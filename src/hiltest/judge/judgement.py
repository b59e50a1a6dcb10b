"""Numbers of judged entries, with their confidence intervals, and limits on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from statistics import fmean, median, stdev

from hiltest import __version__
from hiltest.errors import ConfigError, nearest_hint
from hiltest.judge.answers import Answer, Entry, Outcome, Rating, rate
from hiltest.judge.filter_scores import FilterResult
from hiltest.judge.worlds import DEFAULT_CLOUDS, FAMILIES, HALF_SPHERE, RIG, World, draw_worlds
from hiltest.measurement.estimates import CONFIDENCE, Estimate, quantile
from hiltest.text import format_count

ALL = "all"
"""Name of the row over all families."""
_P99 = 0.99
_BESIDE = "direct"  # the calibrator of ours whose errors the sentence names
_NORMAL = 1.96  # standard deviations on each side that 95 % are within
_DIGITS = 6  # degrees and ratios are the same on every host to this many


@dataclass(frozen=True, slots=True)
class FamilyResult:
    """An entry in the worlds of one family."""

    family: str
    worlds: int
    refused: int
    no_ellipsoid: int
    """Number of answers that are not finite, singular or mirrored."""
    rms: Estimate | None
    median: Estimate | None
    p99: Estimate | None
    """Heading errors of accepted answers as multiples of the Cramér-Rao bound, root mean square and quantiles over
    worlds; None if there are none. The root mean square of an efficient calibrator is 1."""
    worst_deg: Estimate | None
    """Median over worlds of the largest heading error at the poses, of means of 16 samples [deg]."""
    refused_deg: float | None
    """Median rms heading error that refused calibrations would have had [deg]; None if there were none."""

    @property
    def unanswered(self) -> int:
        """Number of worlds without an accepted answer."""
        return self.refused + self.no_ellipsoid


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of a calibration."""

    cycles: int | None
    low: int | None
    high: int | None
    """Cycles of 100 points of the default rig, and their uncertainty range."""
    most_cycles: int | None
    """Most cycles in any world."""
    stack_bytes: int | None
    flash_bytes: int | None
    host_us: float | None
    """Median time on the host over the worlds of the default rig; it depends on the host [us]."""


@dataclass(frozen=True, slots=True)
class EntryResult:
    """Result of one entry."""

    name: str
    role: str
    """``judged``, ``against`` or ``hiltest``."""
    built_by: str
    """Compiler and flags; counts of different compilers are not ranked."""
    cycle_model: str
    cost: Cost
    families: tuple[FamilyResult, ...]
    """One for each family, and one for all together."""

    def family(self, name: str) -> FamilyResult:
        """Return the result in a family."""
        return next(result for result in self.families if result.family == name)

    @property
    def rank_error(self) -> float:
        """Larger error of the two default clouds as a multiple of the bound, by which entries are ranked.

        It is infinite if more than half of the worlds of one of them have no accepted answer.
        """
        clouds = map(self.family, DEFAULT_CLOUDS)
        return max(
            cloud.rms.value if cloud.rms and 2 * cloud.unanswered <= cloud.worlds else math.inf for cloud in clouds
        )


@dataclass(frozen=True, slots=True)
class LimitResult:
    """A limit, and whether the judged entry is within it."""

    name: str
    most: float
    value: float | None
    """None if it was not measured; the limit is then not evaluated."""

    @property
    def holds(self) -> bool | None:
        return None if self.value is None else self.value <= self.most


@dataclass(frozen=True, slots=True)
class Comparison:
    """Errors and cycles of the judged entry, relative to those of another one in the same worlds."""

    error: Estimate | None
    """Median ratio of the rms heading errors over all worlds; None if no world has an answer of both."""
    families: dict[str, Estimate]
    """The same over each family in which both answer; all of these intervals hold together at 95 % confidence."""
    cycles: float | None
    """Ratio of the cycles; None if compilers or cycle models differ."""
    more_refused: int

    @property
    def is_worse(self) -> bool:
        ratios = [*self.families.values(), *([self.error] if self.error else [])]
        errs_more = any(ratio.low is not None and ratio.low > 1.0 for ratio in ratios)
        return errs_more or (self.cycles or 1.0) > 1.0 or self.more_refused > 0


@dataclass(frozen=True, slots=True)
class JudgeDocument:
    """Result of `hiltest judge`."""

    hiltest: str
    sentence: str
    exit_code: int
    entries: tuple[EntryResult, ...]
    """The judged one first."""
    limits: tuple[LimitResult, ...]
    comparison: Comparison | None
    """Comparison with ``--against``; null without."""
    filters: tuple[FilterResult, ...] = ()
    """Filters, the judged one first; empty for a calibrator."""


@dataclass(frozen=True, slots=True)
class Judged:
    """An entry with its ratings, by family, in the order of the worlds."""

    result: EntryResult
    ratings: Mapping[str, Sequence[Rating]]


def judge(entry: Entry, role: str, tell: Callable[[World], None] = lambda _world: None) -> Judged:
    """Judge an entry in all worlds.

    Parameters
    ----------
    tell
        Is called before each world.
    """
    answers: dict[str, list[Answer]] = {}
    ratings: dict[str, list[Rating]] = {}
    for family in FAMILIES:
        for world in draw_worlds(family):
            tell(world)
            answer = entry.answer(world)
            answers.setdefault(family.name, []).append(answer)
            ratings.setdefault(family.name, []).append(rate(answer, world))
    families = [_family_result(name, rated) for name, rated in ratings.items()]
    families.append(_family_result(ALL, list(chain(*ratings.values()))))
    cost = _cost(entry, answers[RIG], list(chain(*answers.values())))
    return Judged(EntryResult(entry.name, role, entry.built_by, entry.cycle_model, cost, tuple(families)), ratings)


def _family_result(name: str, ratings: Sequence[Rating]) -> FamilyResult:
    accepted = [rating for rating in ratings if rating.outcome is Outcome.ACCEPTED]
    refused = [rating for rating in ratings if rating.outcome is Outcome.REFUSED]
    over_bound = [rating.over_bound for rating in accepted if rating.over_bound is not None]
    would_be = [rating.rms_deg for rating in refused if rating.rms_deg is not None]
    return FamilyResult(
        name,
        len(ratings),
        len(refused),
        sum(rating.outcome is Outcome.NO_ELLIPSOID for rating in ratings),
        root_mean_square(over_bound),
        _quantile(over_bound, 0.5),
        _quantile(over_bound, _P99),
        _quantile([rating.worst_deg for rating in accepted if rating.worst_deg is not None], 0.5),
        round(median(would_be), _DIGITS) if would_be else None,
    )


def _cost(entry: Entry, of_rig: Sequence[Answer], answers: Sequence[Answer]) -> Cost:
    first = of_rig[0]
    times = [answer.host_us for answer in of_rig if answer.host_us is not None]
    stacks = [answer.stack_bytes for answer in answers if answer.stack_bytes is not None]
    counts = [answer.cycles for answer in answers if answer.cycles is not None]
    band = first.band
    return Cost(
        first.cycles,
        band.low if band else None,
        band.high if band else None,
        max(counts, default=None),
        max(stacks, default=None),
        entry.flash_bytes,
        round(median(times), 1) if times else None,
    )


def root_mean_square(values: Sequence[float]) -> Estimate | None:
    """Return the root mean square with its interval, from the deviation of the squares; None without values."""
    if not values:
        return None
    squares = [value * value for value in values]
    rms = math.sqrt(fmean(squares))
    if len(squares) < 2 or rms == 0.0:  # a deviation needs two
        return Estimate(rms, None, None).rounded(_DIGITS)
    half = _NORMAL * stdev(squares) / math.sqrt(len(squares)) / (2.0 * rms)
    return Estimate(rms, max(rms - half, 0.0), rms + half).rounded(_DIGITS)


def _quantile(values: Sequence[float], share: float) -> Estimate | None:
    return quantile(values, share).rounded(_DIGITS) if values else None


def compare(judged: Judged, against: Judged) -> Comparison:
    """Compare two entries in the same worlds."""
    logs = {
        family: [
            math.log(mine.rms_deg / other.rms_deg)
            for mine, other in zip(rated, against.ratings[family], strict=True)
            if mine.outcome is other.outcome is Outcome.ACCEPTED and mine.rms_deg and other.rms_deg
        ]
        for family, rated in judged.ratings.items()
    }
    one_of_all = 1.0 - (1.0 - CONFIDENCE) / len(logs)
    families = {family: _median_ratio(ratios, one_of_all) for family, ratios in logs.items() if ratios}
    every = list(chain(*logs.values()))
    error = _median_ratio(every, CONFIDENCE) if every else None
    new, old = judged.result, against.result
    can_rank = ranks_with(new, old) and new.cost.cycles and old.cost.cycles
    cycles = (new.cost.cycles or 0) / (old.cost.cycles or 1) if can_rank else None
    return Comparison(error, families, cycles, new.family(ALL).unanswered - old.family(ALL).unanswered)


def _median_ratio(logs: Sequence[float], confidence: float) -> Estimate:
    median_log = quantile(logs, 0.5, confidence)
    low, high = (None if end is None else math.exp(end) for end in (median_log.low, median_log.high))
    return Estimate(math.exp(median_log.value), low, high)


def ranks_with(one: EntryResult | FilterResult | Entry, other: EntryResult | FilterResult | Entry) -> bool:
    """Return whether the cycles of two entries can be ranked: one cycle model, and one compiler that is known."""
    compilers = [compiler_in(entry.built_by) for entry in (one, other)]
    return one.cycle_model == other.cycle_model and compilers[0] == compilers[1] != ""


def compiler_in(built_by: str) -> str:
    """Return a compiler and its version from a text such as ``arm-none-eabi-gcc 12.2.1 -O2``."""
    words = built_by.split()
    return " ".join(words[:2]) if len(words) > 1 and words[1][:1].isdigit() else ""


def limit_values(result: EntryResult) -> dict[str, float | None]:
    """Return the values that limits may name."""
    values: dict[str, float | None] = {}
    for family in result.families:
        prefix = "bound" if family.family == ALL else f"bound.{family.family}"
        values[f"{prefix}.rms"] = family.rms.value if family.rms else None
        values[f"{prefix}.median"] = family.median.value if family.median else None
        values[f"{prefix}.p99"] = family.p99.value if family.p99 else None
    whole, rig, cost = result.family(ALL), result.family(RIG), result.cost
    values |= {
        "worst": rig.worst_deg.value if rig.worst_deg else None,
        "refused": whole.refused,
        "no_ellipsoid": whole.no_ellipsoid,
        "cycles": cost.cycles,
        "cycles.most": cost.most_cycles,
        "stack": cost.stack_bytes,
        "flash": cost.flash_bytes,
        "us": cost.host_us,
    }
    return values


def check_limits(values: Mapping[str, float | None], limits: Mapping[str, float]) -> Iterator[LimitResult]:
    """Yield the limits with the values that they name.

    Raises
    ------
    ConfigError
        If a limit names no value.
    """
    for name, most in limits.items():
        if name not in values:
            raise ConfigError(f"--limit {name}: no such value; {nearest_hint(name, list(values))}")
        yield LimitResult(name, most, values[name])


def document(
    judged: Judged, others: Sequence[Judged], limits: Mapping[str, float], against: Judged | None = None
) -> JudgeDocument:
    """Return the document, with the sentence and the exit code; the others are ranked by both default clouds."""
    others = sorted(others, key=lambda other: other.result.rank_error)
    checked = tuple(check_limits(limit_values(judged.result), limits))
    comparison = compare(judged, against) if against else None
    entries = tuple(entry.result for entry in (judged, *([against] if against else []), *others))
    whole = judged.result.family(ALL)
    code, word = _verdict(
        checked,
        is_checked=against is not None,
        is_worse=comparison is not None and comparison.is_worse,
        unanswered=whole if whole.unanswered == whole.worlds else None,
    )
    beside = next((entry.result for entry in others if entry.result.name == _BESIDE), None)
    sentence = f"{word}{describe(judged.result, beside, comparison, against)}"
    return JudgeDocument(__version__, sentence, code, entries, checked, comparison)


def filter_document(results: Sequence[FilterResult], limits: Mapping[str, float]) -> JudgeDocument:
    """Return the document of filters, the judged one first, and behind it maybe the one to compare with."""
    first = results[0]
    values: dict[str, float | None] = {name: first.mean_deg(name) for name in ("total", "heading", "inclination")}
    values |= {"cycles": first.cycles, "cycles.most": first.most_cycles, "us": first.host_us}
    checked = tuple(check_limits(values, limits))
    against = next((result for result in results if result.role == "against"), None)
    is_worse = against is not None and is_worse_filter(first, against)
    code, word = _verdict(checked, is_checked=against is not None, is_worse=is_worse)
    motions = len({score.motion for score in first.scores})
    error = f"heading error {values['heading']:.2f} deg rms"
    if values["total"] is not None:
        error = f"total error {values['total']:.2f} deg rms, heading {values['heading']:.2f}"
    cost = f", {first.cycles} cycles an update" if first.cycles else ""
    text = f"{word}{first.name}: {error}, mean of {format_count(motions, 'motion')}{cost}."
    return JudgeDocument(__version__, text, code, (), checked, None, tuple(results))


def is_worse_filter(new: FilterResult, old: FilterResult) -> bool:
    """Return whether a filter errs by a hundredth more in the same motions, or takes more cycles.

    A hundredth is more than the choice between float32 and float64 changes.
    """
    error = "heading" if None in (new.mean_deg("total"), old.mean_deg("total")) else "total"
    errors = [result.mean_deg(error) for result in (new, old)]
    errs_more = errors[0] is not None and errors[1] is not None and errors[0] > 1.01 * errors[1]
    return errs_more or (ranks_with(new, old) and (new.cycles or 0) > (old.cycles or 0) > 0)


def _verdict(
    checked: Sequence[LimitResult], *, is_checked: bool, is_worse: bool, unanswered: FamilyResult | None = None
) -> tuple[int, str]:
    """Return exit code and first words of the sentence, which are empty if nothing was asked for."""
    failed = [limit for limit in checked if limit.holds is False]
    missing = [limit for limit in checked if limit.holds is None]
    if failed:
        return 1, f"FAIL: {_limit_words(failed[0])}. "
    if unanswered:
        counts = f"{unanswered.refused} are refused and {unanswered.no_ellipsoid} no ellipsoid"
        return 1, f"FAIL: of {unanswered.worlds} answers {counts}. "
    if missing:
        return 22, f"NOT EVALUATED: {missing[0].name} was not measured. "
    if is_worse:
        return 21, "REGRESSION. "
    return 0, "PASS. " if checked or is_checked else ""


def _limit_words(limit: LimitResult) -> str:
    return f"{limit.name} {limit.value:g} (limit {limit.most:g})"


def describe(
    result: EntryResult,
    beside: EntryResult | None = None,
    comparison: Comparison | None = None,
    against: Judged | None = None,
) -> str:
    """Return a sentence on an entry in the default clouds, with the errors of another one in parentheses."""
    errors = [
        f"{rms.value:.2f} x the bound {place}{_parenthesis(beside, cloud)}"
        for cloud, place in ((RIG, "on the default rig"), (HALF_SPHERE, "over half the sphere at 1 uT"))
        if (rms := result.family(cloud).rms)
    ]
    cycles = result.cost.cycles
    cost = f", {cycles:_} cycles".replace("_", " ") if cycles else ""
    text = f"{result.name}: {', '.join(errors) or 'no accepted answer in the default clouds'}{cost}"
    if comparison and against and comparison.error:
        ratio = f"{comparison.cycles:.2f} x its cycles" if comparison.cycles else "cycles of another compiler"
        family, error = max(comparison.families.items(), key=lambda item: item[1].value)
        text += f"; {comparison.error.value:.2f} x the error of {against.result.name}"
        text += f" ({error.value:.2f} x in the worlds of {family}), {ratio}"
    return f"{text}."


def _parenthesis(beside: EntryResult | None, family: str) -> str:
    rms = beside.family(family).rms if beside else None
    return f" ({beside.name} {rms.value:.2f})" if beside and rms else ""
