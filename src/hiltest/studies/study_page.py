"""The page of a study, which is rendered from its record."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from hiltest import __version__
from hiltest.measurement.estimates import Estimate
from hiltest.report.page import render
from hiltest.run_record.run import Cell, Column, Run, Table, Verdict
from hiltest.studies.quantiles import ENDS
from hiltest.studies.study import EQUAL, PrintedFigure, Study
from hiltest.text import format_number

PAGE_FILE = "study.html"
PRINTED_HEADER = ("figure", "paper", "printed", "measured", "reproduced", "why")


def study_table(study: Study, run: Run) -> Table:
    """Return the table of a study's record."""
    table = run.table(f"study.{study.name}")
    assert table is not None
    return table


def page(study: Study, run: Run) -> str:
    """Return the page: the answer, the plot, the printed and measured figures, and the table."""
    table = study_table(study, run)
    columns, rows = _joined_intervals(table)
    headings = [f"{column.name} [{column.unit}]" if column.unit else column.name for column in columns]
    estimates = {table.columns[place] for place in _interval_columns(table)}
    return render(
        "study.html.j2",
        package="hiltest.studies",
        study=study,
        run=run,
        figure=study.draw(run, table),
        header=PRINTED_HEADER,
        printed=list(printed_rows(study, run)),
        columns=[
            f"{heading}, 95 % interval" if column in estimates else heading
            for column, heading in zip(columns, headings, strict=True)
        ],
        rows=rows,
        version=__version__,
    )


def method_lines(study: Study, run: Run, methods: Collection[str]) -> Iterator[str]:
    """Yield a line for each row of these methods in the table of a study's record."""
    columns, rows = _joined_intervals(study_table(study, run))
    for row in rows:
        name = next((cell for cell in row if {*cell.split(EQUAL), cell.partition(",")[0]} & set(methods)), None)
        if name is not None:
            cells = ((column, cell) for column, cell in zip(columns, row, strict=True) if cell not in (name, "", "-"))
            yield f"{name}: " + ", ".join(f"{column.name} {cell} {column.unit}".rstrip() for column, cell in cells)


def _joined_intervals(table: Table) -> tuple[list[Column], list[list[str]]]:
    """Return columns and their texts by row; an estimate and the ends of its interval are one text."""
    with_interval = _interval_columns(table)
    shown = [place for place in range(len(table.columns)) if not with_interval & {place - 1, place - 2}]
    return [table.columns[place] for place in shown], [
        [_estimate(row[place : place + 3]) if place in with_interval else _text(row[place]) for place in shown]
        for row in table.rows
    ]


def _interval_columns(table: Table) -> set[int]:
    """Return the places of the columns whose next two are the ends of an interval."""
    names = [column.name for column in table.columns]
    return {
        place for place, name in enumerate(names) if names[place + 1 : place + 3] == [f"{name}, {end}" for end in ENDS]
    }


def _estimate(cells: Sequence[Cell]) -> str:
    value, low, high = (float(cell) if isinstance(cell, (int, float)) else None for cell in cells)
    return "" if value is None else str(Estimate(value, low, high))


@dataclass(frozen=True, slots=True)
class StudyDocument:
    """Result of `hiltest study`."""

    folder: str
    """Folder of ``run.json`` and ``study.html``."""
    figures: list[PrintedFigure]
    table: Table
    """The numbers of the study; two columns after a quantile are the ends of its 95 % confidence interval."""
    verdict: Verdict
    """Verdict of the record."""


def printed_rows(study: Study, run: Run) -> Iterator[tuple[str, ...]]:
    """Yield a row under `PRINTED_HEADER` for each figure that a paper printed."""
    table = run.table(f"study.{study.name}.printed") or Table("", (), ())
    for row in table.rows:
        yield tuple("undecided" if cell is None else _text(cell) for cell in row)


def _text(cell: Cell) -> str:
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return cell if isinstance(cell, str) else format_number(cell)
