"""Reasons why a comparison cannot be made: only numbers measured under the same conditions are compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from shlex import quote

from hiltest.record.comparison import Change, Difference
from hiltest.record.outcomes import TestOutcome
from hiltest.text import without_folders
from hiltest.verdict.evidence import NO_BOARD, REAL, Conditions, Evidence, Seed

_NAMED_AT_MOST = 3
_RENEW = "renew the baseline with `hiltest baseline save RUN FILE`"
_A_LARGER_SUITE = ("gate", "full")


def obstacles(
    base: Evidence, new: Evidence, differences: Sequence[Difference] | None, *, together: bool
) -> tuple[str, ...]:
    """Return why the gate cannot be evaluated, one line each, with what to do; nothing when it can.

    Parameters
    ----------
    differences
        Between them; None to ask only whether numbers of one may stand beside numbers of the other.
    together
        Whether both firmwares ran in one session: compiler and flags may then differ.
    """
    unlike = (*base.faults, *new.faults, *_of_sides(base, new, together=together))
    if differences is None:
        return unlike
    # Other conditions have other tests: that is no reason of its own.
    missing = () if unlike or new.chosen else _of_tests(base, new, together=together)
    return (*unlike, *missing, *_of_broken_tests(base, new, differences), *_of_measurements(base, new, differences))


def _of_sides(base: Evidence, new: Evidence, *, together: bool) -> Iterator[str]:
    """Yield the differences between two sides; where one has no board, or another kind, the rest follows from that."""
    was, now = base.conditions, new.conditions
    if was is None or now is None:
        # Of what has no record at all its fault is the whole reason.
        boardless = (each for each in (base, new) if each.conditions is None and each.measurements)
        yield from (f"{each.name}: no board answered; run it again" for each in boardless)
    elif was.board != now.board:
        yield f"another kind of board: {was.board} before, {now.board} now; compare runs of one kind"
    else:
        yield from _of_conditions(base, new, was, now, _or_renew(together=together))
        yield from _of_cycle_models(base, new, _or_renew(together=together))
        yield from () if together else _of_builds(base, new, was, now)
        yield from _of_choice(base, new)
        yield from _of_seeds(base, new) if now.board != REAL else ()


def _of_conditions(base: Evidence, new: Evidence, was: Conditions, now: Conditions, renew: str) -> Iterator[str]:
    yield from _of_rigs(base, new, was, now, renew)
    if set(was.sensors) != set(now.sensors):
        lost, added = _without(was.sensors, now.sensors), _without(now.sensors, was.sensors)
        yield f"other sensors: {_gone_and_added(lost, added)}; put them back{renew}"
    if lost := _without(was.calibrators, now.calibrators):
        yield f"calibrator missing: the firmware has no {lost} any more; put it back{renew}"
    if was.protocol_version != now.protocol_version:
        versions = f"version {was.protocol_version} before, {now.protocol_version} now"
        yield f"another protocol: {versions}; build both of one{renew}"
    if was.poses != now.poses:
        yield f"other poses: {was.poses!r} before, {now.poses!r} now; run with --poses {was.poses}"
    if now.suite != was.suite and (was.suite, now.suite) != _A_LARGER_SUITE:
        kind = "a smaller" if (now.suite, was.suite) == _A_LARGER_SUITE else "another"
        yield f"{kind} set of tests: {was.suite!r} before, {now.suite!r} now; run with --suite {was.suite}"
    if was.calibrated and not now.calibrated:
        yield "no calibration file: the base tested one; run with --calibration FILE"


def _of_rigs(base: Evidence, new: Evidence, was: Conditions, now: Conditions, renew: str) -> Iterator[str]:
    if was.board == now.board == NO_BOARD and not (was.rig_sha256 and now.rig_sha256):
        return  # what needs no board needs no rig, which is read all the same where there is one
    unknown = [each.name for each, conditions in ((base, was), (new, now)) if not conditions.rig_sha256]
    if unknown:
        yield f"{' and '.join(unknown)}: the record does not say what rig it is of; run it again with this hiltest"
    elif was.rig_sha256 != now.rig_sha256:
        yield (
            f"another rig: {base.side.rig} ({was.rig_sha256[:8]}) before, {new.side.rig} ({now.rig_sha256[:8]}) now; "
            f"use the same --rig{renew}"
        )


def _of_cycle_models(base: Evidence, new: Evidence, renew: str) -> Iterator[str]:
    if base.side.cycle_model != new.side.cycle_model:
        yield (
            f"another cycle model: {base.side.cycle_model} before, {new.side.cycle_model} now; cycles of different "
            f"models are never compared; measure both with one{renew}"
        )


def _of_builds(base: Evidence, new: Evidence, was: Conditions, now: Conditions) -> Iterator[str]:
    advice = f"run both firmwares together with `hiltest run --against OLD.elf`, or {_RENEW}"
    if base.side.compiler != new.side.compiler:
        yield f"another compiler: {base.side.compiler} before, {new.side.compiler} now; {advice}"
    before, after = was.compiler_flags, now.compiler_flags
    if not before or not after:
        unknown = base.name if after else new.name
        if before or after:
            yield f"{unknown}: its compiler flags are unknown; build it with debugging information (-g)"
    elif set(before) != set(after):
        lost, added = _without(before, after), _without(after, before)
        yield f"other compiler flags: {_gone_and_added(lost, added)}; {advice}"


def _of_choice(base: Evidence, new: Evidence) -> Iterator[str]:
    # What it did not measure would be new, and new is no regression. The other way round it would be gone.
    if base.chosen and not new.chosen:
        yield f"{base.name}: only chosen tests ran before, and all now; run all of them for a base"


def _of_seeds(base: Evidence, new: Evidence) -> Iterator[str]:
    if not set(base.measurements) & set(new.measurements):
        was, now = _seeds(base), _seeds(new)
        yield f"no seed in common: {was} before, {now} now; run with a seed of the base"


def _of_tests(base: Evidence, new: Evidence, *, together: bool) -> Iterator[str]:
    """Yield an obstacle for tests that passed in the base and are gone; they need not have measured anything."""
    missing: dict[str, str] = {}
    for seed, before in base.tests.items():
        now = new.tests.get(seed, {} if seed in new.measurements else before)
        # By name alone, and as often: pytest's ids depend on the folder that it was started in.
        passed = Counter(without_folders(test) for test, outcome in before.items() if outcome is TestOutcome.PASSED)
        ran = Counter(without_folders(test) for test, outcome in now.items() if outcome.has_run)
        outcomes = {without_folders(test): f"is {outcome}" for test, outcome in now.items() if not outcome.has_run}
        missing |= {test: outcomes.get(test, "did not run") for test in passed - ran}
    if not missing:
        return
    test, what = next(iter(missing.items()))
    more, them = (f", and so {len(missing) - 1} more", "them") if len(missing) > 1 else ("", "it")
    otherwise = _without_test(test, base, new, together=together)
    yield f"test missing: {test} passed before and {what} now{more}; let {them} run, or {otherwise}"


def _without_test(test: str, base: Evidence, new: Evidence, *, together: bool) -> str:
    """Return how to go on without a test."""
    if together:
        return f"leave it out of both runs: -- -k {quote('not ' + test.rpartition('::')[2].partition('[')[0])}"
    run = quote(new.side.file or "RUN")
    if base.is_baseline:
        return f"renew the baseline with `hiltest baseline save {run} {quote(base.side.file)}`"
    return f"make this run the base with `hiltest baseline save {run} FILE`"


def _of_broken_tests(base: Evidence, new: Evidence, differences: Sequence[Difference]) -> Iterator[str]:
    """Yield an obstacle for measurements that are new only because their test broke off in the base."""
    broken = {
        seed: {without_folders(test) for test, outcome in tests.items() if not outcome.came_to_its_end}
        for seed, tests in base.tests.items()
    }
    lost = {}
    for difference in differences:
        if difference.change is Change.NEW and (test := _broken_test_of(difference.name, new, broken)):
            lost[difference.name] = test
    if not lost:
        return
    name, test = next(iter(lost.items()))
    more = f", and so {len(lost) - 1} more" if len(lost) > 1 else ""
    why = f"{name} is new, for {test} failed in {base.name}{more}"
    yield f"nothing to compare with: {why}; name a base in which it passes"


def _broken_test_of(name: str, new: Evidence, broken: Mapping[Seed, Set[str]]) -> str:
    """Return the test that measured this now and is among those that broke off on its seed, empty if none did."""
    for seed, made in new.measurements.items():
        if name in made and (test := without_folders(made[name].test)) in broken.get(seed, ()):
            return test
    return ""


def _of_measurements(base: Evidence, new: Evidence, differences: Sequence[Difference]) -> Iterator[str]:
    # Cycles of another model are there, and the other model is an obstacle already; and so are other poses, at which
    # other measurements are made.
    was, now = base.conditions, new.conditions
    other_poses = was is not None and now is not None and was.poses != now.poses
    counted_otherwise = base.side.cycle_model != new.side.cycle_model
    gone = [] if other_poses else [
        each for each in differences
        if each.change is Change.GONE and not (counted_otherwise and each.cycle_model and each.new is not None)
    ]  # fmt: skip
    for each in gone[:_NAMED_AT_MOST]:
        why = f" ({each.note})" if each.note else ""
        accept = _accept(base, new, each.name)
        yield f"measurement gone: {each.name}{why}; bring it back, or {accept}"
    if len(gone) > _NAMED_AT_MOST:
        yield f"measurements gone: {len(gone) - _NAMED_AT_MOST} more, {gone[_NAMED_AT_MOST].name} among them"
    not_taken = sum(difference.change is Change.NOT_TAKEN for difference in differences)
    if not_taken and not new.faults:
        measurements = f"{not_taken} measurement{'s' * (not_taken != 1)}"
        if new.failed:
            yield f"{new.name}: {measurements} of {base.name} not made, since tests failed; mend those first"
        else:
            yield (
                f"{new.name}: only chosen tests ran, and {measurements} of {base.name} not among them; run all of them"
            )
    compared = any(difference.seeds for difference in differences)
    if not compared and not gone and not not_taken and set(base.measurements) & set(new.measurements):
        yield f"nothing was compared: {base.name} and {new.name} have no number in common; name another base"


def _accept(base: Evidence, new: Evidence, name: str) -> str:
    """Return how to go on without a measurement: a run is made a baseline, which one of chosen tests cannot be."""
    if base.chosen:
        made = (measurement[name].test for measurement in base.measurements.values() if name in measurement)
        test = next((each.rpartition("::")[2].partition("[")[0] for each in made if each), "")
        return f"leave its test out of both runs: -- -k 'not {test or 'its name'}'"
    file, run = quote(base.side.file), quote(new.side.file or "RUN")
    update = f"{run} --accept {quote(name)} --because TEXT`"
    if base.is_baseline:
        return f"accept that with `hiltest baseline update {file} {update}"
    save = f"`hiltest baseline save {file} FILE`"
    return f"accept that into a baseline, {save} and `hiltest baseline update FILE {update}"


def _or_renew(*, together: bool) -> str:
    """Return the other remedy; two firmwares in one session have no baseline to renew."""
    return "" if together else f", or {_RENEW}"


def _without(these: Sequence[str], those: Sequence[str]) -> str:
    return ", ".join(each for each in these if each not in those)


def _gone_and_added(lost: str, added: str) -> str:
    return ", and ".join(filter(None, (lost and f"{lost} before and not now", added and f"{added} now and not before")))


def _seeds(evidence: Evidence) -> str:
    seeds = [str(seed) for seed in evidence.side.seeds]
    return f"seed{'s' * (len(seeds) != 1)} {', '.join(seeds) or 'none'}"
