"""The sentence and the exit code, from records written by hand."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import replace

import pytest

from hiltest.errors import BoardFault
from hiltest.measurement import CycleRange, Limit, Measurement, check, identify
from hiltest.report.overview import accuracy_and_cost
from hiltest.run_record.comparison import Comparison, Side
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.run import Findings, TestResult
from hiltest.text import format_number
from hiltest.verdict.calibrators import cheapest_first
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import Conditions, Evidence
from hiltest.verdict.summary import close_to_limit, cost_line, summarise
from hiltest.verdict.verdict import decide, headline, unmet_limits

from .evidence import evidence

Make = Callable[..., Findings]
Heading = Callable[..., list[Measurement]]


def test_a_good_run_says_accuracy_cost_and_pass_in_one_sentence(findings: Make, good: list[Measurement]) -> None:
    verdict = decide(findings(*good), pytest_exit=0)
    assert verdict.sentence == (
        "PASS. direct: worst heading 0.97 deg over 60 poses (limit 1.8), 12 400 cycles. "
        "iterative: equal accuracy (within 0.1 deg), 16.37 x the cycles of direct."
    )
    assert (verdict.outcome, verdict.exit_code, verdict.complete) == ("pass", 0, True)


def test_what_is_neither_judged_nor_costed_is_left_to_the_report(findings: Make, good: list[Measurement]) -> None:
    stream = check("heading.direct-stream.max", 0.5, unit="deg")
    assert [calibrator.name for calibrator in summarise(findings(*good, stream)).calibrators] == ["direct", "iterative"]
    judged = check("heading.direct-stream.max", 0.5, unit="deg", limit=Limit(max=1.8))
    names = [calibrator.name for calibrator in summarise(findings(*good, judged)).calibrators]
    assert names == ["direct", "iterative", "direct-stream"]


@pytest.mark.parametrize(
    ("max_deg", "message"), [(1.0, "iterative: 0.50 deg better, 2.00 x"), (1.75, "iterative: 0.25 deg worse, 2.00 x")]
)
def test_how_much_better_or_worse_is_said_where_accuracy_is_not_equal(
    findings: Make, heading: Heading, max_deg: float, message: str
) -> None:
    iterative = heading("iterative", max_deg, limit=2, cycles=24_000)
    run = findings(*heading("direct", 1.5, limit=1.8, cycles=12_000), *iterative)
    assert decide(run, pytest_exit=0).sentence.endswith(f"{message} the cycles of direct.")


def test_the_rig_says_which_calibrator_costs_are_multiples_of(findings: Make, good: list[Measurement]) -> None:
    run = findings(*good)
    assert run.rig is not None
    run.rig = replace(run.rig, cost_reference="iterative")
    summary = summarise(run)
    assert [(calibrator.name, calibrator.ratio) for calibrator in summary.calibrators] == [
        ("direct", "0.06"),
        ("iterative", "1.00"),
    ]
    assert decide(run, pytest_exit=0).sentence.startswith("PASS. iterative: worst heading 0.95 deg")
    run.rig = replace(run.rig, cost_reference="")
    assert {calibrator.ratio for calibrator in summarise(run).calibrators} == {""}
    assert "x the cycles" not in decide(run, pytest_exit=0).sentence


def test_a_calibrator_that_is_given_other_points_has_no_ratio(
    findings: Make, good: list[Measurement], heading: Heading
) -> None:
    (dpi,) = (
        calibrator
        for calibrator in summarise(findings(*good, *heading("dpi", 1.0, limit=2, cycles=100_000))).calibrators
        if calibrator.name == "dpi"
    )
    assert dpi.ratio == ""


@pytest.mark.parametrize(
    ("cycles", "message"),
    [
        (12_500, "within 10 % of the cycles of direct: code in flash cannot be ranked."),
        (14_000, "equal accuracy (within 0.1 deg), 1.17 x the cycles of direct."),
    ],
)
def test_costs_of_code_in_flash_are_not_ranked_when_they_are_close(
    findings: Make, heading: Heading, cycles: int, message: str
) -> None:
    results = [
        *heading("direct", 0.97, limit=1.8, cycles=12_000),
        *heading("iterative", 0.95, limit=1.8, cycles=cycles),
    ]
    assert "ranks neither" not in decide(findings(*results), pytest_exit=0).sentence
    results = [replace(entry, cycle_model=entry.cycle_model.replace("@sram", "@flash")) for entry in results]
    assert decide(findings(*results), pytest_exit=0).sentence.endswith(message)


@pytest.mark.parametrize(
    ("placement", "cycles", "order", "ranked"),
    [
        ("sram", 10_910, ["iterative", "direct"], True),
        ("flash", 10_910, ["direct", "iterative"], False),
        ("flash", 10_909, ["iterative", "direct"], True),
    ],
)
def test_the_table_and_the_line_of_costs_do_not_rank_code_in_flash_either(
    findings: Make, heading: Heading, placement: str, cycles: int, order: list[str], ranked: bool
) -> None:
    """A tenth of the cheaper one is what flash does not tell apart: 1091 of 10 910."""
    both = [*heading("direct", 0.97, limit=1.8, cycles=12_000), *heading("iterative", 0.95, limit=1.8, cycles=cycles)]
    made = findings(*(replace(item, cycle_model=f"m@{placement}" if item.cycle_model else "") for item in both))
    run = made.finish(decide(made, pytest_exit=0), "2026-01-02T03:04:06Z")
    assert [row.name for row in accuracy_and_cost(run).rows] == order
    refused = "within 10 % of the cycles of direct: code in flash cannot be ranked"
    assert (refused in cost_line(run)) is not ranked
    assert ("0.91 x the cycles of direct" in cost_line(run)) is ranked


def test_costs_of_code_in_flash_stand_by_name_only_where_the_cheapest_of_them_cannot_be_told_apart() -> None:
    """Each is close to the next, which does not make the first close to the last."""
    costs = {"c": 10_000, "b": 10_900, "a": 11_900}
    made = {name: check(name, cost, unit="cycle", cycle_model="m@flash") for name, cost in costs.items()}
    assert cheapest_first(made) == ["b", "c", "a"]


@pytest.mark.parametrize(
    ("numbers", "cause"),
    [
        ({"maximum": 6.1, "residual": 0.81}, "good fit, bad heading (residual 0.81 %, noise predicts 0.79 %)"),
        ({"maximum": 6.1, "residual": 2.4}, "bad fit (residual 2.40 %, noise predicts 0.79 %)"),
        ({"maximum": 3.9, "bias": 3.0, "centred": 0.9}, "constant offset"),
    ],
)
def test_a_failed_heading_names_its_cause(
    findings: Make, heading: Heading, numbers: dict[str, float], cause: str
) -> None:
    maximum = numbers.pop("maximum")
    run = findings(
        *heading("direct", maximum, limit=1.8, cycles=12_400, **numbers), tests=(_test("failed"),), tables=False
    )
    verdict = decide(run, pytest_exit=1)
    assert f"heading.direct.max {maximum:.2f} deg (limit 1.8)" in verdict.sentence
    assert verdict.sentence.startswith("FAIL. ")
    (advice,) = summarise(run).advice
    assert verdict.sentence.endswith(f"Likely cause: {cause}. Next: {advice}")
    assert verdict.exit_code == 1


def test_one_failure_of_each_calibrator_stands_before_the_rest_of_any(findings: Make, heading: Heading) -> None:
    norm = check("accelerometer.norm_rms", 40.0, unit="mg", limit=Limit(max=8))
    bad = [*heading("corrected", 6.1, limit=1.8, cycles=14_000), *heading("direct", 6.1, limit=1.8, cycles=12_400)]
    summary = summarise(findings(*bad, norm, tests=(_test("failed"),)))
    assert [failure.measurement.name for failure in summary.failures] == [
        "heading.direct.max",
        "accelerometer.norm_rms",
        "heading.corrected.max",
        "heading.corrected.max_centred",
        "heading.direct.max_centred",
    ]


def test_a_bad_accelerometer_is_named_before_the_fit(findings: Make, heading: Heading) -> None:
    norm = check("accelerometer.norm_rms", 40.0, unit="mg", limit=Limit(max=8))
    run = findings(*heading("direct", 6.1, limit=1.8, cycles=12_400), norm, tests=(_test("failed"),))
    sentence = decide(run, pytest_exit=1).sentence
    first, second = "heading.direct.max 6.10 deg (limit 1.8)", "accelerometer.norm_rms 40 mg (limit 8)"
    assert sentence.startswith(f"FAIL. {first}, {second}, ")
    assert "Likely cause: accelerometer. Next: Calibrate the accelerometer first" in sentence


def test_without_a_declared_mounting_only_centred_values_count(findings: Make, heading: Heading) -> None:
    run = findings(
        *heading(
            "direct",
            2.7,
            limit=1.8,
            cycles=12_400,
            bias=1.71,
            centred=0.95,
            not_checked="the rig declares no mounting yaw",
        )
    )
    verdict = decide(run, pytest_exit=0)
    assert verdict.sentence == (
        "NOT EVALUATED. Only centred values were checked: the rig declares no mounting yaw; mean error 1.71 deg. "
        "direct: worst heading 0.95 deg about its mean over 60 poses (limit 1.8), 12 400 cycles."
    )
    assert verdict.exit_code == 22
    assert re.match(r"All headings are off by \+1\.71 deg .* \[mounting\]", summarise(run).advice[0])


def test_a_limit_that_cannot_be_told_is_no_pass_and_is_named_with_value_limit_and_uncertainty(
    findings: Make, good: list[Measurement]
) -> None:
    near = check("heading.direct.max", 1.62, unit="deg", limit=Limit(max=2), uncertainty=0.707)
    verdict = decide(findings(*good, near), pytest_exit=0)
    assert verdict.exit_code == 22
    assert verdict.sentence.startswith(
        "NOT EVALUATED. Cannot tell at this uncertainty: heading.direct.max 1.62 deg (limit 2 with U 0.71). "
    )
    assert "uncertainty_deg under [turntable] and [mounting]" in " ".join(summarise(findings(*good, near)).advice)
    # A failure that is proven beside it comes first, and the open one is said all the same.
    beyond = check("heading.iterative.max", 3.1, unit="deg", limit=Limit(max=2), uncertainty=0.707)
    both = decide(findings(*good, near, beyond, tests=(_test("failed"),)), pytest_exit=1)
    assert both.exit_code == 1
    assert both.sentence.startswith("FAIL. heading.iterative.max 3.10 deg (limit 2 with U 0.71). ")
    assert "Cannot tell at this uncertainty: heading.direct.max" in both.sentence


@pytest.mark.parametrize(
    ("biases_deg", "added_deg"), [((1.7, 1.9), "+1.80"), ((-1.7, -1.7), "-1.70"), ((1.7, -1.7), ""), ((0.6, 0.7), "")]
)
def test_headings_that_are_all_off_by_the_same_angle_get_the_advice_to_correct_the_mounting(
    findings: Make, biases_deg: tuple[float, float], added_deg: str
) -> None:
    near = [
        check(f"heading.{name}.{statistic}", value, unit="deg", limit=Limit(min=-2, max=2), uncertainty=0.707)
        for name, bias_deg in zip(("direct", "iterative"), biases_deg, strict=True)
        for statistic, value in (("max", 2.4), ("bias", bias_deg), ("max_centred", 0.7))
    ]
    (advice,) = summarise(findings(*near)).advice
    named = re.match(r"All headings are off by (\S+) deg in the mean: .* yaw_deg under \[mounting\]", advice)
    assert (named[1] if named else "") == added_deg


def test_angles_that_were_not_all_taken_leave_no_centred_value_either(findings: Make, heading: Heading) -> None:
    why = "2 of 12 known angles were skipped"
    unset = check("heading.direct.max_centred", 0.9, unit="deg", limit=Limit(max=1.8), not_checked=why)
    run = findings(*heading("direct", 1.1, limit=1.8, cycles=12_400, bias=0.2, not_checked=why), unset)
    sentence = decide(run, pytest_exit=0).sentence
    assert "Only centred" not in sentence
    assert "about its mean" not in sentence
    assert f"heading.direct.max_centred ({why})" in sentence


def test_a_centred_error_out_of_limit_fails_even_without_a_mounting(findings: Make, heading: Heading) -> None:
    run = findings(
        *heading("direct", 7.4, limit=1.8, cycles=12_400, bias=1.7, centred=6.0, not_checked="no mounting"),
        tests=(_test("failed"),),
    )
    verdict = decide(run, pytest_exit=1)
    assert "heading.direct.max_centred 6.00 deg (limit 1.8)" in verdict.sentence
    assert "Likely cause: good fit, bad heading" in verdict.sentence
    assert verdict.exit_code == 1


@pytest.mark.parametrize("outcome", ["passed", "skipped", "xfailed"])
def test_out_of_limit_is_red_whatever_became_of_the_test(findings: Make, good: list[Measurement], outcome: str) -> None:
    bad = check("cycles.direct.fixed", 11_061.0, unit="cycle", limit=Limit(max=2_600), cycle_model="m", test="t::t")
    verdict = decide(findings(*good, bad, tests=(TestResult("t::t", TestOutcome(outcome), 1),)), pytest_exit=0)
    assert (verdict.exit_code, verdict.outcome) == (1, "fail")
    assert verdict.sentence.startswith("FAIL. cycles.direct.fixed 11 061 cycles (limit 2 600). Next: List the cycles")


def test_limits_that_were_left_out_are_said_and_make_nobody_red(findings: Make, good: list[Measurement]) -> None:
    verdict = decide(findings(*good), pytest_exit=0, left_out=["a.b", "c.d"])
    assert verdict.sentence.endswith(
        "x the cycles of direct. 2 limits of the rig were not checked, because no test measured them, e.g. a.b."
    )
    assert (verdict.exit_code, verdict.outcome, verdict.complete) == (0, "pass", False)
    chosen = findings(*good)
    chosen.chosen = True
    assert decide(chosen, pytest_exit=0, left_out=["a.b"]).complete
    assert not decide(chosen, pytest_exit=0, left_out=["a.b"], cut_short=True).complete
    assert not decide(chosen, pytest_exit=2, left_out=["a.b"]).complete


def test_a_limit_that_nothing_met_is_named_and_is_no_calibrator(findings: Make, good: list[Measurement]) -> None:
    limits = {"heading.dirct.max": Limit(max=1.8), "heading.direct.max": Limit(max=1.8), "lamp": Limit(max=1)}
    unmet = unmet_limits(limits, {"lamp": "cd"}, {measurement.name for measurement in good}, ("direct", "iterative"))
    verdict = decide(findings(*good, *unmet), pytest_exit=0)
    assert verdict.exit_code == 22
    assert verdict.sentence.startswith(
        "NOT EVALUATED. heading.dirct.max (the board has no calibrator 'dirct'; it has direct, iterative), "
        "lamp (nothing measured it). direct: worst heading 0.97 deg over 60 poses"
    )


@pytest.mark.parametrize(
    ("name", "gate_only", "why"),
    [
        ("heading.joint.max", True, 'nothing measured it; procedure.dpi is "none", or its fit was refused'),
        ("cycles.dpi-poses.total", False, 'nothing measured it; procedure.dpi is "none", or its fit was refused'),
        ("heading.dpi.max", True, "nothing in the gate set measured it"),
        ("heading.dpi-poses.max", True, "nothing in the gate set measured it"),
        ("heading.calibration.max", True, "nothing measured it; --calibration named no file"),
    ],
)
def test_what_is_no_calibrator_of_the_firmware_is_unmet_for_another_reason(
    name: str, why: str, *, gate_only: bool
) -> None:
    (unmet,) = unmet_limits({name: Limit(max=2.0)}, {}, (), ["direct"], gate_only=gate_only)
    assert unmet.note == why


def test_where_the_limit_of_a_calibrator_that_the_firmware_lacks_stands_is_said() -> None:
    name = "heading.dirct.max"
    (unmet,) = unmet_limits({name: Limit(max=2.0)}, {}, (), ["direct"], places={name: "bench.toml:47"})
    assert unmet.note == "the board has no calibrator 'dirct'; it has direct; the limit is in bench.toml:47"


def test_other_measurements_out_of_limit_are_named(findings: Make, good: list[Measurement]) -> None:
    bad = check("gyroscope.bias_error", 0.4, unit="dps", limit=Limit(max=0.1), test="t.py::test_rest")
    verdict = decide(findings(*good, bad, tests=(TestResult("t.py::test_rest", TestOutcome.FAILED, 1),)), pytest_exit=1)
    assert verdict.sentence.startswith("FAIL. gyroscope.bias_error 0.4 dps (limit 0.1). Next: ")


def test_a_heading_that_is_not_a_number_fails_by_name(findings: Make, heading: Heading) -> None:
    run = findings(*heading("direct", float("nan"), limit=1.8, cycles=12_400), tests=(_test("failed"),))
    sentence = decide(run, pytest_exit=1).sentence
    assert "heading.direct.max the value is nan (limit 1.8)" in sentence


def test_a_test_that_failed_without_a_measurement_is_named(findings: Make, good: list[Measurement]) -> None:
    for name in ("test_echo", "test_echo[a/b]"):
        failed = TestResult(f"hil/suites/test_link.py::{name}", TestOutcome.FAILED, 1, reason="assert 3 == 4")
        sentence = decide(findings(*good, tests=(failed,)), pytest_exit=1).sentence
        action = "Next: Repeat the test alone: hiltest run -- -k test_echo, or pytest -k test_echo."
        assert sentence == f"FAIL. Failed: test_link.py::{name} (assert 3 == 4). {action}"


def test_a_lost_bench_says_what_happened_and_what_is_kept(findings: Make) -> None:
    lost = TestResult("a", TestOutcome.CONNECTION_LOST, 1, reason="lost /dev/ttyACM0: unplugged.")
    run = findings(check("x", 1, unit=""), tests=(lost, TestResult("b", TestOutcome.SKIPPED, 0)))
    verdict = decide(run, pytest_exit=1)
    assert verdict.sentence == "CONNECTION LOST: lost /dev/ttyACM0: unplugged. 1 measurement kept."
    assert (verdict.exit_code, verdict.complete) == (20, False)


def test_a_fault_of_the_firmware_is_told_without_the_registers(findings: Make) -> None:
    fault = BoardFault("write to flash", pc=0x694, function="take", location="a.c:9", registers={"r0": 1, "xpsr": 2})
    lost = TestResult("a", TestOutcome.CONNECTION_LOST, 1, reason=f"the firmware reset itself, after: {fault}")
    assert decide(findings(tests=(lost,)), pytest_exit=1).sentence == (
        "CONNECTION LOST: the firmware reset itself, after: write to flash at 0x00000694 in take (a.c:9). "
        "0 measurements kept."
    )


def test_a_bench_lost_after_a_failure_is_said_behind_it(findings: Make, good: list[Measurement]) -> None:
    bad = check("gyroscope.bias_error", 0.4, unit="dps", limit=Limit(max=0.1), test="a")
    lost = TestResult("a", TestOutcome.CONNECTION_LOST, 1, reason="lost /dev/ttyACM0: unplugged.")
    verdict = decide(findings(*good, bad, tests=(lost,)), pytest_exit=1)
    assert verdict.exit_code == 1
    assert verdict.sentence.startswith("FAIL. gyroscope.bias_error 0.4 dps (limit 0.1). Next: ")
    assert verdict.sentence.endswith("Connection lost: lost /dev/ttyACM0: unplugged.")


@pytest.mark.parametrize(
    ("outcomes", "pytest_exit", "code", "word"),
    [
        (["passed"], 0, 0, "pass"),
        (["failed", "wrong firmware", "connection lost"], 1, 1, "fail"),
        (["error", "connection lost"], 1, 1, "fail"),
        (["wrong firmware", "connection lost"], 1, 23, "wrong firmware"),
        (["connection lost", "skipped"], 1, 20, "connection lost"),
        (["failed", "connection lost"], 2, 2, "interrupted"),
        (["connection lost"], 3, 3, "internal error"),
        ([], 4, 4, "usage error"),
        ([], 5, 5, "no tests"),
        (["passed"], 6, 6, "exit code 6"),
    ],
)
def test_exit_codes_in_their_order(findings: Make, outcomes: list[str], pytest_exit: int, code: int, word: str) -> None:
    run = findings(
        tests=tuple(TestResult(str(k), TestOutcome(outcome), 0, reason="why") for k, outcome in enumerate(outcomes))
    )
    if not outcomes:
        run.tests.clear()
    verdict = decide(run, pytest_exit=pytest_exit)
    assert (verdict.exit_code, verdict.outcome) == (code, word)


def test_an_unset_measurement_gates_only_where_nothing_is_worse(findings: Make, good: list[Measurement]) -> None:
    unset = check("x", 1.0, unit="deg", limit=Limit(max=2), not_checked="no reference")
    assert decide(findings(*good, unset), pytest_exit=0).exit_code == 22
    assert decide(findings(*good, unset, tests=(_test("failed"),)), pytest_exit=1).exit_code == 1


def _compared(now: Measurement, *faults: str, failed: tuple[str, ...] = ()) -> Comparison:
    """Compare a lamp of 2 mA with another, measured under the same conditions."""
    conditions = Conditions("virtual", "ab", ("direct",), (), 4, (), "all", "gate", False)
    sides = [
        Evidence(Side(file, "", "lamp", "1", "", "gcc", "", "bench", (1,), ""), conditions, {1: {item.name: item}})
        for file, item in (("base.json", check("lamp.current", 2.0, unit="mA", limit=Limit(max=9))), ("", now))
    ]
    return compare(sides[0], dataclasses.replace(sides[1], faults=faults, failed=failed))


@pytest.mark.parametrize("base_deg", [0.9, 2.5], ids=["right", "wrong too"])
def test_the_change_is_blamed_if_the_base_was_right_with_the_same_samples(
    findings: Make, heading: Heading, base_deg: float
) -> None:
    coverage = check("tumble.coverage", 40.0, unit="%")
    base, new = ([coverage, *heading("direct", deg, limit=1.8, cycles=12_000)] for deg in (base_deg, 3.0))
    run = findings(*new)
    run.comparison = compare(evidence(base), evidence(new))
    summary = summarise(run)
    was_right = base_deg < 1.8
    change = "the change of the firmware, since the base calibrated with the same samples; "
    assert summary.causes[0].startswith(f"{change * was_right}poor coverage")
    assert summary.advice[0].startswith("Compare the calibration of both builds" if was_right else "Collect points")


@pytest.mark.parametrize(
    ("current_ma", "faults", "more", "pytest_exit", "code"),
    [
        (2.0, (), (), 0, 0),
        (1.0, (), (), 0, 0),
        (3.0, (), (), 0, 21),
        (3.0, ("cut short",), (), 0, 22),
        (2.0, ("cut short",), (), 0, 22),
        (3.0, (), (check("x", 1.0, unit="", limit=Limit(max=2), not_checked="no reference"),), 0, 22),
        (3.0, (), (), 1, 1),
        (3.0, ("cut short",), (), 2, 2),
        (2.0, ("cut short",), (), 5, 5),
    ],
)
def test_a_comparison_decides_where_nothing_else_has(
    findings: Make,
    current_ma: float,
    faults: tuple[str, ...],
    more: tuple[Measurement, ...],
    pytest_exit: int,
    code: int,
) -> None:
    now = check("lamp.current", current_ma, unit="mA", limit=Limit(max=9))
    run = findings(now, *more)
    run.comparison = _compared(now, *faults, failed=("test_lamp.py::test_on",) if pytest_exit == 1 else ())
    verdict = decide(run, pytest_exit=pytest_exit)
    assert verdict.exit_code == code
    assert verdict.sentence.startswith("May be merged ") == (code == 0)
    assert verdict.sentence.startswith("Not to be merged ") == (current_ma == 3.0 and not faults)
    assert verdict.sentence.startswith("Cannot say whether ") == bool(faults)


def test_the_order_of_measurements_does_not_change_the_sentence(findings: Make, good: list[Measurement]) -> None:
    forward = decide(findings(*good), pytest_exit=0)
    assert decide(findings(*reversed(good)), pytest_exit=0) == forward
    assert dataclasses.replace(forward) == forward


def test_thousands_are_apart() -> None:
    assert [format_number(value) for value in (0, 999, 12_400, 1_234_567)] == ["0", "999", "12 400", "1 234 567"]


def _test(outcome: str) -> TestResult:
    return TestResult("hil/suites/test_heading.py::test_heading", TestOutcome(outcome), 1.0)


def test_what_was_in_the_baseline_stands_beside_a_failure(findings: Make) -> None:
    now = check("lamp.current", 12.0, unit="mA", limit=Limit(max=9), test="t::t")
    run = findings(now, tests=(TestResult("t::t", TestOutcome.FAILED, 1),))
    run.comparison = _compared(now)
    (failure,) = summarise(run).failures
    assert failure.was == 2.0
    opening = "Not to be merged (against base.json): FAIL. lamp.current 12 mA (limit 9, was 2). Next: "
    assert decide(run, pytest_exit=1).sentence.startswith(opening)


def test_a_regression_opens_with_the_answer_and_the_worst_change(findings: Make) -> None:
    now = check("lamp.current", 3.0, unit="mA", limit=Limit(max=9))
    compared = findings(now)
    compared.comparison = _compared(now)
    verdict = decide(compared, pytest_exit=0)
    change = "lamp.current 2 -> 3 mA (+1, +50 %; limit at most 9)"
    assert verdict.sentence.startswith(f"Not to be merged (against base.json): REGRESSION: 1 worse: {change}. Next: ")
    run = compared.finish(verdict, "")
    first = headline(run, summarise(run))
    assert first.verdict == "Not to be merged (against base.json): REGRESSION, 1 worse"
    assert first.number == change
    assert first.action in verdict.sentence


def test_first_lines_are_one_verdict_one_number_one_cause_one_action(findings: Make, heading: Heading) -> None:
    bad = [*heading("direct", 5.9, limit=1.8, cycles=12_400), *heading("iterative", 6.1, limit=1.8, cycles=203_000)]
    collected = findings(*bad, tests=(_test("failed"), TestResult("t.py::echo", TestOutcome.FAILED, 1, reason="no")))
    run = collected.finish(decide(collected, pytest_exit=1), "")
    summary = summarise(run)
    verdict, number, cause, action = headline(run, summary).lines
    assert verdict == "FAIL: 4 of 6 limits missed, 1 test failed."
    assert number.startswith("heading.iterative.max 6.10 deg (limit 1.8)"), "the worst of all that the cause explains"
    assert (cause, action) == (f"Likely cause: {summary.causes[0]}.", f"Next: {summary.advice[0]}")
    assert {failure.cause for failure in summary.failures} == {summary.causes[0]}


def test_a_cause_in_the_message_of_a_failed_test_is_the_cause_of_the_run(findings: Make) -> None:
    reason = "it answers 3.5 and gives 3.4 degrees; likely cause: sign of pitch. Check the formula."
    collected = findings(tests=(TestResult("t.py::heading", TestOutcome.FAILED, 1, reason=reason),))
    verdict = decide(collected, pytest_exit=1)
    first = headline(collected.finish(verdict, ""), summarise(collected))
    assert (first.number, first.cause) == ("t.py::heading: it answers 3.5 and gives 3.4 degrees", "sign of pitch")
    assert first.action == "Check the formula."
    assert verdict.sentence.count("sign of pitch") == 1


def test_the_number_of_the_first_lines_is_one_that_the_cause_explains(findings: Make, heading: Heading) -> None:
    tilt = check("accelerometer.tilt_error", 50.0, unit="deg", limit=Limit(max=0.5), test="test_reports.py::test")
    collected = findings(tilt, *heading("iterative", 5.9, limit=1.8, cycles=203_000), tests=(_test("failed"),))
    run = collected.finish(decide(collected, pytest_exit=1), "")
    assert headline(run, summarise(run)).number.startswith("heading.iterative.max 5.90 deg")


def test_first_lines_of_a_run_without_failures_are_its_word_and_its_best_results(
    findings: Make, good: list[Measurement]
) -> None:
    run = findings(*good).finish(decide(findings(*good), pytest_exit=0), "")
    first = headline(run, summarise(run))
    assert first.verdict == "PASS"
    assert " ".join(first.lines) == run.verdict.sentence


def test_close_is_what_has_5_percent_left_or_a_range_beyond_the_limit_and_no_count() -> None:
    def passed(name: str, value: float, limit: Limit, band: CycleRange | None = None) -> Measurement:
        kind = identify(name).kind
        unit = (kind.unit if kind else "mA") or ""
        return check(name, value, unit=unit, limit=limit, cycle_model="m" if unit == "cycle" else "", band=band)

    near = passed("heading.direct.max", 1.72, Limit(max=1.8))
    beyond = passed("cycles.direct.total", 9_000, Limit(max=10_000), CycleRange(8_900, 10_001))
    within = passed("cycles.dpi.total", 9_000, Limit(max=10_000), CycleRange(8_900, 9_999))
    others = [
        passed("heading.direct.rms", 0.70, Limit(max=0.75)),
        passed("tumble.points", 300, Limit(min=300)),
        passed("link.echoed", 26, Limit(min=26)),
        passed("lamp.current", 0.0, Limit(max=0.0)),
        passed("fit.dpi.dip", 61.93, Limit(min=60, max=64)),
    ]
    assert close_to_limit([*others, within, near, beyond]) == (beyond, near)
    assert len(close_to_limit([near] * 9)) == 5
