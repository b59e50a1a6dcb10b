"""The page about records: its commands run, its table has every field, its bounds and words are the program's."""

from __future__ import annotations

import dataclasses
import re
import shlex
from pathlib import Path

import pytest
from tests.finished_run import run_module

import hiltest
from hiltest.run_record import journal
from hiltest.run_record.comparison import Revision
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import SCHEMA, Run

PAGE = (Path(__file__).parents[2] / "docs" / "record.md").read_text(encoding="utf-8")
COMMANDS, LABELLED = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)


@pytest.mark.ci
def test_the_commands_do_what_the_page_says(tmp_path: Path) -> None:
    for command in COMMANDS.splitlines():
        done = run_module(*shlex.split(command), folder=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
        sentence = read_record(tmp_path / "hil-out").run.verdict.sentence
        assert " ".join(sentence.split()) in " ".join(done.stdout.split())
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == ["report.html", "report.md", "run.json"]
    assert (tmp_path / "kept" / "run.json").read_bytes() == (tmp_path / "hil-out" / "run.json").read_bytes()
    # A row for each field, and a field for each row.
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \| ", PAGE, re.M)
    assert {name for row in rows for name in re.findall(r"\w+", row)} == {
        field.name for field in dataclasses.fields(Run)
    }


def test_the_label_is_in_the_record(tmp_path: Path) -> None:
    command = f"{LABELLED.strip()} -- -k identity"  # one test is enough to have a record
    done = run_module(*shlex.split(command), folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert read_record(tmp_path / "hil-out").run.revision == Revision(label="compass v1.2")


def test_names_are_the_program_s() -> None:
    assert f"`{SCHEMA}`" in PAGE
    assert f"`{journal.JOURNAL_FILE}`" in PAGE


def test_the_schema_is_where_the_page_says() -> None:
    (place,) = re.findall(r"`hiltest/(\S+\.schema\.json)`", PAGE)
    assert (Path(hiltest.__file__).parent / place).is_file()
