"""The page of a run, section by section: what is shown, what is left out, and how it is told."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.measurement import EXACT, Better, CycleRange, Limit, Measurement, Tolerance, check
from hiltest.report.figures.cost import cost_group
from hiltest.report.figures.heading import FailedHeading, failed_heading
from hiltest.report.markdown import markdown_report
from hiltest.report.overview import accuracy_and_cost, tally
from hiltest.report.render import html_report
from hiltest.report.svg import Figure
from hiltest.report.terminal import summary
from hiltest.run_record.comparison import Change, Comparison, Difference, Side
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import Column, Findings, Run, Table, TestResult
from hiltest.text import legible
from hiltest.verdict.summary import summarise
from hiltest.verdict.verdict import decide

Make = Callable[..., Findings]
SIDE = Side("base.json", "ab" * 32, "hiltest-frdm-k64f", "0.1.0", "0123", "GCC 12.2.1", "m", "virtual-k64f", (1,), "")


@pytest.fixture
def run(findings: Make, good: list[Measurement]) -> Run:
    return finished(findings(*good))


def finished(collected: Findings) -> Run:
    return collected.finish(decide(collected, pytest_exit=0), "2026-01-02T03:05:00Z")


def text_of(page: str) -> str:
    """Return what is read on a page, without its style sheet and without what only drawings have."""
    body = page[page.index("<body>") :]
    return " ".join(re.sub(r"<[^>]*>", " ", re.sub(r"<svg.*?</svg>", " ", body, flags=re.S)).split())


def difference(name: str, change: Change, base: float | None, new: float | None, **more: object) -> Difference:
    delta = None if base is None or new is None else new - base
    arguments = {
        "unit": "cycle",
        "sense": Better.LOWER,
        "interval": None,
        "seeds": 1,
        "tolerance": EXACT,
        "limit": None,
        "outcome": "information",
        "cycle_model": "m",
        "note": "",
    } | more
    return Difference(name=name, change=change, base=base, new=new, delta=delta, **arguments)  # type: ignore[arg-type]


def test_streams_have_their_cycles_in_the_table_of_all_calibrators(
    findings: Make, good: list[Measurement], heading: Callable[..., list[Measurement]]
) -> None:
    cycles = {"cycles_mean": 246.03, "cycles_max": 255.0, "fit_cycles": 3503}
    stream = [item for item in heading("direct-stream", 0.9, limit=1.8, cycles=1) if item.name.startswith("heading")]
    run = finished(
        findings(
            *good,
            *stream,
            *(
                check(f"stream.direct-stream.{name}", value, unit="cycle", cycle_model="m")
                for name, value in cycles.items()
            ),
        )
    )
    table = accuracy_and_cost(run)
    assert [row.name for row in table.rows] == ["direct", "iterative", "direct-stream"]
    row = dict(zip(table.headings, table.rows[-1].cells, strict=True))
    # 300 points of the table of stages: 300 times 246.03, and the fit's 3 503.
    assert (row["cycles"].text, row["cycles"].note) == ("77 312", "300 points")
    assert (row["per point"].text, row["per point"].note) == ("246", "max 255")
    assert row["fixed"].text == "3 503"
    assert "direct-stream: 0.90 degrees for 77 312 cycles" in html_report(run)
    total = check("stream.direct-stream.total", 77_312, unit="cycle", cycle_model="m", band=CycleRange(76_000, 80_500))
    banded = accuracy_and_cost(replace(run, measurements=(*run.measurements, total))).rows[-1]
    assert "300 points, 76 000 to 80 500" in [cell.note for cell in banded.cells]


def test_cycles_with_and_without_the_waits_of_memories_are_two_columns_that_say_which(
    findings: Make, good: list[Measurement]
) -> None:
    plain = accuracy_and_cost(finished(findings(*good)))
    assert "cycles" in plain.headings
    waited = check("cycles.direct.from_flash", 12_345, unit="cycle", cycle_model="m@flash")
    run = finished(findings(*good, waited))
    table = accuracy_and_cost(run)
    assert [heading for heading in table.headings if "cycles" in heading] == [
        "cycles without memory waits (ranked)",
        "cycles as it runs from flash",
    ]
    direct, iterative = ([cell.text for cell in row.cells] for row in table.rows[:2])
    place = table.headings.index("cycles as it runs from flash")
    assert (direct[place], iterative[place]) == ("12 345", "")
    assert "cycles by cortex-m4-trm/3@sram, from flash by m@flash" in text_of(html_report(run))
    answer = summary(run, Path("out"), verbose=False, width=100, colour=False)
    assert "(ranked)" in answer
    assert "from flash" in answer
    (line,) = [line for line in answer.splitlines() if line.startswith("direct ")]
    assert "12 345" in line


def test_a_limit_far_from_all_that_is_compared_is_not_drawn(
    findings: Make, heading: Callable[..., list[Measurement]]
) -> None:
    for limit, is_drawn in ((1.8, True), (5.0, False)):
        both = heading("direct", 0.4, limit=limit, cycles=12_400) + heading("iterative", 0.5, limit=1.8, cycles=203_000)
        group = cost_group(finished(findings(*both)))
        assert group is not None
        (figure, *_) = group.panels
        assert isinstance(figure, Figure)
        assert (figure.y_range[1] > limit) is is_drawn


def test_a_verdict_is_told_by_a_sign_and_a_word_and_not_by_its_colour(findings: Make, good: list[Measurement]) -> None:
    assert '<h1><span aria-hidden="true">✓</span> PASS</h1>' in html_report(finished(findings(*good)))
    bad = check("gyroscope.bias_error", 0.4, unit="dps", limit=Limit(max=0.1), test="t.py::t")
    page = html_report(finished(findings(*good, bad)))
    assert '<h1><span aria-hidden="true">✗</span> FAIL: 1 of 7 limits missed</h1>' in page
    failures = text_of(page)[text_of(page).index("Measurements beyond their limit") :]
    assert "gyroscope.bias_error 0.4 dps at most 0.1 fail" in failures[: failures.index("Accuracy and cost")]


def test_the_tab_says_what_the_page_is(run: Run) -> None:
    page = html_report(run)
    answer = "hiltest report: virtual FRDM-K64F, seed 1, rig virtual-k64f"
    assert f"<title>{answer}, PASS</title>" in page


def test_a_failure_stands_with_its_value_in_the_baseline_and_the_cause_of_all_is_named_once(
    run: Run, findings: Make, heading: Callable[..., list[Measurement]]
) -> None:
    bad = finished(findings(*heading("direct", 6.3, limit=1.8, cycles=12_400)))
    base = difference("heading.direct.max", Change.WORSE, 0.97, 6.3, unit="deg")
    compared = replace(bad, comparison=Comparison(SIDE, SIDE, (base,), (), "1 worse."))
    row = "heading.direct.max 6.30 deg at most 1.8 fail {}test_heading.py"
    assert row.format("0.97 deg ") in text_of(html_report(compared))
    assert row.format("") in text_of(html_report(bad))
    assert html_report(bad).count("good fit, bad heading") == 1


@pytest.fixture
def red(findings: Make, heading: Callable[..., list[Measurement]]) -> Run:
    """A run with a wrong heading of both calibrators, and the poses of a base, whose errors are half as large."""
    bad = [*heading("direct", 6.3, limit=0.5, cycles=12_400), *heading("iterative", 5.9, limit=0.5, cycles=203_000)]
    collected = findings(*bad)
    poses = collected.tables["heading.poses"]
    halves = tuple((*row[:4], row[4] / 2.0, *row[5:]) for row in poses.rows)  # type: ignore[operator]
    collected.tables["heading.base_poses"] = replace(poses, name="heading.base_poses", rows=halves)
    return collected.finish(decide(collected, pytest_exit=1), "")


def picture_of(run: Run, predicted_deg: Sequence[float]) -> FailedHeading:
    picture = failed_heading(run, replace(summarise(run), predicted_deg={"direct": predicted_deg}))
    assert picture is not None
    return picture


def test_the_picture_has_the_errors_of_this_run_of_the_base_and_of_the_likely_cause(red: Run) -> None:
    poses = red.table("heading.poses")
    assert poses is not None
    errors = [float(error) for error in poses.column("error.direct")]  # type: ignore[arg-type]
    predicted = [0.9 * error for error in errors]
    figure = picture_of(red, predicted).figure
    assert figure.sheet is not None
    assert {entry.text for entry in figure.key} >= {"limit", "base", "level", "predicted by the likely cause"}
    cells = sorted((float(row[0]), *map(float, row[2:])) for row in figure.sheet.rows)
    headings = [float(heading) for heading in poses.column("heading")]  # type: ignore[arg-type]
    rows = zip(headings, errors, [error / 2.0 for error in errors], predicted, strict=True)
    assert cells == [pytest.approx(row, abs=0.006) for row in sorted(rows)]
    curves = re.findall(r'<path class="series-\d" d="([^"]*)"', str(figure.svg()))
    assert len(curves) == len({row[1] for row in figure.sheet.rows})
    x, y = figure.place(headings[3], predicted[3])
    assert f"L{x:.1f} {y:.1f}L" in "".join(curves)


def test_a_curve_does_not_join_errors_on_both_sides_of_half_a_turn(red: Run) -> None:
    jumping = [170.0 if index % 12 < 6 else -170.0 for index in range(60)]
    svg = str(picture_of(red, jumping).figure.svg())
    tilts = len({row[1] for row in picture_of(red, jumping).figure.sheet.rows})  # type: ignore[union-attr]
    assert len(re.findall(r'<path class="series-\d" d=', svg)) > tilts


def test_a_heading_that_got_worse_has_a_picture_and_a_cost_that_failed_has_none(
    run: Run, findings: Make, good: list[Measurement]
) -> None:
    worse = difference("heading.iterative.max", Change.WORSE, 0.5, 0.97, unit="deg")
    compared = replace(run, comparison=Comparison(SIDE, SIDE, (worse,), (), "1 worse."))
    picture = failed_heading(compared, summarise(compared))
    assert picture is not None
    assert picture.name == "iterative"
    costly = check("cycles.direct.worst_found", 40_000, unit="cycle", limit=Limit(max=30_000), cycle_model="m")
    failed = finished(findings(*good, costly))
    assert failed_heading(failed, summarise(failed)) is None


def test_a_comment_has_the_same_picture_as_a_chart_with_a_line_for_each_series(red: Run) -> None:
    chart = list(picture_of(red, [1.0] * 60).mermaid())
    lines = [[float(value) for value in line[6:-1].split(", ")] for line in chart if line.startswith("line [")]
    assert [set(line) for line in lines[:2]] == [{0.5}, {-0.5}]
    base, predicted, errors = lines[2:]
    assert base == pytest.approx([error / 2.0 for error in errors], abs=0.006)
    assert set(predicted) == {1.0}
    assert max(map(abs, errors)) == 0.97
    assert "\n".join(markdown_report(red).splitlines()[:12]).count("```mermaid") == 1


def test_a_red_page_folds_all_but_first_lines_and_picture_and_a_green_one_nothing(run: Run, red: Run) -> None:
    page = html_report(red)
    assert '<details class="part" open' not in page
    header = page[page.index("<header>") : page.index("</header>")]
    assert header.index("FAIL: ") < header.index("heading.direct.max 6.30 deg") < header.index("Likely cause:")
    assert header.index("Likely cause:") < header.index("Next:") < header.index("<title>direct: worst")
    assert page.count("<title>direct: worst") == 1, "it moved up"
    assert "<title>iterative: worst" in page[page.index("</header>") :]
    assert page.count("good fit, bad heading") == 1
    assert '<details class="part">' not in html_report(run)


def test_numbers_beside_a_limit_say_whether_it_held(findings: Make, heading: Callable[..., list[Measurement]]) -> None:
    page = text_of(html_report(finished(findings(*heading("direct", 2.5, limit=1.8, cycles=12_400)))))
    assert "2.50 ✗ beyond its limit: at most 1.8" in page
    assert "0.10 ✓ within its limit: within ±0.7" in page


def test_limits_and_tests_are_counted(run: Run) -> None:
    assert tally(run) == "Tests: 1 passed · 7 of 7 within their limits · 7 more measurements without a limit"


def test_a_run_that_was_cut_short_says_so(run: Run) -> None:
    assert "not complete" not in text_of(html_report(run))
    cut = replace(run, verdict=replace(run.verdict, complete=False))
    assert "This run is not complete" in text_of(html_report(cut))
    assert "This run is not complete" in text_of(html_report(replace(run, chosen=True)))


def test_a_line_that_was_spoilt_on_purpose_is_said_and_one_that_was_not_is_not(run: Run) -> None:
    assert run.rig is not None
    spoilt = replace(run, rig=replace(run.rig, faults="0.1 of bytes lost; both ways, seed 1"))
    assert "0.1 of bytes lost; both ways, seed 1" in html_report(spoilt)
    assert "on purpose" not in html_report(run)


def test_a_run_of_nothing_still_has_a_page(findings: Make) -> None:
    collected = findings(tests=(TestResult("t", TestOutcome.CONNECTION_LOST, 0, reason="no port"),), tables=False)
    collected.board = collected.rig = None
    page = html_report(replace(finished(collected), tests=()))
    assert "Nothing was measured" in page
    assert "No test ran to its end" in page
    assert 'role="img"' not in page
    assert "Accuracy and cost" not in page


@pytest.mark.parametrize(
    ("measured", "message"),
    [
        (["heading.direct.max", "cycles.direct.float64_distance"], "; worst heading 0.89 deg"),
        (["cycles.direct.float64_distance"], "; 0.89 deg from float64 on even samples"),
        ([], ""),
    ],
)
def test_cycles_against_points_stand_with_the_accuracy_that_they_buy(
    findings: Make, measured: list[str], message: str
) -> None:
    line = [
        check(f"cycles.direct.{case}", value, unit="cycle", cycle_model="m@sram")
        for case, value in (("per_point", 105.0), ("fixed", 1900.0))
    ]
    accuracy = [check(name, 0.894, unit="deg") for name in measured]
    page = html_report(finished(findings(*line, *accuracy)))
    keys = [text_of(f"<body>{match}") for match in re.findall("<li>(.*?)</li>", page)]
    assert {f"direct: 105.0 n + 1 900{message}", "iterative: cycles"} <= set(keys)


def test_what_has_no_data_is_left_out_and_the_contents_agree(run: Run) -> None:
    for item in (run, replace(run, tables=()), replace(run, tables=(), measurements=())):
        page = html_report(item)
        anchors = re.findall(r'<li><a href="#([^"]*)"', page)
        identifiers = re.findall(r' id="([^"]*)"', page)
        assert set(anchors) <= set(identifiers)
        assert len(identifiers) == len(set(identifiers))
        assert re.findall(r'<section id="([^"]*)"', page) == anchors


def test_headings_go_down_by_one(run: Run) -> None:
    levels = [int(level) for level in re.findall(r"<h(\d)", html_report(run))]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))


def test_every_table_has_a_caption_and_every_heading_a_scope(run: Run) -> None:
    page = html_report(replace(run, comparison=Comparison(SIDE, SIDE, (), (), "The same.")))
    assert page.count("<table") == page.count("<caption") >= 8
    assert all("scope=" in heading for heading in re.findall(r"<th[ >][^>]*", page))


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("a\u202egpj.elf", "a⟨U+202E⟩gpj.elf"),
        ("zero\x00byte", "zero⟨U+0000⟩byte"),
        ("Kompaß 12 µT", "Kompaß 12 µT"),
        ("hid\u200bden", "hid⟨U+200B⟩den"),
        ("lone \ud800", "lone ⟨U+D800⟩"),
        ("עברית", "עברית"),
    ],
)
def test_a_name_can_neither_hide_nor_turn_the_words_around_it(findings: Make, name: str, shown: str) -> None:
    assert legible(name) == shown
    failed = TestResult(f"{name}[\"'x']", TestOutcome.FAILED, 1, reason=name)
    collected = findings(check(name, 1.0, unit="uT"), tests=(failed,))
    collected.tables["cycles.sizes"] = Table("cycles.sizes", (Column("n"), Column(name, "cycle")), ((1, 2), (3, 4)))
    page = html_report(finished(collected))
    page.encode()
    assert page.count(shown) >= 5
    assert shown == name or name not in page


def test_a_trace_is_a_path_beside_the_page_whatever_it_is_called(findings: Make, good: list[Measurement]) -> None:
    test = TestResult("t", TestOutcome.FAILED, 1, reason="r", trace="javascript:alert(1)")
    page = html_report(finished(findings(*good, tests=(test,))))
    assert 'href="./javascript%3Aalert%281%29"' in page


def test_a_comparison_shows_what_changed_in_order_of_concern(run: Run) -> None:
    differences = (
        difference("a.better", Change.BETTER, 200.0, 150.0),
        difference("b.same", Change.UNCHANGED, 1.0, 1.0),
        difference("c.new", Change.NEW, None, 3.0),
        difference("d.gone", Change.GONE, 3.0, None),
        difference("cycles.direct.total", Change.WORSE, 11_061.0, 11_161.0, limit=Limit(max=12_500)),
        difference(
            "heading.direct.bias",
            Change.WORSE,
            0.1,
            0.4,
            unit="deg",
            tolerance=Tolerance(0.05, 0.02),
            interval=(0.28, 0.32),
            seeds=8,
        ),
    )
    page = html_report(replace(run, comparison=Comparison(SIDE, SIDE, differences, (), "2 worse: not to be merged.")))
    text = text_of(page)
    table = text.index("Changes, worst first")
    names = ("heading.direct.bias", "cycles.direct.total", "d.gone", "a.better", "c.new")
    places = [
        text.index("2 worse: not to be merged."),
        text.index("2 worse, 1 gone, 1 better, 1 new, 1 unchanged"),
        table,
        *(text.index(name, table) for name in names),
    ]
    assert places == sorted(places)
    assert "✗ worse 11 061 cycle 11 161 cycle +100, +0.9 % exact at most 12 500" in text
    assert "+0.3, 6 times its tolerance, 95 % +0.28 to +0.32 0.05 deg and 2 %" in text
    assert "b.same" not in text
    assert "1 new, 1 unchanged; cycles counted by m. A measurement is worse only" in text
    assert "cycles.direct.total: worse, +0.9 %" in page, "the drawing says in words what it shows"


def test_a_gate_that_was_not_evaluated_names_what_stands_in_its_way(run: Run) -> None:
    blocked = Comparison(SIDE, SIDE, (), ("another rig: x; run on y", "another model"), "Not evaluated.")
    text = text_of(html_report(replace(run, comparison=blocked)))
    assert text.index("Not evaluated.") < text.index("another rig: x; run on y")


def test_a_run_that_was_compared_with_nothing_has_no_such_section(run: Run) -> None:
    assert "Against the baseline" not in html_report(run)


def test_a_thousand_measurements_are_three_megabytes_at_most(findings: Make) -> None:
    names = [f"family_{k % 25}.calibrator-{k // 25}.a_rather_long_quantity" for k in range(1000)]
    test = "hil/suites/test_heading.py::test_a_rather_long_sentence_about_behaviour"
    measurements = [check(name, 1.2345, unit="deg", limit=Limit(max=2), test=test) for name in names]
    differences = tuple(difference(name, Change.WORSE, 1.0, 1.2345, unit="deg", limit=Limit(max=2)) for name in names)
    run = replace(finished(findings(*measurements)), comparison=Comparison(SIDE, SIDE, differences, (), "All worse."))
    page = html_report(run)
    assert all(page.count(name) >= 2 for name in names)
    assert len(page.encode()) <= 3_000_000
