"""Export of a run for tools that keep histories: Bencher, and the GitHub Action for continuous benchmarking.

Both take any number by name, and neither knows which way one gets better: Bencher needs a threshold for each of
its measures, the action the kind of its file. So only measurements with a better direction are exported: those that
should be near zero as their magnitude, and each kind apart from the other. Their thresholds are ratios to earlier
runs; limits and tolerances stay here.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from hiltest.measurement import Better, Limit, Measurement, round_significant
from hiltest.verdict.evidence import Seed

MOST_NAME, MOST_MEASURE = 1024, 64
"""Characters that Bencher keeps of the name of a benchmark, and of a measure."""


@dataclass(frozen=True, slots=True)
class Exported:
    """One measurement as a number that gets better one way, on each seed that has it."""

    name: str
    """Name, for cycles with their cycle model: both tools compare what has the same name."""
    unit: str
    larger_is_better: bool
    values: tuple[float | int, ...]
    """Finite, at least one."""
    limit: Limit | None

    @property
    def mean(self) -> float | int:
        """Mean over the seeds."""
        return self.values[0] if len(self.values) == 1 else round_significant(fmean(self.values)) or 0.0


def exported(by_seed: Mapping[Seed, Mapping[str, Measurement]]) -> list[Exported]:
    """Return all measurements with a better direction and a number, sorted by name."""
    names = sorted({name for measurements in by_seed.values() for name in measurements})
    found = (_exported([each[name] for each in by_seed.values() if name in each]) for name in names)
    return [each for each in found if each is not None]


def bencher_json(numbers: list[Exported]) -> str:
    """Return Bencher Metric Format: by benchmark and measure a value, over several seeds with smallest and largest.

    The measure is named after the unit and the better direction, since a threshold belongs to a measure.
    """
    return _json({number.name[:MOST_NAME]: {_measure(number): _metric(number)} for number in numbers})


def github_action_benchmark_json(numbers: list[Exported]) -> str:
    """Return the list for the action's tool ``customSmallerIsBetter`` or ``customBiggerIsBetter``.

    Parameters
    ----------
    numbers
        Measurements of one better direction, which the file itself does not state; the action refuses an empty list.
    """
    return _json([_entry(number) for number in numbers])


def _exported(measurements: list[Measurement]) -> Exported | None:
    kept = [measurement for measurement in measurements if measurement.value is not None and not measurement.volatile]
    if not kept:
        return None
    latest = kept[-1]
    sense = latest.better
    if sense is Better.NEITHER:
        return None
    values = [each.value for each in kept if each.value is not None]
    name = latest.name
    if sense is Better.NEARER_ZERO:
        name, values = f"{name}, magnitude", [abs(value) for value in values]
    if latest.cycle_model:
        name = f"{name} ({latest.cycle_model})"
    return Exported(name, latest.unit, sense is Better.HIGHER, tuple(values), latest.limit)


def _measure(number: Exported) -> str:
    sense = f", {'larger' if number.larger_is_better else 'smaller'} is better"
    return (number.unit or "value")[: MOST_MEASURE - len(sense)] + sense


def _metric(number: Exported) -> dict[str, float | int]:
    if len(number.values) == 1:
        return {"value": number.mean}
    return {"value": number.mean, "lower_value": min(number.values), "upper_value": max(number.values)}


def _entry(number: Exported) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": number.name, "unit": number.unit, "value": number.mean}
    if len(number.values) > 1:
        widest = max(abs(value - number.mean) for value in number.values)
        entry["range"] = f"± {round_significant(widest)}"
    entry["extra"] = "\n".join(_extra(number))
    return entry


def _extra(number: Exported) -> Iterator[str]:
    yield f"limit {number.limit}" if number.limit else "no limit"
    if len(number.values) > 1:
        yield f"mean of {len(number.values)} seeds, {min(number.values)} to {max(number.values)}"


def _json(content: object) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
