"""The verdict of a run: its exit code and its one sentence, from the record alone, and the limits without a value."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from hiltest.errors import LIKELY_CAUSE, remove_registers
from hiltest.measurement import UNDECIDED, Limit, Measurement, Outcome, Reference, Section, identify
from hiltest.run_record.comparison import Change, Comparison
from hiltest.run_record.exit_codes import PYTEST_WINS, WORDS, ExitCode, comparison_code, outcome_of
from hiltest.run_record.failures import group_by_reason, out_of_limit, tests_in_words, tests_named
from hiltest.run_record.outcomes import RED, TestOutcome
from hiltest.run_record.run import Findings, Run, TestResult, Verdict
from hiltest.text import format_count, format_with_unit, join_words, number, short_test_id
from hiltest.verdict.calibrators import (
    MEAN_ERROR,
    UNCALIBRATED,
    WORST_HEADING,
    CalibratorResult,
    has_no_number,
    value_of,
)
from hiltest.verdict.evidence import POSES_TABLE
from hiltest.verdict.reported_headings import FIRMWARE, costs_in_words, parts_in_words
from hiltest.verdict.summary import Failure, Summary, held_to, ratio_in_words, summarise, unmeasured_in_words
from hiltest.verdict.wording import answer_in_words, entry, reasons

TIE_DEG = 0.1
"""Worst headings this close count as equal: a tenth of the resolution of a compass limit of 1 or 2 degrees."""

_NAMED_AT_MOST = 3
_CALIBRATOR = "{calibrator}"
_UNTRIMMED = "-untrimmed"
# Calibrations against gravity that only the full set makes.
_OF_THE_FULL_SET = ("dpi", "dpi-poses")
# Calibrations that no calibrator of the firmware makes from the tumble's points, and reasons why one may be missing.
_OTHERWISE = {
    **dict.fromkeys(("joint", *_OF_THE_FULL_SET), 'procedure.dpi is "none", or its fit was refused'),
    "calibration": "--calibration named no file",
}


def decide(findings: Findings, *, pytest_exit: int, left_out: Sequence[str] = (), cut_short: bool = False) -> Verdict:
    """Decide a run.

    Parameters
    ----------
    findings
        Tests, measurements and tables of the run, and its comparison with a base, if any.
    pytest_exit
        Exit status of pytest; its 2, 3, 4 and 5 take precedence over every other.
    left_out
        Limits of the rig without a measurement, because the user chose among the tests
        or because the session stopped. They are named, and fail no run.
    cut_short
        True if planned tests did not run.

    Returns
    -------
    Verdict
        `complete` is False if planned tests did not finish, or limits were left out without the user's choice. The
        record states a choice (`Run.chosen`), and is compared with runs of the same choice.
    """
    code = exit_code(findings, pytest_exit=pytest_exit)
    word = outcome_of(code)
    not_met = left_out and not findings.chosen
    return Verdict(
        outcome=word,
        exit_code=code,
        sentence=_sentence(findings, word, left_out),
        complete=not (pytest_exit in PYTEST_WINS or cut_short or not_met or _bench_failures(findings)),
    )


def exit_code(findings: Findings, *, pytest_exit: int) -> int:
    """Return the exit code: pytest's 2 to 5 and 24, then 1, 23, 20, 22, 21; 1 also for a crash that the base lacks."""
    if pytest_exit in PYTEST_WINS:
        return pytest_exit
    # A measurement out of its limit is red even if its test is skipped afterwards.
    outcomes = {test.outcome for test in findings.tests}
    if _has_failed(findings):
        return ExitCode.FAILED
    if TestOutcome.WRONG_FIRMWARE in outcomes:
        return ExitCode.WRONG_FIRMWARE
    if TestOutcome.CONNECTION_LOST in outcomes:
        crashes = findings.comparison is not None and findings.comparison.failed
        return ExitCode.FAILED if crashes else ExitCode.CONNECTION_LOST
    if pytest_exit != ExitCode.OK:
        return pytest_exit
    if any(measurement.outcome in UNDECIDED for measurement in findings.measurements.values()):
        return ExitCode.NOT_EVALUATED
    return ExitCode.OK if findings.comparison is None else comparison_code(findings.comparison)


