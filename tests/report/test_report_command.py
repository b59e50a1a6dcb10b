"""``hiltest report``: what it renders, where it writes, what it keeps, and what it refuses."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hiltest.commands.cli import main
from hiltest.measurement import Measurement
from hiltest.run_record.files import RUN_FILE
from hiltest.run_record.journal import JOURNAL_FILE, Journal
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.reader import read_record
from hiltest.run_record.recorder import Recorder
from hiltest.run_record.run import Findings, TestResult, Verdict
from hiltest.run_record.run_json import content_to_json, write_run

PASSED = Verdict("pass", 0, "PASS.", complete=True)
OUTPUT = ["report.html", "report.md"]


@pytest.fixture
def folder(findings: Callable[..., Findings], good: list[Measurement], tmp_path: Path) -> Path:
    """Return a folder with the record of a run that has finished, and no report."""
    path = tmp_path / "out"
    path.mkdir()
    write_run(findings(*good).finish(PASSED, "2026-01-02T03:05:00Z"), path)
    return path


def report(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["report", *map(str, arguments)])
    code = ended.value.code
    assert isinstance(code, int)
    return code


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_reports_of_a_folder_are_those_that_the_run_wrote(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hiltest.report.markdown import markdown_report
    from hiltest.report.render import html_report

    assert report(folder) == 0
    run = read_record(folder).run
    assert names(folder) == sorted([*OUTPUT, RUN_FILE])
    assert (folder / "report.html").read_text(encoding="utf-8") == html_report(run)
    assert (folder / "report.md").read_text(encoding="utf-8") == markdown_report(run)
    assert capsys.readouterr().out == f"{folder}: report.html, report.md\nPASS.\n"


def test_a_file_of_any_name_is_rendered_beside_itself(folder: Path) -> None:
    (folder / RUN_FILE).rename(folder / "kept.json")
    assert report(folder / "kept.json") == 0
    assert names(folder) == sorted([*OUTPUT, "kept.json"])


def test_another_folder_gets_record_and_reports_and_loses_what_was_there(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    for name in ("junit.xml", "mine.txt"):
        (other / name).write_text("before")
    assert report(folder, "--out", other) == 0
    assert names(folder) == [RUN_FILE]
    assert names(other) == sorted([*OUTPUT, RUN_FILE, "mine.txt"])
    assert (other / RUN_FILE).read_bytes() == (folder / RUN_FILE).read_bytes()


def test_a_folder_that_another_run_has_is_left_alone(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    busy = tmp_path / "busy"
    busy.mkdir()
    journal = Journal(busy)
    assert report(folder, "--out", busy) == 4
    assert f"ERROR: the folder {busy} is in use" in capsys.readouterr().err
    assert names(busy) == [JOURNAL_FILE]
    journal.release()


class TestUnfinished:
    """A run that was cut short, or still goes on."""

    @pytest.fixture
    def recorder(self, good: list[Measurement], tmp_path: Path) -> Iterator[Recorder]:
        (tmp_path / "cut").mkdir()
        recorder = Recorder(Journal(tmp_path / "cut"), suite="gate", poses="all")
        recorder.begin()
        recorder.add(good, ())
        recorder.finish_test(TestResult("a", TestOutcome.PASSED, 0.5))
        yield recorder
        recorder.release()

    def test_everything_that_had_finished_is_in_the_reports(
        self, recorder: Recorder, good: list[Measurement], capsys: pytest.CaptureFixture[str]
    ) -> None:
        recorder.release()
        assert report(recorder.folder) == 0
        saved = f"1 test finished, {len(good)} measurements kept; the last test was a."
        assert capsys.readouterr().out.splitlines()[-1] == f"CUT SHORT: {saved}"
        assert names(recorder.folder) == sorted([*OUTPUT, JOURNAL_FILE])
        page = (recorder.folder / "report.html").read_text(encoding="utf-8")
        assert 0 < page.index("CUT SHORT</h1>") < page.index(saved)
        assert [measurement.name for measurement in good if measurement.name not in page] == []
        assert f"# CUT SHORT\n\n{saved}" in (recorder.folder / "report.md").read_text(encoding="utf-8")

    def test_one_that_goes_on_says_so(self, recorder: Recorder, capsys: pytest.CaptureFixture[str]) -> None:
        assert report(recorder.folder) == 0
        assert capsys.readouterr().out.splitlines()[-1].startswith("STILL RUNNING: 1 test finished")
        assert "STILL RUNNING" in (recorder.folder / "report.html").read_text(encoding="utf-8")

    def test_in_another_folder_it_is_a_record_like_others(self, recorder: Recorder, tmp_path: Path) -> None:
        recorder.release()
        assert report(recorder.folder, "--out", tmp_path / "copy") == 0
        stored = read_record(tmp_path / "copy")
        assert stored.file.path.name == RUN_FILE
        assert stored.run == read_record(recorder.folder).run
        assert (stored.run.verdict.outcome, stored.run.verdict.complete) == ("cut short", False)

    def test_a_run_that_finishes_while_it_is_rendered_has_the_last_word(
        self, recorder: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        from hiltest.report import render

        write = render.write_reports

        def finishes_meanwhile(run: Any, folder: Path) -> None:
            monkeypatch.undo()
            write(recorder.finish(PASSED), folder)
            recorder.release()
            write(run, folder)

        monkeypatch.setattr(render, "write_reports", finishes_meanwhile)
        assert report(recorder.folder) == 0
        assert capsys.readouterr().out.splitlines()[-1] == "PASS."
        assert "STILL RUNNING" not in (recorder.folder / "report.html").read_text(encoding="utf-8")


class TestNewerMinor:
    """A record with fields that this version does not know."""

    @pytest.fixture
    def newer(self, folder: Path) -> dict[str, Any]:
        content: dict[str, Any] = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
        content["moon"] = {"phase": "full", "list": [1, {"a": None}]}
        content["verdict"]["confidence"] = 0.9
        content["board"]["colour"] = "green"
        content["board"]["sensors"][0]["maker"] = "NXP"
        for kind in ("tests", "measurements", "tables"):
            content[kind][0]["moon"] = kind
        content["tables"][0]["columns"][0]["moon"] = "column"
        return content

    def test_it_is_rendered_and_all_of_it_is_written_again(
        self, folder: Path, newer: dict[str, Any], tmp_path: Path
    ) -> None:
        run = read_record(folder).run
        (folder / RUN_FILE).write_text(content_to_json(newer), encoding="utf-8")
        assert read_record(folder).run == run
        assert report(folder, "--out", tmp_path / "copy") == 0
        assert json.loads((tmp_path / "copy" / RUN_FILE).read_text(encoding="utf-8")) == newer

    def test_in_a_journal_as_well(self, tmp_path: Path) -> None:
        (tmp_path / "cut").mkdir()
        recorder = Recorder(Journal(tmp_path / "cut"), suite="gate", poses="all")
        recorder.begin()
        recorder.release()
        path = tmp_path / "cut" / JOURNAL_FILE
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        lines[0] |= {"moon": "full"}
        measurement = {"name": "m", "value": 1, "unit": "", "moon": "new"}
        lines += [
            {
                "kind": "test",
                "utc": "2026-01-02T03:05:00Z",
                "measurements": [measurement],
                "tables": [],
                "test": {"id": "t", "outcome": "passed", "duration_s": 1, "moon": "half"},
            }
        ]
        path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
        assert report(tmp_path / "cut", "--out", tmp_path / "copy") == 0
        content = json.loads((tmp_path / "copy" / RUN_FILE).read_text(encoding="utf-8"))
        assert (content["moon"], content["tests"][0]["moon"], content["measurements"][0]["moon"]) == (
            "full",
            "half",
            "new",
        )


def changed(content: Any, place: list[str | int], value: object) -> Any:
    other = copy.deepcopy(content)
    target = other
    for step in place[:-1]:
        target = target[step]
    target[place[-1]] = value
    return other


@pytest.mark.parametrize(
    ("place", "value", "complaint"),
    [
        (["measurements", 0, "value"], "12", "measurements.0.value"),
        (["measurements", 0, "value"], [1], "measurements.0.value"),
        (["measurements", 0, "outcome"], "fine", "measurements.0.outcome"),
        (["measurements", 0, "limit"], {"min": 2, "max": 1}, "limit min 2.0 is above its max 1.0"),
        (["measurements", 1, "name"], "board.wall_seconds", 'measurement "board.wall_seconds" appears twice'),
        (["verdict", "complete"], "no", "verdict.complete"),
        (["verdict", "exit_code"], 1.5, "verdict.exit_code"),
        (["tables", 0, "rows", 2], [1], "row 3: 1 cells in"),
        (["tables", 0, "rows"], {"0": 1}, "tables.0.rows"),
        (["tables", 0, "rows", 0, 0], {"a": 1}, "tables.0.rows.0.0"),
        (["board"], [], "board"),
        (["seed"], 10**18, "too large for a whole number"),
        (["seed"], True, "seed"),
    ],
)
def test_a_field_that_is_wrong_is_refused_by_its_place(
    folder: Path,
    tmp_path: Path,
    place: list[str | int],
    value: object,
    complaint: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    content = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps(changed(content, place, value)))
    assert report(path) == 4
    error = capsys.readouterr().err
    assert error.startswith(f"ERROR: {path}: ")
    assert complaint in error
    assert names(tmp_path) == ["out", "wrong.json"], "nothing was written"


def places(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield every place of a parsed JSON file, of long lists the first three."""
    if place:
        yield place
    inner = value.items() if isinstance(value, dict) else enumerate(value[:3]) if isinstance(value, list) else ()
    for step, content in inner:
        yield from places(content, (*place, step))


@given(data=st.data())
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_value_anywhere_makes_more_than_a_sentence(
    folder: Path, tmp_path: Path, data: st.DataObject, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
    place = data.draw(st.sampled_from(sorted(places(content), key=str)))
    value = data.draw(
        st.sampled_from(
            [
                None,
                True,
                0,
                -1,
                10**17,
                1e308,
                -1e-308,
                "",
                "<script>",
                "\ud800",
                "\u202e\0",
                [],
                {},
                [[]],
                [None],
                {"": []},
            ]
        )
    )
    path = tmp_path / "hostile.json"
    path.write_text(json.dumps(changed(content, list(place), value)))
    code = report(path)
    error = capsys.readouterr().err
    assert (code, error) == (0, "") or (code == 4 and error.startswith("ERROR: ") and error.count("\n") == 1)
