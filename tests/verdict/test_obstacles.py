"""What keeps a gate from being evaluated: each difference is made in a real record, and named in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from hiltest.boards import default_firmware
from hiltest.campaigns.campaign import SeedResult, evidence_of_all
from hiltest.errors import ConfigError
from hiltest.rig.bench_files import rig_file
from hiltest.rig.rig import conditions_sha256
from hiltest.rig.rig_file import load_rig
from hiltest.run_record.comparison import Comparison
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.reader import read_record
from hiltest.verdict.baseline import baseline_of
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import Evidence, evidence_of_seeds
from hiltest.verdict.evidence_reader import read_evidence
from hiltest.virtual.program.elf import load_image

from .evidence import CONDITIONS, MODEL, evidence, measurement

Changed = Callable[..., Path]


def compared(base: Path, new: Path, **more: Any) -> Comparison:
    return compare(read_evidence(base), read_evidence(new), **more)


def test_two_runs_alike_have_no_obstacle(changed: Changed) -> None:
    comparison = compared(changed("base"), changed("new"))
    assert comparison.obstacles == ()
    unchanged = f"{len(comparison.differences)} unchanged"
    assert comparison.sentence.startswith("May be merged ")
    assert comparison.sentence.endswith(f" (against {comparison.base.file}): {unchanged}.")
    assert len(comparison.differences) > 140


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"rig.conditions_sha256": "00" * 32}, "another rig: virtual-k64f ("),
        (
            {"rig.conditions_sha256": "00" * 32, "rig.faults": "0.1 of bytes lost"},
            "before, virtual-k64f with faults (0.1 of bytes lost) (00000000) now; use the same --rig",
        ),
        ({"rig.conditions_sha256": ""}, "the record has no rig"),
        ({"board.kind": "real"}, "another kind of board: virtual before, real now"),
        (
            {"board.calibrators": ["direct", "direct-fast", "iterative"]},
            "calibrator missing: the firmware no longer has corrected",
        ),
        ({"board.protocol_version": 3}, "another protocol: version "),
        ({"board.compiler": "arm-none-eabi-gcc 13.2.1"}, "another compiler: arm-none-eabi-gcc 12"),
        ({"board.compiler_flags": "-O3 -g"}, "other compiler flags: "),
        ({"board.compiler_flags": ""}, "the compiler flags are unknown"),
        ({"board.cycle_model": "silicon-dwt"}, "another cycle model: cortex-m4-trm/3@sram before, silicon-dwt now"),
        ({"poses": "level"}, "other poses: 'all' before, 'level' now; run with --poses all"),
        ({"seed": 7}, "no seed in common: seed 1 before, seed 7 now"),
        ({"verdict.complete": False, "verdict.outcome": "interrupted"}, "the run is incomplete (interrupted)"),
        ({"board": None, "verdict.complete": False}, "no board answered"),
        ({"board": None}, "another kind of board: virtual before, none now"),
    ],
)
def test_a_difference_that_makes_numbers_incomparable_is_named(
    changed: Changed, fields: dict[str, Any], reason: str
) -> None:
    comparison = compared(changed("base"), changed("new", fields))
    assert any(reason in obstacle for obstacle in comparison.obstacles), comparison.obstacles
    assert all("\n" not in obstacle for obstacle in comparison.obstacles)
    assert comparison.sentence.startswith("Cannot say whether it may be merged (against ")
    assert not comparison.regression


def test_a_missing_sensor_is_one_and_so_is_another_one(changed: Changed, real_record: dict[str, Any]) -> None:
    sensors = real_record["board"]["sensors"]
    absent = [{**sensor, "present": sensor["name"] != "MAG3110"} for sensor in sensors]
    (reason,) = compared(changed("base"), changed("new", {"board.sensors": absent})).obstacles
    assert reason.startswith("other sensors: MAG3110 before and not now; restore them")
    more = [*sensors, {**sensors[0], "name": "LIS3MDL"}]
    (reason,) = compared(changed("base"), changed("new", {"board.sensors": more})).obstacles
    assert reason.startswith("other sensors: LIS3MDL now and not before")


def test_an_added_calibrator_is_none(changed: Changed, real_record: dict[str, Any]) -> None:
    more = [*real_record["board"]["calibrators"], "quick"]
    assert compared(changed("base"), changed("new", {"board.calibrators": more})).obstacles == ()


def test_a_smaller_set_of_tests_is_one_and_a_larger_is_none(changed: Changed) -> None:
    full, gate = changed("full", {"suite": "full"}), changed("gate")
    (reason,) = compared(full, gate).obstacles
    assert reason == "a smaller set of tests: 'full' before, 'gate' now; run with --suite full"
    assert compared(gate, full).obstacles == ()


def test_a_set_of_tests_that_is_not_known_is_one_unless_both_have_it() -> None:
    gate, full = evidence([measurement("link.retried", 0)]), replace(CONDITIONS, suite="full")
    nightly = replace(gate, conditions=replace(CONDITIONS, suite="nightly"))
    for base, new in ((gate, nightly), (nightly, gate), (nightly, replace(gate, conditions=full))):
        assert compare(base, new).obstacles[0].startswith("another set of tests: ")
    assert compare(nightly, nightly).obstacles == ()


def test_a_record_with_a_tolerance_that_is_none_is_refused(changed: Changed) -> None:
    file = changed("run", {"rig.tolerances": {"compass.lag": [-1.0, 0.0]}})
    file = file.rename(file.with_name("refused.json"))
    with pytest.raises(ConfigError, match=r"rig: tolerances\.compass\.lag: absolute must be a finite number"):
        read_evidence(file)


@pytest.mark.parametrize("ending", ["", ".json", ".jsonl"])
def test_a_name_that_no_file_can_have_is_refused_in_one_line(tmp_path: Path, ending: str) -> None:
    for read in (read_evidence, read_record):
        with pytest.raises(ConfigError, match="File name too long"):
            read(tmp_path / ("n" * 300 + ending))


def test_the_digest_is_of_what_was_read(changed: Changed) -> None:
    file = changed("run")
    read = read_record(file)
    assert read.file.sha256 == sha256(file.read_bytes()).hexdigest() == read_evidence(file).side.sha256


def test_a_base_that_judged_a_calibration_file_needs_one(changed: Changed) -> None:
    file = {"file": "imu.json", "sha256": "ef" * 32, "made_utc": "2026-01-02T03:04:05Z"}
    judged, other = changed("judged", {"calibration": file}), changed("other")
    (reason,) = compared(judged, other).obstacles
    assert reason.startswith("no calibration file: the base tested one")
    assert compared(other, judged).obstacles == ()


def test_both_firmwares_in_one_session_may_be_of_two_compilers_and_nothing_else(changed: Changed) -> None:
    built = {"board.compiler": "arm-none-eabi-gcc 13.2.1", "board.compiler_flags": "-O3"}
    assert len(compared(changed("base"), changed("new", built)).obstacles) == 2
    assert compared(changed("base"), changed("new", built), together=True).obstacles == ()
    other = changed("other", {**built, "rig.conditions_sha256": "00" * 32})
    (reason,) = compared(changed("base"), other, together=True).obstacles
    assert reason.startswith("another rig")


def test_flags_in_another_order_or_twice_are_the_same_flags() -> None:
    base = evidence([measurement("link.retried", 0)])
    new = replace(base, conditions=replace(CONDITIONS, compiler_flags=("-g", "-O2", "-g")))
    assert compare(base, new).obstacles == ()


def test_cycles_that_another_model_counted_are_no_further_reason_and_others_that_are_gone_are() -> None:
    values = {"cycles.direct.total": 10_838, "cycles.x.total": 5, "link.retried": 0}
    base = evidence([measurement(name, value) for name, value in values.items()])
    result = base.measurements[1]
    otherwise = {name: replace(item, cycle_model=item.cycle_model and "dwt") for name, item in result.items()}
    new = replace(base, side=replace(base.side, cycle_model="dwt"), measurements={1: otherwise})
    (reason,) = compare(base, new).obstacles
    assert reason.startswith(f"another cycle model: {MODEL} before, dwt now")
    del otherwise["cycles.x.total"]
    _, gone = compare(base, replace(new, measurements={1: otherwise})).obstacles
    assert gone.startswith("measurement missing: cycles.x.total; restore it")


def test_of_two_firmwares_in_one_session_no_baseline_is_to_be_renewed() -> None:
    base = evidence([measurement("link.retried", 0)])
    unlike = replace(CONDITIONS, rig_sha256="00" * 32, calibrators=(), sensors=(), protocol_version=5, poses="level")
    new = replace(base, conditions=unlike, side=replace(base.side, cycle_model="dwt"), measurements={1: {}})
    assert "renew the baseline" in " ".join(compare(base, new).obstacles)
    reasons = compare(base, new, together=True).obstacles
    assert len(reasons) == 7
    assert "renew the baseline" not in " ".join(reasons)


def test_a_measurement_that_is_gone_is_named_with_the_way_to_accept_it(changed: Changed) -> None:
    base, new = changed("base"), changed("new", values={"heading.direct.max": None})
    (reason,) = compared(base, new).obstacles
    begins = "measurement missing: heading.direct.max; restore it, or "
    save = f"accept that into a baseline, `hiltest baseline save {base} FILE`"
    update = f"`hiltest baseline update FILE {new} --accept heading.direct.max --because TEXT`"
    assert reason == f"{begins}{save} and {update}"
    assert compared(base, new, together=True).obstacles == (reason,)
    (reason,) = compare(replace(read_evidence(base), is_baseline=True), read_evidence(new)).obstacles
    assert reason == (
        f"{begins}accept that with `hiltest baseline update {base} {new} --accept heading.direct.max --because TEXT`"
    )
    chosen = [replace(read_evidence(side), chosen=True) for side in (base, new)]
    (reason,) = compare(*chosen, together=True).obstacles
    assert reason == f"{begins}omit its test from both runs: -- -k 'not test_heading_at_known_angles'"


def test_a_run_without_any_measurement_names_a_few_and_counts_the_rest(changed: Changed) -> None:
    comparison = compared(changed("base"), changed("new", {"measurements": []}))
    assert len(comparison.obstacles) == 4
    assert comparison.obstacles[-1].startswith("measurements missing: ")


def test_an_edited_limit_voids_nothing(changed: Changed) -> None:
    assert compared(changed("base"), changed("new", {"rig.sha256": "00" * 32})).obstacles == ()


def test_a_campaign_is_one_side(changed: Changed, tmp_path: Path) -> None:
    for side in ("base", "new"):
        for seed in range(1, 9):
            faster = {"cycles.direct.total": 10_000 - seed} if side == "new" else {}
            changed(f"{side}/seed-{seed:04d}", {"seed": seed}, faster)
    (tmp_path / "new" / "seeds.json").write_text("{}", encoding="utf-8")
    comparison = compared(tmp_path / "base", tmp_path / "new")
    assert comparison.obstacles == (
        f"{tmp_path / 'base'}: the campaign was cut short: it has no seeds.json; repeat it",
    )
    (difference,) = (difference for difference in comparison.differences if difference.name == "cycles.direct.total")
    assert (difference.change, difference.seeds, difference.new) == ("better", 8, 9_995.5)
    assert comparison.base.seeds == tuple(range(1, 9))


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"board.build_id": "ff" * 8}, "another firmware than"),
        ({"rig.conditions_sha256": "00" * 32}, "other conditions than"),
        ({"seed": 1}, "a seed appears twice"),
        ({"verdict.complete": False}, "the run is incomplete"),
    ],
)
def test_a_campaign_of_different_things_is_no_evidence(
    changed: Changed, tmp_path: Path, fields: dict[str, Any], reason: str
) -> None:
    changed("base/seed-0001")
    changed("base/seed-0002", {"seed": 2, **fields})
    (tmp_path / "base" / "seeds.json").write_text("{}", encoding="utf-8")
    (fault,) = read_evidence(tmp_path / "base").faults
    assert reason in fault


def test_a_folder_with_both_a_run_and_a_campaign_is_refused(changed: Changed, tmp_path: Path) -> None:
    changed("base")
    changed("base/seed-0001", {"seed": 1})
    assert read_evidence(tmp_path / "base").side.file == str(tmp_path / "base" / "run.json")
    (tmp_path / "base" / "seeds.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"has both a single run and a campaign \(seeds.json\).*; name the run's"):
        read_evidence(tmp_path / "base")
    (tmp_path / "base" / "run.json").unlink()
    (tmp_path / "base" / "journal.jsonl").write_text("")
    assert read_evidence(tmp_path / "base").side.file == str(tmp_path / "base")


def test_a_seed_that_left_no_record_is_a_fault_of_the_campaign(changed: Changed, tmp_path: Path) -> None:
    changed("base/seed-0001")
    (tmp_path / "base" / "seed-0002").mkdir()
    (tmp_path / "base" / "seeds.json").write_text("{}", encoding="utf-8")
    (fault,) = read_evidence(tmp_path / "base").faults
    assert "seed-0002" in fault


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "12",
        '{"schema": "hiltest.run/2"}',
        '{"schema": "hiltest.run/1"}',
        "\x00\xff",
        "[" * 9999,
        '{"schema": "hiltest.baseline/2"}',
        '{"schema": "hiltest.baseline/1"}',
        '{"schema": ["hiltest.baseline/1"]}',
        '{"schema": "other"}',
        '{"schema": "hiltest.baseline/1", "seeds": NaN}',
    ],
)
def test_a_file_that_is_no_evidence_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "file.json"
    file.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError) as refused:
        read_evidence(file)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_number_that_is_no_number_is_refused(changed: Changed, tmp_path: Path) -> None:
    text = changed("base").read_text(encoding="utf-8")
    file = tmp_path / "hostile.json"
    for hostile in ("NaN", "1e999", '"11061"', "[1]", "true"):
        record = json.loads(text)
        record["measurements"][0]["value"] = "HERE"
        file.write_text(json.dumps(record).replace('"HERE"', hostile), encoding="utf-8")
        with pytest.raises(ConfigError):
            read_evidence(file)


def test_where_no_board_answered_that_alone_is_the_reason(changed: Changed) -> None:
    lost = changed("new", {"board": None, "seed": None, "verdict.complete": False, "measurements": []})
    reasons = compared(changed("base"), lost).obstacles
    assert [reason.partition(": ")[2].partition(" (")[0] for reason in reasons] == [
        "the run is incomplete",
        "no board answered; run it again",
    ]
    without = compared(changed("base"), changed("without", {"board": None, "measurements": []})).obstacles
    assert [item.partition(": ")[0] for item in without if "missing" not in item] == ["another kind of board"]


def test_where_no_seed_left_a_record_the_reason_of_that_is_the_only_one(changed: Changed) -> None:
    answer = "it wrote: ERROR: no such rig"
    nothing = evidence_of_all([SeedResult(seed, 22, answer) for seed in range(1, 6)], "hil-out")
    assert compare(read_evidence(changed("base")), nothing).obstacles == (
        f"hil-out: no record on seed 1, 2, 3 and 2 more: {answer}",
    )
    two = evidence_of_all([SeedResult(1, 22, answer), SeedResult(2, 22, "gone")], "hil-out")
    assert two.faults == (f"hil-out: no record on seed 1: {answer}", "hil-out: no record on seed 2: gone")


def on_seed_1(**outcomes: str) -> dict[int | None, dict[str, TestOutcome]]:
    return {1: {f"a/test_lamp.py::{name}": TestOutcome(outcome) for name, outcome in outcomes.items()}}


@pytest.mark.parametrize(
    ("before", "after", "missing"),
    [
        ({"test_a": "passed"}, {"test_a": "passed", "test_b": "skipped"}, ""),
        ({"test_a": "skipped", "test_b": "failed", "test_c": "xfailed"}, {}, ""),
        ({"test_a": "passed"}, {"test_a": "failed"}, ""),
        ({"test_a": "passed"}, {"test_a": "xpassed"}, ""),
        ({"test_a": "passed"}, {"test_a": "skipped"}, "test_a passed before and is skipped now; let it run"),
        ({"test_a[1]": "passed"}, {"test_a[2]": "passed"}, "test_a[1] passed before and did not run now; let it run"),
        (
            {"test_a": "passed", "test_b": "passed", "test_c": "passed"},
            {"test_b": "passed", "test_c": "skipped"},
            "test_a passed before and did not run now, and 1 more; let them run",
        ),
    ],
)
def test_what_passed_before_and_is_no_test_any_more_is_missed(
    before: dict[str, str], after: dict[str, str], missing: str
) -> None:
    side = evidence([measurement("link.retried", 0)])
    base, new = replace(side, tests=on_seed_1(**before)), replace(side, tests=on_seed_1(**after))
    reasons = compare(base, new).obstacles
    assert [reason.partition(", or ")[0] for reason in reasons] == (
        [f"test missing: test_lamp.py::{missing}"] if missing else []
    )
    assert compare(side, new).obstacles == ()  # of a base from before they were kept
    if missing:
        (reason,) = compare(base, new, together=True).obstacles
        assert reason.endswith("or omit it from both runs: -- -k 'not test_a'")
        assert compare(base, replace(new, chosen=True)).obstacles == ()
        (reason,) = compare(base, replace(new, faults=("cut short",))).obstacles
        assert reason == "cut short"


@pytest.mark.parametrize("outcome", ["failed", "connection lost", "passed", "skipped"])
def test_what_is_new_because_its_test_failed_in_the_base_was_not_compared(outcome: str) -> None:
    retried = measurement("link.retried", 0)
    rest = [replace(measurement(f"lamp.{name}", 1), test="b/test_lamp.py::test_a") for name in ("colour", "life")]
    base = replace(evidence([retried]), tests=on_seed_1(test_a=outcome))
    new = replace(evidence([retried, *rest]), tests=on_seed_1(test_a="passed"))
    for together, side in ((False, new), (True, new), (True, replace(new, chosen=True))):
        reasons = compare(base, side, together=together).obstacles
        assert list(reasons) == (
            [
                "no base: lamp.colour is new, since test_lamp.py::test_a failed in run.json, and 1 "
                "more; name a base in which it passes"
            ]
            if outcome in ("failed", "connection lost")
            else []
        )


def test_a_test_that_moved_to_another_folder_is_the_same_and_each_of_two_of_a_name_counts() -> None:
    side = evidence([measurement("link.retried", 0)])
    two, moved_there = (
        {1: dict.fromkeys(("a/test_lamp.py::test_a", f"{folder}/test_lamp.py::test_a"), TestOutcome.PASSED)}
        for folder in "bc"
    )
    moved = replace(side, tests=moved_there)
    assert compare(replace(side, tests=two), moved).obstacles == ()
    assert len(compare(moved, replace(side, tests=on_seed_1(test_a="passed"))).obstacles) == 1


def test_a_test_is_missed_on_each_seed_and_a_baseline_keeps_what_passed_on_all() -> None:
    both = evidence(*[[measurement("link.retried", 0)]] * 2)
    passed, skipped = {"test_lamp.py::test_a": TestOutcome.PASSED}, {"test_lamp.py::test_a": TestOutcome.SKIPPED}
    base, new = replace(both, tests={1: passed, 2: passed}), replace(both, tests={1: passed, 2: skipped})
    assert "test_a passed before and is skipped now" in compare(base, new).obstacles[0]
    assert compare(new, new).obstacles == ()
    assert baseline_of(base, "").passed == ("test_lamp.py::test_a",)
    assert baseline_of(new, "").passed == ()


def test_runs_put_together_keep_all_their_faults(changed: Changed) -> None:
    run = read_evidence(changed("base"))
    other: Evidence = replace(run, faults=("one", "two"))
    assert evidence_of_seeds([run, other], "both").faults[:2] == ("one", "two")


def test_the_record_of_a_run_says_what_its_numbers_rest_on(real_record: dict[str, Any]) -> None:
    assert real_record["rig"]["conditions_sha256"] == conditions_sha256(load_rig(rig_file(Path("/"), None)))
    assert real_record["board"]["compiler_flags"] == load_image(default_firmware()).compiler_flags != ""