def _sentence(findings: Findings, word: str, left_out: Sequence[str]) -> str:
    """Compose the verdict: answer and word, failures, cause and next step, accuracy, and limits not evaluated.

    A comparison names its changes before everything else, unless the run itself failed: it then ends with their count.
    """
    opening, comparison, failed = _opening(word, findings.comparison), findings.comparison, _has_failed(findings)
    stopped = _stop_reason(findings)
    crashes = comparison.failed if comparison and stopped else ()
    changes = f"{reasons(comparison, beside_failures=failed or bool(crashes))}." if comparison else ""
    counts = f"Changes: {changes}" if changes else ""
    if stopped:
        saved = f"{format_count(len(findings.measurements), 'measurement')} kept."
        reason = _end_with_period(crashes[0]) if crashes else stopped
        return " ".join(filter(None, (f"{opening}: {reason} {saved}", counts)))
    summary = summarise(findings)
    poses = findings.tables.get(POSES_TABLE)
    is_red = failed or (comparison is not None and comparison.regression)
    return " ".join(
        filter(
            None,
            (
                f"{opening}." if failed or not changes else f"{opening}: {changes}",
                failures_in_words(summary.failures),
                tests_in_words([replace(test, reason=_fault(test.reason)) for test in summary.broken]),
                _cause_sentence(summary.causes),
                f"Next: {summary.advice[0]}" if is_red and summary.advice else "",
                _not_evaluated(summary, findings, word.upper()),
                _as_sentence(unmeasured_in_words(summary.unmeasured)),
                "" if is_red else _best_results(summary, len(poses.rows) if poses else 0),
                *(
                    f"{test.outcome.capitalize()}: {_end_with_period(_fault(test.reason))}"
                    for test in _bench_failures(findings)[:1]
                ),
                _left_out_words(left_out),
                counts if failed else "",
            ),
        )
    )


@dataclass(frozen=True, slots=True)
class Headline:
    """First lines of every report, in this order; an empty line is left out."""

    verdict: str
    """Answer of the comparison, if there is one, the verdict's word, and the number of failures."""
    number: str
    """Measurement that decides, with its limit and its value in the baseline; of a green run the best results."""
    cause: str
    """Likely cause."""
    action: str
    """Next step."""

    @property
    def lines(self) -> list[str]:
        """The lines as sentences."""
        cause = self.cause and f"Likely cause: {self.cause}."
        return [
            _end_with_period(self.verdict),
            *filter(None, (self.number, cause, self.action and f"Next: {self.action}")),
        ]


def headline(run: Run, summary: Summary) -> Headline:
    """Return the first lines of the reports of a run, from its summary."""
    opening, comparison = _opening(run.verdict.outcome, run.comparison), run.comparison
    action = summary.advice[0] if summary.advice else ""
    worse = comparison.differences_with(Change.WORSE) if comparison and comparison.regression else ()
    is_red = run.verdict.exit_code in (ExitCode.FAILED, ExitCode.REGRESSION)
    if is_red and summary.failures:
        number = failure_in_words(worst_failure(summary))
    elif is_red and summary.broken:
        (reason, tests), *_ = group_by_reason(summary.broken).items()
        number = f"{tests_named(tests)}: {_fault(reason)}"
    elif is_red and worse:
        number = entry(worse[0])
    else:
        words = run.verdict.sentence.removeprefix(opening).removeprefix(run.verdict.outcome.upper())
        return Headline(opening, words.lstrip(".: "), "", action)
    limits = sum(measurement.limit is not None for measurement in run.measurements)
    counts = (
        f"{len(summary.failures)} of {format_count(limits, 'limit')} missed" if summary.failures else "",
        f"{format_count(len(summary.broken), 'test')} failed" if summary.broken else "",
        f"{len(worse)} worse" if worse else "",
    )
    verdict = f"{opening}{', ' if comparison else ': '}{', '.join(filter(None, counts))}"
    return Headline(verdict, number, join_words(summary.causes, 1), action)


def worst_failure(summary: Summary) -> Failure:
    """Return the failure that stands for all: the first one that the likely cause explains; of headings the largest."""
    first = next((failure for failure in summary.failures if failure.cause), summary.failures[0])
    alike = [
        failure
        for failure in summary.failures
        if failure.cause == first.cause and failure.measurement.kind is first.measurement.kind is WORST_HEADING
    ]
    return max(alike, key=lambda failure: round(value_of(failure.measurement) or 0.0, 2), default=first)


