"""Write records and pictures of docs/studies.md anew: ``python docs/studies.py [NAME ...]``, by default of all studies.

A record is the ``run.json`` of a small plan without what differs from host to host; the picture is drawn from it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from markupsafe import Markup

import hiltest.report
from hiltest.report.svg import Figure
from hiltest.run_record.files import write_atomically
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Environment, Run
from hiltest.run_record.run_json import to_json
from hiltest.studies.study import Conditions, Plan, study_of
from hiltest.studies.study_page import study_table
from hiltest.studies.study_run import run_study

FOLDER = Path(__file__).with_suffix("")

# Small enough to be renewed by a test, and large enough for the picture to look as that of the full size does. The
# interval of a 95th percentile needs 72 instances, and a row of imu 119 in which frosio has no fit.
PLANS = {
    plan.study: plan
    for plan in (
        Plan("budget", 1, 3, 30),
        Plan("choose", 1, 80, 300, Conditions(48.5, 2.5)),
        Plan("compensation", 1, 2000, 100),
        Plan("constraints", 1, 10, 30),
        Plan("dpi", 1, 80, 0),
        Plan("ellipsoids", 1, 5000, 30),
        Plan("estimators", 1, 20, 0),
        Plan("float32", 1, 100, 100),
        Plan("imu", 1, 160, 100),
    )
}

_STYLE = (Path(hiltest.report.__file__).with_name("style.css")).read_text(encoding="utf-8")
_MARGIN, _LINE = 12.0, 20.0
_LETTER = 7.2  # of 13 pixels, the widest mean of common fonts


def small_run(plan: Plan) -> Run:
    """Run a study, and return the record without what differs from host to host."""
    with TemporaryDirectory() as folder:
        run = run_study(plan, Path(folder), jobs=1, progress=lambda what, done, of: None)
    nowhere = Environment("", "", "", {})
    return replace(run, environment=nowhere, started_utc="", finished_utc="", tests=(), volatile=())


def picture(run: Run) -> str:
    """Return the study's plot as an SVG file that stands alone: its caption, its key and its style are in it."""
    (name,) = {table.name.split(".")[1] for table in run.tables}
    plan, study = PLANS[name], study_of(name)
    figure = study.draw(run, study_table(study, run))
    caption = f"{figure.title}: {plan.instances} instances" + (f" of {plan.points} points" if plan.points else "")
    key, lines = _key(figure)
    top = _MARGIN + _LINE * (1 + lines)
    width, height = figure.width + 2.0 * _MARGIN, figure.height + top + _MARGIN
    return str(
        Markup(
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {0:g} {1:g}" width="{0:g}" height="{1:g}">'
            "<style>\n{2}\n</style>\n"
            '<rect width="100%" height="100%" style="fill: var(--card)"/>\n'
            '<text class="caption" x="{3:g}" y="{4:g}">{5}</text>\n{6}\n'
            '<svg x="{3:g}" y="{7:g}" width="{8:g}" height="{9:g}">{10}</svg>\n</svg>\n'
        ).format(
            width,
            height,
            Markup(_style()),
            _MARGIN,
            _MARGIN + 14.0,
            caption,
            key,
            top,
            figure.width,
            figure.height,
            figure.svg(),
        )
    )


def _style() -> str:
    """Return the light colours of the pages, and what their style says of drawings."""
    colours = _STYLE[: _STYLE.index("}") + 1]
    drawings = [line for line in _STYLE.splitlines() if line.startswith("svg ") and not line.startswith("svg {")]
    own = (
        "svg text { font-family: system-ui, sans-serif; } svg .caption { fill: var(--ink); font-size: 14px; } "
        "svg .key { fill: var(--ink); font-size: 13px; }"
    )
    return "\n".join([colours, *drawings, own])


def _key(figure: Figure) -> tuple[Markup, int]:
    """Return the entries of the key, side by side as far as there is room, and how many lines they take."""
    x, line, drawn = 0.0, 1, []
    for entry in figure.key:
        swatch = 40.0 if entry.line else 20.0
        width = swatch + _LETTER * len(entry.text) + 16.0
        if x and x + width > figure.width:
            x, line = 0.0, line + 1
        y = _MARGIN + _LINE * line
        drawn.append(
            Markup(
                '<svg x="{:g}" y="{:g}" width="34" height="14">{}</svg><text class="key" x="{:g}" y="{:g}">{}</text>'
            ).format(_MARGIN + x, y, Markup(entry.swatch), _MARGIN + x + swatch, y + 12.0, entry.text)
        )
        x += width
    return Markup("\n").join(drawn), line


def main(names: list[str]) -> Iterator[Path]:
    """Write record and picture of each study."""
    FOLDER.mkdir(exist_ok=True)
    for name in names or sorted(PLANS):
        record = write_atomically(FOLDER / f"{name}.json", to_json(small_run(PLANS[name])))
        yield record
        yield write_atomically(record.with_suffix(".svg"), picture(read_record(record).run))


if __name__ == "__main__":
    for written in main(sys.argv[1:]):
        print(written)
