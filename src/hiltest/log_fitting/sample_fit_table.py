"""Fitted samples for people: tables and sentences within 80 columns."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from hiltest.calibration.acceptance import Acceptance, Reason
from hiltest.calibration.direction_error import LARGEST_PREDICTED_DEG
from hiltest.log_fitting.fit_result import AgainstGravity, CalibratorFit, GravityFigures, SampleFit
from hiltest.log_fitting.fit_sentence import headline
from hiltest.text import format_number

STYLES = {Acceptance.GOOD: "green", Acceptance.FAIR: "yellow", Acceptance.POOR: "red", Acceptance.REFUSED: "bold red"}
_NAMES = {
    "n": "number of points",
    "condition": "condition",
    "residual_percent": "residual",
    "axis_ratio": "axis ratio",
    "radius_ut": "radius",
    "direction_error_deg": "direction error",
    "change_percent": "change of the field",
    "growth_percent": "growth of the field",
    "residual_of_spread": "residual over the spread of the raw norms",
    "halves_difference": "difference of the halves over the predicted one",
    "strong_iron_deg": "direction error under strong iron",
    "rests": "number of rests",
    "turns": "number of turns",
    "spread_after_percent": "spread of norms",
    "left_out_percent": "left out",
    "left_percent": "left of a turn",
}
WIDTH = 80
# Number of calibrators in one table of a page; more become several tables.
_MOST_COLUMNS = 5
# Figures that are nearly equal for all calibrators, or only exist on a board.
_OF_SAMPLES = ("coverage [%]", "condition of the samples", "from all samples [deg]")
# Maximum number of sentences.
_MOST_DECIMALS = 8


def print_fit(fit: SampleFit, console: Console) -> None:
    """Print a summary of the samples, a table of calibrators, the best one's numbers, reasons and notes."""
    points = f"{fit.n_in} points, columns {', '.join(fit.columns)} [{fit.unit}]"
    console.print(escape(f"{fit.file}: {points}"), soft_wrap=True)
    shown = _select_shown(fit)
    grid = _grid(shown)
    unlimited = console.options.update(max_width=10 * WIDTH)
    if len(shown.calibrators) > 2 or console.measure(grid, options=unlimited).maximum > WIDTH:
        grid = _grid_of_rows(shown)
    console.print(grid, width=min(WIDTH, console.width))
    if fit.gravity is not None and not fit.gravity.unused:
        console.print(_gravity_grid(fit, fit.gravity), width=min(WIDTH, console.width))
    for line in _best(fit):
        console.print(line, soft_wrap=True)
    columns = os.environ.get("COLUMNS", "")
    for style, sentences in (("", told_reasons(fit)), ("dim", iter(fit.notes)), ("bold", iter([headline(fit)]))):
        for sentence in sentences:
            text = Text(sentence, style=style)
            folded = text.wrap(console, int(columns)) if columns.isdecimal() else [text]
            console.print(*folded, sep="\n", soft_wrap=not console.is_terminal)


def _select_shown(fit: SampleFit) -> SampleFit:
    """Return a fit without results that have a separate table, and without calibrators that a shape replaces.

    The latter are all refused for one reason.
    """
    if fit.best.shape:
        return replace(fit, calibrators=(fit.best, fit.as_read), firmware=None)
    return replace(fit, calibrators=_fits_of_norms(fit))


def _fits_of_norms(fit: SampleFit) -> tuple[CalibratorFit, ...]:
    """Return the calibrators of norms alone, then the readings without calibration."""
    return (*(calibrator for calibrator in fit.calibrators if calibrator.gravity is None), fit.as_read)


def _grid(fit: SampleFit) -> Table:
    grid = Table(box=SIMPLE_HEAD, pad_edge=False)
    grid.add_column("")
    for calibrator in fit.calibrators:
        grid.add_column(escape(calibrator.name), justify="right")
    grid.add_row("verdict", *(Text(result.verdict_text, style=STYLES[result.verdict]) for result in fit.calibrators))
    for label, cells in (*_kind_rows(fit), *_number_rows(fit), *_cycle_rows(fit, "cycles")):
        grid.add_row(escape(label), *map(escape, cells))
    return grid


def _grid_of_rows(fit: SampleFit) -> Table:
    """Return a table with a row per calibrator and the figures that differ."""
    (kind, kinds), *_ = _kind_rows(fit)
    figures = [row for row in _number_rows(fit) if row[0] not in _OF_SAMPLES]
    cycles = [("cycles", [format_number(calibrator.cycles) for calibrator in fit.calibrators])] if fit.firmware else []
    grid = Table(box=SIMPLE_HEAD, padding=0)
    for label in ("", "verdict", kind):
        grid.add_column(label, no_wrap=label != kind)
    for label, _ in (*figures, *cycles):
        grid.add_column(escape(label.removeprefix("direction ").replace(" ", "\n")), justify="right", no_wrap=True)
    for index, result in enumerate(fit.calibrators):
        cells = (kinds[index], *(cells[index] for _, cells in (*figures, *cycles)))
        grid.add_row(escape(result.name), Text(result.verdict_text, style=STYLES[result.verdict]), *map(escape, cells))
    return grid


