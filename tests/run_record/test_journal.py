"""What stands on the disk while a run goes on, what it says when it was cut short, and whose the folder is."""

from __future__ import annotations

import fcntl
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.measurement import Limit, check
from hiltest.run_record.files import RECORD_FILES, RUN_FILE
from hiltest.run_record.journal import JOURNAL_FILE, Journal
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.reader import read_record
from hiltest.run_record.recorder import Recorder
from hiltest.run_record.run import BoardRecord, CalibrationRecord, Column, RigRecord, Run, Table, TestResult, Verdict

PASSED = Verdict("pass", 0, "PASS.", complete=True)
Begin = Callable[[], Recorder]


@pytest.fixture
def begin(tmp_path: Path, board: BoardRecord) -> Iterator[Begin]:
    """Return a function that begins a run in ``tmp_path``; its first test is through."""
    journals = []

    def begun() -> Recorder:
        journals.append(Journal(tmp_path))
        calibration = CalibrationRecord("imu.json", "ef" * 32, "2026-01-02T03:04:05Z")
        recorder = Recorder(journals[-1], suite="gate", poses="all")
        recorder.begin(calibration)
        recorder.rig(RigRecord("virtual-k64f", "rig.toml", "cd" * 32, "not declared"), seed=None)
        recorder.board(board, seed=7)
        recorder.add(
            [check("heading.direct.max", 0.97, unit="deg", limit=Limit(max=1.8), test="a")],
            [Table("t", (Column("n"),), ((1,), (2,)))],
        )
        recorder.finish_test(TestResult("a", TestOutcome.PASSED, 1.0))
        return recorder

    yield begun
    for journal in journals:
        journal.release()


@pytest.fixture
def cut_short(begin: Begin) -> Path:
    """Return the journal of a run whose process died after its first test."""
    recorder = begin()
    path = recorder.folder / JOURNAL_FILE
    recorder.release()
    return path


def finished(recorder: Recorder) -> Path:
    recorder.finish(PASSED)
    recorder.release()
    return recorder.folder


def _no_room(_run: Run, _folder: Path) -> None:
    raise OSError(28, "the disk is full")


def timeless(run: Run) -> Run:
    return replace(run, finished_utc="", verdict=PASSED)


def test_a_finished_test_is_on_the_disk_before_the_next(begin: Begin) -> None:
    lines = (begin().folder / JOURNAL_FILE).read_text().splitlines()
    assert json.loads(lines[-1])["measurements"][0]["value"] == 0.97


def test_a_run_that_was_cut_short_is_read_with_every_finished_test(cut_short: Path, board: BoardRecord) -> None:
    run = read_record(cut_short.parent).run
    assert (run.verdict.outcome, run.verdict.exit_code, run.verdict.complete) == ("cut short", 2, False)
    assert run.verdict.sentence == "CUT SHORT: 1 test finished, 1 measurement kept; the last test was a."
    assert (run.board, run.seed, run.suite, run.poses) == (board, 7, "gate", "all")
    assert run.calibration is not None
    assert [test.id for test in run.tests] == ["a"]
    measured = run.measurement("heading.direct.max")
    assert measured is not None
    assert (measured.value, measured.limit) == (0.97, Limit(max=1.8))
    assert run.table("t") == Table("t", (Column("n"),), ((1,), (2,)))


def test_the_journal_gives_the_same_run_as_the_end_does(begin: Begin) -> None:
    recorder = begin()
    from_journal = read_record(recorder.folder).run
    assert timeless(from_journal) == timeless(recorder.finish(PASSED))
    assert timeless(read_record(recorder.folder).run) == timeless(from_journal)


def test_a_run_that_goes_on_says_so(begin: Begin) -> None:
    verdict = read_record(begin().folder).run.verdict
    assert (verdict.outcome, verdict.complete) == ("still running", False)
    assert verdict.sentence.startswith("STILL RUNNING: 1 test finished")


def test_what_is_out_of_its_limit_is_named_even_when_the_run_is_cut_short(begin: Begin) -> None:
    recorder = begin()
    recorder.add([check("heading.direct.max", 2.5, unit="deg", limit=Limit(max=1.8), test="b")], ())
    recorder.finish_test(TestResult("b", TestOutcome.FAILED, 1.0, "heading.direct.max = 2.5"))
    recorder.finish_test(TestResult("c", TestOutcome.FAILED, 1.0, "assert 1 == 2"))
    recorder.release()
    assert read_record(recorder.folder).run.verdict.sentence == (
        "CUT SHORT: 3 tests finished, 1 measurement kept; the last test was c. "
        "Out of limit: heading.direct.max 2.5 deg (at most 1.8). Failed: c (assert 1 == 2)."
    )


