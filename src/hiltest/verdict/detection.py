"""How many runs a side a comparison needs to see a change of a given size."""

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
from hiltest.verdict.noise import FALSE_ALARMS, of_runs, runs_a_side, seeds_needed
from hiltest.verdict.pairs import number_of

_SIZE = re.compile(r"([0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]{1,3})?|\.[0-9]+)\s*(\D.*)", re.ASCII)
_SHOWN_AT_MOST = 40


@dataclass(frozen=True, slots=True)
class Needed:
    """What a change of one measurement takes to be seen in 4 of 5 comparisons."""

    name: str
    deviation: float
    """From run to run, where runs share no noise."""
    paired_deviation: float | None
    """Of changes on the same seed; None where no two firmwares were compared on several seeds of a virtual board."""
    tolerance: float
    """What it may move on a virtual board, or where nothing differs from run to run, and count as unchanged."""
    runs: int | None
    """Runs a side on a board with this noise; None where no number of them is enough."""
    seeds: int | None
    """Seeds on a virtual board, where both firmwares read the same noise. None there: no number is enough."""


@dataclass(frozen=True, slots=True)
class Detection:
    """Numbers of runs for a change of `size` in all measurements of one unit."""

    size: float
    unit: str
    board: str
    """Kind of the base's board: only on a virtual one are runs paired."""
    of_base: bool
    """Whether BASE has runs enough to say how much they differ; else it is assumed as on the default rig."""
    sharing: int
    """So many measurements share the false alarms of a comparison."""
    measurements: tuple[Needed, ...]


def detection(written: str, base: Evidence, new: Evidence | None = None) -> Detection:
    """Return how many runs a side see a change.

    Parameters
    ----------
    written
        Size and unit, such as ``0.05deg``.
    new
        Another firmware on the same board: says more about the noise, and on a virtual board how much changes differ.

    Raises
    ------
    ValueError
        If it is no size of anything that the base measures.
    ConfigError
        If the base is none that could be compared with.
    """
    if base.faults or base.conditions is None:
        raise ConfigError(base.faults[0] if base.faults else f"{base.name}: no board answered")
    numbers = _numbers(base)
    units = {name: unit for name, unit in _units(base).items() if name in numbers}
    size, unit = _read(written, sorted({each for each in units.values() if each}))
    others = _numbers(new) if new else {}
    runs = {name: [list(by_seed.values()) for by_seed in (values, others.get(name, {})) if by_seed]
            for name, values in numbers.items()}  # fmt: skip
    found = {name: of_runs(sides, deviation_of(name)) for name, sides in runs.items()}
    deviations = {name: each.value if each else 0.0 for name, (each, _) in found.items()}
    board = base.conditions.board
    paired = {} if board == REAL else {name: _paired(numbers[name], others.get(name, {})) for name in numbers}
    sharing = sum(_may_be_called(name, units[name], base) and bool(deviations[name]) for name in numbers)
    moving = sum(_may_be_called(name, units[name], base) and bool(paired.get(name)) for name in numbers)
    tolerances = {name: base.in_force.get(name) or tolerance_of(name, base.tolerances) for name in numbers}
    floors = {name: max(each.absolute, each.relative * abs(fmean(numbers[name].values())))
              for name, each in tolerances.items()}  # fmt: skip
    # As in a comparison: on a real board noise takes the place of the catalogue's tolerance, where that is smaller.
    replaced = {
        name: deviations[name] > floors[name] and each == tolerance_of(name, {}) for name, each in tolerances.items()
    }
    runs_share, seeds_share = (FALSE_ALARMS / max(count, 1) for count in (sharing, moving))

    def needed(name: str) -> Needed:
        deviation, floor = deviations[name], floors[name]
        seeds = None if board == REAL else seeds_needed(paired[name] or 0.0, floor, seeds_share, size)
        runs_needed = runs_a_side(deviation, 0.0 if replaced[name] else floor, runs_share, size)
        return Needed(name, deviation, paired.get(name), floor, runs_needed, seeds)

    measured = tuple(needed(name) for name in sorted(numbers) if units[name] == unit and not is_direction(name))
    return Detection(size, unit, board, any(own for _, own in found.values()), max(sharing, 1), measured)


def _read(written: str, units: Sequence[str]) -> tuple[float, str]:
    found = _SIZE.fullmatch(written.strip())
    size, unit = (float(found[1]), found[2].strip()) if found else (0.0, "")
    unit = "cycle" if unit == "cycles" else unit
    if unit in units and 0.0 < size < math.inf:
        return size, unit
    shown = legible(written if len(written) <= _SHOWN_AT_MOST else f"{written[:_SHOWN_AT_MOST]}...")
    raise ValueError(
        f"expected a number above 0 and a unit of what BASE measured, such as 0.05deg, not {shown!r}; its units are "
        f"{', '.join(units) or 'none'}"
    )


_Numbers = Mapping[str, Mapping[object, float]]


def _numbers(side: Evidence) -> _Numbers:
    """Return the numbers of all that is compared, by name and run."""
    found: dict[str, dict[object, float]] = {}
    for seed, made in side.measurements.items():
        for name, each in made.items():
            if is_compared(name) and not each.volatile and (number := number_of(each)) is not None:
                found.setdefault(name, {})[seed] = number
    return found


def _units(side: Evidence) -> dict[str, str]:
    return {name: each.unit for made in side.measurements.values() for name, each in made.items()}


def _paired(base: Mapping[object, float], new: Mapping[object, float]) -> float | None:
    """Return the deviation of changes on the same seed, None where there are no two of them."""
    changes = [new[seed] - base[seed] for seed in base if seed in new]
    return stdev(changes) if len(changes) > 1 else None


def _may_be_called(name: str, unit: str, base: Evidence) -> bool:
    """Say whether a measurement shares the false alarms: it has a better direction, and decides on a real board."""
    limit = next((measurement[name].limit for measurement in base.measurements.values() if name in measurement), None)
    return better_of(name, limit, unit) is not Better.NEITHER and not identify(name).decided_by
