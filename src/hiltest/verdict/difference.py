"""One measurement, base against new, over the seeds that both sides have."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

from hiltest.measurement import (
    EXACT,
    FLASH_TIE,
    SIGNIFICANT_DIGITS,
    Better,
    Limit,
    Measurement,
    Outcome,
    Tolerance,
    better_of,
    deviation_of,
    in_flash,
    is_beyond,
    is_direction,
    round_significant,
    tolerance_of,
)
from hiltest.record.comparison import Change, Difference
from hiltest.verdict.evidence import REAL, Seed
from hiltest.verdict.noise import FALSE_ALARMS, Noise, half_width, mean_interval, paired, smallest_seen, unpaired
from hiltest.verdict.statistics import LARGEST, mean_value, moved_alone
from hiltest.verdict.wording import held_to, on_seeds

#: Values are written with so many significant digits; what two of them differ by in the last one is no difference.
_LAST_DIGIT = 10.0 ** (1 - SIGNIFICANT_DIGITS)
_SEEN_DIGITS = 3


@dataclass(frozen=True, slots=True)
class Pairs:
    """One measurement on every seed that both sides have; None where a side did not make it.

    `tolerance` is the base's, which a change under test cannot take away either; None where it states none. `runs` are
    the numbers of each run of either side on a board whose runs share no noise: they are no pairs, but their means are.
    """

    name: str
    base: Mapping[Seed, Measurement | None]
    new: Mapping[Seed, Measurement | None]
    tolerance: Tolerance | None = None
    runs: tuple[Sequence[float], Sequence[float]] | None = None

    @property
    def seeds(self) -> list[Seed]:
        """Seeds with a number on both sides."""
        return [seed for seed, was in self.base.items() if _has_number(was) and _has_number(self.new[seed])]

    @property
    def is_nothing(self) -> bool:
        """True where neither side has a number or a limit."""
        made = [each for side in (self.base, self.new) for each in side.values() if each is not None]
        return not any(each.limit or each.value is not None for each in made)

    @property
    def lost(self) -> list[Seed]:
        """Seeds with a number in the base alone and no reason given; a measurement with a limit is never excused."""
        return [seed for seed in self._in_base_alone if not self._excused(seed)]

    @property
    def not_offered(self) -> list[Seed]:
        """Seeds with a number in the base alone, where the new run says why it has none."""
        return [seed for seed in self._in_base_alone if self._excused(seed)]

    def _excused(self, seed: Seed) -> bool:
        was = self.base[seed]
        return _states_why(self.new[seed]) and not (was and was.limit)

    @property
    def _in_base_alone(self) -> list[Seed]:
        return [seed for seed, was in self.base.items() if _has_number(was) and not _has_number(self.new[seed])]

    @property
    def newly_out(self) -> list[Seed]:
        """Seeds that fail a limit now and did not before: a NaN always, otherwise what the base measured too.

        Where the limit is another now, not those that have not passed through either of the two.
        """
        return [
            seed for seed, now in self.new.items()
            if now is not None and _is_out(now) and not _is_out(was := self.base[seed])
            and (not _has_number(now) if was is None else _went_out(was, now))
        ]

    @property
    def limit_changed(self) -> str:
        """The limit before it was edited or dropped; empty where the base has none, or the same."""
        both = ((was.limit, now) for seed, was in self.base.items() if was and (now := self.new[seed]))
        edited = [(before, now.limit) for before, now in both if before is not None and before != now.limit]
        if not edited:
            return ""
        before, after = edited[0]
        return f"it has no limit any more; it was {before}" if after is None else f"its limit was {before} in the base"

    @property
    def limit_loosened(self) -> bool:
        """True where the new limit accepts more than the base's did, or there is none any more."""
        both = ((was.limit, now.limit) for seed, was in self.base.items() if was and (now := self.new[seed]))
        return any(before is not None and (after is None or not before.covers(after)) for before, after in both)

    @property
    def limit(self) -> Limit | None:
        """The base's, which a change under test cannot take away; where there is none the new run's."""
        made = (*self.base.values(), *self.new.values())
        return next((each.limit for each in made if each and each.limit), None)

    @property
    def latest(self) -> Measurement:
        """The new run's, or where there is none the base's; over several seeds one that gates, if any."""
        made = [each for each in self.new.values() if each] or [each for each in self.base.values() if each]
        return next((each for each in made if each.gates), made[0])


