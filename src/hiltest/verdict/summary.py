"""Summary of a run: failures and causes, accuracy and cost of each calibrator, and measurements close to a limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from shlex import quote
from statistics import median

from hiltest.errors import LIKELY_CAUSE
from hiltest.measurement import (
    FLASH_TIE,
    KINDS,
    UNDECIDED,
    Limit,
    Measurement,
    Outcome,
    Section,
    cannot_be_ranked,
    identify,
    ratio_range,
)
from hiltest.orientation.heading_models import OUTPUT_STEP
from hiltest.run_record.comparison import Change, Difference
from hiltest.run_record.failures import failed_otherwise, out_of_limit
from hiltest.run_record.run import Findings, Run, TestResult
from hiltest.text import format_count, format_number, hundredths, join_words, number
from hiltest.verdict.calibrators import CalibratorResult, calibrator_results, heading_as_read, value_of
from hiltest.verdict.causes import Cause
from hiltest.verdict.compare import CALIBRATED_AFTER, OF_FIRMWARE, rounding_in_words
from hiltest.verdict.diagnosis import Diagnosis, diagnose_run
from hiltest.verdict.evidence import BASE_POSES_TABLE, POSES_TABLE
from hiltest.verdict.reported_headings import FIRMWARE, next_step
from hiltest.verdict.wording import entry

CLOSE = 0.05
"""A measurement is close to its limit if it is nearer than this fraction of it."""
CLOSE_AT_MOST = 5

_OF_UNSET = "Run the tests that measure these limits, or remove the limits from the rig."

_OF_DOUBT = (
    "Set and read the angles more precisely, and update uncertainty_deg under [turntable] and [mounting] in "
    "the rig: a value closer to its limit than U proves nothing."
)

_OF_THE_TUMBLE = (Cause.POOR_COVERAGE, Cause.OWN_CALIBRATION)
"""Causes whose advice is another tumble."""
_OF_THE_CHANGE = (
    "Compare the calibration of both builds: its samples, the time at which it takes them, and when it accepts its fit."
)

_OF_ROUNDING = f"Check {OUTPUT_STEP}."

_SAME_DEG = 0.5
"""Calibrators that measured the same points differ in their mean errors by less, unless one of them is wrong."""

_OF_CALIBRATORS = (Section.HEADING, Section.FIT)

MAY_EXCEED = "may exceed the limit within the model's uncertainty"
"""Remark on a count within its limit that would not be at one end of its uncertainty range."""
_MOST_POINTS = 10_000
_OF_THE_THESIS = (168.0, 2600.0)
"""Budget of the thesis' own calibrator: cycles per point, and fixed."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A measurement out of its limit."""

    measurement: Measurement
    was: float | None
    """Value in the baseline; None without one."""
    cause: str
    """Likely cause, in the same words for all failures of its kind; empty if unknown."""


@dataclass(frozen=True, slots=True)
class CalibratorLine:
    """Worst heading and cycles of one calibrator; `ratio` is its cost as a multiple of the reference's."""

    result: CalibratorResult
    ratio: str

    @property
    def name(self) -> str:
        """Name of the calibrator."""
        return self.result.name


@dataclass(frozen=True, slots=True)
class Summary:
    """Contents of the top of every report, in this order."""

    failures: tuple[Failure, ...]
    """Failures, one of each calibrator first."""
    causes: tuple[str, ...]
    """Likely causes: changed settings of sensors, then one of each kind; that of the first failure comes first."""
    broken: tuple[TestResult, ...]
    """Tests that are red for another reason than a limit."""
    unset: tuple[Measurement, ...]
    """Limits that could not be decided at the uncertainty of their reference, or not evaluated for another reason."""
    unmeasured: tuple[Measurement, ...]
    """Limits without a measurement because tests broke off."""
    advice: tuple[str, ...]
    """Suggested next steps; that of the first cause comes first."""
    predicted_deg: Mapping[str, Sequence[float]]
    """Heading errors [deg] that the likely cause of a calibrator predicts at each known angle, as far as it has any."""
    reference: str
    """Calibrator that the ratios refer to; empty without one."""
    calibrators: tuple[CalibratorLine, ...]
    """Calibrators, cheapest first."""
    as_read: Measurement | None
    """Worst heading error without calibration; None if it was not measured."""
    close: tuple[Measurement, ...]
    """Measurements within `CLOSE` of a limit, or whose uncertainty range crosses it; at most `CLOSE_AT_MOST`."""

    def other_cause(self, failure: Failure) -> str:
        """Return the cause of a failure, unless it is the first one, which reports name once for all failures."""
        return "" if failure.cause in self.causes[:1] else failure.cause


