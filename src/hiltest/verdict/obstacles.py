"""Reasons why a comparison cannot be made: only numbers measured under the same conditions are compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from shlex import quote

from hiltest.measurement import tolerance_of
from hiltest.run_record.comparison import Change, Difference
from hiltest.run_record.outcomes import TestOutcome
from hiltest.text import id_without_repetition, short_test_id
from hiltest.verdict.evidence import NO_BOARD, REAL, Conditions, Evidence, Seed

_NAMED_AT_MOST = 3
_RENEW = "renew the baseline with `hiltest baseline save RUN FILE`"
_A_LARGER_SUITE = ("gate", "full")


def obstacles(
    base: Evidence, new: Evidence, differences: Sequence[Difference] | None, *, together: bool
) -> tuple[str, ...]:
    """Return why the gate cannot be evaluated, one line each, with a remedy; empty if it can.

    Parameters
    ----------
    differences
        Differences between the sides; None asks only if their numbers may stand beside each other.
    together
        True if both firmwares ran in one session: compiler and flags may then differ.
    """
    unlike = (*base.faults, *new.faults, *_side_differences(base, new, together=together))
    if differences is None:
        return unlike
    # Other conditions have other tests, so missing tests are no reason of their own.
    missing = () if unlike or new.chosen or new.crashes else _missing_tests(base, new, together=together)
    return (
        *unlike,
        *missing,
        *_wide_tolerances(base, new),
        *_tests_broken_in_base(base, new, differences),
        *_missing_measurements(base, new, differences),
    )


def blame_crashes(base: Evidence, new: Evidence, *, together: bool) -> Evidence:
    """Return the new side; a crash that the base does not have under the same conditions is its failure."""
    was, now = base.conditions, new.conditions
    is_alike = was is not None and base.side.rig == new.side.rig and (now is None or now.suite == was.suite)
    if not new.crashes or base.faults or not is_alike or any(_side_differences(base, new, together=together)):
        return new
    failed = (f"the firmware crashes, and the base does not: {crash}" for crash in dict.fromkeys(new.crashes.values()))
    faults = tuple(fault for fault in new.faults if fault not in new.crashes)
    return replace(new, failed=(*new.failed, *failed), faults=faults)


def _side_differences(base: Evidence, new: Evidence, *, together: bool) -> Iterator[str]:
    """Yield the differences between two sides; a missing board or another kind of board explains all others."""
    was, now = base.conditions, new.conditions
    if was is None or now is None:
        # If a side left no record, its fault is the only reason.
        boardless = [side for side in (base, new) if side.conditions is None and side.measurements]
        boardless = [side for side in boardless if not side.crashes]
        yield from (f"{side.name}: no board answered; run it again" for side in boardless)
    elif was.board != now.board:
        yield f"another kind of board: {was.board} before, {now.board} now; compare runs on one kind of board"
    else:
        yield from _condition_differences(base, new, was, now, _renew_advice(together=together))
        yield from _cycle_model_differences(base, new, _renew_advice(together=together))
        yield from () if together else _build_differences(base, new, was, now)
        yield from _choice_differences(base, new)
        yield from _seed_differences(base, new) if now.board != REAL else ()


def _condition_differences(
    base: Evidence, new: Evidence, was: Conditions, now: Conditions, renew: str
) -> Iterator[str]:
    yield from _rig_differences(base, new, was, now, renew)
    if set(was.sensors) != set(now.sensors):
        lost, added = _join_missing(was.sensors, now.sensors), _join_missing(now.sensors, was.sensors)
        yield f"other sensors: {_describe_changes(lost, added)}; restore them{renew}"
    if lost := _join_missing(was.calibrators, now.calibrators):
        yield f"calibrator missing: the firmware no longer has {lost}; restore it{renew}"
    if was.protocol_version != now.protocol_version:
        versions = f"version {was.protocol_version} before, {now.protocol_version} now"
        yield f"another protocol: {versions}; build both firmwares with one version{renew}"
    if was.poses != now.poses:
        yield f"other poses: {was.poses!r} before, {now.poses!r} now; run with --poses {was.poses}"
    if now.suite != was.suite and (was.suite, now.suite) != _A_LARGER_SUITE:
        kind = "a smaller" if (now.suite, was.suite) == _A_LARGER_SUITE else "another"
        yield f"{kind} set of tests: {was.suite!r} before, {now.suite!r} now; run with --suite {was.suite}"
    if was.calibrated and not now.calibrated:
        yield "no calibration file: the base tested one; run with --calibration FILE"


def _rig_differences(base: Evidence, new: Evidence, was: Conditions, now: Conditions, renew: str) -> Iterator[str]:
    if was.board == now.board == NO_BOARD and not (was.rig_sha256 and now.rig_sha256):
        return  # tests that need no board need no rig either, although it is read if there is one
    unknown = [side.name for side, conditions in ((base, was), (new, now)) if not conditions.rig_sha256]
    if unknown:
        yield f"{' and '.join(unknown)}: the record has no rig; repeat the run with this hiltest"
    elif was.rig_sha256 != now.rig_sha256:
        yield (
            f"another rig: {base.side.rig} ({was.rig_sha256[:8]}) before, {new.side.rig} ({now.rig_sha256[:8]}) now; "
            f"use the same --rig{renew}"
        )


def _cycle_model_differences(base: Evidence, new: Evidence, renew: str) -> Iterator[str]:
    if base.side.cycle_model != new.side.cycle_model:
        yield (
            f"another cycle model: {base.side.cycle_model} before, {new.side.cycle_model} now; cycles of different "
            f"models are not comparable; measure both with one model{renew}"
        )


def _build_differences(base: Evidence, new: Evidence, was: Conditions, now: Conditions) -> Iterator[str]:
    advice = f"run both firmwares together with `hiltest run --against OLD.elf`, or {_RENEW}"
    if base.side.compiler != new.side.compiler:
        yield f"another compiler: {base.side.compiler} before, {new.side.compiler} now; {advice}"
    before, after = was.compiler_flags, now.compiler_flags
    if not before or not after:
        unknown = base.name if after else new.name
        if before or after:
            yield f"{unknown}: the compiler flags are unknown; build with debugging information (-g)"
    elif set(before) != set(after):
        lost, added = _join_missing(before, after), _join_missing(after, before)
        yield f"other compiler flags: {_describe_changes(lost, added)}; {advice}"


def _choice_differences(base: Evidence, new: Evidence) -> Iterator[str]:
    # Measurements that the base lacks would be new, and new ones are no regression; the opposite case would be "gone".
    if base.chosen and not new.chosen:
        yield f"{base.name}: only chosen tests ran before, and all tests now; run all tests for a base"


def _seed_differences(base: Evidence, new: Evidence) -> Iterator[str]:
    if not set(base.measurements) & set(new.measurements):
        was, now = _seeds(base), _seeds(new)
        yield f"no seed in common: {was} before, {now} now; run with a seed of the base"


def _missing_tests(base: Evidence, new: Evidence, *, together: bool) -> Iterator[str]:
    """Yield an obstacle for tests that passed in the base and are gone, even if they measured nothing."""
    missing: dict[str, str] = {}
    for seed, before in base.tests.items():
        now = new.tests.get(seed, {} if seed in new.measurements else before)
        # Tests are matched by name and count: pytest's ids depend on the folder that it was started in.
        passed = Counter(short_test_id(test) for test, outcome in before.items() if outcome is TestOutcome.PASSED)
        ran = Counter(short_test_id(test) for test, outcome in now.items() if outcome.has_run)
        outcomes = {short_test_id(test): f"is {outcome}" for test, outcome in now.items() if not outcome.has_run}
        missing |= {test: outcomes.get(test, "did not run") for test in passed - ran}
    if not missing:
        return
    test, reason = next(iter(missing.items()))
    more, pronoun = (f", and {len(missing) - 1} more", "them") if len(missing) > 1 else ("", "it")
    otherwise = _remedy_for_test(test, base, new, together=together)
    yield f"test missing: {test} passed before and {reason} now{more}; let {pronoun} run, or {otherwise}"


def _remedy_for_test(test: str, base: Evidence, new: Evidence, *, together: bool) -> str:
    """Return the remedy for a missing test."""
    if together:
        return f"omit it from both runs: -- -k {quote('not ' + test.rpartition('::')[2].partition('[')[0])}"
    run = quote(new.side.file or "RUN")
    if base.is_baseline:
        return f"renew the baseline with `hiltest baseline save {run} {quote(base.side.file)}`"
    return f"make this run the base with `hiltest baseline save {run} FILE`"


def _wide_tolerances(base: Evidence, new: Evidence) -> Iterator[str]:
    """Yield an obstacle for each tolerance of a baseline that neither the catalogue nor the run's rig states."""
    if not base.is_baseline or new.is_baseline:
        return
    for name, tolerance in base.in_force.items():
        if not any(tolerance_of(name, stated).covers(tolerance) for stated in ({}, new.tolerances)):
            yield (
                f"tolerance of {name}: {base.name} has a wider one than the catalogue, and the rig states none; "
                f"accept the catalogue's: {accept_command(base.side.file, name, new.side.file)}"
            )