def failure_in_words(failure: Failure) -> str:
    """Return a failure in one line: value, limit, value in the baseline, and place of the measurement."""
    measurement = failure.measurement
    place = measurement.place or short_test_id(measurement.test)
    note = f": {measurement.note}" if measurement.note and measurement.value is not None else ""
    value = f"{measurement.name} {_value(measurement) or 'no value'}{held_to(measurement, failure.was)}"
    return f"{value}{note}" + (f", {place}" if place else "")


def _fault(reason: str) -> str:
    """Return the message of a failed test without registers, and without the likely cause, which has a sentence."""
    return remove_registers(reason).partition(LIKELY_CAUSE)[0]


def _opening(word: str, comparison: Comparison | None) -> str:
    """Return the answer of the comparison, if there is one, and the word of the verdict."""
    return f"{answer_in_words(comparison)}: {word.upper()}" if comparison else word.upper()


def _as_sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}." if words else ""


def _has_failed(findings: Findings) -> bool:
    return bool(_failed_measurements(findings)) or _has_red_test(findings)


def _best_results(summary: Summary, poses: int) -> str:
    """Return accuracy and cost of the cost reference, and of the cheapest other calibrator."""
    results = [calibrator.result for calibrator in summary.calibrators]
    if not results:
        return ""
    lead = next((result for result in results if result.name == summary.reference), results[0])
    ratios = {calibrator.name: calibrator.ratio for calibrator in summary.calibrators}
    others = [
        result for result in results if result is not lead and ratios[result.name] and result.maximum.value is not None
    ]
    beside = (
        [
            parts_in_words({result.name: value_of(result.maximum) for result in results}),
            costs_in_words(results),
        ]
        if lead.name == FIRMWARE
        else []
    )
    against = _compare_calibrators(others[0], lead) if others else ""
    return " ".join(filter(None, (_accuracy_and_cost(lead, poses), *beside, against)))


def _accuracy_and_cost(result: CalibratorResult, poses: int) -> str:
    centred = result.maximum.outcome is Outcome.UNSET and result.centred is not None
    centred = centred and result.centred is not None and result.centred.outcome is not Outcome.UNSET
    heading = result.centred if centred and result.centred else result.maximum
    worst = "no heading" if heading.value is None else f"worst heading {format_with_unit(heading.value, heading.unit)}"
    worst += (" about its mean" if centred else "") + (f" over {poses} poses" if poses else "") + held_to(heading)
    cycles = result.cycles
    cost = ""
    if cycles is not None and cycles.value is not None:
        cost = f", {format_with_unit(cycles.value, 'cycle')}{held_to(cycles)}"
    return f"{result.name}: {worst}{cost}."


def _compare_calibrators(other: CalibratorResult, lead: CalibratorResult) -> str:
    """Compare accuracy and cost of two calibrators that received the same points."""
    worse_deg = (value_of(other.maximum) or 0.0) - (value_of(lead.maximum) or 0.0)
    if abs(worse_deg) <= TIE_DEG:
        accuracy = f"equal accuracy (within {TIE_DEG:g} deg)"
    else:
        accuracy = f"{abs(worse_deg):.2f} deg {'worse' if worse_deg > 0 else 'better'}"
    return f"{other.name}: {accuracy}, {ratio_in_words(other, lead)}."


def failures_in_words(failures: Sequence[Failure]) -> str:
    """Name the first measurements that failed, each with its limit and its value in the baseline."""
    if not failures:
        return ""
    named = [
        f"{failure.measurement.name} {_value(failure.measurement)}" + held_to(failure.measurement, failure.was)
        for failure in failures
    ]
    return f"{join_words(named, _NAMED_AT_MOST)}."


def _cause_sentence(causes: Sequence[str]) -> str:
    return f"Likely cause: {join_words(causes, 1)}." if causes else ""


def _value(measurement: Measurement) -> str:
    return measurement.note if measurement.value is None else format_with_unit(measurement.value, measurement.unit)


def _left_out_words(left_out: Sequence[str]) -> str:
    if not left_out:
        return ""
    if len(left_out) == 1:
        return f"No test measured {left_out[0]}, so that its limit was not checked."
    return f"{len(left_out)} limits of the rig were not checked, because no test measured them, e.g. {left_out[0]}."


