"""Streaming calibrators in the HTML and the Markdown report: one row per stage."""

from __future__ import annotations

from collections.abc import Iterator

from hiltest.run_record.run import Cell, Run
from hiltest.text import format_number
from hiltest.verdict.calibrators import STAGES_TABLE

HEADING = "Streaming calibrators"
LEGEND = (
    "Each row is a state after some points of the tumble. Held: points that the calibration uses or would use. "
    "Elements: unknowns of its solver. The host computes heading errors from the board's means at the known angles. "
    "Cycles per point are means over all points; fit cycles are added once per fit."
)
HEADINGS = (
    "calibrator",
    "points",
    "held",
    "elements",
    "fit",
    "fit error",
    "worst heading",
    "mean error",
    "mean cycles per point",
    "median",
    "max",
    "fit cycles",
)
_MEASURED = ("cycles_mean", "cycles_median", "cycles_max", "fit_cycles")


def stream_stages(run: Run) -> list[tuple[str, ...]]:
    """Return the rows under `HEADINGS`; empty if nothing was streamed."""
    return list(_rows(run))


def _rows(run: Run) -> Iterator[tuple[str, ...]]:
    table = run.table(STAGES_TABLE)
    if table is None:
        return
    names = ("calibrator", "points", "held", "elements", "fit", "fit_error", "max_error", "mean_error")
    stages = list(zip(*(table.column(name) for name in names), table.column_if_any("sphere"), strict=True))
    last = {stage[0]: index for index, stage in enumerate(stages)}
    for index, (name, points, held, elements, fit, fit_error, worst, mean, is_sphere) in enumerate(stages):
        has_fit = worst is not None
        yield (
            str(name),
            str(points),
            str(held),
            str(elements or ""),
            _fit_in_words(fit, is_sphere),
            _number(fit_error, "%") if has_fit else "",
            _number(worst, "deg"),
            _number(mean, "deg"),
            *(_cycles(run, f"stream.{name}.{quantity}") if last[name] == index else "" for quantity in _MEASURED),
        )


def _fit_in_words(status: Cell, is_sphere: Cell) -> str:
    words = str(status).lower().replace("_", " ")
    if not is_sphere:
        return words
    return "sphere" if words == "ellipsoid" else f"{words}: sphere"


def _number(value: Cell, unit: str) -> str:
    return f"{value:.2f} {unit}" if isinstance(value, int | float) else ""


def _cycles(run: Run, name: str) -> str:
    measurement = run.measurement(name)
    return "" if measurement is None or measurement.value is None else format_number(measurement.value)
