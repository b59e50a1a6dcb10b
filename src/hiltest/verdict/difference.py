"""One measurement, base against new, over the seeds that both sides have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import fmean

from hiltest.measurement import (
    EXACT,
    SIGNIFICANT_DIGITS,
    Better,
    Measurement,
    Tolerance,
    better_of,
    identify,
    is_beyond,
    is_direction,
    round_significant,
    tolerance_of,
)
from hiltest.measurement.sensor_registers import MOMENTS, Setting
from hiltest.run_record.comparison import Change, Difference
from hiltest.verdict.chance import Chance, chance_of, changes_of, flash_tolerance, moves
from hiltest.verdict.evidence import Seed
from hiltest.verdict.pairs import Pairs, has_number, is_out, values_of
from hiltest.verdict.run_noise import FALSE_ALARMS, mean_interval, paired
from hiltest.verdict.statistics import LARGEST, mean_value, moved_alone
from hiltest.verdict.wording import format_seeds, held_to

#: Number of significant digits in which values are written; a difference in the last one does not count.
_LAST_DIGIT = 10.0 ** (1 - SIGNIFICANT_DIGITS)
_SEEN_DIGITS = 3


def difference(
    pairs: Pairs, board: str, tolerances: Mapping[str, Tolerance], chance: Chance | None = None
) -> Difference:
    """Return the difference of one measurement.

    Parameters
    ----------
    pairs
        Pairs with at least one measurement.
    board
        Kind of the board: on a real one every run has noise of its own.
    tolerances
        Tolerances of the new run's rig, by exact name.
    chance
        Chance with the share of false alarms if many measurements are compared; computed for this one alone if None.
    """
    latest = pairs.latest
    better = better_of(pairs.name, pairs.limit, latest.unit)
    chance = chance or chance_of(pairs, board, tolerances)
    now = flash_tolerance(latest, tolerance_of(pairs.name, tolerances))
    tolerance = flash_tolerance(latest, pairs.tolerance or now)
    note = _cannot_be_paired(pairs)
    seeds = [] if note else pairs.seeds
    base, new = values_of(pairs.base, seeds), values_of(pairs.new, seeds)
    change, remark = _presence(pairs, note) or _paired_change(base, new, better, pairs, chance)
    if change is Change.UNCHANGED and seeds and not tolerance.covers(now):
        change = Change.CHANGED  # a loosened tolerance is shown even if the number did not change
    edited = f"its tolerance was {held_to(tolerance, latest.unit)} in the base" if seeds and tolerance != now else ""
    changes = moves(pairs.name, base, new)
    smallest = chance.smallest_change if seeds and not is_direction(pairs.name) else None
    return Difference(
        name=pairs.name,
        unit=latest.unit,
        change=change,
        sense=better,
        base=mean_value(base or values_of(pairs.base)),
        new=mean_value(new or values_of(pairs.new)),
        delta=mean_value(changes),
        interval=_round_interval(mean_interval(changes)),
        seeds=len(seeds),
        tolerance=chance.shown,
        limit=latest.limit,
        outcome=str(latest.outcome),
        cycle_model=latest.cycle_model,
        seen=round_significant(smallest, _SEEN_DIGITS),
        note="; ".join(filter(None, (remark, _not_offered(pairs), _limit_changed(pairs), edited))),
    )


def _not_offered(pairs: Pairs) -> str:
    """Return the suite's reason for a missing number; empty if none is missing."""
    reasons = {measurement.note for seed in pairs.not_offered if (measurement := pairs.new[seed])}
    return f"not offered{_seeds_remark(pairs.not_offered, pairs)}: {'; '.join(sorted(reasons))}" if reasons else ""


def _limit_changed(pairs: Pairs) -> str:
    """Return a remark on a changed limit; a number that fails only the new limit is not the firmware's doing."""
    if remark := pairs.limit_changed:
        return remark
    fails = [seed for seed, now in pairs.new.items() if is_out(now) and not is_out(was := pairs.base[seed]) and was]
    return "the base has no limit for it" if fails and not pairs.newly_out else ""


def _cannot_be_paired(pairs: Pairs) -> str:
    """Return why numbers of this name are never compared; empty if they are."""
    bases, news = ([measurement for measurement in side.values() if measurement] for side in (pairs.base, pairs.new))
    if not bases or not news:
        return ""
    for property_name, was, now in (
        ("unit", {base.unit for base in bases}, {new.unit for new in news}),
        ("cycle model", {base.cycle_model for base in bases}, {new.cycle_model for new in news}),
    ):
        if was != now:
            return f"the {property_name} was {_join_quoted(was)}, and is {_join_quoted(now)}"
    if any(new.volatile for new in news):
        return "it is volatile now, and not compared"
    if any(abs(number) > LARGEST for side in (pairs.base, pairs.new) for number in values_of(side)):
        return f"numbers beyond {LARGEST:g} cannot be compared"
    return ""


def _presence(pairs: Pairs, note: str) -> tuple[Change, str] | None:
    """Return the change of a measurement without pairs or with missing numbers; None for any other."""
    if pairs.lost or (note and pairs.seeds):
        missing = [str(seed) for seed in pairs.lost if seed is not None]
        reasons = {measurement.note for seed in pairs.lost if (measurement := pairs.new[seed]) and measurement.note}
        seeds_text = f"on seed {', '.join(missing)}" if pairs.seeds and missing else ""
        return Change.GONE, "; ".join(filter(None, (note, seeds_text, *sorted(reasons))))
    if pairs.newly_out:
        return Change.WORSE, f"out of its limit{_seeds_remark(pairs.newly_out, pairs)}"
    if pairs.seeds:
        return None
    if pairs.not_offered:
        return Change.CHANGED, ""
    has_new_number = any(map(has_number, pairs.new.values()))
    return (Change.NEW, "") if has_new_number else (Change.UNCHANGED, "no number on either side")