@dataclass(frozen=True, slots=True)
class Chance:
    """What chance makes of one measurement.

    Attributes
    ----------
    noise : Noise or None
        Of its mean change; None where there is none.
    floor : float
        Its tolerance as a number.
    shared : bool
        Whether runs of one seed read the same noise.
    share : float
        Share of comparisons of unchanged firmware that may call it changed.
    """

    noise: Noise | None
    floor: float
    shared: bool
    share: float = FALSE_ALARMS

    def explains(self, moved: float) -> bool:
        """Say whether noise alone may have moved the mean by so much, at this measurement's share of false alarms."""
        return self.noise is not None and abs(moved) <= half_width(self.noise, self.share)

    def tolerance(self, of: Tolerance) -> Tolerance:
        """Return the tolerance with what noise moves, where runs do not share it."""
        if self.shared or self.noise is None:
            return of
        return Tolerance(max(of.absolute, half_width(self.noise, self.share)), of.relative)


def chance_of(pairs: Pairs, board: str, tolerances: Mapping[str, Tolerance]) -> Chance:
    """Return what chance makes of a measurement that is compared alone.

    A tolerance that the rig states is taken as it is on a real board: no test stands beside it.
    """
    tolerance = _of_flash(pairs.latest, pairs.tolerance or tolerance_of(pairs.name, tolerances))
    seeds = pairs.seeds
    base, new = _values(pairs.base, seeds), _values(pairs.new, seeds)
    if not base or max(map(abs, (*base, *new))) > LARGEST:
        return Chance(None, tolerance.absolute, shared=board != REAL)
    floor = max(tolerance.absolute, tolerance.relative * abs(fmean(base)))
    if board != REAL:
        return Chance(None if tolerance == EXACT else paired(_moves(pairs.name, base, new)), floor, shared=True)
    noise = unpaired(*(pairs.runs or (base, new)), deviation_of(pairs.name))
    stated = tolerances.get(pairs.name) == tolerance
    return Chance(replace(noise, tested=False) if noise and stated else noise, floor, shared=False)


def difference(
    pairs: Pairs, board: str, tolerances: Mapping[str, Tolerance], chance: Chance | None = None
) -> Difference:
    """Return the difference of one measurement.

    Parameters
    ----------
    pairs : Pairs
        At least one measurement in it.
    board : str
        Kind of the board: a real one has noise of its own in every run.
    tolerances : mapping of str to Tolerance
        Tolerances of the new run's rig, by exact name.
    chance : Chance, optional
        Where it is one of many measurements: with its share of the false alarms.
    """
    latest = pairs.latest
    better = better_of(pairs.name, pairs.limit, latest.unit)
    chance = chance or chance_of(pairs, board, tolerances)
    now = _of_flash(latest, tolerance_of(pairs.name, tolerances))
    tolerance = _of_flash(latest, pairs.tolerance or now)
    note = _cannot_be_paired(pairs)
    seeds = [] if note else pairs.seeds
    base, new = _values(pairs.base, seeds), _values(pairs.new, seeds)
    change, remark = _presence(pairs, note) or _compared(base, new, better, tolerance, pairs, chance)
    if change is Change.UNCHANGED and seeds and not tolerance.covers(now):
        change = Change.CHANGED  # it is loosened, which is shown though the number is what it was
    edited = f"its tolerance was {held_to(tolerance, latest.unit)} in the base" if seeds and tolerance != now else ""
    changes = _moves(pairs.name, base, new)
    seen = smallest_seen(chance.noise, chance.floor, chance.share) if seeds and not is_direction(pairs.name) else None
    return Difference(
        name=pairs.name, unit=latest.unit, change=change, sense=better,
        base=mean_value(base or _values(pairs.base)), new=mean_value(new or _values(pairs.new)),
        delta=mean_value(changes), interval=_rounded(mean_interval(changes)),
        seeds=len(seeds), tolerance=chance.tolerance(tolerance), limit=latest.limit, outcome=str(latest.outcome),
        cycle_model=latest.cycle_model, seen=round_significant(seen, _SEEN_DIGITS),
        note="; ".join(filter(None, (remark, _not_offered(pairs), _limit_changed(pairs), edited))),
    )


def _moves(name: str, base: Sequence[float], new: Sequence[float]) -> list[float]:
    """Return the changes; of a direction the short way round, and as far back: of half a turn both signs are right."""
    changes = _changes(base, new)
    return [math.remainder(each, 360.0) for each in changes] if is_direction(name) else changes


