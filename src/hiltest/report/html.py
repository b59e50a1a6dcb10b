"""Render a run as one self-contained HTML file: no script, no address, light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from hiltest.report import overview, stream_overview
from hiltest.report.budget_plot import budget_figures
from hiltest.report.fusion_plot import fusion_figures
from hiltest.report.plots import cloud_figures, cycle_figures, heading_figures
from hiltest.report.record import Run
from hiltest.report.svg import Figure
from hiltest.report.terminal import shown_limit, shown_outcome, shown_value

_TONES = {"pass": "good", "not judged": "warn", "interrupted": "warn", "no tests": "warn"}


@dataclass(frozen=True, slots=True)
class FigureGroup:
    """Figures under one heading."""

    heading: str
    legend: str
    figures: Sequence[Figure]
    small: bool = False


def html_report(run: Run) -> str:
    """Return the page of a run.

    Every text of the run is escaped, so a firmware called ``<script>`` shows as text.
    """
    environment = Environment(
        loader=PackageLoader("hiltest.report", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )
    environment.filters |= {
        "value": shown_value, "limit": shown_limit, "outcome": shown_outcome,
        "tone": overview.tone, "origin": overview.origin,
    }
    return environment.get_template("report.html.j2").render(
        run=run, tone=_TONES.get(run.verdict.outcome, "bad"), board_line=overview.board_line(run),
        calibrators=overview.accuracy_and_cost(run), groups=overview.groups(run), figures=_figure_groups(run),
        streams=stream_overview, stream_stages=stream_overview.stream_stages(run),
        provenance=list(overview.provenance(run)),
    )


def _figure_groups(run: Run) -> list[FigureGroup]:
    groups = [
        FigureGroup(
            "Heading error", "Filled, joined: level poses. Rings: tilted by 20 degrees. Dashed: the limit.",
            heading_figures(run),
        ),
        FigureGroup(
            "The cloud", "What the board collected, then the same points as it corrected them, with the unit circle.",
            cloud_figures(run), small=True,
        ),
        FigureGroup(
            "Error against cycle budget",
            "Each calibrator with more and more effort on the same points: a closed form with more of them, one that "
            "iterates with more sweeps, a stream calibrator with more points seen. Mean over the known angles. Hollow: "
            "there was no ellipsoid, only a sphere was fitted. Dashed: the cycles that the thesis counts for its own "
            "calibrator and for the library's.",
            budget_figures(run),
        ),
        FigureGroup(
            "Fusion",
            "Heading while the board was turned and tilted, against the truth; all three began with the same attitude.",
            fusion_figures(run),
        ),
        FigureGroup(
            "Cycles", "Dots: counted on the board. Line: least squares through them.", cycle_figures(run),
        ),
    ]
    return [group for group in groups if group.figures]
