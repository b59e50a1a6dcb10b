"""Comparison of two sides: every measurement's change, and the obstacles of the gate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from statistics import fmean

from hiltest.measurement import UNDECIDED, Measurement, Outcome, Tolerance, identify, is_compared, is_direction
from hiltest.run_record.comparison import BaseKind, Change, Comparison, Difference, Side
from hiltest.run_record.failures import measured
from hiltest.run_record.run import Run
from hiltest.text import hundredths
from hiltest.verdict.chance import Chance, chance_of
from hiltest.verdict.difference import difference
from hiltest.verdict.evidence import REAL, Evidence, Seed, as_one_run, evidence_of
from hiltest.verdict.obstacles import obstacles
from hiltest.verdict.pairs import Pairs, number_of
from hiltest.verdict.run_noise import FALSE_ALARMS
from hiltest.verdict.wording import entry, format_seeds, sentence

_Measured = Mapping[Seed, Mapping[str, Measurement]]
_MOVED = (Change.BETTER, Change.WORSE)
_ASSUMED = (
    "Too few runs to estimate their differences: the noise of the default rig is assumed. Save at least five "
    "runs of one firmware: hiltest baseline save RUN RUN ... FILE."
)


def compare(base: Evidence, new: Evidence, *, together: bool = False) -> Comparison:
    """Compare two sides, paired by seed, with the base's tolerances, or those of the new run's rig if it has none.

    Parameters
    ----------
    together
        True if both firmwares ran in one session: their compilers and flags may then differ.

    Returns
    -------
    Comparison
        The comparison; it has obstacles if the gate cannot be evaluated, and its differences are then information only.
    """
    board = new.conditions.board if new.conditions else ""
    runs = (base, new)
    if all(run.conditions is not None and run.conditions.board == REAL for run in runs):
        base, new = map(as_one_run, runs)
    pairs = [replace(pair, runs=_numbers_of_runs(pair.name, runs)) for pair in pairs_of(base, new)]
    chances = chances_of(pairs, board, new.tolerances)
    names = {pair.name for pair in pairs}
    raw = (
        _as_information(difference(pair, board, new.tolerances, chances[pair.name]), pair, names, chances)
        for pair in pairs
    )
    changes = (
        _mark_not_taken(_mark_loosened(change, pair), pair, base, new) for change, pair in zip(raw, pairs, strict=True)
    )
    differences = tuple(add_accuracy(change, base.measurements, new.measurements) for change in changes)
    kind = BaseKind.TOGETHER if together else BaseKind.BASELINE if base.is_baseline else BaseKind.RUN
    comparison = _comparison(base.side, new, differences, obstacles(base, new, differences, together=together), kind)
    return replace(comparison, remark=_ASSUMED) if _noise_is_assumed(chances.values()) else comparison


def _noise_is_assumed(chances: Iterable[Chance]) -> bool:
    """Return whether unpaired runs are too few to estimate their noise."""
    noises = [chance.noise for chance in chances if chance.noise is not None and not chance.shared]
    return bool(noises) and not any(noise.of_these_runs for noise in noises)


def chances_of(pairs: Sequence[Pairs], board: str, tolerances: Mapping[str, Tolerance]) -> dict[str, Chance]:
    """Return the effect of chance on each measurement of a comparison, by name.

    Measurements that noise could move beyond their tolerance share the false alarms equally (Bonferroni): 99 of 100
    comparisons of unchanged firmware call none of them better or worse.
    """
    chances = {pair.name: chance_of(pair, board, tolerances) for pair in pairs}
    sharing = sum(
        chance.noise is not None
        and chance.noise.reaches(chance.floor)
        and (chance.shared or not identify(name).decided_by)
        for name, chance in chances.items()
    )
    return {name: replace(chance, share=FALSE_ALARMS / max(sharing, 1)) for name, chance in chances.items()}


def changes_seen(run: Run) -> dict[str, float]:
    """Return the smallest change of each measurement that the run's comparison detects in 4 of 5 cases.

    If the run was compared with nothing, the values are for a comparison with one more such run.
    """
    if run.comparison is not None:
        return {
            difference.name: difference.seen for difference in run.comparison.differences if difference.seen is not None
        }
    evidence = evidence_of(run)
    board = evidence.conditions.board if evidence.conditions else ""
    chances = chances_of(pairs_of(evidence, evidence), board, evidence.tolerances)
    return {name: chance.smallest_change for name, chance in chances.items() if not is_direction(name)}


def not_compared(file: str, reason: str, new: Evidence) -> Comparison:
    """Return the comparison with an unreadable base: the obstacle, and the failures of the run itself.

    Parameters
    ----------
    file
        File of the base.
    reason
        Reason why it cannot be used, with a remedy.
    """
    return _comparison(Side(file), new, (), (reason, *new.faults), BaseKind.RUN)


def _comparison(
    base: Side, new: Evidence, differences: tuple[Difference, ...], reasons: tuple[str, ...], kind: BaseKind
) -> Comparison:
    failed = (*(() if new.may_miss else _missed_limits(new, differences)), *new.failed)
    comparison = Comparison(
        base,
        new.side,
        differences,
        reasons,
        "",
        failed=failed,
        unjudged=tuple(_unevaluated_limits(new)),
        chosen=new.chosen,
        base_kind=kind,
    )
    return replace(comparison, sentence=sentence(comparison))


def _missed_limits(new: Evidence, differences: tuple[Difference, ...]) -> Iterator[str]:
    """Yield the limits that the new run misses, in order of concern; measurements that got worse show the change."""
    missed = _measurements_with(new, Outcome.FAIL)
    for changed in sorted(differences, key=lambda changed: changed.concern):
        if seeds := missed.pop(changed.name, None):
            named = changed.change is Change.WORSE or len(new.measurements) == 1
            yield entry(changed) + ("" if named else format_seeds(list(seeds)))
    for seeds in missed.values():
        yield measured(next(iter(seeds.values())))


def _unevaluated_limits(new: Evidence) -> Iterator[str]:
    for outcome in UNDECIDED:
        for name, seeds in _measurements_with(new, outcome).items():
            yield f"{name} ({next(iter(seeds.values())).note})"


def _measurements_with(new: Evidence, outcome: Outcome) -> dict[str, dict[Seed, Measurement]]:
    """Return the measurements that have an outcome, by name and seed."""
    by_name: dict[str, dict[Seed, Measurement]] = {}
    for seed, measurements in new.measurements.items():
        for name, measurement in sorted(measurements.items()):
            if measurement.outcome is outcome:
                by_name.setdefault(name, {})[seed] = measurement
    return by_name


def _as_information(difference: Difference, pairs: Pairs, names: Set[str], chances: Mapping[str, Chance]) -> Difference:
    """Return a difference as information if runs share no noise and it is the largest of many errors: the rms decides.

    It decides all the same if it has left its limit, or if the rig states its tolerance.
    """
    chance, decides = chances[difference.name], identify(difference.name).decided_by
    stated = chance.noise is not None and not chance.noise.tested
    if chance.shared or stated or decides not in names or difference.change not in _MOVED or pairs.newly_out:
        return difference
    note = f"on a real board {decides} decides"
    return replace(difference, change=Change.CHANGED, note="; ".join(filter(None, (difference.note, note))))


def _mark_loosened(difference: Difference, pairs: Pairs) -> Difference:
    """Return a difference; a loosened limit is shown even if the number did not change."""
    loosened = difference.change is Change.UNCHANGED and pairs.limit_loosened
    return replace(difference, change=Change.CHANGED) if loosened else difference


def _mark_not_taken(difference: Difference, pairs: Pairs, base: Evidence, new: Evidence) -> Difference:
    """Return a difference; a measurement is not called gone if the run ended before it."""
    partial = bool(new.faults or new.failed) or (new.chosen and not base.chosen)
    was_made = any(_was_made(pairs.new[seed]) for seed in pairs.lost)
    if partial and difference.change is Change.GONE and pairs.lost and not was_made:
        return replace(difference, change=Change.NOT_TAKEN, note="")
    return difference


def _was_made(measurement: Measurement | None) -> bool:
    """Return whether a test made a measurement, with or without a number; unmet limits are recorded without a test."""
    return measurement is not None and (bool(measurement.test) or measurement.outcome is not Outcome.UNSET)


def pairs_of(base: Evidence, new: Evidence) -> list[Pairs]:
    """Return the measurements to compare, by name: all that are not volatile in the base, or in the new run if new."""
    seeds = [seed for seed in base.measurements if seed in new.measurements]
    names: set[str] = set()
    for seed in seeds:
        names.update(name for name, measurement in base.measurements[seed].items() if not measurement.volatile)
        was = base.measurements[seed]
        names.update(
            name for name, measurement in new.measurements[seed].items() if not measurement.volatile and name not in was
        )
    pairs = (
        Pairs(
            name,
            _values_on(base.measurements, name, seeds),
            _values_on(new.measurements, name, seeds),
            base.in_force.get(name),
        )
        for name in sorted(filter(is_compared, names))
    )
    return [pair for pair in pairs if not pair.is_nothing]


def _numbers_of_runs(name: str, sides: tuple[Evidence, Evidence]) -> tuple[list[float], list[float]]:
    base, new = (
        [number for run in side.measurements.values() if (number := number_of(run.get(name))) is not None]
        for side in sides
    )
    return base, new


def _values_on(
    measurements: Mapping[Seed, Mapping[str, Measurement]], name: str, seeds: list[Seed]
) -> dict[Seed, Measurement | None]:
    return {seed: measurements[seed].get(name) for seed in seeds}


def add_accuracy(difference: Difference, base: _Measured, new: _Measured) -> Difference:
    """Return a difference; a calibrator's cost is supplemented by its accuracy on both sides, if both have it.

    Parameters
    ----------
    base, new
        All measurements of both sides. Over several seeds the means are named, as for the cost.
    """
    name = identify(difference.name).accuracy
    if difference.change not in _MOVED or not name:
        return difference
    pairs = [
        (was.value, now.value)
        for seed in base.keys() & new.keys()
        if (was := base[seed].get(name))
        and (now := new[seed].get(name))
        and was.value is not None
        and now.value is not None
    ]
    if not pairs:
        return difference
    unit = next(measurements[name].unit for measurements in new.values() if name in measurements)
    before, after = (fmean(side) for side in zip(*pairs, strict=True))
    accuracy = f"{name} {hundredths(before)} -> {hundredths(after)} {unit}"
    return replace(difference, note="; ".join(filter(None, (difference.note, accuracy))))