def summarise(run: Run | Findings) -> Summary:
    """Return the summary of a run."""
    measurements = tuple(run.measurements.values()) if isinstance(run, Findings) else run.measurements
    results = calibrator_results(measurements)
    failed = out_of_limit(measurements)
    reference = cost_reference(run, results)
    broken = tuple(failed_otherwise(run))
    in_messages = dict(filter(None, map(_cause_in_message, broken)))
    if (after := _differing(run, CALIBRATED_AFTER)) and after.change is Change.WORSE and after.new is None:
        in_messages = {after.note: _OF_THE_CHANGE}
    tables = run.tables if isinstance(run, Findings) else {table.name: table for table in run.tables}
    named = [result.name for result in results]
    causes = diagnose_run(named, measurements, tables, is_broken=bool(broken)) if failed or broken else {}
    causes = {name: _blame_change(name, diagnosis, run) for name, diagnosis in causes.items()}
    in_order = _sort_failures(failed, reference.name if reference else "")
    of_failures = [causes[subject] for subject in _failed_headings(in_order) if subject in causes]
    distinct = _distinct_causes([*of_failures, *causes.values()])
    failures = [_failure(measurement, run, causes, distinct) for measurement in in_order]
    unset = [measurement for measurement in measurements if measurement.outcome in UNDECIDED]
    near = [measurement for measurement in unset if measurement.outcome is Outcome.CANNOT_TELL]
    unmeasured = [measurement for measurement in unset if broken and measurement.value is None and not measurement.test]
    differences = run.comparison.differences if run.comparison and (failed or broken) else ()
    worse = run.comparison.differences_with(Change.WORSE)[:1] if run.comparison and run.comparison.regression else ()
    settings = [entry(difference) for difference in differences if difference.is_changed_setting]
    rounding = rounding_in_words(tables.get(BASE_POSES_TABLE), tables.get(POSES_TABLE))
    rounding = rounding if _has_moved_headings(run, failed) else ""
    mounting = _mounting_advice(unset, measurements)
    return Summary(
        failures=tuple(failures),
        causes=(*settings, *([rounding] if rounding else []), *in_messages, *distinct.values()),
        broken=broken,
        unset=tuple(measurement for measurement in unset if measurement not in unmeasured),
        unmeasured=tuple(unmeasured),
        advice=tuple(
            dict.fromkeys(
                (
                    *([_OF_ROUNDING] if rounding else []),
                    *in_messages.values(),
                    *(cause.advice for cause in [*of_failures, *causes.values()]),
                    *(next_step(failure.measurement, tables) for failure in failures if not failure.cause),
                    *([mounting or _OF_DOUBT] if near else []),
                    *(identify(difference.name).next_step for difference in worse if not failed and not broken),
                    *(_repeat_test(test) for test in broken[:1] if not failed and not causes),
                    *([mounting or _OF_UNSET] if len(unset) > len(near) and not failed and not broken else []),
                )
            )
        ),
        predicted_deg={name: cause.predicted_deg for name, cause in causes.items() if len(cause.predicted_deg)},
        reference=reference.name if reference else "",
        calibrators=tuple(
            CalibratorLine(result, _ratio(run, result, reference))
            for result in sorted(results, key=lambda result: result.name != FIRMWARE)
            if result.maximum.limit or result.cycles or FIRMWARE in named
        ),
        as_read=heading_as_read(measurements),
        close=close_to_limit(measurements),
    )


