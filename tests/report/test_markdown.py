"""The Markdown page of a run: what changed comes before the rest, nothing breaks out, and no line is cut in two."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt  # rich brings it along

from hiltest.measurement import Measurement
from hiltest.report.markdown import markdown_report
from hiltest.report.markdown_text import cut, plain_text
from hiltest.run_record.comparison import Change
from hiltest.run_record.run import Findings, Run
from hiltest.verdict.verdict import decide

from .comparisons import comparison, difference

Make = Callable[..., Findings]
HOSTILE = "<script>alert('x')</script>|`\"&"


@pytest.fixture
def run(findings: Make, good: list[Measurement]) -> Run:
    collected = findings(*good)
    collected.comparison = comparison()
    return collected.finish(decide(collected, pytest_exit=0), "2026-01-02T03:05:00Z")


def unfolded(page: str) -> str:
    """Return what a reader sees without opening anything."""
    return re.sub(r"<details>.*?</details>", "", page, flags=re.S)


def test_what_changed_is_shown_worst_first_with_limit_and_tolerance(run: Run) -> None:
    rows = re.findall(r"^\| (?:worse|gone|better|new|changed) .*$", unfolded(markdown_report(run)), re.M)
    assert rows == [
        "| worse | cycles.direct.total | 11 061 cycle | 11 161 cycle | +100, +0.9 % | exact | at most 12 500 | pass |",
        "| gone | fusion.kalman.max | 1.2 deg | - |  |  |  |  |",
        "| better | heading.direct.max | 0.97 deg | 0.75 deg | -0.22, 4.4 times its tolerance | 0.05 deg and 2 % "
        "| at most 1.8 | pass |",
        "| new | link.errors | - | 0 |  |  | at most 1.8 | pass |",
        "| changed | heading.direct.worst\\_sector | 200 deg | 230 deg | +30, 7.5 times its tolerance "
        "| 0.05 deg and 2 % | at most 1.8 | pass |",
    ]


def test_what_did_not_change_is_counted_and_folded(run: Run) -> None:
    page = markdown_report(run)
    counts = "1 worse, 1 gone, 1 better, 1 new, 1 changed, 1 unchanged; cycles counted by cortex-m4-trm/3@sram."
    assert counts in unfolded(page)
    assert "fit.direct.residual" not in unfolded(page)
    assert "fit.direct.residual" in page
    assert "| calibrator |" not in unfolded(page)
    assert "| calibrator |" in page


def test_without_a_baseline_accuracy_and_cost_are_open(run: Run) -> None:
    green = replace(run, comparison=None, verdict=replace(run.verdict, outcome="pass", exit_code=0))
    page = unfolded(markdown_report(green))
    assert "| calibrator |" in page
    assert "Against the baseline" not in page


def test_a_note_stands_beside_the_place_of_the_measurement(run: Run) -> None:
    noted = replace(run.measurements[0], note="of 36 poses")
    page = markdown_report(replace(run, measurements=(noted,)))
    (row,) = (line for line in page.splitlines() if line.startswith("|") and "of 36 poses" in line)
    *_, outcome, place, _ = (cell.strip() for cell in row.split("|"))
    assert "of 36 poses" not in outcome
    assert place.endswith("of 36 poses")


def test_a_gate_that_was_not_evaluated_says_why(run: Run) -> None:
    page = unfolded(markdown_report(replace(run, comparison=comparison(obstacles=("another rig: <b>; save anew",)))))
    assert "- not evaluated: another rig: \\<b\\>; save anew" in page


def test_the_interval_over_seeds_is_told(run: Run) -> None:
    paired = difference("heading.direct.max", Change.WORSE, 0.9, 1.2, interval=(0.25, 0.35), seeds=8)
    assert "+0.3, 6 times its tolerance, 95 % +0.25 to +0.35 |" in markdown_report(
        replace(run, comparison=comparison(paired))
    )


def test_a_comparison_of_nothing_says_so(run: Run) -> None:
    nothing = replace(comparison(), differences=())
    assert "nothing to compare." in unfolded(markdown_report(replace(run, comparison=nothing)))


def test_hostile_texts_of_a_comparison_stay_text(run: Run) -> None:
    hostile = comparison(difference(HOSTILE, Change.WORSE, 1, 2, unit=HOSTILE, note=HOSTILE), obstacles=(HOSTILE,))
    result = replace(hostile, sentence=HOSTILE, base=replace(hostile.base, firmware=HOSTILE, file=HOSTILE))
    page = markdown_report(replace(run, comparison=result))
    assert "<script" not in page.replace("\\<script", "")
    rows = [line for line in page.splitlines() if line.startswith("|") and "alert" in line]
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in rows} == {9, 4}, "an unescaped | would add a column"


def test_a_renderer_makes_text_of_hostile_texts_and_as_many_cells_in_every_row(run: Run) -> None:
    texts = (
        HOSTILE,
        "**b** _i_ `c` ~~s~~",
        "[x](https://e) <https://e>",
        "\\| \\\\| |",
        "# h\n> q\n- l\n1. l",
        "&lt;&amp;",
    )
    rows = [difference(text, Change.WORSE, 1, 2, unit=text, note=text) for text in texts]
    result = replace(comparison(*rows), sentence=" ".join(texts), obstacles=texts)
    page = (
        MarkdownIt("commonmark", {"html": True})
        .enable(["table", "strikethrough"])
        .render(markdown_report(replace(run, comparison=result)))
    )
    tags = set(re.findall(r"<([a-z][a-z0-9]*)", page))
    assert tags <= {"h1", "h2", "p", "ul", "li", "details", "summary", "table", "thead", "tbody", "tr", "th", "td"}
    read = html.unescape(re.sub(r"<!-- -->", "", page))
    for text in texts:
        assert " ".join(text.split()) in read
    for head, body in re.findall(r"<thead>(.*?)</thead>\s*<tbody>(.*?)</tbody>", page, re.S):
        assert {row.count("<td") for row in re.findall(r"<tr>(.*?)</tr>", body, re.S)} == {head.count("<th>")}


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("https://evil.example", "https:<!-- -->//evil.example"),
        ("www.evil.example", "w<!-- -->ww.evil.example"),
        ("ask @team", "ask @<!-- -->team"),
        ("cortex-m4-trm/3@sram", "cortex-m4-trm/3@sram"),
        ("$\\frac12$", "\\$\\\\frac12\\$"),
        ("![x](y)", "!\\[x\\](y)"),
        ("a\u202eb\x1b[31m", "a⟨U+202E⟩b⟨U+001B⟩\\[31m"),
        ("\udce9", "⟨U+DCE9⟩"),
    ],
)
def test_nothing_becomes_a_link_a_formula_or_a_control_character(text: str, shown: str) -> None:
    assert plain_text(text) == shown


def page_of(sections: list[tuple[bool, int]]) -> str:
    """Return a page of paragraphs and folded tables with so many rows each."""
    parts = []
    for folds, rows in sections:
        lines = "".join(f"| {row} | ä |\n" for row in range(rows))
        parts.append(f"\n<details><summary>s</summary>\n\n{lines}\n</details>\n" if folds else f"\n{lines}")
    return "# PASS\n" + "".join(parts)


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 20)), max_size=6), st.integers(0, 1500))
def test_a_page_is_cut_at_the_end_of_a_line_with_everything_closed(
    sections: list[tuple[bool, int]], most_bytes: int
) -> None:
    page = page_of(sections)
    stored = cut(page, most_bytes, "hil-out/report.md")
    assert len(stored.encode()) <= most_bytes
    if len(page.encode()) <= most_bytes:
        assert stored == page
        return
    assert stored.count("<details>") == stored.count("</details>")
    body, _, remark = stored.rpartition("\n**Cut short")
    if stored:
        assert "hil-out/report.md" in remark
        lines = [line for line in body.splitlines() if line not in ("", "</details>")]
        whole = [line for line in page.splitlines() if line not in ("", "</details>")]
        assert lines == whole[: len(lines)]
    else:
        assert most_bytes < 130, "only a length that has no room for the remark leaves nothing"


def test_a_page_that_is_cut_keeps_as_much_as_fits() -> None:
    page = page_of([(True, 100)])
    stored = cut(page, 600, "r.md")
    # The longest line of the page, the end of the fold and half a remark.
    assert len(stored.encode()) > 600 - 40
