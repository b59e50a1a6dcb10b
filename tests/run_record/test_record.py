"""run.json: schema, rounding, volatile places, atomic writes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from hiltest.errors import ConfigError
from hiltest.measurement import Measurement
from hiltest.run_record.files import write_atomically
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Column, Findings, Table, TestResult, Verdict
from hiltest.run_record.run_json import to_json, write_run
from hiltest.run_record.schema import SCHEMA_FILE, run_schema, schema_text

from ..finished_run import without_volatile

Make = Callable[..., Findings]
PASSED = Verdict("pass", 0, "PASS.", complete=True)


def test_the_shipped_schema_is_the_one_of_the_classes() -> None:
    assert SCHEMA_FILE.read_text(encoding="utf-8") == schema_text(), (
        "the record changed: write hiltest.record.schema.schema_text() to run.schema.json"
    )


def test_every_object_of_the_schema_lists_what_it_requires() -> None:
    for name, definition in run_schema()["$defs"].items():
        assert "enum" in definition or definition.get("properties"), name


def test_a_run_survives_writing_and_reading(findings: Make, good: list[Measurement], tmp_path: Path) -> None:
    run = findings(*good).finish(PASSED, "2026-01-02T03:05:00Z")
    assert read_record(write_run(run, tmp_path)).run == run


def test_measurements_and_tables_are_sorted_by_name(findings: Make, good: list[Measurement]) -> None:
    run = findings(*reversed(good)).finish(PASSED, "")
    assert [measurement.name for measurement in run.measurements] == sorted(each.name for each in good)
    assert [table.name for table in run.tables] == sorted(table.name for table in run.tables)


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
        ("[]", "schema is null, .*: it is not a record of a run"),
        ('{"schema": "hiltest.fit/1"}', 'schema is "hiltest.fit/1", .*: it is not a record of a run'),
        (
            '{"schema": "hiltest.run/2"}',
            'schema is "hiltest.run/2", this hiltest reads "hiltest.run/1": use the version that wrote it, or repeat '
            "the",
        ),
        ('{"schema": "hiltest.run/2", "environment": {"versions": {"hiltest": "3.1"}}}', r'wrote it \(hiltest "3.1"\)'),
        ('{"schema": "hiltest.run/1"}', "verdict: Field required"),
    ],
)
def test_a_file_that_is_no_run_is_refused_with_the_reason(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "no-run.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        read_record(path)


def test_a_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.json: No such file"):
        read_record(tmp_path / "gone.json")


def test_a_write_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    path = write_atomically(tmp_path / "a", "old")
    write_atomically(path, "new")
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("a", "new")]


def test_the_older_word_for_a_lost_connection_is_read_and_valid(
    findings: Make, good: list[Measurement], tmp_path: Path
) -> None:
    lost = TestResult("t.py::t", TestOutcome.CONNECTION_LOST, 1.0, reason="unplugged")
    text = to_json(findings(*good, tests=(lost,)).finish(PASSED, "")).replace("connection lost", "bench lost")
    (tmp_path / "older.json").write_text(text, encoding="utf-8")
    assert read_record(tmp_path / "older.json").run.tests == (lost,)
    assert Draft202012Validator(run_schema()).is_valid(json.loads(text))
    assert not Draft202012Validator(run_schema()).is_valid(json.loads(text.replace("bench lost", "lunch lost")))
    (tmp_path / "older.json").write_text(text.replace("bench lost", "lunch lost"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"tests\.0\.outcome"):
        read_record(tmp_path / "older.json")