def accept_command(file: str, name: str, run: str = "") -> str:
    """Return the command that accepts one measurement of a run into a baseline."""
    return f"`hiltest baseline update {quote(file)} {quote(run or 'RUN')} --accept {quote(name)} --because TEXT`"


def _tests_broken_in_base(base: Evidence, new: Evidence, differences: Sequence[Difference]) -> Iterator[str]:
    """Yield an obstacle for measurements that are new only because their test broke off in the base."""
    broken = {
        seed: {short_test_id(test) for test, outcome in tests.items() if not outcome.came_to_its_end}
        for seed, tests in base.tests.items()
    }
    lost = {}
    for difference in differences:
        if difference.change is Change.NEW and (test := _broken_test_of(difference.name, new, broken)):
            lost[difference.name] = test
    if not lost:
        return
    name, test = next(iter(lost.items()))
    more = f", and {len(lost) - 1} more" if len(lost) > 1 else ""
    why = f"{name} is new, since {test} failed in {base.name}{more}"
    yield f"no base: {why}; name a base in which it passes"


def _broken_test_of(name: str, new: Evidence, broken: Mapping[Seed, Set[str]]) -> str:
    """Return the test that measured this now and broke off on its seed before; empty if none did."""
    for seed, measurements in new.measurements.items():
        if name not in measurements:
            continue
        test = short_test_id(id_without_repetition(measurements[name].test))
        if test in broken.get(seed, ()):
            return test
    return ""


