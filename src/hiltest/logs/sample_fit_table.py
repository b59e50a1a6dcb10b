"""A fitted cloud for people."""

from __future__ import annotations

import math

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from hiltest.calibration.acceptance import Acceptance, Reason
from hiltest.logs.sample_fit import CalibratorFit, CloudFit
from hiltest.text import readable

_STYLES = {Acceptance.GOOD: "green", Acceptance.POOR: "yellow", Acceptance.REFUSED: "bold red"}
_NAMES = {
    "n": "number of points", "condition": "condition", "residual_percent": "residual", "axis_ratio": "axis ratio",
    "radius_ut": "radius", "direction_error_deg": "predicted direction error",
}  # fmt: skip
# More of them nobody reads.
_MOST_DECIMALS = 8


def print_fit(fit: CloudFit, console: Console) -> None:
    """Print what was read, a table with a column for each calibrator, the reasons and the verdict."""
    points = f"{fit.n_in} points, columns {', '.join(fit.columns)} [{fit.unit}]"
    as_one_line = not console.is_terminal
    console.print(escape(f"{fit.file}: {points}"), soft_wrap=True)
    console.print(_grid(fit))
    for each in fit.calibrators:
        console.print(_reasons(each), soft_wrap=as_one_line)
    for note in fit.notes:
        console.print(Text(note, style="dim"), soft_wrap=as_one_line)


def _grid(fit: CloudFit) -> Table:
    grid = Table(box=SIMPLE_HEAD, pad_edge=False)
    grid.add_column("")
    for each in fit.calibrators:
        grid.add_column(escape(each.name), justify="right")
    grid.add_row("verdict", *(Text(each.verdict, style=_STYLES[each.verdict]) for each in fit.calibrators))
    for label, cells in figure_rows(fit):
        grid.add_row(escape(label), *map(escape, cells))
    return grid


def figure_rows(fit: CloudFit) -> list[tuple[str, list[str]]]:
    """Return the figures of a fit: a label, and a text for each calibrator."""
    fits = fit.calibrators
    rows = [
        ("fit", [each.status for each in fits]),
        ("points used", [str(each.n_used) for each in fits]),
        (f"hard iron [{fit.unit}]", [_hard_iron(each) for each in fits]),
        ("soft iron [1]", ["\n".join(map(_row, each.soft_iron or ())) or "-" for each in fits]),
        (f"radius [{fit.unit}]", [_number(each.radius, ".4g") for each in fits]),
        ("residual [%]", [_number(each.residual_percent, ".2f") for each in fits]),
        ("coverage [%]", [_number(each.coverage and 100 * each.coverage, ".0f") for each in fits]),
        ("axis ratio", [_number(each.axis_ratio, ".3f") for each in fits]),
        ("condition of the samples", [_number(fit.condition, ".4g")] * len(fits)),
        ("direction error [deg]", [_number(each.direction_error_deg, ".2f") for each in fits]),
    ]
    if fit.firmware is not None:
        cycles = ["not counted" if each.cycles is None else readable(each.cycles) for each in fits]
        rows.append((f"cycles, {fit.firmware.cycle_model}", cycles))
        if any(each.cycle_band for each in fits):
            rows.append(("cycles, lowest to highest", [str(each.cycle_band or "-") for each in fits]))
    return rows


def _reasons(each: CalibratorFit) -> RenderableType:
    head = Text(f"{each.name}: ").append(each.verdict, style=_STYLES[each.verdict])
    lines = [Text(f"  {reason_line(reason)}") for reason in each.reasons]
    return Group(head, *lines)


def reason_line(reason: Reason) -> str:
    """Return one reason of a verdict as a sentence."""
    if isinstance(reason.value, str) or isinstance(reason.threshold, str):
        return f"the fit ended as {reason.value!r}: {reason.meaning}."
    name = _NAMES[reason.figure]
    side = "above" if reason.value > reason.threshold else "below"
    unit = f" {reason.unit}" if reason.unit and reason.figure != "n" else ""  # a number of points has said it
    limit = f"{reason.threshold:g}{unit} ({reason.verdict})"
    return f"{name} {reason.value:.4g}{unit} is {side} {limit}: {reason.meaning}."


def _number(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)


def _hard_iron(each: CalibratorFit) -> str:
    """Show as small a part of the radius as four digits of it are, however far out the middle is."""
    if each.hard_iron is None or not each.radius:
        return "-"
    decimals = max(0, 3 - math.floor(math.log10(each.radius)))
    how = f".{decimals}f" if decimals <= _MOST_DECIMALS else ".4g"
    return " ".join(format(value, how) for value in each.hard_iron)


def _row(values: tuple[float, float, float]) -> str:
    return " ".join(f"{value:7.4f}" for value in values)