def _of_flash(latest: Measurement, tolerance: Tolerance) -> Tolerance:
    """Return the tolerance, no tighter than two counts of code in flash can be distinguished."""
    if not in_flash(latest.cycle_model):
        return tolerance
    return Tolerance(tolerance.absolute, max(tolerance.relative, FLASH_TIE))


def _not_offered(pairs: Pairs) -> str:
    """Return the suite's reason why there is no number now; empty where nothing is missing."""
    reasons = {each.note for seed in pairs.not_offered if (each := pairs.new[seed])}
    return f"not offered{_on_seeds(pairs.not_offered, pairs)}: {'; '.join(sorted(reasons))}" if reasons else ""


def _limit_changed(pairs: Pairs) -> str:
    """Return a remark on another limit; a number that fails it, and has not gone out, is not the firmware's doing."""
    if remark := pairs.limit_changed:
        return remark
    fails = [seed for seed, now in pairs.new.items() if _is_out(now) and not _is_out(was := pairs.base[seed]) and was]
    return "the base has no limit for it" if fails and not pairs.newly_out else ""


def _cannot_be_paired(pairs: Pairs) -> str:
    """Return why numbers of this name are never compared, empty when they are."""
    bases, news = ([each for each in side.values() if each] for side in (pairs.base, pairs.new))
    if not bases or not news:
        return ""
    for what, was, now in (
        ("unit", {each.unit for each in bases}, {each.unit for each in news}),
        ("cycle model", {each.cycle_model for each in bases}, {each.cycle_model for each in news}),
    ):
        if was != now:
            return f"the {what} was {_listed(was)}, and is {_listed(now)}"
    if any(each.volatile for each in news):
        return "it is volatile now, and no longer compared"
    if any(abs(number) > LARGEST for side in (pairs.base, pairs.new) for number in _values(side)):
        return f"a number beyond {LARGEST:g} is none that can be compared"
    return ""


def _presence(pairs: Pairs, note: str) -> tuple[Change, str] | None:
    """Return the change of a measurement without pairs or with missing numbers; None where neither is so."""
    if pairs.lost or (note and pairs.seeds):
        missing = [str(seed) for seed in pairs.lost if seed is not None]
        reasons = {each.note for seed in pairs.lost if (each := pairs.new[seed]) and each.note}
        on_seeds = f"on seed {', '.join(missing)}" if pairs.seeds and missing else ""
        return Change.GONE, "; ".join(filter(None, (note, on_seeds, *sorted(reasons))))
    if pairs.newly_out:
        return Change.WORSE, f"out of its limit{_on_seeds(pairs.newly_out, pairs)}"
    if pairs.seeds:
        return None
    if pairs.not_offered:
        return Change.CHANGED, ""
    made = any(map(_has_number, pairs.new.values()))
    return (Change.NEW, "") if made else (Change.UNCHANGED, "no number on either side")


def _compared(
    base: Sequence[float], new: Sequence[float], sense: Better, tolerance: Tolerance, pairs: Pairs, chance: Chance
) -> tuple[Change, str]:
    """Return the change of paired numbers, with a remark where they alone do not say why."""
    change, remark = _in_the_mean(base, new, sense, tolerance, chance)
    way, alone = _on_single_seeds(base, new, sense, tolerance) if chance.shared else (change, [])
    if alone and (change in (Change.UNCHANGED, way) or way is Change.WORSE):
        change, remark = way, f"moved alone{_on_seeds([pairs.seeds[index] for index in alone], pairs)}"
    again = "within its limit again" if _any_out(pairs.base) and not _any_out(pairs.new) else ""
    if change is Change.UNCHANGED and pairs.not_offered:
        change = Change.CHANGED
    return change, "; ".join(filter(None, (again, remark)))