@pytest.mark.parametrize(
    "torn",
    [
        '{"kind": "te',
        '{"kind": "test", "test": null, "utc": "", "measurements": [], "ta',
        '{"kind": "test", "reason": "\xc3',
        "x",
    ],
)
def test_a_half_written_last_line_is_left_out(cut_short: Path, torn: str) -> None:
    whole = read_record(cut_short).run
    with cut_short.open("ab") as file:
        file.write(torn.encode("latin-1"))
    assert read_record(cut_short).run == whole


def test_a_last_line_that_is_whole_but_for_its_end_is_not_taken_for_finished(cut_short: Path) -> None:
    cut_short.write_bytes(cut_short.read_bytes()[:-1])
    assert read_record(cut_short).run.tests == ()


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("{", "line 6 is damaged: Expecting property name"),
        ("[]", r"line 6 is damaged: \[\] is no object"),
        ("{}", "line 6 is not an entry of a journal: 'kind'"),
        ('{"kind": "test", "test": null, "utc": "", "measurements": [{}], "tables": []}', "line 6 .*: 'name'"),
        ('{"kind": "test", "test": null, "utc": "", "measurements": 1, "tables": []}', "line 6 is not an entry"),
        ('{"kind": "test", "test": {"id": 1}, "utc": "", "measurements": [], "tables": []}', r"tests\.1\.id"),
        ('{"kind": "board", "board": 1, "seed": 1}', "board"),
    ],
)
def test_a_line_that_is_whole_and_wrong_is_refused_by_its_number(cut_short: Path, line: str, complaint: str) -> None:
    with cut_short.open("a") as file:
        file.write(f"{line}\n")
    with pytest.raises(ConfigError, match=rf"{JOURNAL_FILE}: .*{complaint}"):
        read_record(cut_short)


def test_an_entry_of_a_kind_that_is_not_known_yet_is_passed_over(cut_short: Path) -> None:
    whole = read_record(cut_short).run
    with cut_short.open("a") as file:
        file.write('{"kind": "weather", "rain": true}\n')
    assert read_record(cut_short).run == whole


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"kind": "start", "schema": "hiltest.run/9"}\n', '"hiltest.run/9", this hiltest reads "hiltest.run/1"; use'),
        ('{"kind": "start", "schema": "hiltest.run/1"}\n', "suite is missing"),
        ('{"kind": "test"}\n', "no record of a run"),
        ("\n", "line 1 is damaged"),
    ],
)
def test_what_is_no_journal_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / JOURNAL_FILE).write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        read_record(tmp_path)