def _gravity_grid(fit: SampleFit, log: AgainstGravity) -> Table:
    """Return a table of fits against gravity beside norms alone, which cannot show a rotation."""
    grid, fits = (
        Table(box=SIMPLE_HEAD, pad_edge=False),
        [result for result in fit.calibrators if result.gravity is not None],
    )
    grid.add_column(f"against gravity, {log.n_pairs} pairs")
    for name in ("norms alone", *(result.name for result in fits)):
        grid.add_column(escape(name), justify="right")
    grid.add_row("verdict", "", *(Text(result.verdict_text, style=STYLES[result.verdict]) for result in fits))
    (label, spreads), *others = _gravity_rows(fits)
    grid.add_row(escape(label), _number(log.norms_held_out_dip_deg, ".2f"), *spreads)
    for label, cells in (*others, ("residual [%]", [_number(result.residual_percent, ".2f") for result in fits])):
        grid.add_row(escape(label), "", *cells)
    return grid


def _gravity_rows(fits: Sequence[CalibratorFit]) -> list[tuple[str, list[str]]]:
    figures = [fit.gravity or GravityFigures() for fit in fits]
    return [
        ("dip varies, held out [deg]", [_number(figure.held_out_dip_deg, ".2f") for figure in figures]),
        ("dip [deg]", [_number(figure.dip_deg, ".1f") for figure in figures]),
        ("rotation found [deg]", [_number(figure.rotation_deg, ".1f") for figure in figures]),
    ]


@dataclass(frozen=True, slots=True)
class FigureTable:
    """Figures of some calibrators as columns: each row has a label, and a text per calibrator."""

    caption: str
    fits: tuple[CalibratorFit, ...]
    rows: list[tuple[str, list[str]]]


def figure_tables(fit: SampleFit) -> list[FigureTable]:
    """Return the figures of a fit with hard and soft iron; those against gravity separately, because six do not fit."""
    label = f"cycles, {fit.firmware.cycle_model}" if fit.firmware else ""
    norms = _fits_of_norms(fit)
    tables = []
    for first in range(0, len(norms), _MOST_COLUMNS):
        part = replace(fit, calibrators=norms[first : first + _MOST_COLUMNS])
        rows = [*_kind_rows(part), *_iron_rows(part), *_number_rows(part), *_cycle_rows(part, label)]
        further = ", continued" if first else ""
        tables.append(FigureTable(f"Results of each calibrator{further}", part.calibrators, rows))
    if fit.gravity is not None and not fit.gravity.unused:
        against = replace(fit, calibrators=tuple(result for result in fit.calibrators if result.gravity), firmware=None)
        caption = "Against gravity"
        if fit.gravity.norms_held_out_dip_deg is not None:
            caption += f"; with norms alone the dip varies by {fit.gravity.norms_held_out_dip_deg:.2f} deg"
        rows = [*_kind_rows(against), *_iron_rows(against), *_number_rows(against), *_gravity_rows(against.calibrators)]
        tables.append(FigureTable(caption, against.calibrators, rows))
    return tables


def _kind_rows(fit: SampleFit) -> list[tuple[str, list[str]]]:
    return [
        ("fit", [calibrator.status for calibrator in fit.calibrators]),
        ("points used", [str(calibrator.n_used) for calibrator in fit.calibrators]),
    ]


def _iron_rows(fit: SampleFit) -> list[tuple[str, list[str]]]:
    return [
        (f"hard iron [{fit.unit}]", [_hard_iron(calibrator) for calibrator in fit.calibrators]),
        ("soft iron [1]", ["\n".join(map(_row, calibrator.soft_iron or ())) or "-" for calibrator in fit.calibrators]),
    ]


def _number_rows(fit: SampleFit) -> list[tuple[str, list[str]]]:
    fits = fit.calibrators
    return [
        (f"radius [{fit.unit}]", [_number(result.radius, ".4g") for result in fits]),
        ("residual [%]", [_number(result.residual_percent, ".2f") for result in fits]),
        ("coverage [%]", [_number(result.coverage and 100 * result.coverage, ".0f") for result in fits]),
        ("axis ratio", [_number(result.axis_ratio, ".3f") for result in fits]),
        ("condition of the samples", [_number(fit.condition, ".4g")] * len(fits)),
        ("direction error [deg]", list(map(direction_error_text, fits))),
        *(
            [("from all samples [deg]", [_number(result.host_difference_deg, ".2f") for result in fits])]
            if fit.firmware is not None
            else []
        ),
    ]


