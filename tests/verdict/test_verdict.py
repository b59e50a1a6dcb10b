"""The sentence and the exit code, from records written by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import pytest

from hiltest.measurement import Limit, Measurement, judge
from hiltest.record.comparison import Comparison, Side
from hiltest.record.outcomes import TestOutcome
from hiltest.record.run import Findings, TestResult
from hiltest.report.cost_line import cost_line
from hiltest.report.overview import accuracy_and_cost
from hiltest.text import readable
from hiltest.verdict.calibrators import cheapest_first
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import Conditions, Evidence
from hiltest.verdict.not_measured import unmet_limits
from hiltest.verdict.verdict import decide

Make = Callable[..., Findings]
Heading = Callable[..., list[Measurement]]


def test_a_good_run_says_accuracy_cost_and_pass_in_one_sentence(findings: Make, good: list[Measurement]) -> None:
    verdict = decide(findings(*good), pytest_exit=0)
    assert verdict.sentence == (
        "direct: worst heading 0.97 deg over 60 poses for 12 400 cycles; iterative: 0.95 deg for 203 000; "
        "limit 1.8 deg: PASS. Accuracy ties; direct costs 1/16 of iterative."
    )
    assert (verdict.outcome, verdict.exit_code, verdict.complete) == ("pass", 0, True)


def test_what_is_neither_judged_nor_costed_is_left_to_the_report(findings: Make, good: list[Measurement]) -> None:
    stream = judge("heading.direct-stream.max", 0.5, unit="deg")
    assert decide(findings(*good, stream), pytest_exit=0).sentence == decide(findings(*good), pytest_exit=0).sentence
    judged = judge("heading.direct-stream.max", 0.5, unit="deg", limit=Limit(max=1.8))
    assert "direct-stream: 0.50 deg" in decide(findings(*good, judged), pytest_exit=0).sentence


def test_the_better_calibrator_is_named_when_accuracy_does_not_tie(findings: Make, heading: Heading) -> None:
    iterative = heading("iterative", 1.0, limit=2, cycles=24_000)
    made = findings(*heading("direct", 1.5, limit=1.8, cycles=12_000), *iterative)
    assert decide(made, pytest_exit=0).sentence.endswith(
        "limits 1.8 and 2 deg: PASS. iterative is 0.50 deg better; direct costs 1/2 of iterative."
    )


@pytest.mark.parametrize(
    ("cycles", "said"),
    [(12_500, "Accuracy ties; their costs are within 10% and from flash, which ranks neither."),
     (14_000, "Accuracy ties; direct costs 0.86 of iterative.")],
)  # fmt: skip
def test_costs_of_code_in_flash_are_not_ranked_when_they_are_close(
    findings: Make, heading: Heading, cycles: int, said: str
) -> None:
    made = [*heading("direct", 0.97, limit=1.8, cycles=12_000), *heading("iterative", 0.95, limit=1.8, cycles=cycles)]
    assert "ranks neither" not in decide(findings(*made), pytest_exit=0).sentence
    made = [replace(each, cycle_model=each.cycle_model.replace("@sram", "@flash")) for each in made]
    assert decide(findings(*made), pytest_exit=0).sentence.endswith(said)


@pytest.mark.parametrize(
    ("placement", "cycles", "order", "ranked"),
    [("sram", 10_910, ["iterative", "direct"], True), ("flash", 10_910, ["direct", "iterative"], False),
     ("flash", 10_909, ["iterative", "direct"], True)],
)  # fmt: skip
def test_the_table_and_the_line_of_costs_do_not_rank_code_in_flash_either(
    findings: Make, heading: Heading, placement: str, cycles: int, order: list[str], ranked: bool
) -> None:
    """A tenth of the cheaper one is what flash does not tell apart: 1091 of 10 910."""
    both = [*heading("direct", 0.97, limit=1.8, cycles=12_000), *heading("iterative", 0.95, limit=1.8, cycles=cycles)]
    made = findings(*(replace(each, cycle_model=f"m@{placement}" if each.cycle_model else "") for each in both))
    run = made.finish(decide(made, pytest_exit=0), "2026-01-02T03:04:06Z")
    assert [each.name for each in accuracy_and_cost(run).rows] == order
    refused = "iterative and direct are within 10% and from flash, which ranks neither"
    assert (refused in cost_line(run)) is not ranked
    assert ("iterative costs 0.91 times direct" in cost_line(run)) is ranked


def test_costs_of_code_in_flash_stand_by_name_only_where_the_cheapest_of_them_cannot_be_told_apart() -> None:
    """Each is close to the next, which does not make the first close to the last."""
    costs = {"c": 10_000, "b": 10_900, "a": 11_900}
    made = {name: judge(name, cost, unit="cycle", cycle_model="m@flash") for name, cost in costs.items()}
    assert cheapest_first(made) == ["b", "c", "a"]


@pytest.mark.parametrize(
    ("numbers", "cause"),
    [
        ({"maximum": 6.1, "residual": 0.81}, "(good fit, bad heading: residual 0.81 %, noise predicts 0.79 %)"),
        ({"maximum": 6.1, "residual": 2.4}, "(bad fit: residual 2.40 %, noise predicts 0.79 %)"),
        ({"maximum": 3.9, "bias": 3.0, "centred": 0.9}, "(constant offset)"),
    ],
)
def test_a_failed_heading_names_its_cause(
    findings: Make, heading: Heading, numbers: dict[str, float], cause: str
) -> None:
    maximum = numbers.pop("maximum")
    made = findings(
        *heading("direct", maximum, limit=1.8, cycles=12_400, **numbers), tests=(_test("failed"),), tables=False
    )
    verdict = decide(made, pytest_exit=1)
    assert f"{maximum:.2f} deg for 12 400 {cause}; limit 1.8 deg: FAIL." in verdict.sentence
    assert "Out of limit" not in verdict.sentence, "the cause already covers this calibrator's measurements"
    assert verdict.exit_code == 1


def test_a_bad_accelerometer_is_named_before_the_fit(findings: Make, heading: Heading) -> None:
    norm = judge("accelerometer.norm_rms", 40.0, unit="mg", limit=Limit(max=8))
    made = findings(*heading("direct", 6.1, limit=1.8, cycles=12_400), norm, tests=(_test("failed"),))
    sentence = decide(made, pytest_exit=1).sentence
    assert "12 400 cycles (accelerometer); limit 1.8 deg: FAIL." in sentence
    assert "Out of limit: accelerometer.norm_rms 40 mg (at most 8)." in sentence


def test_without_a_declared_mounting_only_centred_values_count(findings: Make, heading: Heading) -> None:
    made = findings(*heading(
        "direct", 2.7, limit=1.8, cycles=12_400, bias=1.71, centred=0.95, not_judged="the rig declares no mounting yaw"
    ))
    verdict = decide(made, pytest_exit=0)
    assert verdict.sentence == (
        "direct: worst heading 0.95 deg about its mean over 60 poses for 12 400 cycles; limit 1.8 deg: NOT EVALUATED. "
        "Only centred values were judged: the rig declares no mounting yaw; mean error 1.71 deg."
    )
    assert verdict.exit_code == 22


def test_a_centred_error_out_of_limit_fails_even_without_a_mounting(findings: Make, heading: Heading) -> None:
    made = findings(
        *heading("direct", 7.4, limit=1.8, cycles=12_400, bias=1.7, centred=6.0, not_judged="no mounting"),
        tests=(_test("failed"),),
    )
    verdict = decide(made, pytest_exit=1)
    assert "worst heading 6.00 deg about its mean" in verdict.sentence
    assert "good fit, bad heading" in verdict.sentence
    assert verdict.exit_code == 1


def test_limits_stand_in_the_order_of_the_calibrators(findings: Make, heading: Heading) -> None:
    iterative = heading("iterative", 1.0, limit=1.5, cycles=24_000)
    sentence = decide(findings(*heading("direct", 1.5, limit=1.8, cycles=12_000), *iterative), pytest_exit=0).sentence
    assert "; limits 1.8 and 1.5 deg: PASS." in sentence


@pytest.mark.parametrize("outcome", ["passed", "skipped", "xfailed"])
def test_out_of_limit_is_red_whatever_became_of_the_test(
    findings: Make, good: list[Measurement], outcome: str
) -> None:
    bad = judge("cycles.direct.fixed", 11_061.0, unit="cycle", limit=Limit(max=2_600), cycle_model="m", test="t::t")
    verdict = decide(findings(*good, bad, tests=(TestResult("t::t", TestOutcome(outcome), 1),)), pytest_exit=0)
    assert (verdict.exit_code, verdict.outcome) == (1, "fail")
    assert verdict.sentence.endswith("FAIL. Out of limit: cycles.direct.fixed 11 061 cycle (at most 2 600).")


def test_limits_that_were_left_out_are_said_and_make_nobody_red(findings: Make, good: list[Measurement]) -> None:
    verdict = decide(findings(*good), pytest_exit=0, left_out=["a.b", "c.d"])
    assert verdict.sentence.endswith("costs 1/16 of iterative. Not judged: 2 limits of the rig, e.g. a.b.")
    assert (verdict.exit_code, verdict.outcome, verdict.complete) == (0, "pass", False)
    chosen = findings(*good)
    chosen.chosen = True
    assert decide(chosen, pytest_exit=0, left_out=["a.b"]).complete
    assert not decide(chosen, pytest_exit=0, left_out=["a.b"], cut_short=True).complete
    assert not decide(chosen, pytest_exit=2, left_out=["a.b"]).complete


def test_a_limit_that_nothing_met_is_named_and_is_no_calibrator(findings: Make, good: list[Measurement]) -> None:
    limits = {"heading.dirct.max": Limit(max=1.8), "heading.direct.max": Limit(max=1.8), "lamp": Limit(max=1)}
    unmet = unmet_limits(limits, {"lamp": "cd"}, {each.name for each in good}, ("direct", "iterative"))
    verdict = decide(findings(*good, *unmet), pytest_exit=0)
    assert verdict.exit_code == 22
    assert verdict.sentence.startswith("direct: worst heading 0.97 deg over 60 poses for 12 400 cycles; iterative: ")
    assert (
        "NOT EVALUATED. Not judged: heading.dirct.max (the board has no calibrator 'dirct', only direct, iterative), "
        "lamp (nothing measured it)."
    ) in verdict.sentence


@pytest.mark.parametrize(
    ("name", "gate_only", "why"),
    [
        ("heading.dpi.max", True, 'nothing measured it; procedure.dpi is "none", or its fit was refused'),
        ("cycles.dpi-poses.total", False, 'nothing measured it; procedure.dpi is "none", or its fit was refused'),
        ("heading.dpi-poses.max", True, "nothing in the gate set measured it"),
        ("heading.calibration.max", True, "nothing measured it; no calibration file was named with --calibration"),
    ],
)
def test_what_is_no_calibrator_of_the_firmware_is_unmet_for_another_reason(
    name: str, why: str, *, gate_only: bool
) -> None:
    (unmet,) = unmet_limits({name: Limit(max=2.0)}, {}, (), ["direct"], gate_only=gate_only)
    assert unmet.note == why


def test_other_measurements_out_of_limit_are_named(findings: Make, good: list[Measurement]) -> None:
    bad = judge("gyroscope.bias_error", 0.4, unit="dps", limit=Limit(max=0.1), test="t.py::test_rest")
    verdict = decide(findings(*good, bad, tests=(TestResult("t.py::test_rest", TestOutcome.FAILED, 1),)), pytest_exit=1)
    assert verdict.sentence.endswith("FAIL. Out of limit: gyroscope.bias_error 0.4 dps (at most 0.1).")


def test_a_heading_that_is_not_a_number_fails_by_name(findings: Make, heading: Heading) -> None:
    made = findings(*heading("direct", float("nan"), limit=1.8, cycles=12_400), tests=(_test("failed"),))
    sentence = decide(made, pytest_exit=1).sentence
    assert "direct: no heading over 60 poses" in sentence
    assert "heading.direct.max (the value is nan)" in sentence


def test_a_test_that_failed_without_a_measurement_is_named(findings: Make, good: list[Measurement]) -> None:
    for name in ("test_echo", "test_echo[a/b]"):
        failed = TestResult(f"hil/suites/test_link.py::{name}", TestOutcome.FAILED, 1, reason="assert 3 == 4")
        sentence = decide(findings(*good, tests=(failed,)), pytest_exit=1).sentence
        assert sentence.endswith(f"FAIL. Failed: test_link.py::{name} (assert 3 == 4).")


def test_a_lost_bench_says_what_happened_and_what_is_kept(findings: Make) -> None:
    lost = TestResult("a", TestOutcome.CONNECTION_LOST, 1, reason="lost /dev/ttyACM0: unplugged.")
    made = findings(judge("x", 1, unit=""), tests=(lost, TestResult("b", TestOutcome.SKIPPED, 0)))
    verdict = decide(made, pytest_exit=1)
    assert verdict.sentence == "CONNECTION LOST: lost /dev/ttyACM0: unplugged. 1 measurement kept."
    assert (verdict.exit_code, verdict.complete) == (20, False)


def test_a_bench_lost_after_a_failure_is_said_behind_it(findings: Make, good: list[Measurement]) -> None:
    bad = judge("gyroscope.bias_error", 0.4, unit="dps", limit=Limit(max=0.1), test="a")
    lost = TestResult("a", TestOutcome.CONNECTION_LOST, 1, reason="lost /dev/ttyACM0: unplugged.")
    verdict = decide(findings(*good, bad, tests=(lost,)), pytest_exit=1)
    assert verdict.exit_code == 1
    assert verdict.sentence.endswith(
        "FAIL. Out of limit: gyroscope.bias_error 0.4 dps (at most 0.1). Connection lost: lost /dev/ttyACM0: unplugged."
    )


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
def test_exit_codes_in_their_order(
    findings: Make, outcomes: list[str], pytest_exit: int, code: int, word: str
) -> None:
    made = findings(tests=tuple(
        TestResult(str(k), TestOutcome(outcome), 0, reason="why") for k, outcome in enumerate(outcomes)
    ))
    if not outcomes:
        made.tests.clear()
    verdict = decide(made, pytest_exit=pytest_exit)
    assert (verdict.exit_code, verdict.outcome) == (code, word)


def test_an_unset_measurement_gates_only_where_nothing_is_worse(findings: Make, good: list[Measurement]) -> None:
    unset = judge("x", 1.0, unit="deg", limit=Limit(max=2), not_judged="no reference")
    assert decide(findings(*good, unset), pytest_exit=0).exit_code == 22
    assert decide(findings(*good, unset, tests=(_test("failed"),)), pytest_exit=1).exit_code == 1


def _compared(now: Measurement, *faults: str, failed: tuple[str, ...] = ()) -> Comparison:
    """Compare a lamp of 2 mA with another, measured under the same conditions."""
    conditions = Conditions("virtual", "ab", ("direct",), (), 4, (), "all", "gate", False)
    sides = [
        Evidence(Side(file, "", "lamp", "1", "", "gcc", "", "bench", (1,), ""), conditions, {1: {each.name: each}})
        for file, each in (("base.json", judge("lamp.current", 2.0, unit="mA", limit=Limit(max=9))), ("", now))
    ]
    return compare(sides[0], dataclasses.replace(sides[1], faults=faults, failed=failed))


@pytest.mark.parametrize(
    ("current_ma", "faults", "more", "pytest_exit", "code"),
    [
        (2.0, (), (), 0, 0),
        (1.0, (), (), 0, 0),
        (3.0, (), (), 0, 21),
        (3.0, ("cut short",), (), 0, 22),
        (2.0, ("cut short",), (), 0, 22),
        (3.0, (), (judge("x", 1.0, unit="", limit=Limit(max=2), not_judged="no reference"),), 0, 22),
        (3.0, (), (), 1, 1),
        (3.0, ("cut short",), (), 2, 2),
        (2.0, ("cut short",), (), 5, 5),
    ],
)
def test_a_comparison_decides_where_nothing_else_has(
    findings: Make, current_ma: float, faults: tuple[str, ...], more: tuple[Measurement, ...], pytest_exit: int,
    code: int,
) -> None:
    now = judge("lamp.current", current_ma, unit="mA", limit=Limit(max=9))
    made = findings(now, *more)
    made.comparison = _compared(now, *faults, failed=("test_lamp.py::test_on",) if pytest_exit == 1 else ())
    verdict = decide(made, pytest_exit=pytest_exit)
    assert verdict.exit_code == code
    assert ("May be merged " in verdict.sentence) == (code == 0)
    assert ("Not to be merged " in verdict.sentence) == (current_ma == 3.0 and not faults)
    assert ("Cannot say whether " in verdict.sentence) == bool(faults)


def test_the_order_of_measurements_does_not_change_the_sentence(findings: Make, good: list[Measurement]) -> None:
    forward = decide(findings(*good), pytest_exit=0)
    assert decide(findings(*reversed(good)), pytest_exit=0) == forward
    assert dataclasses.replace(forward) == forward


def test_thousands_are_apart() -> None:
    assert [readable(value) for value in (0, 999, 12_400, 1_234_567)] == ["0", "999", "12 400", "1 234 567"]


def _test(outcome: str) -> TestResult:
    return TestResult("hil/suites/test_heading.py::test_heading", TestOutcome(outcome), 1.0)
