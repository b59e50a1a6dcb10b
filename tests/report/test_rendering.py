"""The HTML and Markdown reports: complete, self-contained, and safe with hostile names."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from html import unescape
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pytest

import hiltest.report
from hiltest.measurement import Limit, Measurement, check
from hiltest.report.figures.cost import budget_figures
from hiltest.report.figures.section import columns
from hiltest.report.markdown import markdown_report
from hiltest.report.marks import Mark
from hiltest.report.render import html_report, write_reports
from hiltest.report.svg import Figure, log_ticks, nice_ticks
from hiltest.report.terminal import summary
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import Findings, Run, Table, TestResult
from hiltest.verdict.verdict import decide

from .comparisons import comparison

Make = Callable[..., Findings]
HOSTILE = "<script>alert('x')</script>|`\"&"


class Page(HTMLParser):
    """Tags, attributes and text of a page; complains about tags that do not nest."""

    _VOID = frozenset({"meta", "br", "hr", "img", "link"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert not self._open, f"never closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in self._VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture
def run(findings: Make, good: list[Measurement]) -> Run:
    collected = findings(*good)
    return collected.finish(decide(collected, pytest_exit=0), "2026-01-02T03:05:00Z")


@pytest.fixture
def hostile(findings: Make) -> Run:
    collected = findings(
        check("heading.<b>.max", 1.0, unit="<i>", limit=Limit(max=2)),
        check(HOSTILE, 1.0, unit=HOSTILE),
        tests=(TestResult(HOSTILE, TestOutcome.FAILED, 1, reason=HOSTILE),),
    )
    assert collected.board is not None
    collected.board = replace(collected.board, firmware=HOSTILE, description=HOSTILE, calibrators=(HOSTILE,))
    return collected.finish(decide(collected, pytest_exit=1), "")


def test_the_page_shows_the_verdict_before_anything_else(run: Run) -> None:
    body = Page(html_report(run)).text.split("}", maxsplit=1)[-1]
    assert body.index("direct: worst heading 0.97 deg") < body.index("Accuracy and cost") < body.index("Heading error")


def test_the_page_holds_every_measurement_with_value_and_limit(run: Run) -> None:
    text = Page(html_report(run)).text
    for measurement in run.measurements:
        assert measurement.name in text
    assert "heading.direct.max 0.97 deg at most 1.8 pass" in text
    assert "cycles.direct.total 12 400 cycle" in text
    assert "cortex-m4-trm/3@sram" in text


def test_the_page_needs_no_network_and_runs_no_script_but_its_own(run: Run) -> None:
    page = Page(html_report(run))
    assert {"link", "iframe", "img", "object"}.isdisjoint(page.tags)
    (script,) = re.findall(r"<script>(.*?)</script>", html_report(run), re.S)
    assert script == (Path(hiltest.report.__file__).parent / "rows.js").read_text(encoding="utf-8")
    digest = b64encode(sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in html_report(run)
    assert not [value for name, value in page.attributes if name in ("src", "srcset", "data")]
    assert all((value or "").startswith("#") for name, value in page.attributes if name == "href")
    style = re.search(r"<style>(.*?)</style>", html_report(run), re.S)
    assert style is not None
    assert "url(" not in style[1]
    assert "@import" not in style[1]
    assert "prefers-color-scheme: dark" in style[1]


def test_every_plot_says_in_words_what_it_shows(run: Run) -> None:
    page = html_report(run)
    matches = re.findall(r'<svg [^>]*role="img"><title>([^<]*)</title><desc>([^<]*)</desc>', page)
    assert len(matches) == page.count('role="img"') >= 8
    words = dict(matches)
    assert words["direct: worst +0.97° at 90°"] == "60 poses, limit 1.8 degrees"
    sizes = words["Cycles of one calibration over its points"]
    assert "iterative: 43 000 cycles for 20 points to 603 000 for 300" in sizes
    assert words["after direct"] == "200 samples seen along z, with the unit circle"
    # What is drawn for the eye alone says nothing to a screen reader.
    assert page.count("<svg") == len(matches) + page.count('class="swatch"')
    assert page.count('class="swatch"') == page.count('aria-hidden="true"') - 1


def test_markdown_leads_with_what_is_out_of_order(findings: Make, good: list[Measurement]) -> None:
    bad = check("gyroscope.bias_error", 0.4, unit="dps", limit=Limit(max=0.1), test="t.py::t")
    collected = findings(*good, bad, tests=(TestResult("t.py::t", TestOutcome.FAILED, 1, reason="out"),))
    text = markdown_report(collected.finish(decide(collected, pytest_exit=1), ""))
    assert text.startswith("# FAIL: 1 of 7 limits missed\n\ngyroscope.bias\\_error 0.4 dps (limit 0.1)")
    assert text.index("\nNext: ") < text.index("<details>")


def test_a_pose_without_heading_is_left_out_of_the_plot(run: Run) -> None:
    table = run.table("heading.poses")
    assert table is not None
    holes = replace(table, rows=tuple((*row[:4], None, None, None) for row in table.rows))
    tables = tuple(holes if table.name == "heading.poses" else table for table in run.tables)
    assert "no pose was answered" in html_report(replace(run, tables=tables))


def test_the_terminal_begins_with_the_verdict_and_ends_with_where_the_report_is(run: Run, tmp_path: Path) -> None:
    write_reports(run, tmp_path)
    text = summary(run, tmp_path, verbose=False, width=80, colour=False)
    assert "\x1b" not in text
    assert "board.wall_seconds" not in text
    assert " ".join(text.split()).startswith(run.verdict.sentence)
    assert re.search(r"^direct +0\.97 +1\.8 +12 400 +1\.00 *$", text, re.MULTILINE)
    assert re.search(r"^Report: .*report\.html \(\d+ measurements; -v prints them\)$", text, re.MULTILINE)
    assert max(map(len, text.splitlines()[:-1])) <= 80
    every = summary(run, tmp_path, verbose=True, width=100, colour=False)
    assert re.search(r"heading\.direct\.max +0\.97 +deg +at most 1\.8 +pass", every)
    assert "board.wall_seconds" in every


def test_the_smallest_change_that_a_comparison_sees_stands_beside_each_limit(run: Run, tmp_path: Path) -> None:
    """On the virtual board the tolerance, for the noise is the same; on a real one the noise of the default rig."""
    every = " ".join(summary(run, tmp_path, verbose=True, width=100, colour=False).split())
    assert re.search(r"detects in 4 of 5 cases, where there is a limit \[deg\] .*heading\.direct\.max 0\.01\b", every)
    assert "| heading.direct.max | 0.97 | deg | at most 1.8, change 0.01 |" in markdown_report(run)
    assert "heading.direct.max 0.97 deg at most 1.8 pass 0.01" in Page(html_report(run)).text
    assert run.board is not None
    bench = replace(run, board=replace(run.board, kind="real"))
    (match,) = re.findall(r"\| heading\.direct\.max \| .* at most 1\.8, change (\S+) \|", markdown_report(bench))
    assert 0.5 < float(match) < 1.8


def test_a_failing_run_begins_with_what_failed_and_what_to_do_next(
    findings: Make, heading: Callable[..., list[Measurement]], tmp_path: Path
) -> None:
    bad = [replace(item, place="test_heading.py:74") for item in heading("direct", 6.3, limit=1.8, cycles=12_400)]
    warm = check("gyroscope.bias_error", 0.4, unit="dps", limit=Limit(max=0.1), place="test_gyroscope.py:9")
    collected = findings(*bad, warm)
    text = summary(
        collected.finish(decide(collected, pytest_exit=1), ""), tmp_path, verbose=False, width=80, colour=False
    )
    lines = text.splitlines()
    assert lines[:2] == ["FAIL: 3 of 4 limits missed.", "  heading.direct.max 6.30 deg (limit 1.8), test_heading.py:74"]
    assert lines[2].startswith("  Likely cause: good fit, bad heading")
    action = next(index for index, line in enumerate(lines) if line.startswith("  Next: "))
    table = next(index for index, line in enumerate(lines) if line.startswith("calibrator "))
    assert action < lines.index("  gyroscope.bias_error 0.4 dps (limit 0.1), test_gyroscope.py:9") < table
    assert (text.count("heading.direct.max 6.30"), text.lower().count("likely cause")) == (1, 1), "said once"


def test_the_terminal_counts_failures_beyond_the_first_few(findings: Make, tmp_path: Path) -> None:
    run = findings(*(check(f"lamp.{k}", 2.0 + k, unit="mA", limit=Limit(max=1)) for k in range(6)))
    finished = run.finish(decide(run, pytest_exit=1), "")
    text = summary(finished, tmp_path, verbose=False, width=80, colour=False)
    assert [f"lamp.{k} " in text for k in range(6)] == [True, True, True, False, False, False]
    assert "and 3 more in the report" in text
    assert "lamp.5 " in summary(finished, tmp_path, verbose=True, width=80, colour=False).partition("Report:")[0]


def test_markup_in_names_does_not_style_the_terminal(hostile: Run, tmp_path: Path) -> None:
    odd = replace(hostile.measurements[0], name="[red]x[/red]")
    text = summary(replace(hostile, measurements=(odd,)), tmp_path, verbose=True, width=200, colour=False)
    assert "[red]x[/red]" in text


@pytest.mark.parametrize(("as_read_deg", "marked"), [(11.5, False), (0.3, True)])
def test_a_calibrator_stands_beside_the_heading_as_read_and_is_marked_if_worse(
    findings: Make, good: list[Measurement], tmp_path: Path, as_read_deg: float, marked: bool
) -> None:
    measured = findings(*good, check("heading.uncalibrated.max", as_read_deg, unit="deg"))
    run = measured.finish(decide(measured, pytest_exit=0), "")
    for report in (
        summary(run, tmp_path, verbose=False, width=80, colour=False),
        Page(html_report(run)).text,
        markdown_report(run),
    ):
        assert "as read" in report
        assert ("worse than as read" in report) == marked


@pytest.mark.parametrize(
    ("ends", "ticks"),
    [((0, 1), (0, 0.2, 0.4, 0.6, 0.8, 1.0)), ((-2.1, 2.1), (-2, -1, 0, 1, 2)), ((0, 36.7), (0, 10, 20, 30))],
)
def test_ticks_are_round_numbers(ends: tuple[float, float], ticks: tuple[float, ...]) -> None:
    assert nice_ticks(*ends) == pytest.approx(ticks)


@pytest.mark.parametrize("most", [3, 4, 6])
def test_the_last_row_of_panels_is_half_full_at_least(most: int) -> None:
    for count in range(1, 37):  # 37 are two of five in the last row, as good as it gets
        across = columns(count, most)
        assert 2 * ((count - 1) % across + 1) >= across
        assert min(count, most) // 2 < across <= most + 1


def test_a_figure_maps_its_corners_to_the_frame() -> None:
    figure = Figure("t", "d", "x", "y", x_range=(0, 360), y_range=(-2, 2), width=640, height=300)
    assert figure.place(0, 2) == (68, 14)
    assert figure.place(360, -2) == (626, 256)


def test_error_against_cycles_is_drawn_one_figure_a_size_with_the_thesis_beside_it(run: Run) -> None:
    thirty, hundred = budget_figures(run)
    assert thirty.title.startswith("30 points")
    assert hundred.title.startswith("100 points")
    drawing = str(thirty.svg())
    assert "direct ends at 0.70 degrees for 4 600 cycles; iterative ends at 0.70 degrees for 90 000" in drawing
    assert "thesis: 168 N + 2600 = 7 640" in drawing
    assert "thesis: 2860 N = 85 800" in drawing
    assert [item.text for item in thirty.key] == ["direct", "iterative", "slow-stream: none yet"]
    assert "slow-stream has no calibration after 12 000 cycles" in drawing
    # An effort without a calibration is no point; the others are: two, and one of another shape.
    # A sphere that stands in for a refused ellipsoid is hollow.
    assert re.findall(r'<circle class="([^"]*)"', drawing) == ["series-0 filled", "series-0 filled", "series-0 hollow"]
    assert re.findall(r'<path class="mark ([^"]*)"', drawing) == ["series-1 filled"]
    # Equal ratios are equal distances.
    places = [thirty.place(x, 1.0)[0] for x in (4_000.0, 8_000.0, 16_000.0)]
    assert places[1] - places[0] == pytest.approx(places[2] - places[1])


@pytest.mark.parametrize("decades", range(1, 40))
def test_a_logarithmic_axis_has_two_to_ten_labels(decades: int) -> None:
    ticks = log_ticks(0.7e-6, 1.3 * 10.0 ** (decades - 6))
    assert 2 <= len(ticks) <= 10
    assert all(low < high for low, high in pairwise(ticks))


def test_a_point_names_its_numbers_and_its_row() -> None:
    figure = Figure("t", "d", "x [s]", "y [uT]", (0.0, 3.0), (0.0, 9.0))
    figure.series("one", [(1.0, 5.0), (2.0, 6.5)], "series-0", Mark.DOT)
    figure.series("<two>", [(1.5, 7.0)], "series-1", Mark.CROSS)
    assert figure.sheet is not None
    found = re.findall(r'<g data-row="(\d+)"><title>([^<]*)</title>', figure.svg())
    assert [(int(row), unescape(words)) for row, words in found] == [
        (row, ", ".join(cells)) for row, cells in enumerate(figure.sheet.rows)
    ]


def test_a_logarithmic_axis_has_no_zero() -> None:
    assert log_ticks(900.0, 12_000.0) == (1000.0, 2000.0, 5000.0, 10_000.0)
    with pytest.raises(ValueError, match="logarithmic axis"):
        log_ticks(0.0, 10.0)


def test_what_streams_know_on_the_way_is_in_both_reports(findings: Make, good: list[Measurement]) -> None:
    cycles = {"cycles_mean": 246.03, "cycles_median": 246.0, "cycles_max": 255.0, "fit_cycles": 3503}
    collected = findings(
        *good,
        *(
            check(f"stream.direct-stream.{name}", value, unit="cycle", cycle_model="m")
            for name, value in cycles.items()
        ),
    )
    run = collected.finish(decide(collected, pytest_exit=0), "")
    page = Page(html_report(run)).text
    assert "Streaming calibrators" in page
    rows = [line for line in markdown_report(run).splitlines() if line.startswith(("| direct-stream", "| slow-stream"))]
    assert rows == [
        "| direct-stream | 100 | 100 |  | poor coverage: sphere |  | 3.27 deg | 1.12 deg |  |  |  |  |",
        "| direct-stream | 300 | 300 |  | ellipsoid |  | 0.81 deg | 0.23 deg | 246 | 246 | 255 | 3 503 |",
        "| slow-stream | 100 | 96 |  | too few points |  |  |  |  |  |  |  |",
        "| slow-stream | 300 | 217 | 4 | sphere | 1.57 % | 2.42 deg | 0.97 deg |  |  |  |  |",
    ]
    for cell in ("poor coverage: sphere", "too few points", "1.57 %", "3 503"):
        assert cell in page
    for report in (html_report, markdown_report):
        assert "slow-stream" not in report(replace(run, tables=()))


def test_curves_and_stages_of_a_suite_that_says_nothing_of_spheres_are_shown(run: Run) -> None:
    """`hiltest init` copied suites before they did."""
    tables = tuple(without_column(table, "sphere") for table in run.tables)
    older = replace(run, tables=tables)
    assert "sphere" not in str(budget_figures(older)[0].svg())
    assert "| slow-stream | 300 | 217 | 4 | ellipsoid |" in markdown_report(older)


def without_column(table: Table, name: str) -> Table:
    keep = [index for index, column in enumerate(table.columns) if column.name != name]
    return Table(
        table.name,
        tuple(table.columns[index] for index in keep),
        tuple(tuple(row[index] for index in keep) for row in table.rows),
    )


def test_a_long_number_at_the_right_end_of_an_axis_is_not_cut() -> None:
    drawn = str(Figure("t", "d", "x", "y", x_range=(0, 10_000), y_range=(0, 1), width=400, height=300).svg())
    texts = re.findall(r'<text x="([0-9.]+)" [^>]*>([^<]*)<', drawn)
    (x,) = [float(x) for x, label in texts if label == "10000"]
    # A digit of DejaVu Sans, the widest of the usual fonts, is 0.64 em: 9.6 of the 15 px on a telephone.
    assert x + 9.6 / 2 * len("10000") <= 400


@pytest.mark.parametrize("value", [9.0, 1.0], ids=["out of its limit", "within it"])
def test_the_only_obstacle_of_a_comparison_is_printed_once_also_beside_a_missed_limit(
    findings: Make, tmp_path: Path, value: float
) -> None:
    obstacle = "another rig: mine (b7d25d4f) before, mine (761c7d55) now"
    compared = comparison(obstacles=(obstacle,))
    measurement = check("heading.direct.max", value, unit="deg", limit=Limit(max=2))
    collected = replace(findings(measurement), comparison=compared)
    run = collected.finish(decide(collected, pytest_exit=int(value > 2)), "2026-01-02T03:05:00Z")
    printed = " ".join(summary(run, tmp_path, verbose=False, width=200, colour=False).split())
    assert printed.count(obstacle) == 1
