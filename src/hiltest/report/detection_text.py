"""Number of runs that detect a change, as text for the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hiltest.report.comparison_text import say
from hiltest.text import format_number
from hiltest.verdict.detection import Detection
from hiltest.verdict.evidence import REAL


def print_detection(console: Console, detection: Detection) -> None:
    """Print the number of runs for each measurement, and the assumptions."""
    say(
        console,
        f"To detect a change of {detection.size:g} {detection.unit} in 4 of 5 comparisons, with at most 1 of 100 "
        f"comparisons of unchanged firmware that calls any of {detection.sharing} measurements worse:",
    )
    paired = detection.board != REAL
    grid = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    grid.add_column("measurement", overflow="fold")
    headings = ["deviation", "runs a side", *(["seeds, paired", "tolerance"] if paired else [])]
    for heading in headings:
        grid.add_column(heading, justify="right", no_wrap=True)
    for needed in detection.measurements:
        cells = [format_number(needed.deviation, 3), _count(needed.runs)]
        grid.add_row(
            escape(needed.name), *cells, *([_count(needed.seeds), format_number(needed.tolerance, 3)] if paired else [])
        )
    console.print(grid)
    if not detection.of_base:
        say(
            console,
            "BASE has too few runs to estimate their differences: the deviations are those of the default rig. Save "
            "at least five runs of one firmware: hiltest baseline save RUN... FILE",
        )
    if paired:
        say(
            console,
            "Runs per side are for a board with this noise; on a virtual board both firmwares read the same samples.",
        )


def _count(count: int | None) -> str:
    return "none is enough" if count is None else format_number(count)
