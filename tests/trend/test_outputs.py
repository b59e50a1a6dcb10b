"""The page of a trend: self-contained, readable without seeing it, and safe with hostile names."""

from __future__ import annotations

import re
from dataclasses import replace

from hiltest.measurement import Limit, check
from hiltest.report.trend.figures import figure
from hiltest.report.trend.folder import Skipped
from hiltest.report.trend.outputs import trend_page
from hiltest.report.trend.series import Trend, trend_of
from hiltest.run_record.comparison import Revision

from .entries import cycles, degrees, entry

RUNS = [f"run {number}" for number in range(1, 31)]
HOSTILE = "<script>alert('x')</script>|`\"&"


def step_at_run_4() -> Trend:
    return trend_of(
        [
            entry(day, cycles(11_061 if day < 4 else 11_161), degrees(1.0), build="old" if day < 4 else "new")
            for day in range(1, 8)
        ]
    )


def headings(page: str) -> list[str]:
    return [text.replace("\xa0", " ") for text in re.findall(r"<h[23][^>]*>([^<]*)<", page)]


def test_the_plots_come_first_then_what_changed_in_each_run() -> None:
    trend = trend_of(
        [
            entry(
                day,
                cycles(11_061 + 100 * (day > 3)),
                degrees(1.0 + (day > 3) - 1.5 * (day > 5)),
                degrees(2.0, "fit.direct.dip"),
                build=f"b{(day > 3) + (day > 5)}",
            )
            for day in range(1, 8)
        ]
    )
    page = trend_page(trend, [])
    assert headings(page) == [
        "With a change point: 2 of 3 measurements",
        "Change points by run, newest first",
        "run 6, 2026-01-06T00:00:00Z: 1 better",
        "run 4, 2026-01-04T00:00:00Z: 2 worse",
        "Without a change point",
        "Runs",
    ]
    assert page.index("<svg viewBox") < page.index("<table>")
    of_run_4 = page[page.index('id="change-2"') : page.index("Without a change point")].replace("\xa0", " ")
    assert of_run_4.count("build b0 -&gt; b1") == 1, "said once for all that changed in a run"
    names = re.findall(r'<th scope="row" class="name">([^<]*)<', of_run_4)
    assert names == ["heading.direct.max", "cycles.direct.total"], "the farthest first"
    moved = "+100, +0.9 %; limit at most 12 500; heading.direct.max 1.00 -&gt; 2.00 deg"
    assert f"11 061 -&gt; 11 161 cycles ({moved})" in of_run_4


def test_a_trend_without_a_change_point_shows_its_plots_all_the_same() -> None:
    page = trend_page(trend_of([entry(day, cycles(100), degrees(1.0)) for day in (1, 2)]), [])
    assert headings(page) == ["Without a change point: 2 of 2 measurements", "Runs"]
    assert page.count('role="img"') == 2


def test_every_measurement_is_drawn_and_told_in_words() -> None:
    page = trend_page(step_at_run_4(), [])
    assert page.count('role="img"') == 2
    assert "From 11 061 in run 1 to 11 161 cycle in run 7, limit at most 12 500. Change points: run 4 worse." in page
    assert "No change point." in page
    page = page.replace("\xa0", " ")
    assert '<p class="soft">Cycles counted by cortex-m4-trm/3@sram.</p>' in page
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page)
    assert captions == [
        "cycles.direct.total [cycle], limit at most 12 500",
        "heading.direct.max [deg]",
    ]


def test_a_step_is_marked_where_it_is_and_a_limit_where_it_holds() -> None:
    steps = [entry(day, cycles(11_061 + 100 * (day > 3), limit=11_300)) for day in range(1, 8)]
    (measured,) = trend_of(steps).measured
    drawn = figure(measured, RUNS[:7])
    svg = str(drawn.svg())
    x, y = drawn.place(4.0, 11_161)
    assert f'<path class="mark step worse" transform="translate({x:.1f} {y:.1f})' in svg
    assert svg.count("mark step") == 1
    (remainder, limit_y), (right, _) = drawn.place(0.5, 11_300), drawn.place(7.5, 11_300)
    assert f'<path class="limit" d="M{remainder:.1f} {limit_y:.1f}L{right:.1f} {limit_y:.1f}"/>' in svg


def test_lines_of_other_conditions_are_not_joined() -> None:
    trend = trend_of([entry(1, cycles(100)), entry(2, cycles(200, model="b"), model="b"), entry(3, cycles(100))])
    drawn = figure(trend.measured[0], RUNS[:3])
    (remainder, y), (right, _) = drawn.place(1.0, 100), drawn.place(3.0, 100)
    svg = str(drawn.svg())
    assert f'<path class="series-0" d="M{remainder:.1f} {y:.1f}L{right:.1f} {y:.1f}"/>' in svg
    assert 'class="series-1"' in svg
    assert "2 conditions that are not comparable" in svg
    key = re.findall(r"</svg>([^<]*)</li>", trend_page(trend, []))
    assert key == ["cortex-m4-trm/3@sram", "b"], "what tells one line from the other, and no change point"


