"""Export of a run for tools that keep histories: Bencher, and the GitHub Action for continuous benchmarking.

Both take any number by name, and neither knows its better direction: Bencher needs a threshold for each of
its measures, the action has one direction per file. So only measurements with a better direction are exported: those
that should be near zero as their magnitude, and each direction separately. Their thresholds are ratios to earlier
runs; limits and tolerances are not exported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from hiltest.measurement import Better, Limit, Measurement, round_significant
from hiltest.verdict.evidence import Seed

MOST_NAME, MOST_MEASURE = 1024, 64
"""Numbers of characters that Bencher keeps of the names of benchmarks and measures."""


@dataclass(frozen=True, slots=True)
class Exported:
    """One measurement as a number with one better direction, on each seed that has it."""

    name: str
    """Name, for cycles including the cycle model, since both tools compare numbers of the same name."""
    unit: str
    larger_is_better: bool
    values: tuple[float | int, ...]
    """Values; finite, at least one."""
    limit: Limit | None

    @property
    def mean(self) -> float | int:
        """Mean over the seeds."""
        return self.values[0] if len(self.values) == 1 else round_significant(fmean(self.values)) or 0.0


def exported(by_seed: Mapping[Seed, Mapping[str, Measurement]]) -> list[Exported]:
    """Return all measurements with a better direction and a number, sorted by name."""
    names = sorted({name for measurements in by_seed.values() for name in measurements})
    candidates = (
        _export_measurement([measurements[name] for measurements in by_seed.values() if name in measurements])
        for name in names
    )
    return [candidate for candidate in candidates if candidate is not None]


def bencher_metrics(numbers: list[Exported]) -> dict[str, Any]:
    """Return Bencher Metric Format: one value by benchmark and measure, over several seeds with smallest and largest.

    The measure is named after the unit and the better direction, since a threshold belongs to a measure.
    """
    return {number.name[:MOST_NAME]: {_measure(number): _metric(number)} for number in numbers}


def github_action_entries(numbers: list[Exported]) -> list[dict[str, Any]]:
    """Return the list for the action's tool ``customSmallerIsBetter`` or ``customBiggerIsBetter``.

    Parameters
    ----------
    numbers
        Measurements of one better direction, which the file itself does not state; the action rejects an empty list.
    """
    return [_entry(number) for number in numbers]


def _export_measurement(measurements: list[Measurement]) -> Exported | None:
    finite = [measurement for measurement in measurements if measurement.value is not None and not measurement.volatile]
    if not finite:
        return None
    latest = finite[-1]
    sense = latest.better
    if sense is Better.NEITHER:
        return None
    values = [measurement.value for measurement in finite if measurement.value is not None]
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