def _differing(run: Run | Findings, name: str) -> Difference | None:
    """Return the difference of a measurement from the base; None without one."""
    differences = run.comparison.differences if run.comparison else ()
    return next((difference for difference in differences if difference.name == name), None)


def _has_moved_headings(run: Run | Findings, failed: Sequence[Measurement]) -> bool:
    """Return whether the firmware's headings are out of a limit that they met in the base, or else only worse."""
    if not failed:
        worse = run.comparison.differences_with(Change.WORSE) if run.comparison and run.comparison.regression else ()
        return any(difference.name.startswith(OF_FIRMWARE) for difference in worse)
    own = [measurement for measurement in failed if measurement.name.startswith(OF_FIRMWARE) and measurement.limit]
    pairs = [(measurement.limit, _differing(run, measurement.name)) for measurement in own]
    return any(limit and was and was.base is not None and limit.holds(was.base) for limit, was in pairs)


def _blame_change(name: str, diagnosis: Diagnosis, run: Run | Findings) -> Diagnosis:
    """Return a diagnosis; if the base calibrated with the same samples, no other samples are needed."""
    heading = _differing(run, f"heading.{name}.max")
    was_right = heading is not None and heading.base is not None and heading.limit and heading.limit.holds(heading.base)
    is_same_tumble = run.comparison and run.comparison.evaluated and run.board and run.board.kind == "virtual"
    if diagnosis.cause not in _OF_THE_TUMBLE or not was_right or not is_same_tumble:
        return diagnosis
    words = f"the change of the firmware, since the base calibrated with the same samples; {diagnosis.words}"
    return replace(diagnosis, words=words, advice=_OF_THE_CHANGE)


def _mounting_advice(unset: Sequence[Measurement], measurements: Sequence[Measurement]) -> str:
    """Return the advice to correct the mounting if all undecided headings err by one angle; empty otherwise."""
    names = {f"heading.{measurement.subject}.bias" for measurement in unset if measurement.section is Section.HEADING}
    values = [float(measurement.value or 0.0) for measurement in measurements if measurement.name in names]
    doubt_deg = max([_SAME_DEG, *(measurement.uncertainty or 0.0 for measurement in unset)])
    if not values or min(map(abs, values)) <= doubt_deg or max(values) - min(values) > _SAME_DEG:
        return ""
    return (
        f"All headings are off by {median(values):+.2f} deg in the mean: if the board sits on its table like this, add "
        "this angle to yaw_deg under [mounting] in the rig (0 if it has none)."
    )


def _distinct_causes(causes: Sequence[Diagnosis]) -> dict[Cause, str]:
    """Return the words of the first cause of each kind."""
    distinct: dict[Cause, str] = {}
    for cause in causes:
        distinct.setdefault(cause.cause, cause.words)
    return distinct


def _failed_headings(failures: Sequence[Measurement]) -> list[str]:
    return [failure.subject for failure in failures if failure.section in _OF_CALIBRATORS]


def _cause_in_message(test: TestResult) -> tuple[str, str] | None:
    """Return the likely cause that the message of a failed test names, and the next step; None without one."""
    _, separator, words = test.reason.partition(LIKELY_CAUSE)
    cause, _, step = words.partition(". ")
    return (cause, step) if separator else None


def _repeat_test(test: TestResult) -> str:
    name = quote(test.id.rpartition("::")[2].partition("[")[0])
    return f"Repeat the test alone: hiltest run -- -k {name}, or pytest -k {name}."


def unmeasured_in_words(unmeasured: Sequence[Measurement]) -> str:
    """Return the limits that failed tests left without a measurement, in words; empty without any."""
    if not unmeasured:
        return ""
    named = join_words([measurement.name for measurement in unmeasured], 1)
    return f"not measured, since tests failed: {format_count(len(unmeasured), 'limit')} of the rig, {named}"


def cost_reference(run: Run | Findings, results: Sequence[CalibratorResult]) -> CalibratorResult | None:
    """Return the calibrator that the rig chose as the unit of costs; None if it was not counted or not chosen."""
    name = run.rig.cost_reference if run.rig else ""
    return next((result for result in results if result.name == name and value_of(result.cycles)), None)


