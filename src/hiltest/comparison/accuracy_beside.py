"""What a calibrator's accuracy did, beside a cost of it that got better or worse."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from statistics import fmean

from hiltest.comparison.evidence import Seed
from hiltest.comparison.model import Change, Difference
from hiltest.measurement import Measurement

Measured = Mapping[Seed, Mapping[str, Measurement]]

_MOVED = (Change.BETTER, Change.WORSE)
_COSTS = ("cycles", "stream")


def with_accuracy(found: Difference, base: Measured, new: Measured) -> Difference:
    """Return a difference; that of a calibrator's cost says what its accuracy was and is, if both sides know.

    Parameters
    ----------
    found : Difference
    base, new : mapping of seed to mapping of str to Measurement
        All that both sides measured. Over several seeds the means are told, as those of the cost are.
    """
    first, _, rest = found.name.partition(".")
    calibrator, _, what = rest.partition(".")
    if found.change not in _MOVED or found.unit != "cycle" or first not in _COSTS or not what:
        return found
    name = f"heading.{calibrator}.max"
    pairs = [
        (was.value, now.value)
        for seed in base.keys() & new.keys()
        if (was := base[seed].get(name)) and (now := new[seed].get(name))
        and was.value is not None and now.value is not None
    ]
    if not pairs:
        return found
    before, after = (fmean(side) for side in zip(*pairs, strict=True))
    accuracy = f"worst heading {_deg(before)} -> {_deg(after)} deg"
    return replace(found, note="; ".join(filter(None, (found.note, accuracy))))


def _deg(value: float) -> str:
    """Return hundredths of a degree, or two digits of less than a tenth."""
    return f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"