def _not_evaluated(summary: Summary, findings: Findings, word: str) -> str:
    """Name the limits that could not be decided or applied, and the checks that replaced them."""
    near = [measurement for measurement in summary.unset if measurement.outcome is Outcome.CANNOT_TELL]
    unset = [measurement for measurement in summary.unset if measurement not in near]
    undecided = join_words(
        [f"{measurement.name} {_value(measurement)}{held_to(measurement)}" for measurement in near], _NAMED_AT_MOST
    )
    open_ = f"Cannot tell at this uncertainty: {undecided}." if near else ""
    return " ".join(filter(None, (open_, _unset_in_words(unset, findings, word))))


def _unset_in_words(unset: Sequence[Measurement], findings: Findings, word: str) -> str:
    if not unset:
        return ""
    if all(_lacks_mounting(measurement) for measurement in unset):
        means = [
            measurement
            for measurement in findings.measurements.values()
            if measurement.kind is MEAN_ERROR and measurement.value is not None
        ]
        mean = f"; mean error {number(means[0].value, 'deg')} deg" if means else ""
        return f"Only centred values were checked: {unset[0].note}{mean}."
    named = join_words([f"{measurement.name} ({measurement.note})" for measurement in unset], _NAMED_AT_MOST)
    is_in_verdict = word == str(WORDS[ExitCode.NOT_EVALUATED]).upper()
    return f"{named}." if is_in_verdict else f"Not evaluated: {named}."


def _lacks_mounting(measurement: Measurement) -> bool:
    """Return whether a heading was measured and only its limit could not be applied, since no mounting is declared."""
    kind = measurement.kind
    mounted = kind is not None and kind.reference is Reference.MOUNTED
    return mounted and not has_no_number(measurement)


def _stop_reason(findings: Findings) -> str:
    """Return why the bench or the firmware ended the run; empty if neither did."""
    stopped = _bench_failures(findings)
    if not stopped or _has_failed(findings):
        return ""
    return _end_with_period(_fault(stopped[0].reason))


def _end_with_period(reason: str) -> str:
    return reason if reason.endswith((".", "?")) else f"{reason}."


def _failed_measurements(findings: Findings) -> list[Measurement]:
    return out_of_limit(findings.measurements.values())


def _bench_failures(findings: Findings) -> list[TestResult]:
    return [test for test in findings.tests if test.outcome.is_of_bench]


def _has_red_test(findings: Findings) -> bool:
    return any(test.outcome in RED for test in findings.tests)


def unmet_limits(
    limits: Mapping[str, Limit],
    units: Mapping[str, str],
    measured: Collection[str],
    calibrators: Sequence[str],
    *,
    gate_only: bool = False,
    places: Mapping[str, str] | None = None,
) -> list[Measurement]:
    """Return a measurement without a value for every limit of the rig without a measurement.

    Parameters
    ----------
    limits, units
        Limits and units of the rig, by measurement name.
    measured
        Names of all measurements.
    calibrators
        Calibrators of the board; empty if no board answered.
    gate_only
        True if tests of the full set were left out.
    places
        Position of each limit, ``file:line``.
    """
    stands = places or {}
    return [
        Measurement(
            name,
            None,
            units.get(name, ""),
            limit=limit,
            outcome=Outcome.UNSET,
            note=_unmet_reason(name, calibrators, gate_only, stands.get(name, "")),
        )
        for name, limit in limits.items()
        if name not in measured
    ]


def _unmet_reason(name: str, calibrators: Sequence[str], gate_only: bool, place: str) -> str:
    named = identify(name)
    calibrator, _, points = named.subject.removesuffix(_UNTRIMMED).partition("@")
    waits = gate_only and calibrator in _OF_THE_FULL_SET
    if named.kind and _CALIBRATOR in named.kind.name and named.section is not Section.STREAMS and not waits:
        if calibrator in _OTHERWISE:
            return f"nothing measured it; {_OTHERWISE[calibrator]}"
        if calibrators and calibrator not in (*calibrators, UNCALIBRATED):
            asked = f"; the limit is in {place}" if place else ""
            return f"the board has no calibrator {calibrator!r}; it has {', '.join(calibrators)}{asked}"
    if points:
        return f"nothing measured it; procedure.further_calibrations has no {calibrator}@{points}, or its fit failed"
    return "nothing in the gate set measured it" if gate_only else "nothing measured it"
