"""run.json: schema, journal, rounding, volatile places, atomic writes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.measurement import Limit, Measurement, judge
from hiltest.report.record import (
    JOURNAL_FILE,
    RUN_FILE,
    BoardRecord,
    CalibrationRecord,
    Column,
    Findings,
    RigRecord,
    Run,
    Table,
    TestResult,
    Verdict,
    read_journal,
    to_json,
    without_volatile,
    write_atomically,
    write_run,
)
from hiltest.report.recorder import Recorder
from hiltest.report.schema import SCHEMA_FILE, load_run, run_schema, schema_text

Make = Callable[..., Findings]
PASSED = Verdict("pass", 0, "PASS.", complete=True)
CUT_SHORT = Verdict("cut short", 2, "cut short", complete=False)


def test_the_shipped_schema_is_the_one_of_the_classes() -> None:
    assert SCHEMA_FILE.read_text(encoding="utf-8") == schema_text(), (
        "the record changed: write hiltest.report.schema.schema_text() to run.schema.json"
    )


def test_every_object_of_the_schema_lists_what_it_requires() -> None:
    for name, definition in run_schema()["$defs"].items():
        assert "enum" in definition or definition.get("properties"), name


def test_a_run_survives_writing_and_reading(findings: Make, good: list[Measurement], tmp_path: Path) -> None:
    run = findings(*good).finish(PASSED, "2026-01-02T03:05:00Z")
    assert load_run(write_run(run, tmp_path)) == run


def test_measurements_and_tables_are_sorted_by_name(findings: Make, good: list[Measurement]) -> None:
    run = findings(*reversed(good)).finish(PASSED, "")
    assert [each.name for each in run.measurements] == sorted(each.name for each in good)
    assert [each.name for each in run.tables] == sorted(each.name for each in run.tables)


def test_two_runs_are_byte_identical_outside_the_volatile_places(findings: Make, good: list[Measurement]) -> None:
    first = findings(*good).finish(PASSED, "2026-01-02T03:05:00Z")
    slower = [replace(each, value=99.0) if each.volatile else each for each in good]
    again = findings(*slower, tests=(replace(first.tests[0], duration_s=77.0),))
    again.started_utc = "2027-01-01T00:00:00Z"
    second = again.finish(PASSED, "2027-01-01T00:01:00Z")
    texts = [json.dumps(without_volatile(json.loads(to_json(run)))) for run in (first, second)]
    assert to_json(first) != to_json(second)
    assert texts[0] == texts[1]


def test_a_change_outside_the_volatile_places_is_seen(findings: Make, good: list[Measurement]) -> None:
    first = findings(*good).finish(PASSED, "")
    changed = [replace(each, value=0.970000001) if each.name == "heading.direct.max" else each for each in good]
    second = findings(*changed).finish(PASSED, "")
    assert without_volatile(json.loads(to_json(first))) != without_volatile(json.loads(to_json(second)))


def test_host_numbers_are_rounded_and_holes_are_null() -> None:
    table = Table("t", (Column("a"),), ((0.1 + 0.2,), (float("nan"),), (12,), ("word",), (True,), (None,)))
    assert table.rounded().column("a") == (0.3, None, 12, "word", True, None)


def test_a_column_that_is_not_there_is_named() -> None:
    with pytest.raises(KeyError, match="no column 'b', only a"):
        Table("t", (Column("a"),), ()).column("b")


def test_the_text_has_one_measurement_a_line(findings: Make, good: list[Measurement]) -> None:
    lines = to_json(findings(*good).finish(PASSED, "")).splitlines()
    assert sum('"name": "heading.direct.max"' in line for line in lines) == 1
    assert any(line.strip().startswith("[30, 0, 0, true,") for line in lines)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "not JSON"),
        ("[]", "schema is None"),
        ('{"schema": "hiltest.run/2"}', r"schema is 'hiltest.run/2', this hiltest reads 'hiltest.run/1'"),
        ('{"schema": "hiltest.run/1"}', "verdict: Field required"),
    ],
)
def test_a_file_that_is_no_run_is_refused_with_the_reason(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / RUN_FILE
    path.write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        load_run(path)


def test_a_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.json: No such file"):
        load_run(tmp_path / "gone.json")


def test_a_write_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    path = write_atomically(tmp_path / "a", "old")
    write_atomically(path, "new")
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("a", "new")]


class TestRecorder:
    """What stands on the disk while a run goes on."""

    @pytest.fixture
    def recorder(self, tmp_path: Path, board: BoardRecord) -> Recorder:
        calibration = CalibrationRecord("imu.json", "ef" * 32, "2026-01-02T03:04:05Z")
        recorder = Recorder(tmp_path / "out", suite="gate", poses="all", calibration=calibration)
        recorder.rig(RigRecord("virtual-k64f", "rig.toml", "cd" * 32, "not declared"), seed=None)
        recorder.board(board, seed=7)
        recorder.found([judge("heading.direct.max", 0.97, unit="deg", limit=Limit(max=1.8), test="a")],
                       [Table("t", (Column("n"),), ((1,), (2,)))])
        recorder.finished(TestResult("a", "passed", 1.0))
        return recorder

    def test_a_finished_test_is_on_the_disk_before_the_next(self, recorder: Recorder) -> None:
        lines = (recorder.folder / JOURNAL_FILE).read_text().splitlines()
        assert json.loads(lines[-1])["measurements"][0]["value"] == 0.97

    def test_a_journal_that_was_cut_short_gives_every_finished_test(
        self, recorder: Recorder, board: BoardRecord
    ) -> None:
        whole = (recorder.folder / JOURNAL_FILE).read_text()
        run = read_journal([*whole.splitlines(), '{"kind": "test", "test": {"id": "b"'], CUT_SHORT)
        assert run.board == board
        assert run.seed == 7
        assert [test.id for test in run.tests] == ["a"]
        assert run.measurement("heading.direct.max") == recorder.findings.measurements["heading.direct.max"]
        assert run.table("t") == recorder.findings.tables["t"]

    def test_the_journal_gives_the_same_run_as_the_end_does(self, recorder: Recorder) -> None:
        lines = (recorder.folder / JOURNAL_FILE).read_text().splitlines()
        assert _timeless(read_journal(lines, PASSED)) == _timeless(recorder.finish(PASSED))

    def test_the_journal_gives_way_to_the_finished_run(self, recorder: Recorder) -> None:
        recorder.finish(PASSED)
        assert [each.name for each in recorder.folder.iterdir()] == [RUN_FILE]

    def test_a_new_run_removes_the_record_of_the_last(self, recorder: Recorder) -> None:
        recorder.finish(PASSED)
        Recorder(recorder.folder, suite="gate", poses="all")
        assert not (recorder.folder / RUN_FILE).exists()


def test_what_is_no_journal_is_refused() -> None:
    with pytest.raises(ValueError, match="not a journal"):
        read_journal(['{"kind": "start", "schema": "hiltest.run/9"}'], CUT_SHORT)


def _timeless(run: Run) -> Run:
    return replace(run, finished_utc="")