def _paired_change(
    base: Sequence[float], new: Sequence[float], better: Better, pairs: Pairs, chance: Chance
) -> tuple[Change, str]:
    """Return the change of paired numbers, with a remark if the numbers do not explain it."""
    named = identify(pairs.name)
    if named.kind is not None and named.kind.setting:
        return _setting_change(named.subject, base, new, chance.tolerance)
    change, remark = _mean_change(base, new, better, chance)
    way, alone = _single_seed_change(base, new, better, chance.tolerance) if chance.shared else (change, [])
    if alone and (change in (Change.UNCHANGED, way) or way is Change.WORSE):
        change, remark = way, f"moved alone{_seeds_remark([pairs.seeds[index] for index in alone], pairs)}"
    again = "within its limit again" if _any_out(pairs.base) and not _any_out(pairs.new) else ""
    if change is Change.UNCHANGED and pairs.not_offered:
        change = Change.CHANGED
    return change, "; ".join(filter(None, (again, remark)))


def _setting_change(
    subject: str, base: Sequence[float], new: Sequence[float], tolerance: Tolerance
) -> tuple[Change, str]:
    """Return the change of a sensor's register, with the meaning of its first change on any seed."""
    part, register, moment = subject.split(".")
    for was, now in zip(base, new, strict=True):
        if _exceeds([was], [now], tolerance):
            change = Setting(part, register, int(now)).describe_change(int(was))
            return Change.WORSE, f"{change} ({MOMENTS.get(moment, moment)})"
    return Change.UNCHANGED, ""


def _mean_change(base: Sequence[float], new: Sequence[float], better: Better, chance: Chance) -> tuple[Change, str]:
    tolerance = chance.tolerance
    if better is not Better.NEITHER:
        before, after = _costs(base, better), _costs(new, better)
        if _exceeds(before, after, tolerance):
            if _may_be_chance(base, new, better, chance):
                return _change_by_chance(base, new, better, chance)
            way = f"magnitude {fmean(before):.4g} -> {fmean(after):.4g}"
            remark = way if better is Better.NEARER_ZERO and len(base) > 1 else ""
            return (Change.WORSE if fmean(after) > fmean(before) else Change.BETTER), remark
    if _exceeds(base, new, tolerance) and not _may_be_chance(base, new, Better.NEITHER, chance):
        return Change.CHANGED, ""
    if tolerance == EXACT and chance.shared and any(_exceeds([a], [b], EXACT) for a, b in zip(base, new, strict=True)):
        return Change.CHANGED, "same mean, but not on every seed"
    return Change.UNCHANGED, ""


def _change_by_chance(
    base: Sequence[float], new: Sequence[float], better: Better, chance: Chance
) -> tuple[Change, str]:
    """Return a change that chance explains: unchanged, unless it would be called if nothing else were compared."""
    alone = replace(chance, share=FALSE_ALARMS)
    if _may_be_chance(base, new, better, alone):
        return Change.UNCHANGED, f"within what {'these seeds differ' if chance.shared else 'runs differ'} by"
    many = round(FALSE_ALARMS / chance.share)
    return Change.CHANGED, f"beyond the noise of one measurement, but not of {many}: compare more runs"


def _single_seed_change(
    base: Sequence[float], new: Sequence[float], better: Better, tolerance: Tolerance
) -> tuple[Change, list[int]]:
    """Return the direction and the indices of pairs that moved alone; the worse ones take precedence."""
    if better is not Better.NEITHER:
        before, after = _costs(base, better), _costs(new, better)
        moved = moved_alone(before, after, tolerance)
        worse = [index for index in moved if after[index] > before[index]]
        if moved:
            return (Change.WORSE, worse) if worse else (Change.BETTER, moved)
    return Change.CHANGED, moved_alone(base, new, tolerance)


def _any_out(side: Mapping[Seed, Measurement | None]) -> bool:
    return any(map(is_out, side.values()))


def _seeds_remark(seeds: Sequence[Seed], pairs: Pairs) -> str:
    """Return the seeds of a remark; empty for a single seed."""
    return format_seeds(seeds) if len(pairs.new) > 1 else ""


def _costs(values: Sequence[float], better: Better) -> list[float]:
    return [better.cost(value) for value in values]


def _exceeds(base: Sequence[float], new: Sequence[float], tolerance: Tolerance) -> bool:
    """Return whether the mean moved by more than both tolerances."""
    was, now = fmean(base), fmean(new)
    sizes = fmean(map(abs, base)), fmean(map(abs, new))
    written = 0.0 if all(map(float.is_integer, (*base, *new))) else _LAST_DIGIT * max(sizes)
    moved = abs(now - was) - written
    return moved > tolerance.absolute and is_beyond(tolerance.relative, moved, *sizes)


def _may_be_chance(base: Sequence[float], new: Sequence[float], better: Better, chance: Chance) -> bool:
    """Return whether noise explains the mean change.

    Paired costs have noise of their own: a bias that crosses zero changes all of them alike. Between unpaired runs
    the noise is that of the numbers themselves; costs never have more.
    """
    if chance.shared and chance.noise is not None and better is not Better.NEITHER:
        costs = changes_of(_costs(base, better), _costs(new, better))
        return replace(chance, noise=paired(costs)).explains(fmean(costs))
    return chance.explains(fmean(changes_of(base, new)))


def _round_interval(interval: tuple[float, float] | None) -> tuple[float, float] | None:
    if interval is None:
        return None
    low, high = (round_significant(side) or 0.0 for side in interval)
    return low, high


def _join_quoted(words: set[str]) -> str:
    return " and ".join(repr(word) for word in sorted(words))
