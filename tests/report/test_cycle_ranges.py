"""A cycle count's band is kept in the record and stands beside the number wherever that is shown."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import asdict, replace
from html import unescape
from itertools import product
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from hiltest.measurement import CycleRange, Limit, Measurement, Outcome, RowEffect, check, ratio_range
from hiltest.report.markdown import markdown_report
from hiltest.report.overview import accuracy_and_cost
from hiltest.report.render import html_report
from hiltest.report.terminal import summary
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Findings, Run
from hiltest.run_record.run_json import part_from, write_run
from hiltest.verdict.summary import cost_line
from hiltest.verdict.verdict import decide

from ..written_run import MODEL

Make = Callable[..., Findings]

BAND = CycleRange(11_900, 13_050, (RowEffect("fp_accumulate", 11_950, 12_400), RowEffect("it", 12_390, 12_400)))
MOST = "most by fp_accumulate: 11 950 to 12 400"
IN_WORDS = f"11 900 to 13 050 by uncertain rows of the cycle model, {MOST}"


def run_of(findings: Make, good: list[Measurement]) -> Run:
    measured = [
        replace(measurement, band=BAND) if measurement.name == "cycles.direct.total" else measurement
        for measurement in good
    ]
    run = findings(*measured)
    return run.finish(decide(run, pytest_exit=0, left_out=[], cut_short=False), "2026-01-02T03:04:06Z")


def test_the_record_keeps_it_and_gives_it_back(findings: Make, good: list[Measurement], tmp_path: Path) -> None:
    run = run_of(findings, good)
    read = read_record(write_run(run, tmp_path)).run
    assert read.measurement("cycles.direct.total") == run.measurement("cycles.direct.total")
    (written,) = (
        measurement
        for measurement in json.loads((tmp_path / "run.json").read_text())["measurements"]
        if measurement["band"] is not None
    )
    assert written["band"] == {
        "low": 11_900,
        "high": 13_050,
        "rows": [
            {"row": "fp_accumulate", "low": 11_950, "high": 12_400},
            {"row": "it", "low": 12_390, "high": 12_400},
        ],
    }


def test_a_record_from_before_there_were_bands_is_read(findings: Make, good: list[Measurement], tmp_path: Path) -> None:
    content = json.loads(write_run(run_of(findings, good), tmp_path).read_text())
    for number in content["measurements"]:
        del number["band"]
    (tmp_path / "run.json").write_text(json.dumps(content), encoding="utf-8")
    assert all(measurement.band is None for measurement in read_record(tmp_path / "run.json").run.measurements)


def test_a_measurement_comes_back_from_another_process_with_it() -> None:
    measurement = check("cycles.x.total", 12_400, unit="cycle", cycle_model="m", limit=Limit(max=13_000), band=BAND)
    assert part_from(Measurement, json.loads(json.dumps(asdict(measurement)))) == measurement
    without = check("cycles.x.total", 12_400, unit="cycle", cycle_model="m")
    assert part_from(Measurement, json.loads(json.dumps(asdict(without)))) == without


def test_every_report_shows_it_beside_the_count(findings: Make, good: list[Measurement], tmp_path: Path) -> None:
    run = run_of(findings, good)
    (row,) = (row for row in accuracy_and_cost(run).rows if row.name == "direct")
    assert [cell.note for cell in row.cells if cell.text == "12 400"] == ["11 900 to 13 050"]
    page = html_report(run).replace("\N{NO-BREAK SPACE}", " ")
    assert "<small>11 900 to 13 050</small>" in page
    assert IN_WORDS.replace("'", "&#39;") in page
    text = markdown_report(run)
    assert "12 400 (11 900 to 13 050)" in text
    assert IN_WORDS in text.replace("\\", "")  # Markdown would take an underscore for emphasis
    printed = summary(run, tmp_path, verbose=False, width=100, colour=False)
    assert re.search(r"^direct +0\.97 +1\.8 +12 400 +11 900 to 13 050 +1\.00 *$", printed, re.M)
    _, ranges = summary(run, tmp_path, verbose=True, width=100, colour=False).split("Cycle-count uncertainty (model ")
    assert re.search(r"^ ?cycles\.direct\.total +12 400 +11 900 +13 050 +fp_accumulate *$", ranges, re.M)


def test_a_count_that_keeps_its_limit_only_as_it_was_counted_says_so_and_passes(
    findings: Make, good: list[Measurement], tmp_path: Path
) -> None:
    def judged(most: float) -> Run:
        """Judge the count against a limit."""
        total = check("cycles.direct.total", 12_400, unit="cycle", cycle_model=MODEL, limit=Limit(max=most), band=BAND)
        made = findings(*(total if measurement.name == total.name else measurement for measurement in good))
        return made.finish(decide(made, pytest_exit=0), "2026-01-02T03:04:06Z")

    remark = "may exceed the limit within the model's uncertainty"
    for run, answer in ((judged(13_000), True), (judged(13_050), False), (judged(12_399), False)):
        assert (run.verdict.exit_code == 0) is (run.measurement("cycles.direct.total").outcome is Outcome.PASS)
        printed = summary(run, tmp_path, verbose=False, width=100, colour=False)
        assert ("cycles.direct.total 12 400 cycles (11 900 to 13 050), limit 13 000" in printed) is answer
        page = unescape(html_report(run)).replace("\N{NO-BREAK SPACE}", " ")
        assert (f"<small>11 900 to 13 050: {remark}</small>" in page) is answer
        assert (f"12 400 (11 900 to 13 050: {remark})" in markdown_report(run)) is answer


def test_a_count_that_nothing_uncertain_enters_says_so() -> None:
    assert CycleRange(5, 5).explained() == "no uncertain row of the cycle model enters"


def test_a_row_that_makes_it_cheaper_at_its_upper_end_is_shown_in_order() -> None:
    assert CycleRange(90, 100, (RowEffect("fp_accumulate_hidden", 100, 90),)).explained().endswith("hidden: 90 to 100")


def counted(value: int, band: CycleRange | None, model: str = "m") -> Measurement:
    """Return a cycle count."""
    return check("cycles.x.total", value, unit="cycle", cycle_model=model, band=band)


def test_the_ratio_of_two_counts_moves_less_than_either_because_both_move_with_the_same_row() -> None:
    one = counted(1000, CycleRange(800, 1000, (RowEffect("fp_store", 800, 1000),)))
    other = counted(100, CycleRange(85, 100, (RowEffect("fp_store", 90, 100), RowEffect("it", 95, 100))))
    # With fp_store cheap 800 / 90, with it cheap 1000 / 95, with both 800 / 85.
    assert ratio_range(one, other) == (800 / 90, 1000 / 95)
    assert ratio_range(one, counted(100, None)) is None
    assert ratio_range(one, counted(100, CycleRange(90, 100), "silicon-dwt")) is None
    assert ratio_range(one, counted(100, CycleRange(0, 100))) is None


def test_the_ratio_is_at_its_least_and_greatest_with_some_rows_low_and_others_high() -> None:
    one = counted(1000, CycleRange(900, 1050, (RowEffect("fp_store", 900, 1000), RowEffect("store", 1000, 1050))))
    other = counted(100, CycleRange(99, 130, (RowEffect("fp_store", 99, 100), RowEffect("store", 100, 130))))
    assert ratio_range(one, other) == ((1000 - 100 + 50) / (100 - 1 + 30), 1000 / 100)


def test_what_rows_change_only_together_widens_the_ratio() -> None:
    one, other = counted(1000, CycleRange(900, 1200)), counted(100, CycleRange(90, 110))
    assert ratio_range(one, other) == (900 / 110, 1200 / 90)
    row = RowEffect("it", 990, 1000)
    assert ratio_range(counted(1000, CycleRange(980, 1000, (row,))), counted(100, CycleRange(100, 100))) == (9.8, 10.0)


EFFECT = st.tuples(st.integers(-40, 40), st.integers(-40, 40))


@given(st.integers(900, 9000), st.integers(300, 900), st.lists(st.tuples(EFFECT, EFFECT), max_size=6))
def test_no_choice_of_ends_of_the_rows_makes_a_ratio_outside_and_two_make_its_ends(
    value: int, other: int, effects: list[tuple[tuple[int, int], tuple[int, int]]]
) -> None:
    result = ratio_range(
        *(
            counted(
                count,
                CycleRange(
                    count + sum(min(0, *item[side]) for item in effects),
                    count + sum(max(0, *item[side]) for item in effects),
                    tuple(
                        RowEffect(f"row{index}", *(count + by for by in item[side]))
                        for index, item in enumerate(effects)
                    ),
                ),
            )
            for side, count in enumerate((value, other))
        )
    )
    ratios = []
    for chosen in product((None, 0, 1), repeat=len(effects)):  # where it is, and at either end
        ends = [(over[at], under[at]) for (over, under), at in zip(effects, chosen, strict=True) if at is not None]
        ratios.append((value + sum(over for over, _ in ends)) / (other + sum(under for _, under in ends)))
    assert result == (min(ratios), max(ratios))


def test_the_cost_line_has_budget_counts_what_they_reach_and_the_ratio(
    findings: Make, good: list[Measurement], tmp_path: Path
) -> None:
    shown = {"cycles.direct.per_point": (98.0, 168), "cycles.direct.fixed": (2_600.0, 2_600)}
    lines = [
        check(name, value, unit="cycle", cycle_model="m", information=Limit(max=most))
        for name, (value, most) in shown.items()
    ]
    measured = [
        replace(measurement, band=BAND) if measurement.name == "cycles.direct.total" else measurement
        for measurement in good
    ]
    made = findings(*measured, *lines)
    run = made.finish(decide(made, pytest_exit=0), "2026-01-02T03:04:06Z")
    line = (
        "Thesis budget for 100 points 19 400 cycles; direct 12 400 (11 900 to 13 050) for 0.97 deg; iterative 203 000 "
        f"for 0.95 deg, 16.37 x the cycles of direct; counted by {MODEL}."
    )
    assert cost_line(run) == line
    assert line in html_report(run).replace("\N{NO-BREAK SPACE}", " ")
    assert line in markdown_report(run)
    assert "Thesis" not in summary(run, tmp_path, verbose=False, width=100, colour=False)
    assert line in " ".join(summary(run, tmp_path, verbose=True, width=100, colour=False).split())


def test_a_budget_of_ones_own_is_not_called_the_thesis(findings: Make, good: list[Measurement]) -> None:
    lines = [
        check(f"cycles.direct.{case}", value, unit="cycle", cycle_model="m", information=Limit(max=most))
        for case, value, most in (("per_point", 98.0, 150), ("fixed", 2_600.0, 2_600))
    ]
    run = findings(*good, *lines)
    line = cost_line(run.finish(decide(run, pytest_exit=0), "2026-01-02T03:04:06Z"))
    assert line.startswith("Budget for 100 points 17 600 cycles; direct 12 400 ")


def test_without_a_counted_calibrator_of_the_board_there_is_no_cost_line(
    findings: Make, good: list[Measurement]
) -> None:
    run = findings(*(measurement for measurement in good if measurement.unit != "cycle"))
    assert cost_line(run.finish(decide(run, pytest_exit=0), "2026-01-02T03:04:06Z")) == ""
