"""Comparison of two sides: every measurement's change, and the obstacles of the gate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from statistics import fmean

from hiltest.errors import LIKELY_CAUSE, NOT_CALIBRATED
from hiltest.measurement import KINDS, UNDECIDED, Measurement, Outcome, Tolerance, identify, is_compared, is_direction
from hiltest.orientation.angles import wrap_180
from hiltest.run_record.comparison import BaseKind, Change, Comparison, Difference, Side
from hiltest.run_record.failures import measured
from hiltest.run_record.run import Run, Table
from hiltest.text import format_number, hundredths, join_words
from hiltest.verdict.chance import Chance, chance_of
from hiltest.verdict.difference import difference
from hiltest.verdict.evidence import REAL, Evidence, Seed, allow_misses, as_one_run, evidence_of
from hiltest.verdict.obstacles import accept_command, blame_crashes, obstacles
from hiltest.verdict.pairs import Pairs, number_of
from hiltest.verdict.run_noise import FALSE_ALARMS
from hiltest.verdict.wording import entry, format_seeds, review_sentence, sentence

CALIBRATED_AFTER = "device.calibrated_after"
OF_FIRMWARE = "heading.firmware."
STEP_COLUMN, ANSWERED_COLUMN = "step.firmware", "answered.firmware"
WORST_FOUND = KINDS["cycles.{calibrator}.worst_found"]

_Measured = Mapping[Seed, Mapping[str, Measurement]]
_MOVED = (Change.BETTER, Change.WORSE)
_ALL = "*"
_NAMED_AT_MOST = 4
_SUSPICIOUS_SHARE = 2 / 3
"""Share of the former cycles below which work may have moved elsewhere."""
_ASSUMED = (
    "Too few runs to estimate their differences: the noise of the default rig is assumed. Save at least five "
    "runs of one firmware: hiltest baseline save RUN RUN ... FILE."
)


def compare(base: Evidence, new: Evidence, *, together: bool = False) -> Comparison:
    """Compare two sides, paired by seed, with the base's tolerances, or those of the new run's rig if it has none.

    Parameters
    ----------
    together
        True if both firmwares ran in one session: their compilers and flags may then differ.

    Returns
    -------
    Comparison
        The comparison; it has obstacles if the gate cannot be evaluated, and its differences are then information only.
    """
    board = new.conditions.board if new.conditions else ""
    runs = (base, new)
    if all(run.conditions is not None and run.conditions.board == REAL for run in runs):
        base, new = map(as_one_run, runs)
    new = blame_crashes(base, new, together=together)
    pairs = [replace(pair, runs=_numbers_of_runs(pair.name, runs)) for pair in pairs_of(base, new)]
    chances = chances_of(pairs, board, new.tolerances)
    names = {pair.name for pair in pairs}
    raw = (
        _as_information(difference(pair, board, new.tolerances, chances[pair.name]), pair, names, chances)
        for pair in pairs
    )
    changes = (
        _mark_not_taken(_mark_few_poses(_mark_loosened(change, pair), pair, names), pair, base, new)
        for change, pair in zip(raw, pairs, strict=True)
    )
    differences = tuple(
        add_accuracy(_mark_other_input(change, pair, base, new), base.measurements, new.measurements)
        for change, pair in zip(changes, pairs, strict=True)
    )
    rounding = rounding_in_words(base.poses, new.poses)
    differences = tuple(_mark_rounding(difference, rounding) for difference in differences)
    new, differences = _blame_lost_calibration(base, new, differences)
    kind = BaseKind.TOGETHER if together else BaseKind.BASELINE if base.is_baseline else BaseKind.RUN
    comparison = _comparison(base.side, new, differences, obstacles(base, new, differences, together=together), kind)
    remarks = [*_remarks(base, new, differences), *([_ASSUMED] if _noise_is_assumed(chances.values()) else [])]
    return replace(comparison, remark=" ".join(remarks))


def rounding_in_words(base: Table | None, new: Table | None) -> str:
    """Return the steps of the firmware's headings at the known angles, if coarser steps alone explain the differences.

    Parameters
    ----------
    base, new
        Headings at the known angles of both sides; older records lack their steps.
    """
    if base is None or new is None or len(base.rows) != len(new.rows):
        return ""
    before, after = ([float(step or 0.0) for step in table.column_if_any(STEP_COLUMN)] for table in (base, new))
    was, now = min(before, default=0.0), min(after, default=0.0)
    is_known = all(None not in table.column_if_any(STEP_COLUMN) for table in (base, new))
    if not is_known or now <= was:
        return ""
    answers = zip(base.column_if_any(ANSWERED_COLUMN), new.column_if_any(ANSWERED_COLUMN), strict=True)
    moved = [abs(wrap_180(float(later or 0.0) - float(earlier or 0.0))) for earlier, later in answers]
    if max(moved) > now + was:
        return ""
    steps = f"multiples of {now:g} deg, in the base {f'of {was:g} deg' if was else 'not rounded'}"
    return f"{'whole degrees' if now >= 1.0 else 'rounding of the heading'} ({steps})"


def _mark_rounding(difference: Difference, rounding: str) -> Difference:
    is_worse = difference.change is Change.WORSE and difference.name.startswith(OF_FIRMWARE)
    note = "; ".join(filter(None, (difference.note, rounding)))
    return replace(difference, note=note) if rounding and is_worse else difference


def _blame_lost_calibration(
    base: Evidence, new: Evidence, differences: tuple[Difference, ...]
) -> tuple[Evidence, tuple[Difference, ...]]:
    """Return both; if the base calibrated itself in the same tumble, the cause is the change of the firmware."""
    was, now = base.conditions, new.conditions
    is_same_tumble = was is not None and now is not None and was.board == "virtual" and was.rig_sha256 == now.rig_sha256
    after = next((difference for difference in differences if difference.name == CALIBRATED_AFTER), None)
    is_lost = after is not None and after.base is not None and after.new is None
    if after is None or not (is_same_tumble and is_lost and any(NOT_CALIBRATED in text for text in new.failed)):
        return new, differences
    seconds = format_number(after.base)
    cause = f"the change of the firmware, since the base calibrated itself after {seconds} s of the same tumble"
    failed = tuple(_replace_cause(text, cause) if NOT_CALIBRATED in text else text for text in new.failed)
    blamed = replace(after, change=Change.WORSE, note=cause)
    return replace(new, failed=failed), tuple(blamed if item is after else item for item in differences)


def _replace_cause(failed: str, cause: str) -> str:
    """Return the text of a failed test with another likely cause, and without the next step."""
    message, _, others = failed.partition(LIKELY_CAUSE)
    return f"{message}{LIKELY_CAUSE}{cause}{others[max(others.rfind(')'), 0) :]}" if others else failed


def review(base: Evidence, new: Evidence) -> Comparison:
    """Compare a baseline with its next version: a change that makes it laxer must be in its history, with a reason.

    Saving a run over the file is accepted as a whole if the conditions changed, too; numbers are then incomparable.
    """
    comparison = _review(base, new)
    return replace(comparison, sentence=review_sentence(comparison))


def _review(base: Evidence, new: Evidence) -> Comparison:
    accepted = {entry.name: entry.because for entry in new.history if entry not in base.history}
    new = allow_misses(new)
    if (saved_anew := accepted.pop(_ALL, "")) and (unlike := obstacles(base, new, None, together=False)):
        comparison = compare(base, new)
        differences = tuple(_mark_accepted(change, saved_anew) for change in comparison.differences)
        remark = f"The baseline was saved anew: {'; '.join(unlike)}. {comparison.remark}".rstrip()
        return replace(_comparison(base.side, new, differences, (), BaseKind.BASELINE), remark=remark)
    if saved_anew:
        base = replace(base, tests={})  # tests were removed on purpose
    comparison = compare(base, new)
    differences = tuple(_mark_accepted(change, accepted.get(change.name)) for change in comparison.differences)
    reasons = (*obstacles(base, new, differences, together=False), *_unaccepted_tolerances(base, new, accepted))
    return replace(_comparison(base.side, new, differences, reasons, BaseKind.BASELINE), remark=comparison.remark)


def _remarks(base: Evidence, new: Evidence, differences: Sequence[Difference]) -> Iterator[str]:
    """Yield remarks on both sides, which decide nothing."""
    unsealed = [side.name for side in (base, new) if not side.sealed]
    if unsealed:
        yield f"{' and '.join(unsealed)}: not sealed, since the file has no digest of its content."
    if new.is_baseline:
        pass  # a review of the next version: equal runs are no mistake
    elif base.record and base.record == new.record and not base.builds:
        yield "The run was compared with itself."
    elif base.side.firmware_sha256 and base.side.firmware_sha256 == new.side.firmware_sha256:
        yield "Both sides ran the same firmware file."
    if base.suites and (files := [name for name, digest in new.suites.items() if base.suites.get(name) != digest]):
        yield f"Tests differ from those of the base: {join_words(files, _NAMED_AT_MOST)}."
    cheaper = sorted(filter(_is_suspiciously_cheap, differences), key=lambda difference: difference.concern)
    if cheaper:
        names = join_words([difference.name for difference in cheaper], _NAMED_AT_MOST)
        yield f"Check that no work moved: {names} fell by more than a third."


def _is_suspiciously_cheap(difference: Difference) -> bool:
    base, new = difference.base, difference.new
    fell = base is not None and new is not None and new < _SUSPICIOUS_SHARE * base
    return difference.change is Change.BETTER and difference.unit == "cycle" and fell


def _mark_accepted(difference: Difference, because: str | None) -> Difference:
    """Return a difference between two baselines: an accepted one is no regression, and any other change is listed."""
    if difference.change is Change.UNCHANGED and difference.delta:
        difference = replace(difference, change=Change.CHANGED)
    if because is None or difference.change is Change.UNCHANGED:
        return difference
    change = Change.CHANGED if difference.change in (Change.WORSE, Change.GONE) else difference.change
    note = "; ".join(filter(None, (difference.note, f"accepted: {because}")))
    return replace(difference, change=change, note=note)


def _unaccepted_tolerances(base: Evidence, new: Evidence, accepted: Mapping[str, str]) -> Iterator[str]:
    for name, tolerance in new.in_force.items():
        before = base.in_force.get(name)
        if before is not None and not before.covers(tolerance) and name not in accepted:
            yield f"tolerance widened: {name}; accept it by name: {accept_command(new.side.file, name)}"


def _mark_other_input(difference: Difference, pairs: Pairs, base: Evidence, new: Evidence) -> Difference:
    """Return a difference; cycles of unchanged code for another worst input are neither worse nor better."""
    named = identify(difference.name)
    is_other_input = named.kind is WORST_FOUND and difference.change in _MOVED and not pairs.newly_out
    if not is_other_input or not _is_same_code(base, new, named.subject):
        return difference
    return replace(difference, change=Change.CHANGED, note="another worst input; the code is unchanged")


def _is_same_code(base: Evidence, new: Evidence, calibrator: str) -> bool:
    """Return whether both sides ran one build, and a calibrator costs the same on each common seed.

    The cycles are compared because a patched file keeps the build id of its ELF.
    """
    total = f"cycles.{calibrator}.total"
    was, now = base.side, new.side
    same_file = not (was.firmware_sha256 and now.firmware_sha256) or was.firmware_sha256 == now.firmware_sha256
    same_build = was.build_id and was.build_id == now.build_id and total not in base.builds
    seeds = base.measurements.keys() & new.measurements.keys()
    costs = [[number_of(side.measurements[seed].get(total)) for side in (base, new)] for seed in seeds]
    same_cost = all(cost is not None and cost == other for cost, other in costs)
    return bool(same_build and same_file and costs and same_cost)


def _noise_is_assumed(chances: Iterable[Chance]) -> bool:
    """Return whether unpaired runs are too few to estimate their noise."""
    noises = [chance.noise for chance in chances if chance.noise is not None and not chance.shared]
    return bool(noises) and not any(noise.of_these_runs for noise in noises)


def chances_of(pairs: Sequence[Pairs], board: str, tolerances: Mapping[str, Tolerance]) -> dict[str, Chance]:
    """Return the effect of chance on each measurement of a comparison, by name.

    Measurements that noise could move beyond their tolerance share the false alarms equally (Bonferroni): 99 of 100
    comparisons of unchanged firmware call none of them better or worse.
    """
    chances = {pair.name: chance_of(pair, board, tolerances) for pair in pairs}
    sharing = sum(
        chance.noise is not None
        and chance.noise.reaches(chance.floor)
        and (chance.shared or not identify(name).decided_by)
        for name, chance in chances.items()
    )
    return {name: replace(chance, share=FALSE_ALARMS / max(sharing, 1)) for name, chance in chances.items()}


def changes_seen(run: Run) -> dict[str, float]:
    """Return the smallest change of each measurement that the run's comparison detects in 4 of 5 cases.

    If the run was compared with nothing, the values are for a comparison with one more such run.
    """
    if run.comparison is not None:
        return {
            difference.name: difference.seen for difference in run.comparison.differences if difference.seen is not None
        }
    evidence = evidence_of(run)
    board = evidence.conditions.board if evidence.conditions else ""
    chances = chances_of(pairs_of(evidence, evidence), board, evidence.tolerances)
    return {name: chance.smallest_change for name, chance in chances.items() if not is_direction(name)}


def not_compared(file: str, reason: str, new: Evidence) -> Comparison:
    """Return the comparison with an unreadable base: the obstacle, and the failures of the run itself.

    Parameters
    ----------
    file
        File of the base.
    reason
        Reason why it cannot be used, with a remedy.
    """
    return _comparison(Side(file), new, (), (reason, *new.faults), BaseKind.RUN)


def _comparison(
    base: Side, new: Evidence, differences: tuple[Difference, ...], reasons: tuple[str, ...], kind: BaseKind
) -> Comparison:
    failed = (*(() if new.may_miss else _missed_limits(new, differences)), *new.failed)
    comparison = Comparison(
        base,
        new.side,
        differences,
        reasons,
        "",
        failed=failed,
        unjudged=tuple(_unevaluated_limits(new)),
        chosen=new.chosen,
        tests_left_out=new.tests_left_out,
        base_kind=kind,
    )
    return replace(comparison, sentence=sentence(comparison))


def _missed_limits(new: Evidence, differences: tuple[Difference, ...]) -> Iterator[str]:
    """Yield the limits that the new run misses, in order of concern; measurements that got worse show the change."""
    missed = _measurements_with(new, Outcome.FAIL)
    for changed in sorted(differences, key=lambda changed: changed.concern):
        if seeds := missed.pop(changed.name, None):
            named = changed.change is Change.WORSE or len(new.measurements) == 1
            yield entry(changed) + ("" if named else format_seeds(list(seeds)))
    for seeds in missed.values():
        yield measured(next(iter(seeds.values())))


def _unevaluated_limits(new: Evidence) -> Iterator[str]:
    for outcome in UNDECIDED:
        for name, seeds in _measurements_with(new, outcome).items():
            yield f"{name} ({next(iter(seeds.values())).note})"


def _measurements_with(new: Evidence, outcome: Outcome) -> dict[str, dict[Seed, Measurement]]:
    """Return the measurements that have an outcome, by name and seed."""
    by_name: dict[str, dict[Seed, Measurement]] = {}
    for seed, measurements in new.measurements.items():
        for name, measurement in sorted(measurements.items()):
            if measurement.outcome is outcome:
                by_name.setdefault(name, {})[seed] = measurement
    return by_name


def _as_information(difference: Difference, pairs: Pairs, names: Set[str], chances: Mapping[str, Chance]) -> Difference:
    """Return a difference as information if runs share no noise and it is the largest of many errors: the rms decides.

    It decides all the same if it has left its limit, or if the rig states its tolerance.
    """
    chance, decides = chances[difference.name], identify(difference.name).decided_by
    stated = chance.noise is not None and not chance.noise.tested
    if chance.shared or stated or decides not in names or difference.change not in _MOVED or pairs.newly_out:
        return difference
    note = f"on a real board {decides} decides"
    return replace(difference, change=Change.CHANGED, note="; ".join(filter(None, (difference.note, note))))


def _mark_loosened(difference: Difference, pairs: Pairs) -> Difference:
    """Return a difference; a loosened limit is shown even if the number did not change."""
    loosened = difference.change is Change.UNCHANGED and pairs.limit_loosened
    return replace(difference, change=Change.CHANGED) if loosened else difference


def _mark_few_poses(difference: Difference, pairs: Pairs, names: Set[str]) -> Difference:
    """Return a difference; values that few poses predict are neither better nor worse within their uncertainties."""
    sides = [[m.uncertainty for m in side.values() if m and m.uncertainty] for side in (pairs.base, pairs.new)]
    decides = pairs.newly_out or difference.change not in _MOVED or difference.delta is None
    if "heading.poses" not in names or decides or not all(sides):
        return difference
    if abs(difference.delta or 0.0) > math.hypot(*map(max, sides)):
        return difference
    return replace(difference, change=Change.CHANGED, note="within the uncertainty of few poses")


def _mark_not_taken(difference: Difference, pairs: Pairs, base: Evidence, new: Evidence) -> Difference:
    """Return a difference; a measurement is not called gone if the run ended before it."""
    partial = bool(new.faults or new.failed) or (new.chosen and not base.chosen)
    was_made = any(_was_made(pairs.new[seed]) for seed in pairs.lost)
    if partial and difference.change is Change.GONE and pairs.lost and not was_made:
        return replace(difference, change=Change.NOT_TAKEN, note="")
    return difference


def _was_made(measurement: Measurement | None) -> bool:
    """Return whether a test made a measurement, with or without a number; unmet limits are recorded without a test."""
    return measurement is not None and (bool(measurement.test) or measurement.outcome is not Outcome.UNSET)


def pairs_of(base: Evidence, new: Evidence) -> list[Pairs]:
    """Return the measurements to compare, by name: all that are not volatile in the base, or in the new run if new."""
    seeds = [seed for seed in base.measurements if seed in new.measurements]
    names: set[str] = set()
    for seed in seeds:
        names.update(name for name, measurement in base.measurements[seed].items() if not measurement.volatile)
        was = base.measurements[seed]
        names.update(
            name for name, measurement in new.measurements[seed].items() if not measurement.volatile and name not in was
        )
    pairs = (
        Pairs(
            name,
            _values_on(base.measurements, name, seeds),
            _values_on(new.measurements, name, seeds),
            base.in_force.get(name),
        )
        for name in sorted(filter(is_compared, names))
    )
    return [pair for pair in pairs if not pair.is_nothing]


def _numbers_of_runs(name: str, sides: tuple[Evidence, Evidence]) -> tuple[list[float], list[float]]:
    base, new = (
        [number for run in side.measurements.values() if (number := number_of(run.get(name))) is not None]
        for side in sides
    )
    return base, new


def _values_on(
    measurements: Mapping[Seed, Mapping[str, Measurement]], name: str, seeds: list[Seed]
) -> dict[Seed, Measurement | None]:
    return {seed: measurements[seed].get(name) for seed in seeds}


def add_accuracy(difference: Difference, base: _Measured, new: _Measured) -> Difference:
    """Return a difference; a calibrator's cost is supplemented by its accuracy on both sides, if both have it.

    Parameters
    ----------
    base, new
        All measurements of both sides. Over several seeds the means are named, as for the cost.
    """
    name = identify(difference.name).accuracy
    if difference.change not in _MOVED or not name:
        return difference
    pairs = [
        (was.value, now.value)
        for seed in base.keys() & new.keys()
        if (was := base[seed].get(name))
        and (now := new[seed].get(name))
        and was.value is not None
        and now.value is not None
    ]
    if not pairs:
        return difference
    unit = next(measurements[name].unit for measurements in new.values() if name in measurements)
    before, after = (fmean(side) for side in zip(*pairs, strict=True))
    accuracy = f"{name} {hundredths(before)} -> {hundredths(after)} {unit}"
    return replace(difference, note="; ".join(filter(None, (difference.note, accuracy))))
