"""The gyroscope: how much of its limits it uses, and its noise on each axis."""

from __future__ import annotations

import math

from hiltest.record.run import Run
from hiltest.report.figures.columns import numbers
from hiltest.report.figures.group import Drawing, FigureGroup
from hiltest.report.figures.limits import limit_figure
from hiltest.report.figures.rows import Row, RowFigure
from hiltest.report.marks import Mark

NOISE_TABLE = "gyroscope.noise_density"


def gyroscope_group(run: Run) -> FigureGroup | None:
    """Return the section, None when nothing was measured of it."""
    figures: list[Drawing | None] = [
        limit_figure(run.measurements, "gyroscope", "Limits"), _rest_figure(run), _noise_figure(run),
    ]
    drawn = [figure for figure in figures if figure]
    return FigureGroup(
        "gyroscope", "Gyroscope",
        "Bias from a rest before the judged one, scale and axes from whole turns of the table.", drawn,
        tall_first=len(drawn) == 3,
    ) if drawn else None


def _rest_figure(run: Run) -> RowFigure | None:
    """Draw the rate at rest before and after the bias was taken off."""
    found = {
        words: run.measurement(name)
        for words, name in (("as read", "gyroscope.uncorrected_error"), ("corrected", "gyroscope.bias_error"))
    }
    values = {
        words: (abs(each.value), f"{abs(each.value):.3g} {each.unit}")
        for words, each in found.items() if each is not None and each.value is not None
    }
    return _bars("Rate at rest", values) if len(values) == len(found) else None


def _noise_figure(run: Run) -> RowFigure | None:
    table = run.table(NOISE_TABLE)
    if table is None:
        return None
    (unit,) = [column.unit for column in table.columns if column.name == "density"] or [""]
    rows = zip(table.column_if_any("axis"), numbers(table, "density"), strict=True)
    values = {str(axis): (value, f"{value:.3g} {unit}") for axis, value in rows if math.isfinite(value)}
    return _bars("Noise density of each axis", values) if values else None


def _bars(title: str, values: dict[str, tuple[float, str]]) -> RowFigure:
    most = max(value for value, _ in values.values()) or 1.0
    rows = [Row(name, text, 0.96 * value / most, Mark.DOT, "level filled", start=0.0)
            for name, (value, text) in values.items()]
    return RowFigure(title, "; ".join(f"{row.name}: {row.number}" for row in rows), rows)
