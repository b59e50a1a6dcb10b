"""One measurement on both sides of a comparison, seed by seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hiltest.measurement import Limit, Measurement, Outcome, Tolerance
from hiltest.verdict.evidence import Seed


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
        return [seed for seed, was in self.base.items() if has_number(was) and has_number(self.new[seed])]

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
        return [seed for seed, was in self.base.items() if has_number(was) and not has_number(self.new[seed])]

    @property
    def newly_out(self) -> list[Seed]:
        """Seeds that fail a limit now and did not before: a NaN always, otherwise what the base measured too.

        Where the limit is another now, not those that have not passed through either of the two.
        """
        return [
            seed for seed, now in self.new.items()
            if now is not None and is_out(now) and not is_out(was := self.base[seed])
            and (not has_number(now) if was is None else _went_out(was, now))
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


def number_of(measurement: Measurement | None) -> float | None:
    """Return the value for a comparison: None for a NaN."""
    if measurement is None or measurement.value is None or not math.isfinite(measurement.value):
        return None
    return float(measurement.value)


def has_number(measurement: Measurement | None) -> bool:
    return number_of(measurement) is not None


def values_of(side: Mapping[Seed, Measurement | None], seeds: Sequence[Seed] | None = None) -> list[float]:
    numbers = [number_of(side[seed]) for seed in (side if seeds is None else seeds)]
    return [number for number in numbers if number is not None]


def is_out(measurement: Measurement | None) -> bool:
    return measurement is not None and measurement.outcome is Outcome.FAIL


def _states_why(measurement: Measurement | None) -> bool:
    return measurement is not None and measurement.says_why_not


def _went_out(was: Measurement, now: Measurement) -> bool:
    """Say whether a failing measurement has left a limit; where that was edited, it may always have failed it."""
    if was.limit == now.limit or now.value is None or was.value is None:
        return True
    return any(limit.holds(was.value) and not limit.holds(now.value) for limit in (was.limit, now.limit) if limit)
