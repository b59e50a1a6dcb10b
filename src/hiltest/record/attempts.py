"""The worst of several attempts counts: no rerun makes a pass of a measurement that was out of its limit."""

from __future__ import annotations

from dataclasses import replace

from hiltest.measurement import WORST_OF_SEVERAL, Better, Measurement, Outcome

_WORST_FIRST = (Outcome.FAIL, Outcome.UNSET, Outcome.NOT_OFFERED)


def worst_first(kept: Measurement, other: Measurement) -> tuple[Measurement, Measurement]:
    """Return what two attempts measured under one name, the one that counts first.

    Out of its limit comes before not judged, that before no number at all, and that before a number. Of two numbers
    the worse one comes first, and where neither is, the earlier.
    """
    worst, rest = sorted((kept, other), key=_rank)
    return worst, rest


def marked(measurement: Measurement) -> Measurement:
    """Return it with the note that it is not the only one of its name."""
    return replace(measurement, note="; ".join(filter(None, (measurement.note, WORST_OF_SEVERAL))))


def _rank(measurement: Measurement) -> tuple[int, float]:
    outcome, value = measurement.outcome, measurement.value
    kind = _WORST_FIRST.index(outcome) if outcome in _WORST_FIRST else len(_WORST_FIRST)
    if value is None or measurement.better is Better.NEITHER:
        return kind, 0.0
    return kind, -measurement.better.cost(float(value))