def _in_the_mean(
    base: Sequence[float], new: Sequence[float], sense: Better, tolerance: Tolerance, chance: Chance
) -> tuple[Change, str]:
    if sense is not Better.NEITHER:
        before, after = _costs(base, sense), _costs(new, sense)
        if _beyond(before, after, tolerance):
            if _may_be_chance(base, new, sense, chance):
                return Change.UNCHANGED, f"within what {'these seeds differ' if chance.shared else 'runs differ'} by"
            way = f"magnitude {fmean(before):.4g} -> {fmean(after):.4g}"
            remark = way if sense is Better.NEARER_ZERO and len(base) > 1 else ""
            return (Change.WORSE if fmean(after) > fmean(before) else Change.BETTER), remark
    if _beyond(base, new, tolerance) and not _may_be_chance(base, new, Better.NEITHER, chance):
        return Change.CHANGED, ""
    if tolerance == EXACT and chance.shared and any(_beyond([a], [b], EXACT) for a, b in zip(base, new, strict=True)):
        return Change.CHANGED, "the same in the mean, not on every seed"
    return Change.UNCHANGED, ""


def _on_single_seeds(
    base: Sequence[float], new: Sequence[float], sense: Better, tolerance: Tolerance
) -> tuple[Change, list[int]]:
    """Return which pairs moved alone, and which way: those that got worse if there are any."""
    if sense is not Better.NEITHER:
        before, after = _costs(base, sense), _costs(new, sense)
        found = moved_alone(before, after, tolerance)
        worse = [index for index in found if after[index] > before[index]]
        if found:
            return (Change.WORSE, worse) if worse else (Change.BETTER, found)
    return Change.CHANGED, moved_alone(base, new, tolerance)


def _is_out(measurement: Measurement | None) -> bool:
    return measurement is not None and measurement.outcome is Outcome.FAIL


def _states_why(measurement: Measurement | None) -> bool:
    return measurement is not None and measurement.says_why_not


def _went_out(was: Measurement, now: Measurement) -> bool:
    """Say whether a failing measurement has left a limit; where that was edited, it may always have failed it."""
    if was.limit == now.limit or now.value is None or was.value is None:
        return True
    return any(limit.holds(was.value) and not limit.holds(now.value) for limit in (was.limit, now.limit) if limit)


def _any_out(side: Mapping[Seed, Measurement | None]) -> bool:
    return any(map(_is_out, side.values()))


def _on_seeds(seeds: Sequence[Seed], pairs: Pairs) -> str:
    """Return the seeds of a remark; empty where there is only one."""
    return on_seeds(seeds) if len(pairs.new) > 1 else ""


def _costs(values: Sequence[float], sense: Better) -> list[float]:
    return [sense.cost(value) for value in values]


def _beyond(base: Sequence[float], new: Sequence[float], tolerance: Tolerance) -> bool:
    """Say whether the mean moved by more than both tolerances."""
    was, now = fmean(base), fmean(new)
    sizes = fmean(map(abs, base)), fmean(map(abs, new))
    written = 0.0 if all(map(float.is_integer, (*base, *new))) else _LAST_DIGIT * max(sizes)
    moved = abs(now - was) - written
    return moved > tolerance.absolute and is_beyond(tolerance.relative, moved, *sizes)


def _may_be_chance(base: Sequence[float], new: Sequence[float], sense: Better, chance: Chance) -> bool:
    """Say whether noise explains the mean change.

    Paired costs have noise of their own: what brings a bias from either side to zero moves all of them alike. Between
    runs that share none the noise is that of the numbers themselves, of which a cost never has more.
    """
    if chance.shared and chance.noise is not None and sense is not Better.NEITHER:
        costs = _changes(_costs(base, sense), _costs(new, sense))
        return replace(chance, noise=paired(costs)).explains(fmean(costs))
    return chance.explains(fmean(_changes(base, new)))


def _changes(base: Sequence[float], new: Sequence[float]) -> list[float]:
    return [after - before for before, after in zip(base, new, strict=True)]


def _values(side: Mapping[Seed, Measurement | None], seeds: Sequence[Seed] | None = None) -> list[float]:
    numbers = [number_of(side[seed]) for seed in (side if seeds is None else seeds)]
    return [each for each in numbers if each is not None]


def number_of(measurement: Measurement | None) -> float | None:
    """Return the value for a comparison: None for a NaN."""
    if measurement is None or measurement.value is None or not math.isfinite(measurement.value):
        return None
    return float(measurement.value)


def _has_number(measurement: Measurement | None) -> bool:
    return number_of(measurement) is not None


def _rounded(interval: tuple[float, float] | None) -> tuple[float, float] | None:
    if interval is None:
        return None
    low, high = (round_significant(side) or 0.0 for side in interval)
    return low, high


def _listed(words: set[str]) -> str:
    return " and ".join(repr(each) for each in sorted(words))