def _cycle_rows(fit: SampleFit, label: str) -> list[tuple[str, list[str]]]:
    if fit.firmware is None:
        return []
    fits = fit.calibrators
    rows = [(label, ["not counted" if result.cycles is None else format_number(result.cycles) for result in fits])]
    if any(result.cycle_band for result in fits):
        rows.append(
            ("cycles, lowest", [format_number(result.cycle_band.low if result.cycle_band else None) for result in fits])
        )
        rows.append(
            (
                "cycles, highest",
                [format_number(result.cycle_band.high if result.cycle_band else None) for result in fits],
            )
        )
    return rows


def _best(fit: SampleFit) -> list[str]:
    """Return hard and soft iron of the best calibrator only, because all would not fit."""
    best = fit.best
    lines = [f"cycles counted by {fit.firmware.cycle_model}"] if fit.firmware and best.shape is None else []
    if best.hard_iron is not None and best.soft_iron is not None:
        lines += [
            f"{escape(best.name)}: hard iron {escape(f'[{fit.unit}]')} {_hard_iron(best)}; soft iron {escape('[1]')}",
            *(f"  {_row(row)}" for row in best.soft_iron),
            *_accelerometer(fit),
            "--json has those of every calibrator",
        ]
    return lines


def _accelerometer(fit: SampleFit) -> list[str]:
    """Return the accelerometer's calibration, which a calibration against gravity needs."""
    gravity = fit.best.gravity
    if gravity is None or fit.gravity is None or not gravity.accelerometer_gain or not gravity.accelerometer_offset:
        return []
    offset = " ".join(format(value, ".4g") for value in gravity.accelerometer_offset)
    units = escape(f"[{fit.gravity.unit}]"), escape(f"[{fit.gravity.gain_unit}]")
    return [
        f"  in the axes of the accelerometer: offset {units[0]} {offset}; gain {units[1]}",
        *(f"  {' '.join(format(value, '9.4g') for value in row)}" for row in gravity.accelerometer_gain),
    ]


def told_reasons(fit: SampleFit) -> Iterator[str]:
    """Yield each reason once, with its calibrators if it does not apply to all.

    For calibrators that a shape replaces, only the common reason is given.
    """
    by_reason: dict[tuple[object, ...], list[tuple[str, Reason]]] = {}
    for calibrator in fit.calibrators:
        for reason in calibrator.reasons:
            same = (reason.figure, reason.threshold, reason.unit, reason.verdict, reason.meaning)
            by_reason.setdefault(same, []).append((calibrator.name, reason))
    count, best = len(fit.calibrators), fit.best
    for named in by_reason.values():
        names, values = [name for name, _ in named], [reason.value for _, reason in named]
        is_common = len(names) == count - 1 and named[0][1].verdict is Acceptance.REFUSED
        if best.shape and best.name not in names and not is_common:
            continue
        line = reason_line(named[0][1], values[:1] if len(set(values)) == 1 else values)
        yield line if len(names) == count and len(set(values)) == 1 else f"{', '.join(names)}: {line}"


def reason_line(reason: Reason, values: Sequence[float | str] = ()) -> str:
    """Return one reason of a verdict as a sentence, for one calibrator or with the `values` of several."""
    if isinstance(reason.value, str) or isinstance(reason.threshold, str):
        if reason.figure == "shape":
            return f"fitted by '{reason.value}', not by '{reason.threshold}' ({reason.verdict}): {reason.meaning}."
        return f"the fit ended as '{reason.value}': {reason.meaning}."
    shown = ", ".join(
        f"> {value:g}" if reason.unit == "deg" and value == LARGEST_PREDICTED_DEG else f"{value:.4g}"
        for value in values or (reason.value,)
    )
    name = _NAMES[reason.figure]
    side = "above" if reason.value > reason.threshold else "below"
    unit = f" {reason.unit}" if reason.unit and reason.figure != "n" else ""  # the text already counts points
    limit = f"{reason.threshold:g}{unit} ({reason.verdict})"
    return f"{name} {shown}{unit} is {side} {limit}: {reason.meaning}{'' if reason.meaning.endswith('?') else '.'}"


def direction_error_text(fit: CalibratorFit) -> str:
    """Return the direction error [deg], a bound if the predicted one is too large, or a dash without one."""
    is_bound = fit.direction_error_deg is None and any(reason.figure == "direction_error_deg" for reason in fit.reasons)
    return f"> {LARGEST_PREDICTED_DEG:g}" if is_bound else _number(fit.direction_error_deg, ".2f")


def _number(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)


def _hard_iron(fit: CalibratorFit) -> str:
    """Format an offset with a resolution of four digits of the radius, regardless of its size."""
    if fit.hard_iron is None or not fit.radius:
        return "-"
    decimals = max(0, 3 - math.floor(math.log10(fit.radius)))
    how = f".{decimals}f" if decimals <= _MOST_DECIMALS else ".4g"
    return " ".join(format(value, how) for value in fit.hard_iron)


def _row(values: tuple[float, float, float]) -> str:
    return " ".join(f"{value:7.4f}" for value in values)