def limit_in_words(measurement: Measurement) -> str:
    """Return the limit in a sentence: ``limit 1.8``, ``limit at least 300``, ``limit 2 with U 0.71``; may be empty."""
    if measurement.limit is None:
        return ""
    uncertainty = f" with U {format_number(measurement.uncertainty, 2)}" if measurement.uncertainty else ""
    return f"limit {measurement.limit}".replace("limit at most ", "limit ") + uncertainty


def held_to(measurement: Measurement, was: float | None = None) -> str:
    """Return the limit and the value in the baseline, in brackets to follow a value; empty without both."""
    in_baseline = "" if was is None else f"was {number(was, measurement.unit)}"
    words = ", ".join(filter(None, (limit_in_words(measurement), in_baseline)))
    return f" ({words})" if words else ""


def ratio_in_words(result: CalibratorResult, reference: CalibratorResult) -> str:
    """Return a calibrator's cycles as a multiple of the reference's, with the range that their model leaves."""
    if result.cycles is None or reference.cycles is None or not result.cycles.value or not reference.cycles.value:
        return ""
    if result is reference:
        return ""
    if cannot_be_ranked(result.cycles, reference.cycles):
        return f"within {100 * FLASH_TIE:g} % of the cycles of {reference.name}: code in flash cannot be ranked"
    band = ratio_range(result.cycles, reference.cycles)
    within = f" ({band[0]:.2f} to {band[1]:.2f})" if band else ""
    return f"{result.cycles.value / reference.cycles.value:.2f} x the cycles of {reference.name}{within}"


def close_to_limit(measurements: Sequence[Measurement]) -> tuple[Measurement, ...]:
    """Return the measurements close to a limit: cycles that may exceed it first, then the nearest."""
    near = [(measurement, _room(measurement)) for measurement in measurements if measurement.outcome is Outcome.PASS]
    close = [
        (measurement, room)
        for measurement, room in near
        if measurement.may_exceed_limit or (room is not None and room <= CLOSE)
    ]
    close.sort(key=lambda pair: (not pair[0].may_exceed_limit, 0.0 if pair[1] is None else pair[1]))
    return tuple(measurement for measurement, _ in close[:CLOSE_AT_MOST])


def _room(measurement: Measurement) -> float | None:
    """Return the distance of a value from its limit as a fraction of the limit; None if that is meaningless.

    A count is at its limit because nothing was lost, and a limit of 0 has no fractions. For a two-sided limit the
    fraction refers to half of its width.
    """
    limit, value = measurement.limit, measurement.value
    if limit is None or value is None or limit.min == limit.max or measurement.section is Section.BOARD:
        return None
    if not measurement.unit:
        return None
    sides = [abs(value - side) / whole for side, whole in _sides(limit) if whole]
    return min(sides, default=None)


def _sides(limit: Limit) -> list[tuple[float, float]]:
    if limit.min is not None and limit.max is not None:
        half = (limit.max - limit.min) / 2.0
        return [(limit.min, half), (limit.max, half)]
    return [(side, abs(side)) for side in (limit.min, limit.max) if side is not None]


def _sort_failures(failed: Sequence[Measurement], reference: str) -> list[Measurement]:
    """Return failures in order of interest: one of each calibrator before the rest, the reference's first.

    Failures that belong to no calibrator follow the reference's: a wrong accelerometer explains all later headings.
    """
    order, kinds = list(Section), list(KINDS)
    by_kind = sorted(
        failed,
        key=lambda failure: (
            order.index(failure.section),
            failure.subject,
            kinds.index(failure.kind.name) if failure.kind else len(kinds),
            failure.name,
        ),
    )
    first = {failure.subject: failure for failure in reversed(by_kind) if failure.section in _OF_CALIBRATORS}

    def rank(failure: Measurement) -> int:
        if failure.section not in _OF_CALIBRATORS:
            return 1
        return 3 if failure is not first[failure.subject] else 0 if failure.subject == reference else 2

    return sorted(by_kind, key=rank)