def test_a_limit_far_away_does_not_press_the_values_flat() -> None:
    near, far = (trend_of([entry(day, cycles(100 + day, limit=limit)) for day in (1, 2)]) for limit in (104, 100_000))
    assert figure(near.measured[0], RUNS[:2]).y_range[1] > 104
    assert figure(far.measured[0], RUNS[:2]).y_range[1] < 104
    assert "limit at most 100 000" in str(figure(far.measured[0], RUNS[:2]).svg())


def test_a_change_is_shown_at_its_size_beside_a_far_limit_and_other_conditions() -> None:
    """A hundred cycles of eleven thousand, under a limit of 12 500, and a line of another rig at 90 000."""
    entries = [
        *(entry(day, cycles(11_061 + 100 * (day > 3))) for day in range(1, 6)),
        entry(6, cycles(90_000), rig="b"),
    ]
    trend = trend_of(entries)
    (measured,) = trend.measured
    drawn = figure(measured, [f"run {k}, 2026-01-0{k}" for k in range(1, 7)])
    low, high = drawn.y_range
    assert 0.8 * (high - low) < 100.0 < high - low
    assert ">2026-01-04</text>" in drawn.svg()
    rows = re.findall(r'data-row="(\d)"><title>run (\d), 2026', drawn.svg())
    assert rows == [(str(k), str(k + 1)) for k in range(5)]


def test_numbers_of_any_size_have_ticks_that_differ() -> None:
    for value in (0.0, 1e-30, 3.0, 123_456.0, 9.87e12, -5.0):
        for more in (0.0, 1e-9 * abs(value), abs(value)):
            trend = trend_of([entry(1, degrees(value)), entry(2, degrees(value + more))])
            svg = str(figure(trend.measured[0], RUNS[:2]).svg())
            labels = re.findall(r'text-anchor="end">([^<]*)<', svg)
            assert len(labels) == len(set(labels)) >= 2, (value, more, labels)


def test_a_level_line_of_many_runs_is_two_points() -> None:
    trend = trend_of([entry(day, cycles(100, limit=None)) for day in range(1, 29)])
    paths = re.findall(r'<path class="series-0" d="([^"]*)"', str(figure(trend.measured[0], RUNS[:28]).svg()))
    assert [path.count("L") for path in paths] == [1]


def test_a_campaign_shows_its_spread() -> None:
    trend = trend_of([entry(1, seeds={1: (degrees(1.0),), 2: (degrees(3.0),)})])
    drawn = figure(trend.measured[0], RUNS[:1])
    (x, low), (_, high) = drawn.place(1.0, 1.0), drawn.place(1.0, 3.0)
    assert f'class="series-0 spread" d="M{x:.1f} {low:.1f}L{x:.1f} {high:.1f}"' in str(drawn.svg())


def made_for(*revisions: Revision | None) -> Trend:
    entries = []
    for day, revision in enumerate(revisions, 1):
        result = entry(day, cycles(11_000 + 100 * day), build=f"b{day}")
        side = replace(result.evidence.side, revision=revision)
        entries.append(replace(result, evidence=replace(result.evidence, side=side)))
    return trend_of(entries)


def test_every_run_is_called_by_what_it_was_made_for() -> None:
    trend = made_for(None, Revision(label="v1.1"), Revision("0123456789abcdef", "main"))
    page = trend_page(trend, []).replace("\xa0", " ")
    numbers = re.findall(r'<th scope="row">([^<]*)</th><td class="number">([^<]*)</td>', page)
    assert numbers == [
        ("run 1, 2026-01-01", "11 100"),
        ("run 2 (v1.1), 2026-01-02", "11 200"),
        ("run 3 (commit 0123456789ab, branch main), 2026-01-03", "11 300"),
    ]
    table = page[page.index('id="runs"') :]
    assert '<th scope="col">made for</th>' in table
    of_a_commit = "commit 0123456789ab, branch main"
    assert re.findall(r"Z</td><td class=\"moved\">([^<]*)</td>", table) == ["", "v1.1", of_a_commit]
    assert "made for v1.1 -&gt; commit 0123456789ab, branch main" in page[page.index('id="changes"') :]
    assert "the last in run 3 (commit 0123456789ab, branch main): cycles.direct.total" in page
    assert "made for" not in trend_page(made_for(None, None), [])


def test_the_page_needs_no_network_and_hostile_names_show_as_text() -> None:
    hostile = entry(1, check(HOSTILE, 1.0, unit=HOSTILE, limit=Limit(max=2)), build=HOSTILE, file=HOSTILE)
    trend = trend_of([hostile, replace(hostile, when_utc="2026-01-02T00:00:00Z")])
    page = trend_page(trend, [Skipped(HOSTILE, HOSTILE)])
    assert page.count("<script") == 1  # its own
    assert page.count("&lt;script&gt;") >= 8
    assert not re.search(r"(\bsrc=|\bhref=|url\(|@import|https?:)", page)
    assert "prefers-color-scheme: dark" in page


def test_every_region_of_the_page_has_a_name_and_every_id_is_there_once() -> None:
    page = trend_page(step_at_run_4(), [])
    ids = re.findall(r'id="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'aria-labelledby="([^"]*)"', page)) <= set(ids)