def _missing_measurements(base: Evidence, new: Evidence, differences: Sequence[Difference]) -> Iterator[str]:
    # Cycles of another model are present, and the other model is an obstacle already. So are other poses, which have
    # other measurements.
    was, now = base.conditions, new.conditions
    other_poses = was is not None and now is not None and was.poses != now.poses
    counted_otherwise = base.side.cycle_model != new.side.cycle_model
    gone = (
        []
        if other_poses
        else [
            difference
            for difference in differences
            if difference.change is Change.GONE
            and not (counted_otherwise and difference.cycle_model and difference.new is not None)
        ]
    )
    for difference in gone[:_NAMED_AT_MOST]:
        why = f" ({difference.note})" if difference.note else ""
        accept = _accept(base, new, difference.name)
        yield f"measurement missing: {difference.name}{why}; restore it, or {accept}"
    if len(gone) > _NAMED_AT_MOST:
        yield f"measurements missing: {len(gone) - _NAMED_AT_MOST} more, {gone[_NAMED_AT_MOST].name} among them"
    not_taken = sum(difference.change is Change.NOT_TAKEN for difference in differences)
    if not_taken and not new.faults:
        measurements = f"{not_taken} measurement{'s' * (not_taken != 1)}"
        if new.failed:
            yield f"{new.name}: {measurements} of {base.name} not made, since tests failed; correct those first"
        else:
            yield (f"{new.name}: only chosen tests ran, without {measurements} of {base.name}; run all tests")
    compared = any(difference.seeds for difference in differences)
    if not compared and not gone and not not_taken and set(base.measurements) & set(new.measurements):
        yield f"{base.name} and {new.name} have no number in common; name another base"


def _accept(base: Evidence, new: Evidence, name: str) -> str:
    """Return the remedy for a missing measurement: a run can become a baseline unless its tests were chosen."""
    if base.chosen:
        tests = (measurement[name].test for measurement in base.measurements.values() if name in measurement)
        test = next((test_id.rpartition("::")[2].partition("[")[0] for test_id in tests if test_id), "")
        return f"omit its test from both runs: -- -k 'not {test or 'its name'}'"
    if base.is_baseline and new.is_baseline:  # a review of the newer one
        return f"accept that with {accept_command(new.side.file, name)}"
    if base.is_baseline:
        return f"accept that with {accept_command(base.side.file, name, new.side.file)}"
    save = f"`hiltest baseline save {quote(base.side.file)} FILE`"
    return f"accept that into a baseline, {save} and {accept_command('FILE', name, new.side.file)}"


def _renew_advice(*, together: bool) -> str:
    """Return the alternative remedy; two firmwares in one session have no baseline to renew."""
    return "" if together else f", or {_RENEW}"


def _join_missing(names: Sequence[str], others: Sequence[str]) -> str:
    return ", ".join(name for name in names if name not in others)


def _describe_changes(lost: str, added: str) -> str:
    return ", and ".join(filter(None, (lost and f"{lost} before and not now", added and f"{added} now and not before")))


def _seeds(evidence: Evidence) -> str:
    seeds = [str(seed) for seed in evidence.side.seeds]
    return f"seed{'s' * (len(seeds) != 1)} {', '.join(seeds) or 'none'}"
