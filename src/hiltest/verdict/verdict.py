"""How a run ended: the exit code and the one sentence. Pure, from the record alone."""

from __future__ import annotations

from collections.abc import Sequence

from hiltest.calibration.fit import FitStatus
from hiltest.measurement import FLASH_TIE, Measurement, Outcome, Section, cannot_be_ranked
from hiltest.record.exit_codes import PYTEST_WINS, WORDS, ExitCode, comparison_code
from hiltest.record.failures import (
    failed_otherwise,
    limits_in_words,
    out_of_limit,
    tests_in_words,
)
from hiltest.record.outcomes import TestOutcome
from hiltest.record.run import Findings, TestResult, Verdict
from hiltest.text import counted, listed, readable
from hiltest.verdict.calibrators import (
    MEAN_ERROR,
    CalibratorResult,
    calibrator_results,
    has_no_number,
    maximum_of,
    value_of,
)
from hiltest.verdict.causes import Cause

POSES_TABLE = "heading.poses"

TIE_DEG = 0.1
"""Worst headings this close are a tie: a tenth of what a compass limit of 1 or 2 degrees resolves."""

_NAMED_AT_MOST = 3


def decide(
    findings: Findings, *, pytest_exit: int, left_out: Sequence[str] = (), cut_short: bool = False
) -> Verdict:
    """Decide a run.

    Parameters
    ----------
    findings : Findings
        Tests, measurements and tables of the run, and its comparison with a base if it was to be judged against one.
    pytest_exit : int
        Exit status as pytest has it; its 2, 3, 4 and 5 win over every other.
    left_out : sequence of str
        Limits of the rig that nothing was measured against, because the user chose among the tests
        or because the session stopped. They are named, and make nobody red.
    cut_short : bool, optional
        Whether tests that were to run did not.

    Returns
    -------
    Verdict
        `complete` is False when tests that were to run did not come to their end, or limits were left out that nobody
        chose to leave out. What was chosen stands in the record (`Run.chosen`), and is compared with its like.
    """
    code = exit_code(findings, pytest_exit=pytest_exit)
    known = code in list(ExitCode)
    word = WORDS[ExitCode(code)] if known else f"exit code {code}"
    not_met = left_out and not findings.chosen
    return Verdict(
        outcome=word, exit_code=code, sentence=_sentence(findings, word, left_out),
        complete=not (pytest_exit in PYTEST_WINS or cut_short or not_met or _stopped(findings)),
    )


def exit_code(findings: Findings, *, pytest_exit: int) -> int:
    """Return the exit code: pytest's 2 to 5, then 1, 23, 20, 22, 21."""
    if pytest_exit in PYTEST_WINS:
        return pytest_exit
    # A measurement out of its limit is red whatever its test went on to do, such as skip.
    outcomes = {each.outcome for each in findings.tests}
    if _red(findings) or _failed(findings):
        return ExitCode.FAILED
    if TestOutcome.WRONG_FIRMWARE in outcomes:
        return ExitCode.WRONG_FIRMWARE
    if TestOutcome.CONNECTION_LOST in outcomes:
        return ExitCode.CONNECTION_LOST
    if pytest_exit != ExitCode.OK:
        return pytest_exit
    if any(each.outcome is Outcome.UNSET for each in findings.measurements.values()):
        return ExitCode.NOT_EVALUATED
    return ExitCode.OK if findings.comparison is None else comparison_code(findings.comparison)


def _sentence(findings: Findings, word: str, left_out: Sequence[str]) -> str:
    """Compose the verdict: calibrators, limit and word, then whatever else is out of order."""
    measurements = tuple(findings.measurements.values())
    # What is neither judged nor has a cost to compare, such as one that lives with the stream, is in the report alone.
    results = [each for each in calibrator_results(measurements) if each.maximum.limit or each.cycles]
    against_base = findings.comparison.sentence if findings.comparison else ""
    stopped = _what_stopped(findings)
    if stopped:
        return f"{word.upper()}: {stopped} {counted(len(measurements), 'measurement')} kept. {against_base}".rstrip()
    poses = findings.tables.get(POSES_TABLE)
    count = len(poses.rows) if poses else 0
    parts = [_calibrator_words(each, 0 if index else count) for index, each in enumerate(results)]
    if limits := _limit_words(results):
        parts.append(limits)
    sentence = "; ".join(parts) + f": {word.upper()}." if parts else f"{word.upper()}."
    return " ".join(filter(None, (
        sentence, *_remarks(findings, results), _left_out_words(left_out),
        against_base,
    )))


def _limit_words(results: Sequence[CalibratorResult]) -> str:
    """Return the limits in the order in which the calibrators are named; one alone when all share it."""
    limits = [maximum_of(each.maximum) for each in results]
    if not any(limit is not None for limit in limits):
        return ""
    words = ["none" if limit is None else f"{limit:g}" for limit in limits]
    if len(set(words)) == 1:
        return f"limit {words[0]} deg"
    return f"limits {', '.join(words[:-1])} and {words[-1]} deg"


