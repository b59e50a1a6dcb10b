"""One measurement on both sides of a comparison, seed by seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hiltest.measurement import Limit, Measurement, Outcome, Tolerance
from hiltest.verdict.evidence import Seed


@dataclass(frozen=True, slots=True)
class Pairs:
    """One measurement on every seed that both sides have; None if a side did not make it.

    `tolerance` is the base's, which a change under test cannot remove; None if the base states none. `runs` are the
    numbers of each run of both sides on a board whose runs share no noise: only their means are paired.
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
        """True if neither side has a number or a limit."""
        measurements = [
            measurement for side in (self.base, self.new) for measurement in side.values() if measurement is not None
        ]
        return not any(measurement.limit or measurement.value is not None for measurement in measurements)

    @property
    def lost(self) -> list[Seed]:
        """Seeds with a number in the base alone and without a reason; a measurement with a limit is never excused."""
        return [seed for seed in self._base_only_seeds if not self._is_excused(seed)]

    @property
    def not_offered(self) -> list[Seed]:
        """Seeds with a number in the base alone, for which the new run gives a reason."""
        return [seed for seed in self._base_only_seeds if self._is_excused(seed)]

    def _is_excused(self, seed: Seed) -> bool:
        was = self.base[seed]
        return _has_reason(self.new[seed]) and not (was and was.limit)

    @property
    def _base_only_seeds(self) -> list[Seed]:
        return [seed for seed, was in self.base.items() if has_number(was) and not has_number(self.new[seed])]

    @property
    def newly_out(self) -> list[Seed]:
        """Seeds that fail a limit now and did not before: any NaN, otherwise only values that the base has, too.

        If the limit was edited, seeds that crossed neither the old nor the new limit are omitted.
        """
        return [
            seed
            for seed, now in self.new.items()
            if now is not None
            and is_out(now)
            and not is_out(was := self.base[seed])
            and (not has_number(now) if was is None else _crossed_limit(was, now))
        ]

    @property
    def limit_changed(self) -> str:
        """The limit before it was edited or dropped; empty if the base has none, or the same."""
        both = ((was.limit, now) for seed, was in self.base.items() if was and (now := self.new[seed]))
        edited = [(before, now.limit) for before, now in both if before is not None and before != now.limit]
        if not edited:
            return ""
        before, after = edited[0]
        return f"its limit was {before}, and was removed" if after is None else f"its limit was {before} in the base"

    @property
    def limit_loosened(self) -> bool:
        """True if the new limit accepts more than the base's, or was removed."""
        both = ((was.limit, now.limit) for seed, was in self.base.items() if was and (now := self.new[seed]))
        return any(before is not None and (after is None or not before.covers(after)) for before, after in both)

    @property
    def limit(self) -> Limit | None:
        """The base's limit, which a change under test cannot remove, or else the new run's."""
        measurements = (*self.base.values(), *self.new.values())
        return next((measurement.limit for measurement in measurements if measurement and measurement.limit), None)

    @property
    def latest(self) -> Measurement:
        """The new run's measurement, or else the base's; over several seeds one that gates, if any."""
        measurements = [measurement for measurement in self.new.values() if measurement] or [
            measurement for measurement in self.base.values() if measurement
        ]
        return next((measurement for measurement in measurements if measurement.gates), measurements[0])


def number_of(measurement: Measurement | None) -> float | None:
    """Return the value for a comparison; None for a NaN."""
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


def _has_reason(measurement: Measurement | None) -> bool:
    return measurement is not None and measurement.says_why_not


def _crossed_limit(was: Measurement, now: Measurement) -> bool:
    """Return whether a failing measurement crossed a limit; if the limit was edited, it may always have failed it."""
    if was.limit == now.limit or now.value is None or was.value is None:
        return True
    return any(limit.holds(was.value) and not limit.holds(now.value) for limit in (was.limit, now.limit) if limit)
