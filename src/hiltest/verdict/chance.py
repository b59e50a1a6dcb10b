"""Effect of chance on the change of one measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

from hiltest.measurement import (
    EXACT,
    FLASH_TIE,
    Measurement,
    Tolerance,
    deviation_of,
    is_direction,
    tolerance_of,
    waits_for_flash,
)
from hiltest.verdict.evidence import REAL
from hiltest.verdict.pairs import Pairs, values_of
from hiltest.verdict.run_noise import FALSE_ALARMS, Noise, half_width, paired, smallest_seen, unpaired
from hiltest.verdict.statistics import LARGEST


@dataclass(frozen=True, slots=True)
class Chance:
    """Effect of chance on one measurement."""

    noise: Noise | None
    """Noise of the mean change; None without noise."""
    tolerance: Tolerance
    """Tolerance that a change must exceed, apart from noise."""
    size: float
    """Magnitude of the values, which a relative tolerance refers to."""
    shared: bool
    """True if runs on one seed read the same noise."""
    share: float = FALSE_ALARMS
    """Share of comparisons of unchanged firmware that may call it changed."""

    @property
    def floor(self) -> float:
        """The tolerance in the measurement's unit."""
        return max(self.tolerance.absolute, self.tolerance.relative * self.size)

    @property
    def shown(self) -> Tolerance:
        """The tolerance, widened by the noise if runs do not share it."""
        if self.shared or self.noise is None or not self.noise.tested:
            return self.tolerance
        return Tolerance(max(self.tolerance.absolute, half_width(self.noise, self.share)), self.tolerance.relative)

    @property
    def smallest_change(self) -> float:
        """Smallest change that is detected in 4 of 5 comparisons."""
        return smallest_seen(self.noise, self.floor, self.share)

    def explains(self, moved: float) -> bool:
        """Return whether noise alone may move the mean this far, at this measurement's share of false alarms."""
        return self.noise is not None and abs(moved) <= half_width(self.noise, self.share)


def chance_of(pairs: Pairs, board: str, tolerances: Mapping[str, Tolerance]) -> Chance:
    """Return the effect of chance on a measurement that is compared alone.

    On a real board the noise replaces the catalogue's tolerance if that is smaller: noise hides a harmless change.
    A tolerance that a rig states decides alone.
    """
    tolerance = flash_tolerance(pairs.latest, pairs.tolerance or tolerance_of(pairs.name, tolerances))
    seeds = pairs.seeds
    base, new = values_of(pairs.base, seeds), values_of(pairs.new, seeds)
    shared = board != REAL
    if not base or max(map(abs, (*base, *new))) > LARGEST:
        return Chance(None, tolerance, 0.0, shared)
    size = abs(fmean(base))
    if shared:
        return Chance(None if tolerance == EXACT else paired(moves(pairs.name, base, new)), tolerance, size, shared)
    noise = unpaired(*(pairs.runs or (base, new)), deviation_of(pairs.name))
    chance = Chance(noise, tolerance, size, shared)
    if noise is None:
        return chance
    if tolerance != tolerance_of(pairs.name, {}):
        return replace(chance, noise=replace(noise, tested=False))
    return chance if noise.deviation <= chance.floor else replace(chance, tolerance=EXACT)


def flash_tolerance(latest: Measurement, tolerance: Tolerance) -> Tolerance:
    """Return the tolerance, widened to the smallest difference that counts of code in flash can resolve."""
    if not waits_for_flash(latest.cycle_model):
        return tolerance
    return Tolerance(tolerance.absolute, max(tolerance.relative, FLASH_TIE))


def moves(name: str, base: Sequence[float], new: Sequence[float]) -> list[float]:
    """Return the changes; changes of a direction are wrapped to half a turn, at which both signs are right."""
    changes = changes_of(base, new)
    return [math.remainder(change, 360.0) for change in changes] if is_direction(name) else changes


def changes_of(base: Sequence[float], new: Sequence[float]) -> list[float]:
    return [after - before for before, after in zip(base, new, strict=True)]