def _left_out_words(left_out: Sequence[str]) -> str:
    if not left_out:
        return ""
    example = f", e.g. {left_out[0]}" if len(left_out) > 1 else f": {left_out[0]}"
    return f"Not judged: {len(left_out)} limit{'s' * (len(left_out) > 1)} of the rig{example}."


def _calibrator_words(result: CalibratorResult, poses: int) -> str:
    unset = result.maximum.outcome is Outcome.UNSET and result.centred is not None
    judged = result.centred if unset and result.centred else result.maximum
    words = f"{result.name}: "
    if judged.value is None:
        words += "no heading"
    else:
        words += ("worst heading " if poses else "") + f"{judged.value:.2f} deg"
    words += " about its mean" if unset else ""
    words += f" over {poses} poses" if poses else ""
    if result.cycles is not None and result.cycles.value is not None:
        words += f" for {readable(result.cycles.value)}" + (" cycles" if poses else "")
    return words + _cause_words(result)


def _cause_words(result: CalibratorResult) -> str:
    if result.cause is Cause.NONE:
        return ""
    residual, predicted = value_of(result.residual), value_of(result.residual_predicted)
    about_the_fit = result.cause in (Cause.GOOD_FIT_BAD_HEADING, Cause.POOR_COVERAGE, Cause.BAD_FIT)
    if about_the_fit and residual is not None and predicted is not None:
        sphere = "" if result.fit is FitStatus.ELLIPSOID else "only a sphere was fitted, "
        return f" ({result.cause}: {sphere}residual {residual:.2f} %, noise predicts {predicted:.2f} %)"
    return f" ({result.cause})"


def _remarks(findings: Findings, results: Sequence[CalibratorResult]) -> list[str]:
    """Return what follows the first sentence."""
    measurements = findings.measurements.values()
    named = [each.name for each in results if each.cause is not Cause.NONE]
    explained = {f"{kind}.{name}." for name in named for kind in ("heading", "fit")}
    failed = _failed(findings)
    others = [each for each in failed if not each.name.startswith(tuple(explained))]
    red_otherwise = failed_otherwise(findings.tests, failed)
    remarks = [_not_judged(list(measurements)), limits_in_words(others), tests_in_words(red_otherwise)]
    remarks += [f"{each.outcome.capitalize()}: {each.reason.rstrip('.')}." for each in _stopped(findings)[:1]]
    if not failed and not _red(findings):
        remarks.append(_comparison(results))
    return remarks


def _not_judged(measurements: Sequence[Measurement]) -> str:
    unset = [each for each in measurements if each.outcome is Outcome.UNSET]
    if not unset:
        return ""
    if all(each.section is Section.HEADING and not has_no_number(each) for each in unset):
        biases = [each for each in measurements if each.kind is MEAN_ERROR and each.value is not None]
        mean = f"; mean error {biases[0].value:.2f} deg" if biases and biases[0].value is not None else ""
        return f"Only centred values were judged: {unset[0].note}{mean}."
    return f"Not judged: {_listed([f'{each.name} ({each.note})' for each in unset])}."


def _comparison(results: Sequence[CalibratorResult]) -> str:
    """Compare the cheapest calibrator with the most accurate other one."""
    rated = [each for each in results if each.maximum.value is not None and each.cycles and each.cycles.value]
    if len(rated) < 2:
        return ""
    cheap = min(rated, key=lambda each: value_of(each.cycles) or 0.0)  # where flash ranks none, they stand by name
    others = [each for each in rated if each is not cheap]
    other = min(others, key=lambda each: value_of(each.maximum) or 0.0)
    ratio = (value_of(other.cycles) or 0.0) / (value_of(cheap.cycles) or 1.0)
    part = f"1/{ratio:.0f}" if ratio >= 1.5 else f"{1 / ratio:.2f}"
    cost = f"{cheap.name} costs {part} of {other.name}"
    if cannot_be_ranked(cheap.cycles, other.cycles):
        cost = f"their costs are within {FLASH_TIE:.0%} and from flash, which ranks neither"
    gain = (value_of(other.maximum) or 0.0) - (value_of(cheap.maximum) or 0.0)
    if abs(gain) <= TIE_DEG:
        return f"Accuracy ties; {cost}."
    better = cheap if gain > 0 else other
    return f"{better.name} is {abs(gain):.2f} deg better; {cost}."


def _what_stopped(findings: Findings) -> str:
    """Return why the bench or the firmware ended the run, empty when neither did."""
    stopped = _stopped(findings)
    if not stopped or _red(findings) or _failed(findings):
        return ""
    return f"{stopped[0].reason.rstrip('.')}."


def _failed(findings: Findings) -> list[Measurement]:
    return out_of_limit(findings.measurements.values())


def _stopped(findings: Findings) -> list[TestResult]:
    return [each for each in findings.tests if each.outcome.is_of_bench]


def _red(findings: Findings) -> bool:
    return any(each.outcome.is_red for each in findings.tests)



def _listed(texts: Sequence[str]) -> str:
    return listed(texts, _NAMED_AT_MOST)
