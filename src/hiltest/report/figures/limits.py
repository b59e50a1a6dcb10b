"""How much of its limit each measurement of a family uses."""

from __future__ import annotations

from collections.abc import Sequence

from hiltest.measurement import Limit, Measurement, Outcome
from hiltest.report.figures.rows import Row, RowFigure
from hiltest.report.marks import KeyEntry, Mark
from hiltest.text import readable

_ROOM = 0.75  # of the width is what a limit allows; the rest shows how far beyond it a value is
_KEY = (
    KeyEntry("within its limit", "", Mark.DOT, "level filled"), KeyEntry("beyond it", "", Mark.CROSS, "over"),
    KeyEntry("limit", "end"),
)


def limit_figure(measurements: Sequence[Measurement], family: str, title: str) -> RowFigure | None:
    """Draw the measurements of a family that have a limit and a number, None when there are none."""
    rows = [row for each in measurements if each.name.startswith(f"{family}.") and (row := _row(each, family))]
    if not rows:
        return None
    return RowFigure(title, "; ".join(f"{row.name}: {row.number}" for row in rows), rows, key=_KEY)


def _row(measurement: Measurement, family: str) -> Row | None:
    limit, value = measurement.limit, measurement.value
    ends = None if limit is None else _ends(limit)
    if limit is None or value is None or ends is None:
        return None
    low, high = ends
    held = measurement.outcome is not Outcome.FAIL
    shares = [(side - low) / (high - low) for side in (limit.min, limit.max) if side is not None]
    zone = (shares[0], shares[1]) if len(shares) == 2 else (0.0, shares[0]) if limit.min is None else (shares[0], 1.0)
    return Row(
        measurement.name.removeprefix(f"{family}."), f"{readable(value, 3)} {measurement.unit}, {limit}".strip(),
        at=(value - low) / (high - low), mark=Mark.DOT if held else Mark.CROSS,
        style="level filled" if held else "over", zone=zone, ends=shares,
    )


def _ends(limit: Limit) -> tuple[float, float] | None:
    """Return what the left and the right end of the bar stand for; None for a limit without a width."""
    if limit.min is not None and limit.max is not None:
        middle, half = (limit.min + limit.max) / 2.0, (limit.max - limit.min) / 2.0
        return None if half == 0.0 else (middle - half / _ROOM, middle + half / _ROOM)
    side = limit.max if limit.min is None else limit.min
    if side is None or side <= 0.0:
        return None
    return 0.0, side / _ROOM if limit.min is None else side / (1.0 - _ROOM)
