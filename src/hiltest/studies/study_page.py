"""The page of a study, which is rendered from its record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hiltest import __version__
from hiltest.report.page import render
from hiltest.run_record.run import Cell, Run, Table, Verdict
from hiltest.studies.study import PrintedFigure, Study
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
    return render(
        "study.html.j2",
        package="hiltest.studies",
        study=study,
        run=run,
        figure=study.draw(run, table),
        header=PRINTED_HEADER,
        printed=list(printed_rows(study, run)),
        columns=[f"{column.name} [{column.unit}]" if column.unit else column.name for column in table.columns],
        rows=[[_text(cell) for cell in row] for row in table.rows],
        version=__version__,
    )


@dataclass(frozen=True, slots=True)
class StudyDocument:
    """Result of `hiltest study`."""

    folder: str
    """Folder of ``run.json`` and ``study.html``."""
    figures: list[PrintedFigure]
    verdict: Verdict
    """Verdict of the record."""


def printed_rows(study: Study, run: Run) -> Iterator[tuple[str, ...]]:
    """Yield a row under `PRINTED_HEADER` for each figure that a paper printed."""
    table = run.table(f"study.{study.name}.printed") or Table("", (), ())
    for row in table.rows:
        yield tuple(_text(cell) for cell in row)


def _text(cell: Cell) -> str:
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return cell if isinstance(cell, str) else format_number(cell)
