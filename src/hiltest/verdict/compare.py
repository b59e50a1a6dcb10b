"""Comparison of two sides: every measurement's change, and the obstacles of the gate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from statistics import fmean

from hiltest.measurement import UNDECIDED, Measurement, Outcome, Tolerance, identify, is_compared, is_direction
from hiltest.record.comparison import BaseKind, Change, Comparison, Difference, Side
from hiltest.record.failures import measured
from hiltest.record.run import Run
from hiltest.text import hundredths
from hiltest.verdict.chance import Chance, chance_of
from hiltest.verdict.difference import difference
from hiltest.verdict.evidence import REAL, Evidence, Seed, as_one_run, evidence_of
from hiltest.verdict.noise import FALSE_ALARMS
from hiltest.verdict.obstacles import obstacles
from hiltest.verdict.pairs import Pairs, number_of
from hiltest.verdict.wording import entry, on_seeds, sentence

_Measured = Mapping[Seed, Mapping[str, Measurement]]
_MOVED = (Change.BETTER, Change.WORSE)
_ASSUMED = (
    "Too few runs to say how much they differ: this board is assumed to be as quiet as the default rig. Save five runs "
    "or more of one firmware: hiltest baseline save RUN RUN ... FILE."
)


def compare(base: Evidence, new: Evidence, *, together: bool = False) -> Comparison:
    """Compare two sides, paired by seed, with the tolerances that the base states, or else those of the new one's rig.

    Parameters
    ----------
    together
        Whether both firmwares ran in one session: they may then be of different compilers and flags.

    Returns
    -------
    Comparison
        Has obstacles where the gate cannot be evaluated; the differences are then information only.
    """
    board = new.conditions.board if new.conditions else ""
    runs = (base, new)
    if all(run.conditions is not None and run.conditions.board == REAL for run in runs):
        base, new = map(as_one_run, runs)
    pairs = [replace(each, runs=_of_each_run(each.name, runs)) for each in pairs_of(base, new)]
    chances = chances_of(pairs, board, new.tolerances)
    names = {pair.name for pair in pairs}
    differences = (
        _informs(difference(pair, board, new.tolerances, chances[pair.name]), pair, names, chances) for pair in pairs
    )
    changes = (
        _taken(_shown_if_loosened(made, each), each, base, new) for made, each in zip(differences, pairs, strict=True)
    )
    found = tuple(with_accuracy(change, base.measurements, new.measurements) for change in changes)
    kind = BaseKind.TOGETHER if together else BaseKind.BASELINE if base.is_baseline else BaseKind.RUN
    made = _comparison(base.side, new, found, obstacles(base, new, found, together=together), kind)
    return replace(made, remark=_ASSUMED) if _noise_is_assumed(chances.values()) else made


def _noise_is_assumed(chances: Iterable[Chance]) -> bool:
    """Say whether runs that share no noise are too few to say how much they differ."""
    noises = [chance.noise for chance in chances if chance.noise is not None and not chance.shared]
    return bool(noises) and not any(noise.of_these_runs for noise in noises)


def chances_of(pairs: Sequence[Pairs], board: str, tolerances: Mapping[str, Tolerance]) -> dict[str, Chance]:
    """Return what chance makes of each measurement of a comparison, by name.

    Those that noise could carry beyond their tolerance, and so call better or worse, share the false alarms equally
    (Bonferroni): none of them may be called in 99 of 100 comparisons of unchanged firmware.
    """
    found = {pair.name: chance_of(pair, board, tolerances) for pair in pairs}
    sharing = sum(
        each.noise is not None and each.noise.reaches(each.floor) and (each.shared or not identify(name).decided_by)
        for name, each in found.items()
    )
    return {name: replace(each, share=FALSE_ALARMS / max(sharing, 1)) for name, each in found.items()}


def changes_seen(run: Run) -> dict[str, float]:
    """Return the smallest change of each measurement that is seen in 4 of 5 cases: by the comparison of the run.

    Of a run that was compared with nothing, by a comparison with one more such run.
    """
    if run.comparison is not None:
        return {each.name: each.seen for each in run.comparison.differences if each.seen is not None}
    evidence = evidence_of(run)
    board = evidence.conditions.board if evidence.conditions else ""
    found = chances_of(pairs_of(evidence, evidence), board, evidence.tolerances)
    return {name: each.seen for name, each in found.items() if not is_direction(name)}


def not_compared(file: str, reason: str, new: Evidence) -> Comparison:
    """Return the comparison with a base that cannot be read: the obstacle, and the failures of the run itself.

    Parameters
    ----------
    file
        File that was to be the base.
    reason
        Why it is none, with what to do.
    """
    return _comparison(Side(file), new, (), (reason, *new.faults), BaseKind.RUN)


def _comparison(
    base: Side, new: Evidence, found: tuple[Difference, ...], reasons: tuple[str, ...], kind: BaseKind
) -> Comparison:
    failed = (*(() if new.may_miss else _missed(new, found)), *new.failed)
    made = Comparison(
        base, new.side, found, reasons, "", failed=failed, unjudged=tuple(_not_evaluated(new)), chosen=new.chosen,
        base_kind=kind,
    )
    return replace(made, sentence=sentence(made))


def _missed(new: Evidence, found: tuple[Difference, ...]) -> Iterator[str]:
    """Yield the limits that the new run misses, in order of concern; what got worse as it is named among that."""
    missed = _with_outcome(new, Outcome.FAIL)
    for each in sorted(found, key=lambda each: each.concern):
        if seeds := missed.pop(each.name, None):
            named = each.change is Change.WORSE or len(new.measurements) == 1
            yield entry(each) + ("" if named else on_seeds(list(seeds)))
    for seeds in missed.values():
        yield measured(next(iter(seeds.values())))


def _not_evaluated(new: Evidence) -> Iterator[str]:
    for outcome in UNDECIDED:
        for name, seeds in _with_outcome(new, outcome).items():
            yield f"{name} ({next(iter(seeds.values())).note})"


def _with_outcome(new: Evidence, outcome: Outcome) -> dict[str, dict[Seed, Measurement]]:
    """Return the measurements that have an outcome, by name and seed."""
    found: dict[str, dict[Seed, Measurement]] = {}
    for seed, made in new.measurements.items():
        for name, each in sorted(made.items()):
            if each.outcome is outcome:
                found.setdefault(name, {})[seed] = each
    return found


def _informs(found: Difference, pairs: Pairs, names: Set[str], chances: Mapping[str, Chance]) -> Difference:
    """Return a difference; between runs that share no noise the largest of many errors informs: their rms decides.

    Unless it has left its limit, or the rig states its tolerance.
    """
    chance, decides = chances[found.name], identify(found.name).decided_by
    stated = chance.noise is not None and not chance.noise.tested
    if chance.shared or stated or decides not in names or found.change not in _MOVED or pairs.newly_out:
        return found
    note = f"on a real board {decides} decides"
    return replace(found, change=Change.CHANGED, note="; ".join(filter(None, (found.note, note))))


def _shown_if_loosened(found: Difference, pairs: Pairs) -> Difference:
    """Return a difference; a limit that the change under test loosens is shown, though the number is what it was."""
    loosened = found.change is Change.UNCHANGED and pairs.limit_loosened
    return replace(found, change=Change.CHANGED) if loosened else found


def _taken(found: Difference, pairs: Pairs, base: Evidence, new: Evidence) -> Difference:
    """Return a difference; a measurement is not gone when the run ended before it."""
    partial = bool(new.faults or new.failed) or (new.chosen and not base.chosen)
    made = any(_was_made(pairs.new[seed]) for seed in pairs.lost)
    if partial and found.change is Change.GONE and pairs.lost and not made:
        return replace(found, change=Change.NOT_TAKEN, note="")
    return found


def _was_made(measurement: Measurement | None) -> bool:
    """Say whether a test made a measurement, with a number or not; a limit that nothing met is kept without a test."""
    return measurement is not None and (bool(measurement.test) or measurement.outcome is not Outcome.UNSET)


def pairs_of(base: Evidence, new: Evidence) -> list[Pairs]:
    """Return the measurements to compare, by name: all but those volatile in the base, or new and volatile."""
    seeds = [seed for seed in base.measurements if seed in new.measurements]
    names: set[str] = set()
    for seed in seeds:
        names.update(name for name, each in base.measurements[seed].items() if not each.volatile)
        was = base.measurements[seed]
        names.update(name for name, each in new.measurements[seed].items() if not each.volatile and name not in was)
    pairs = (
        Pairs(name, _on(base.measurements, name, seeds), _on(new.measurements, name, seeds), base.in_force.get(name))
        for name in sorted(filter(is_compared, names))
    )
    return [pair for pair in pairs if not pair.is_nothing]


def _of_each_run(name: str, sides: tuple[Evidence, Evidence]) -> tuple[list[float], list[float]]:
    base, new = (
        [number for run in side.measurements.values() if (number := number_of(run.get(name))) is not None]
        for side in sides
    )
    return base, new


def _on(
    measurements: Mapping[Seed, Mapping[str, Measurement]], name: str, seeds: list[Seed]
) -> dict[Seed, Measurement | None]:
    return {seed: measurements[seed].get(name) for seed in seeds}


def with_accuracy(found: Difference, base: _Measured, new: _Measured) -> Difference:
    """Return a difference; that of a calibrator's cost says what its accuracy was and is, if both sides know.

    Parameters
    ----------
    base, new
        All that both sides measured. Over several seeds it names the means, as for the cost.
    """
    name = identify(found.name).accuracy
    if found.change not in _MOVED or not name:
        return found
    pairs = [
        (was.value, now.value)
        for seed in base.keys() & new.keys()
        if (was := base[seed].get(name)) and (now := new[seed].get(name))
        and was.value is not None and now.value is not None
    ]
    if not pairs:
        return found
    unit = next(each[name].unit for each in new.values() if name in each)
    before, after = (fmean(side) for side in zip(*pairs, strict=True))
    accuracy = f"{name} {hundredths(before)} -> {hundredths(after)} {unit}"
    return replace(found, note="; ".join(filter(None, (found.note, accuracy))))