class TestFolder:
    """One folder belongs to one run."""

    def test_a_second_run_is_refused_and_told_who_has_the_folder(self, begin: Begin) -> None:
        recorder = begin()
        before = (recorder.folder / JOURNAL_FILE).read_bytes()
        with pytest.raises(ConfigError) as caught:
            Journal(recorder.folder)
        assert str(caught.value).startswith(f"the folder {recorder.folder} is in use by process {os.getpid()} on ")
        assert str(caught.value).endswith(": wait for it, or name another folder with --out")
        assert (recorder.folder / JOURNAL_FILE).read_bytes() == before

    def test_a_run_that_has_only_begun_is_in_the_way_as_well(self, tmp_path: Path) -> None:
        journal = Journal(tmp_path)
        with pytest.raises(ConfigError, match="in use by another run that has just begun"):
            Journal(tmp_path)
        journal.release()

    def test_the_folder_is_free_when_the_process_is_killed(self, tmp_path: Path) -> None:
        program = (
            "import os, sys; from pathlib import Path; from hiltest.run_record.journal import Journal;"
            "journal = Journal(Path(sys.argv[1])); os.kill(os.getpid(), 9)"
        )
        assert subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False, timeout=60).returncode == -9
        assert (tmp_path / JOURNAL_FILE).exists()
        Journal(tmp_path).release()

    def test_who_only_asks_for_a_moment_is_in_nobody_s_way(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / JOURNAL_FILE).touch()
        with (tmp_path / JOURNAL_FILE).open("rb") as asking:
            fcntl.flock(asking, fcntl.LOCK_SH)
            monkeypatch.setattr("time.sleep", lambda _s: fcntl.flock(asking, fcntl.LOCK_UN))
            Journal(tmp_path).release()

    def test_a_journal_that_its_run_removes_meanwhile_is_not_taken_for_one_s_own(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        first = Journal(tmp_path)
        first.finish()
        real = fcntl.flock

        def removed_before_the_lock(file: object, operation: int) -> None:
            first.release()
            real(file, operation)  # type: ignore[arg-type]

        monkeypatch.setattr(fcntl, "flock", removed_before_the_lock)
        second = Journal(tmp_path)
        assert second.path.exists()
        monkeypatch.undo()
        with pytest.raises(ConfigError, match="in use"):
            Journal(tmp_path)
        second.release()

    def test_the_journal_goes_when_the_folder_is_given_back(self, begin: Begin) -> None:
        recorder = begin()
        recorder.finish(PASSED)
        recorder.release()
        assert [path.name for path in recorder.folder.iterdir()] == [RUN_FILE]

    def test_a_run_that_begins_removes_the_record_of_the_last(self, tmp_path: Path, begin: Begin) -> None:
        for name in (*RECORD_FILES, f"{RUN_FILE}.4711.unfinished", "mine.txt"):
            (tmp_path / name).write_text("of an earlier run")
        begin()
        assert sorted(path.name for path in tmp_path.iterdir()) == [JOURNAL_FILE, "mine.txt"]

    def test_a_run_that_never_begins_leaves_the_record_of_the_last(self, begin: Begin) -> None:
        recorder = begin()
        recorder.finish(PASSED)
        recorder.release()
        before = (recorder.folder / RUN_FILE).read_bytes()
        Journal(recorder.folder).release()
        assert [path.name for path in recorder.folder.iterdir()] == [RUN_FILE]
        assert (recorder.folder / RUN_FILE).read_bytes() == before

    def test_a_journal_that_was_cut_short_stays_when_the_next_run_never_begins(self, cut_short: Path) -> None:
        before = cut_short.read_bytes()
        Journal(cut_short.parent).release()
        assert cut_short.read_bytes() == before

    def test_the_record_of_the_last_never_passes_for_the_one_of_a_run_that_has_the_folder(self, begin: Begin) -> None:
        folder = finished(begin())
        later = Recorder(Journal(folder), suite="full", poses="level")
        run = read_record(folder).run
        assert (run.verdict.outcome, run.suite, run.tests) == ("still running", "full", ())
        assert read_record(folder / RUN_FILE).run.verdict == PASSED, "by its own name it can be read"
        later.release()
        assert read_record(folder).run.verdict == PASSED, "it did not take place"

    def test_an_announcement_follows_a_journal_that_was_cut_short(self, cut_short: Path) -> None:
        with cut_short.open("a") as file:
            file.write("half a li")
        before = read_record(cut_short.parent).run
        later = Recorder(Journal(cut_short.parent), suite="full", poses="level")
        assert read_record(cut_short.parent).run.suite == "full"
        later.release()
        assert read_record(cut_short.parent).run == before

    def test_a_run_whose_end_is_in_the_journal_alone_has_its_verdict_and_its_suites(
        self, begin: Begin, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        recorder = begin()
        recorder.findings.suites = {"test_heading.py": "ab"}
        monkeypatch.setattr("hiltest.run_record.recorder.write_run", _no_room)
        with pytest.raises(OSError, match="full"):
            recorder.finish(PASSED)
        recorder.release()
        assert [path.name for path in recorder.folder.iterdir()] == [JOURNAL_FILE]
        run = read_record(recorder.folder).run
        assert (run.verdict, run.suites) == (PASSED, {"test_heading.py": "ab"})

    def test_a_folder_without_any_record_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match=r"no record of a run: neither run\.json nor a line in journal\.jsonl"):
            read_record(tmp_path)
        with pytest.raises(ConfigError, match="No such file"):
            read_record(tmp_path / "gone")

    def test_a_folder_that_cannot_be_written_to_is_a_usage_error(self, tmp_path: Path) -> None:
        (tmp_path / JOURNAL_FILE).mkdir()
        with pytest.raises(
            ConfigError, match=f"cannot write a record to {tmp_path}: Is a directory; name another folder"
        ):
            Journal(tmp_path)


def test_a_full_disk_leaves_no_part_of_a_line(cut_short: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = cut_short.read_bytes()
    journal = Journal(cut_short.parent)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 10, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            journal.append("test", {"reason": "longer than ten bytes"})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert cut_short.read_bytes() == before
    journal.release()


def test_a_name_that_is_no_utf8_is_kept_as_far_as_it_is(begin: Begin) -> None:
    recorder = begin()
    recorder.finish_test(TestResult("test_\udcff.py::test_b", TestOutcome.FAILED, 1.0, "\udcff: no"))
    assert [test.id for test in read_record(recorder.folder).run.tests] == ["a", "test_?.py::test_b"]
    recorder.finish(PASSED)
    assert [test.id for test in read_record(recorder.folder / RUN_FILE).run.tests] == ["a", "test_?.py::test_b"]
