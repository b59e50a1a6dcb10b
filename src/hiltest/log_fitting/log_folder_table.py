"""Table of a folder's logs for people: one row each, and the accuracy of predictions."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from hiltest.log_fitting.log_folder import CUTS, Agreement, LogFit
from hiltest.log_fitting.sample_fit_table import STYLES, WIDTH, direction_error_text

# A prediction within a factor of two is reliable; one beyond the last value is useless.
_RIGHT, _FAR_TOO_GOOD = (0.5, 2.0), 2.5


def print_folder(logs: Sequence[LogFit], console: Console) -> None:
    """Print a row for each log, the accuracy of predictions, and the files that are not logs."""
    grid = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("log", "readings", "verdict", "best"):
        grid.add_column(heading, justify="right" if heading == "readings" else "left", overflow="fold")
    for heading in ("error [deg]", *CUTS):
        grid.add_column(escape(heading), justify="right")
    for log in logs:
        if log.fit is not None:
            best = log.fit.best
            grid.add_row(
                escape(log.name),
                str(log.fit.n_in),
                Text(best.verdict, style=STYLES[best.verdict]),
                escape(best.name),
                direction_error_text(best),
                *_ratios(log),
            )
    console.print(grid, width=min(WIDTH, console.width))
    for line in _summary([agreement for log in logs for agreement in log.agreements]):
        console.print(line, soft_wrap=True)
    for log in logs:
        if log.unread:
            console.print(escape(f"{log.name} was not read: {log.unread}"), style="dim", soft_wrap=True)


def _ratios(log: LogFit) -> list[str]:
    by_cut = {agreement.cut: agreement.ratio for agreement in log.agreements}
    return [f"{by_cut[cut]:.2f}" if cut in by_cut else "-" for cut in CUTS]


def _summary(agreements: Sequence[Agreement]) -> list[str]:
    if not agreements:
        return []
    low, high = _RIGHT
    right = sum(low <= agreement.ratio <= high for agreement in agreements)
    far = sum(agreement.ratio > _FAR_TOO_GOOD for agreement in agreements)
    return [
        "halves, tenths: angle between the best calibrator's results of two parts of a log, over the predicted one;",
        f"{low:g} to {high:g} in {right} of {len(agreements)} cases, above {_FAR_TOO_GOOD:g} in {far}",
    ]
