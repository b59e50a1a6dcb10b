"""A baseline is saved from a run, read back, and changed by name alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hiltest.errors import ConfigError
from hiltest.measurement import EXACT, Limit, Outcome, Tolerance
from hiltest.run_record.comparison import Change, Comparison
from hiltest.run_record.exit_codes import comparison_code
from hiltest.run_record.run import Column, Table
from hiltest.verdict.baseline import Baseline, accept, baseline_of, evidence_from, renewed
from hiltest.verdict.baseline_file import read_baseline, to_json
from hiltest.verdict.compare import compare, review
from hiltest.verdict.evidence import Accepted, Evidence
from hiltest.verdict.evidence_reader import read_evidence
from hiltest.verdict.wording import build

from .evidence import CONDITIONS, evidence, measurement

THEN, NOW = "2026-01-02T03:04:05Z", "2026-02-03T04:05:06Z"


def run(
    direct: float | None = 11_061, heading: float | None = 0.9, lag: float | None = 8.0, *, build: str = ""
) -> Evidence:
    """Return a run over two seeds."""
    results = [
        [
            measurement("cycles.direct.total", direct, unit="cycle"),
            measurement("heading.direct.max", None if heading is None else heading * seed, unit="deg"),
            measurement("compass.lag", lag, unit="ms", outcome=Outcome.FAIL if seed == 2 else Outcome.PASS),
            measurement("board.wall_seconds", 8.1, unit="s", volatile=True),
            measurement("fit.iterative.coverage", None),
        ]
        for seed in (1, 2)
    ]
    made_with = evidence(*results)
    return replace(made_with, side=replace(made_with.side, build_id=build)) if build else made_with


@pytest.fixture
def baseline() -> Baseline:
    return baseline_of(run(), THEN)


def test_a_baseline_compared_with_its_own_run_has_only_unchanged(baseline: Baseline, tmp_path: Path) -> None:
    file = tmp_path / "base.json"
    file.write_text(to_json(baseline), encoding="utf-8")
    assert read_baseline(file) == baseline
    comparison = compare(read_evidence(file), run())
    assert comparison.evaluated
    assert {difference.name for difference in comparison.differences_with(Change.UNCHANGED)} == {
        difference.name for difference in comparison.differences
    }
    assert (comparison.base.file, comparison.base.saved_utc) == (str(file), THEN)
    assert len(comparison.base.sha256) == 64


def test_a_baseline_keeps_the_heading_errors_of_its_first_seed(tmp_path: Path) -> None:
    names = ("heading", "pitch", "roll", "reference", "error.direct")
    poses = Table("heading.poses", tuple(map(Column, names)), ((358.3, 0.0, 20.0, 0.0, 0.12345),))
    file = tmp_path / "base.json"
    file.write_text(to_json(baseline_of(replace(run(), poses=poses), THEN)), encoding="utf-8")
    table = read_evidence(file).poses
    assert table is not None
    assert [column.name for column in table.columns] == ["heading", "pitch", "roll", "error.direct"]
    assert table.rows == ((358.3, 0.0, 20.0, 0.123),)


def test_another_program_may_have_written_it_in_its_own_order(baseline: Baseline, tmp_path: Path) -> None:
    file = tmp_path / "base.json"
    content = json.loads(to_json(baseline))
    file.write_text(json.dumps(dict(sorted(content.items())), indent=4), encoding="utf-8")
    assert read_evidence(file).measurements == evidence_from(baseline, "", "").measurements


def test_there_is_a_line_for_each_measurement_and_none_for_what_is_volatile_or_has_no_number(
    baseline: Baseline,
) -> None:
    lines = [line for line in to_json(baseline).splitlines() if line.startswith(' {"name"')]
    rows = [json.loads(line.strip().removesuffix(",").removesuffix("]")) for line in lines]
    assert [row["name"] for row in rows] == ["compass.lag", "cycles.direct.total", "heading.direct.max"]
    assert [row["values"] for row in rows] == [[8.0, 8.0], [11_061, 11_061], [0.9, 1.8]]
    assert [row["failed"] for row in rows] == [[2], [], []]
    assert baseline.side.file == ""  # where it once lay says nothing to anybody else


def test_one_is_accepted_by_name_and_all_others_stay(baseline: Baseline) -> None:
    after = accept(baseline, run(11_161, 1.5), ["cycles.direct.total"], because="checks its input", when_utc=NOW)
    (entry,) = after.history
    build_id = "0123456789abcdef"
    assert entry == Accepted("cycles.direct.total", "checks its input", NOW, build_id, 11_061, 11_161, build_id)
    rows = [row for row in after.measurements if row.name != "cycles.direct.total"]
    assert rows == [row for row in baseline.measurements if row.name != "cycles.direct.total"]
    comparison = compare(evidence_from(after, "", ""), run(11_161, 1.5))
    others = [difference for difference in comparison.differences if difference.change is not Change.UNCHANGED]
    assert [(other.name, other.change) for other in others] == [("heading.direct.max", Change.WORSE)]


def test_a_pattern_moves_all_that_it_matches_and_history_goes_on(baseline: Baseline) -> None:
    once = accept(baseline, run(heading=1.0), ["heading.*"], because="first", when_utc=THEN)
    twice = accept(once, run(11_161, 1.0, 9.0), ["*"], because="second", when_utc=NOW)
    assert [(state.name, state.because) for state in twice.history] == [
        ("heading.direct.max", "first"),
        ("compass.lag", "second"),
        ("cycles.direct.total", "second"),
    ]
    assert compare(evidence_from(twice, "", ""), run(11_161, 1.0, 9.0)).differences_with(Change.UNCHANGED)


def test_one_that_is_gone_is_taken_out_and_one_that_is_new_put_in(baseline: Baseline) -> None:
    gone = accept(baseline, run(lag=None), ["compass.lag"], because="no longer offered", when_utc=NOW)
    assert "compass.lag" not in {row.name for row in gone.measurements}
    assert (gone.history[0].was, gone.history[0].now) == (8.0, None)
    assert compare(evidence_from(gone, "", ""), run(lag=None)).evaluated
    back = accept(gone, run(), ["compass.lag"], because="again", when_utc=NOW)
    assert back.measurements == baseline.measurements


def read_back(baseline: Baseline, folder: Path) -> Evidence:
    """Return a baseline as who compares with its file gets it."""
    file = folder / "base.json"
    file.write_text(to_json(baseline), encoding="utf-8")
    return read_evidence(file)


def test_every_measurement_keeps_the_build_that_it_is_of(tmp_path: Path) -> None:
    of_a = baseline_of(run(build="a"), THEN)
    of_b = accept(of_a, run(11_161, 1.5, build="b"), ["cycles.*"], because="checks more", when_utc=NOW)
    of_c = accept(of_b, run(11_161, 1.5, 9.0, build="c"), ["compass.lag"], because="waits", when_utc=NOW)
    assert [(row.name, row.build_id) for row in of_c.measurements] == [
        ("compass.lag", "c"),
        ("cycles.direct.total", "b"),
        ("heading.direct.max", None),
    ]
    assert [(item.name, item.was_build_id, item.build_id) for item in of_c.history] == [
        ("cycles.direct.total", "a", "b"),
        ("compass.lag", "a", "c"),
    ]
    assert (of_c.side.build_id, of_c.saved_utc, of_c.side.saved_utc) == ("a", NOW, NOW)
    answer = "build a, with 1 measurement accepted from build b and 1 measurement accepted from build c"
    assert build(of_c.side) == answer, "in the file itself"
    side = read_back(of_c, tmp_path)
    assert build(side.side) == answer
    assert side.builds == {"compass.lag": "c", "cycles.direct.total": "b"}
    again = accept(of_c, run(11_261, 1.5, 9.0, build="d"), ["cycles.*"], because="more yet", when_utc=NOW)
    assert (again.history[2].was_build_id, again.history[2].build_id) == ("b", "d")


def test_a_file_whose_head_counts_wrongly_is_taken_by_its_lines(tmp_path: Path) -> None:
    mixed = accept(baseline_of(run(build="a"), THEN), run(1, 2, build="b"), ["cycles.*"], because="x", when_utc=NOW)
    beautified = replace(mixed, side=replace(mixed.side, accepted=()))
    assert build(read_back(beautified, tmp_path).side) == "build a, with 1 measurement accepted from build b"


def test_a_baseline_whose_numbers_are_all_of_one_run_is_of_its_build(tmp_path: Path) -> None:
    newer = run(11_161, 1.5, build="b")
    after = accept(baseline_of(run(build="a"), THEN), newer, ["cycles.*", "heading.*"], because="x", when_utc=NOW)
    assert build(after.side) == "build b"
    assert after.measurements == baseline_of(newer, NOW).measurements
    assert [state.was_build_id for state in after.history] == ["a", "a"]
    assert read_back(after, tmp_path).side.seeds == (1, 2)
    # A number that goes back to what the side's build has is that build's again.
    back = accept(
        accept(baseline_of(run(build="a"), THEN), run(1, 2, build="b"), ["cycles.*"], because="x", when_utc=NOW),
        run(2, 2, build="a"),
        ["cycles.*"],
        because="undone",
        when_utc=NOW,
    )
    assert build(back.side) == "build a"


def test_a_line_that_says_no_more_what_it_said_is_written_so(tmp_path: Path) -> None:
    mixed = accept(baseline_of(run(build="a"), THEN), run(1, 2, build="b"), ["cycles.*"], because="x", when_utc=NOW)
    before = json.loads(to_json(mixed))
    after = accept(mixed, run(1, 2, build="b"), ["*"], because="the rest", when_utc=NOW)
    assert build(after.side) == "build b"
    written = json.loads(to_json(after, before))
    assert [number for number in written["measurements"] if "build_id" in number] == []
    before["measurements"][0]["moon"] = "full"
    assert json.loads(to_json(mixed, before))["measurements"] == before["measurements"]
    (tmp_path / "base.json").write_text(to_json(after, before), encoding="utf-8")
    assert read_baseline(tmp_path / "base.json") == after


def test_nothing_is_taken_out_because_its_test_was_not_chosen(baseline: Baseline) -> None:
    chosen = replace(run(11_161, None, None), chosen=True)
    with pytest.raises(ConfigError, match=r"only chosen tests ran, and run.json has no compass.lag and 1 more"):
        accept(baseline, chosen, ["*"], because="x", when_utc=NOW)
    after = accept(baseline, chosen, ["cycles.*"], because="x", when_utc=NOW)
    assert [state.name for state in after.history] == ["cycles.direct.total"]
    assert len(after.measurements) == len(baseline.measurements)


def test_a_tolerance_that_an_older_file_does_not_state_is_no_change(baseline: Baseline) -> None:
    stated = {"cycles.direct.total": Tolerance(5, 0.0), "heading.direct.max": EXACT, "compass.lag": EXACT}
    assert accept(baseline, replace(run(), in_force=stated), ["*"], because="x", when_utc=NOW) == baseline
    newer = replace(run(11_161, build="b"), in_force=stated)
    after = accept(baseline, newer, ["cycles.*"], because="x", when_utc=NOW)
    assert [state.name for state in after.history] == ["cycles.direct.total"]
    assert build(after.side) == "build b"
    assert after.measurements == baseline_of(newer, NOW).measurements
    assert '"tolerance"' not in to_json(baseline)
    wider = replace(newer, in_force={**stated, "compass.lag": Tolerance(1.0, 0.0)})
    assert [item.name for item in accept(after, wider, ["*"], because="x", when_utc=NOW).history[1:]] == ["compass.lag"]


def test_nothing_that_is_the_same_is_entered_in_the_history(baseline: Baseline) -> None:
    assert accept(baseline, run(), ["*"], because="why not", when_utc=NOW) == baseline


@pytest.mark.parametrize("name", ["heading.direct.maximum", "fusion.*", ""])
def test_a_name_that_nothing_has_is_refused_with_the_nearest(baseline: Baseline, name: str) -> None:
    with pytest.raises(ConfigError, match="no measurement has the name") as refused:
        accept(baseline, run(), ["cycles.*", name], because="x", when_utc=NOW)
    near = "; did you mean 'heading.direct.max'?"
    assert (near in str(refused.value)) == name.startswith("heading")


def test_a_run_on_another_rig_or_without_a_seed_moves_nothing(baseline: Baseline) -> None:
    other = replace(run(), conditions=replace(CONDITIONS, rig_sha256="00" * 32))
    with pytest.raises(ConfigError, match="nothing changes: another rig"):
        accept(baseline, other, ["*"], because="x", when_utc=NOW)
    one_seed = replace(run(), measurements={1: run().measurements[1]})
    with pytest.raises(ConfigError, match="has no seed 2"):
        accept(baseline, one_seed, ["*"], because="x", when_utc=NOW)


def test_a_run_that_was_cut_short_is_no_baseline() -> None:
    with pytest.raises(ConfigError, match="a baseline needs a complete run"):
        baseline_of(replace(run(), faults=("run.json: the run is incomplete",)), THEN)
    with pytest.raises(ConfigError, match="no board answered"):
        baseline_of(replace(run(), conditions=None), THEN)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('"hiltest.baseline/2"', '"hiltest.baseline/3"', "this hiltest reads"),
        ("[0.9, 1.8]", "[0.9]", "1 values for 2 seeds"),
        ("[0.9, 1.8]", "[0.9, NaN]", "not JSON: NaN is not a number"),
        ("[0.9, 1.8]", '[0.9, "1.8"]', "measurements.2.values.1"),
        ('"seeds": [1, 2],\n"measurements"', '"seeds": [1, 1],\n"measurements"', "seed 1 appears twice"),
        ('"seeds": [1, 2],\n"measurements"', '"seeds": [],\n"measurements"', "seeds is empty"),
        ('"compass.lag"', '"heading.direct.max"', 'measurement "heading.direct.max" appears twice'),
        ("[0.9, 1.8]", "[null, null]", '"heading.direct.max" has no number'),
        ('"protocol_version"', '"protocol"', "conditions.protocol_version"),
    ],
)
def test_a_damaged_baseline_is_refused_with_the_place(
    baseline: Baseline, tmp_path: Path, old: str, new: str, reason: str
) -> None:
    text = to_json(baseline)
    assert old in text
    file = tmp_path / "base.json"
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError, match="save it again") as refused:
        read_baseline(file)
    assert reason in str(refused.value)


def test_a_baseline_of_nothing_is_neither_written_nor_read(baseline: Baseline, tmp_path: Path) -> None:
    nothing = replace(run(), measurements={1: {}, 2: {}})
    with pytest.raises(ConfigError, match="it has no number"):
        baseline_of(nothing, THEN)
    with pytest.raises(ConfigError, match="no measurement would remain"):
        accept(baseline, nothing, ["*"], because="all of it", when_utc=NOW)
    file = tmp_path / "base.json"
    text = to_json(baseline)
    rows = text[text.index('"measurements": [') : text.index('"history"')]
    file.write_text(text.replace(rows, '"measurements": [],\n'), encoding="utf-8")
    with pytest.raises(ConfigError, match="measurements is empty"):
        read_baseline(file)


def test_the_sense_of_one_s_own_measurement_goes_through_a_baseline(tmp_path: Path) -> None:
    file = tmp_path / "base.json"
    sides = []
    for lag in (8.0, 9.0):
        side = evidence([measurement("compass.lag", lag, limit=Limit(max=10)), measurement("link.retried", 0)])
        file.write_text(to_json(baseline_of(side, THEN)), encoding="utf-8")
        sides.append(read_evidence(file))
    (difference,) = compare(*sides).differences_with(Change.WORSE)
    assert (difference.name, difference.limit) == ("compass.lag", Limit(max=10))
    text = file.read_text(encoding="utf-8")
    assert text.count('"limit"') == 1  # one that has none is written as ever
    older = text.replace("hiltest.baseline/2", "hiltest.baseline/1").replace(', "limit": {"min": null, "max": 10}', "")
    file.write_text(older, encoding="utf-8")
    assert {row.limit for row in read_baseline(file).measurements} == {None}


def test_a_file_without_digest_is_compared_and_said_not_to_be_sealed_until_it_is_updated(
    baseline: Baseline, tmp_path: Path
) -> None:
    file = tmp_path / "base.json"
    older = to_json(baseline).replace("hiltest.baseline/2", "hiltest.baseline/1").replace("11061", "11060")
    file.write_text(older, encoding="utf-8")
    comparison = compare(read_evidence(file), run(11_060))
    assert comparison.evaluated
    assert comparison.remark == f"{file}: not sealed, since the file has no digest of its content."
    after = accept(read_baseline(file), run(), ["cycles.*"], because="counted again", when_utc=NOW)
    file.write_text(to_json(after, json.loads(older)), encoding="utf-8")
    assert compare(read_evidence(file), run()).remark == ""


def test_a_tolerance_that_neither_catalogue_nor_rig_states_is_refused_by_name(baseline: Baseline) -> None:
    rows = tuple(replace(row, tolerance=Tolerance(1e9, 0.0)) for row in baseline.measurements[:1])
    wide = evidence_from(replace(baseline, measurements=rows + baseline.measurements[1:]), "base.json", "")
    (obstacle,) = compare(wide, run()).obstacles
    assert obstacle.startswith("tolerance of compass.lag: base.json has a wider one than the catalogue")
    assert "`hiltest baseline update base.json run.json --accept compass.lag --because TEXT`" in obstacle
    stated = replace(run(), tolerances={"compass.lag": Tolerance(1e9, 0.0)})
    assert compare(wide, stated).evaluated


def reviewed(before: Baseline, after: Baseline) -> Comparison:
    return review(evidence_from(before, "before.json", ""), evidence_from(after, "after.json", ""))


def test_a_review_passes_accepted_changes_and_lists_them_with_their_reasons(baseline: Baseline) -> None:
    after = accept(baseline, run(12_000, lag=None), ["cycles.*", "compass.*"], because="it checks more", when_utc=NOW)
    comparison = reviewed(baseline, after)
    assert comparison_code(comparison) == 0
    notes = {change.name: change.note.rpartition("; ")[2] for change in comparison.differences_with(Change.CHANGED)}
    assert notes == dict.fromkeys(("compass.lag", "cycles.direct.total"), "accepted: it checks more")
    unchanged = reviewed(after, after)
    assert (comparison_code(unchanged), unchanged.remark) == (0, "")
    assert "merged" not in unchanged.sentence, "the run beside it may have failed"
    dearer = tuple(
        replace(row, values=(13_000, 13_000)) if row.name == "cycles.direct.total" else row
        for row in after.measurements
    )
    assert comparison_code(reviewed(after, replace(after, measurements=dearer))) == 21, "the reason was for 12 000"


@pytest.mark.parametrize(
    ("edit", "code", "name"),
    [
        ({"values": (20_000, 20_000)}, 21, "1 worse: cycles.direct.total 11 061 -> 20 000 cycles"),
        (None, 22, "measurement missing: cycles.direct.total"),
        ({"tolerance": Tolerance(0.0, 0.5)}, 22, "tolerance widened: cycles.direct.total"),
        ({"values": (11_060, 11_060)}, 0, "1 better: cycles.direct.total"),
    ],
)
def test_a_review_refuses_a_laxer_number_that_nobody_accepted(
    baseline: Baseline, edit: dict[str, Any] | None, code: int, name: str
) -> None:
    before = replace(baseline, measurements=tuple(replace(row, tolerance=EXACT) for row in baseline.measurements))
    is_edited = {row.name: row.name == "cycles.direct.total" for row in before.measurements}
    rows = [
        replace(row, **(edit or {})) if is_edited[row.name] else row
        for row in before.measurements
        if edit is not None or not is_edited[row.name]
    ]
    comparison = reviewed(before, replace(before, measurements=tuple(rows)))
    assert (comparison_code(comparison), name in comparison.sentence) == (code, True), comparison.sentence


def test_a_test_that_was_removed_on_purpose_needs_a_baseline_that_was_saved_again(baseline: Baseline) -> None:
    before = replace(baseline, passed=("test_heading.py::test_north",))
    assert comparison_code(reviewed(before, baseline)) == 22
    assert comparison_code(reviewed(before, renewed(baseline, before))) == 0


def test_a_baseline_that_was_saved_anew_for_another_rig_is_accepted_as_a_whole_and_says_so(baseline: Baseline) -> None:
    another = replace(run(12_000), conditions=replace(CONDITIONS, rig_sha256="cd" * 32))
    comparison = reviewed(baseline, renewed(baseline_of(another, NOW), baseline))
    assert comparison_code(comparison) == 0
    assert comparison.remark.startswith("The baseline was saved anew: another rig: ")
    same_rig = renewed(baseline_of(run(12_000), NOW), baseline)
    assert comparison_code(reviewed(baseline, same_rig)) == 21, "a worse number is accepted by its name"
    assert comparison_code(reviewed(baseline, baseline_of(another, NOW))) == 22, "its history is gone"
