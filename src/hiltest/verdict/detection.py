"""Number of runs per side that a comparison needs to detect a change of a given size."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from hiltest.errors import ConfigError
from hiltest.measurement import Better, better_of, deviation_of, identify, is_compared, is_direction, tolerance_of
from hiltest.text import legible
from hiltest.verdict.evidence import REAL, Evidence
from hiltest.verdict.pairs import number_of
from hiltest.verdict.run_noise import FALSE_ALARMS, deviation_of_runs, runs_a_side, seeds_needed

_SIZE = re.compile(r"([0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]{1,3})?|\.[0-9]+)\s*(\D.*)", re.ASCII)
_SHOWN_AT_MOST = 40


@dataclass(frozen=True, slots=True)
class Needed:
    """Numbers of runs that detect a change of one measurement in 4 of 5 comparisons."""

    name: str
    deviation: float
    """Standard deviation from run to run, if runs share no noise."""
    paired_deviation: float | None
    """Standard deviation of changes on one seed; None unless two firmwares were compared on several virtual seeds."""
    tolerance: float
    """Largest change that counts as unchanged on a virtual board, or if runs do not differ."""
    runs: int | None
    """Runs per side on a board with this noise; None if no number is enough."""
    seeds: int | None
    """Seeds on a virtual board, on which both firmwares read the same noise; None if no number is enough."""


@dataclass(frozen=True, slots=True)
class Detection:
    """Numbers of runs for a change of `size` in all measurements of one unit."""

    size: float
    unit: str
    board: str
    """Kind of the base's board: only runs of a virtual one are paired."""
    of_base: bool
    """True if BASE has enough runs to estimate their noise; otherwise it is assumed to be that of the default rig."""
    sharing: int
    """Number of measurements that share the false alarms of a comparison."""
    measurements: tuple[Needed, ...]


def detection(written: str, base: Evidence, new: Evidence | None = None) -> Detection:
    """Return the number of runs per side that detect a change.

    Parameters
    ----------
    written
        Size and unit, such as ``0.05deg``.
    new
        Another firmware on the same board: it improves the estimates of noise and, on a virtual board, of changes.

    Raises
    ------
    ValueError
        If it is no size of any measurement of the base.
    ConfigError
        If the base cannot be compared with.
    """
    if base.faults or base.conditions is None:
        raise ConfigError(base.faults[0] if base.faults else f"{base.name}: no board answered")
    numbers = _numbers(base)
    units = {name: unit for name, unit in _units(base).items() if name in numbers}
    size, unit = _parse_size(written, sorted({unit for unit in units.values() if unit}))
    others = _numbers(new) if new else {}
    runs = {
        name: [list(by_seed.values()) for by_seed in (values, others.get(name, {})) if by_seed]
        for name, values in numbers.items()
    }
    estimates = {name: deviation_of_runs(sides, deviation_of(name)) for name, sides in runs.items()}
    deviations = {name: deviation.value if deviation else 0.0 for name, (deviation, _) in estimates.items()}
    board = base.conditions.board
    paired = {} if board == REAL else {name: _paired_deviation(numbers[name], others.get(name, {})) for name in numbers}
    sharing = sum(_shares_false_alarms(name, units[name], base) and bool(deviations[name]) for name in numbers)
    moving = sum(_shares_false_alarms(name, units[name], base) and bool(paired.get(name)) for name in numbers)
    tolerances = {name: base.in_force.get(name) or tolerance_of(name, base.tolerances) for name in numbers}
    floors = {
        name: max(tolerance.absolute, tolerance.relative * abs(fmean(numbers[name].values())))
        for name, tolerance in tolerances.items()
    }
    # As in a comparison, noise replaces the catalogue's tolerance on a real board if that is smaller.
    replaced = {
        name: deviations[name] > floors[name] and tolerance == tolerance_of(name, {})
        for name, tolerance in tolerances.items()
    }
    runs_share, seeds_share = (FALSE_ALARMS / max(count, 1) for count in (sharing, moving))

    def needed(name: str) -> Needed:
        deviation, floor = deviations[name], floors[name]
        seeds = None if board == REAL else seeds_needed(paired[name] or 0.0, floor, seeds_share, size)
        runs_needed = runs_a_side(deviation, 0.0 if replaced[name] else floor, runs_share, size)
        return Needed(name, deviation, paired.get(name), floor, runs_needed, seeds)

    measured = tuple(needed(name) for name in sorted(numbers) if units[name] == unit and not is_direction(name))
    return Detection(size, unit, board, any(own for _, own in estimates.values()), max(sharing, 1), measured)


def _parse_size(written: str, units: Sequence[str]) -> tuple[float, str]:
    match = _SIZE.fullmatch(written.strip())
    size, unit = (float(match[1]), match[2].strip()) if match else (0.0, "")
    unit = "cycle" if unit == "cycles" else unit
    if unit in units and 0.0 < size < math.inf:
        return size, unit
    shown = legible(written if len(written) <= _SHOWN_AT_MOST else f"{written[:_SHOWN_AT_MOST]}...")
    raise ValueError(
        f"expected a number above 0 with a unit of BASE, such as 0.05deg, not {shown!r}; the units of BASE are "
        f"{', '.join(units) or 'none'}"
    )


_Numbers = Mapping[str, Mapping[object, float]]


def _numbers(side: Evidence) -> _Numbers:
    """Return the numbers of all compared measurements, by name and run."""
    by_name: dict[str, dict[object, float]] = {}
    for seed, measurements in side.measurements.items():
        for name, measurement in measurements.items():
            if is_compared(name) and not measurement.volatile and (number := number_of(measurement)) is not None:
                by_name.setdefault(name, {})[seed] = number
    return by_name


def _units(side: Evidence) -> dict[str, str]:
    return {
        name: measurement.unit
        for measurements in side.measurements.values()
        for name, measurement in measurements.items()
    }


def _paired_deviation(base: Mapping[object, float], new: Mapping[object, float]) -> float | None:
    """Return the deviation of changes on the same seed; None for fewer than two of them."""
    changes = [new[seed] - base[seed] for seed in base if seed in new]
    return stdev(changes) if len(changes) > 1 else None


def _shares_false_alarms(name: str, unit: str, base: Evidence) -> bool:
    """Return whether a measurement shares the false alarms: it has a better direction, and decides on a real board."""
    limit = next((measurement[name].limit for measurement in base.measurements.values() if name in measurement), None)
    return better_of(name, limit, unit) is not Better.NEITHER and not identify(name).decided_by