def _failure(
    measurement: Measurement, run: Run | Findings, causes: Mapping[str, Diagnosis], distinct: Mapping[Cause, str]
) -> Failure:
    difference = _differing(run, measurement.name)
    cause = causes.get(measurement.subject) if measurement.section in _OF_CALIBRATORS else None
    return Failure(measurement, difference.base if difference else None, distinct[cause.cause] if cause else "")


def _ratio(run: Run | Findings, result: CalibratorResult, reference: CalibratorResult | None) -> str:
    """Return the ratio as a number, for a column; only calibrators of the board receive the same points."""
    cycles, reference_cycles = value_of(result.cycles), value_of(reference.cycles) if reference else None
    offered = run.board.calibrators if run.board else ()
    if reference is None or not cycles or not reference_cycles or result.name not in offered:
        return ""
    tied = result is not reference and cannot_be_ranked(result.cycles, reference.cycles)
    return f"within {100 * FLASH_TIE:g} %" if tied else f"{cycles / reference_cycles:.2f}"


def cost_line(run: Run) -> str:
    """Return the cost of the board's calibrators at the same points; empty if none was counted.

    A cost never stands without its worst heading. The budget is computed from the limits on the per-point and the fixed
    cost of the reference, at as many points.
    """
    offered = run.board.calibrators if run.board else ()
    results = [result for result in calibrator_results(run.measurements) if result.name in offered]
    counted = [result for result in results if result.cycles is not None and result.cycles.value]
    if not counted:
        return ""
    reference = cost_reference(run, counted)
    parts = [_budget(run, reference.name) if reference else "", *(_cost(result, reference) for result in counted)]
    models = sorted({result.cycles.cycle_model for result in counted if result.cycles})
    return "; ".join(filter(None, (*parts, f"counted by {' and '.join(models)}"))) + "."


_EXPECTED = ("rms", "fit_rms", "readings_rms", "expected_largest", "largest_in_99_percent")


def expected_line(run: Run) -> str:
    """Return the errors that noise makes unavoidable beside those of an efficient calibrator; empty without them.

    Only the rms is a bound; the largest error of a run is a matter of chance.
    """
    table = run.table("heading.expected")
    if table is None or not table.rows:
        return ""
    row = dict(zip((column.name for column in table.columns), table.rows[0], strict=True))
    numbers = [row.get(name) for name in _EXPECTED]
    if not all(isinstance(value, float) for value in numbers):
        return ""
    rms, fit, readings, largest, rare = (hundredths(float(value or 0.0)) for value in numbers)
    share = f"{readings} from the readings" + (f" and {fit} from the fit" if row["fit_rms"] else " alone")
    return (
        f"With this noise the rms heading error is at least {rms} deg: {share}. The largest error of an efficient "
        f"calibrator is {largest} deg in half of all runs, and above {rare} deg in 1 of 100."
    )


def _budget(run: Run, name: str) -> str:
    total, per_point, fixed = (run.measurement(f"cycles.{name}.{part}") for part in ("total", "per_point", "fixed"))
    slope, rest = (_information_limit(measurement) for measurement in (per_point, fixed))
    if not (total and per_point and fixed and total.value and per_point.value and fixed.value and slope and rest):
        return ""
    points = (total.value - fixed.value) / per_point.value  # the number of points that the line was fitted to
    if not 1.0 <= points <= _MOST_POINTS:
        return ""
    budget = "Thesis budget" if (slope, rest) == _OF_THE_THESIS else "Budget"
    return f"{budget} for {round(points)} points {format_number(round(points) * slope + rest)} cycles"


def _information_limit(measurement: Measurement | None) -> float | None:
    return measurement.information.max if measurement and measurement.information else None


def _cost(result: CalibratorResult, reference: CalibratorResult | None) -> str:
    cycles, maximum = result.cycles, result.maximum
    band = f" ({cycles.band})" if cycles and cycles.band else ""
    worst = "no heading" if maximum.value is None else f"{number(maximum.value, maximum.unit)} {maximum.unit}"
    ratio = ratio_in_words(result, reference) if reference else ""
    cost = f"{result.name} {format_number(cycles.value if cycles else None)}{band} for {worst}"
    return ", ".join(filter(None, (cost, ratio)))
