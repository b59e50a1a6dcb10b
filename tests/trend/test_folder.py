"""What a folder holds: runs, campaigns and baselines however deep; all else is named and left alone."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.measurement import Limit, check
from hiltest.report.trend.folder import read_folder
from hiltest.report.trend.outputs import trend_page
from hiltest.report.trend.series import trend_of
from hiltest.report.trend.words import between
from hiltest.run_record.journal import JOURNAL_FILE, Journal
from hiltest.run_record.recorder import Recorder
from hiltest.verdict.baseline import accept, baseline_of
from hiltest.verdict.baseline_file import to_json
from hiltest.verdict.evidence_reader import read_evidence

from .entries import cycles
from .runs import finished_run

WriteRun = Callable[..., Path]


def read(folder: Path) -> tuple[list[str], dict[str, str]]:
    entries, skipped = read_folder(folder)
    return sorted(entry.file for entry in entries), {test.file: test.reason for test in skipped}


def test_runs_are_found_however_deep_and_whatever_they_are_called(tmp_path: Path, write: WriteRun) -> None:
    write(".", 1, cycles(1))
    write("a/b/c", 2, cycles(1))
    (tmp_path / "kept").mkdir()
    write("d", 3, cycles(1)).rename(tmp_path / "kept" / "2026-01-03.json")
    assert read(tmp_path) == (["a/b/c/run.json", "kept/2026-01-03.json", "run.json"], {})


def test_the_time_of_a_run_is_when_it_began(tmp_path: Path, write: WriteRun) -> None:
    write("a", 1, cycles(1), hour=7)
    assert read_folder(tmp_path)[0][0].when_utc == "2026-01-01T07:00:00Z"


def test_a_baseline_is_an_entry_of_the_time_it_was_saved(tmp_path: Path, write: WriteRun) -> None:
    run = write("a", 1, cycles(11_061))
    (tmp_path / "base.json").write_text(to_json(baseline_of(read_evidence(run), "2026-01-05T00:00:00Z")))
    entries, skipped = read_folder(tmp_path)
    assert skipped == []
    assert [(entry.file, entry.when_utc) for entry in entries] == [
        ("base.json", "2026-01-05T00:00:00Z"),
        ("a/run.json", "2026-01-01T00:00:00Z"),
    ]
    assert entries[0].evidence.measurements[1]["cycles.direct.total"].value == 11_061


def test_what_a_baseline_has_accepted_is_of_the_build_that_it_is_of(tmp_path: Path, write: WriteRun) -> None:
    heading = check("heading.direct.max", 0.9, unit="deg")
    saved = baseline_of(read_evidence(write("a", 1, cycles(11_061), heading, build="a")), "2026-01-01T01:00:00Z")
    newer = read_evidence(write("b", 2, cycles(11_161), check("heading.direct.max", 1.4, unit="deg"), build="b"))
    mixed = accept(saved, newer, ["cycles.*"], because="x", when_utc="2026-01-02T01:00:00Z")
    (tmp_path / "base.json").write_text(to_json(mixed))
    write("c", 3, cycles(11_261), heading, build="c")
    trend = trend_of(read_folder(tmp_path)[0])
    assert [entry.file for entry in trend.entries] == ["a/run.json", "b/run.json", "base.json", "c/run.json"]
    at_the_baseline, after_it = (
        {
            point.difference.name: between(trend, point)
            for point in trend.change_points
            if number in (point.before, point.after)
        }
        for number in (2, 3)
    )
    assert at_the_baseline == {"heading.direct.max": "build b -> a", "cycles.direct.total": "build b -> c"}
    assert after_it == {"cycles.direct.total": "build b -> c"}
    page = trend_page(trend, [])
    assert "build a, with 1 measurement accepted from build b" in page


def test_the_seeds_of_a_campaign_are_one_entry(tmp_path: Path, write: WriteRun) -> None:
    for seed in (1, 2, 3):
        write(f"night/seed-{seed:04d}", 4, cycles(100 + seed), seed=seed, hour=4 - seed)
    (tmp_path / "night" / "seeds.json").write_text('{"schema": "hiltest.seeds/1"}')
    (campaign,), skipped = read_folder(tmp_path)
    assert skipped == []
    assert (campaign.file, campaign.when_utc) == ("night", "2026-01-04T01:00:00Z")
    assert set(campaign.evidence.measurements) == {1, 2, 3}


@pytest.mark.parametrize("other", [{"build": "another"}, {"seed": 1}])
def test_seeds_that_are_no_campaign_are_entries_each(tmp_path: Path, write: WriteRun, other: dict[str, object]) -> None:
    write("night/seed-0001", 4, cycles(1), seed=1)
    write("night/seed-0002", 4, cycles(1), **({"seed": 2} | other))
    assert read(tmp_path)[0] == ["night/seed-0001/run.json", "night/seed-0002/run.json"]


def test_foreign_and_corrupt_files_are_named_with_the_reason_and_the_rest_is_read(
    tmp_path: Path, write: WriteRun
) -> None:
    write("good", 1, cycles(1))
    write("cut", 2, cycles(1))
    whole = (tmp_path / "cut" / "run.json").read_text()
    (tmp_path / "cut" / "run.json").rename(tmp_path / "half.json").write_text(whole[: len(whole) // 2])
    (tmp_path / "newer.json").write_text(json.dumps({"schema": "hiltest.run/2"}))
    (tmp_path / "package.json").write_text("{}")
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    (tmp_path / "when.json").write_text(whole.replace('"2026-01-02T00:00:00Z"', '"<b>yesterday"'))
    (tmp_path / "huge.json").write_text(whole.replace('"value": 1,', '"value": 1e308,'))
    (tmp_path / "binary.json").write_bytes(b"\xff\x00")
    os.mkfifo(tmp_path / "pipe.json")
    (tmp_path / "gone.json").symlink_to("nowhere")
    entries, skipped = read(tmp_path)
    assert entries == ["good/run.json"]
    begins = {
        "half.json": "not JSON: ",
        "newer.json": 'schema is "hiltest.run/2", this hiltest reads "hiltest.run/1"',
        "package.json": "not a record of hiltest: schema is null",
        "list.json": "not a record of hiltest",
        "deep.json": "nested more than ",
        "when.json": 'began at "<b>yesterday", which is not a time',
        "huge.json": '"cycles.direct.total" is 1e+308, which nothing measures',
        "binary.json": "not JSON: ",
        "pipe.json": "not a regular file",
        "gone.json": "No such file",
    }
    assert skipped.keys() == begins.keys()
    for file, reason in begins.items():
        assert skipped[file].startswith(reason), (file, skipped[file])


@pytest.mark.parametrize("older", ["against", "against/seed-0001"])
def test_the_older_firmware_of_a_run_is_no_run_of_its_own(tmp_path: Path, write: WriteRun, older: str) -> None:
    write(f"out/{older}", 1, cycles(11_061), build="older")
    write(f"out/{older}".replace("against", "."), 2, cycles(11_161), build="newer")
    entries, skipped = read_folder(tmp_path)
    assert ([entry.evidence.side.build_id for entry in entries], skipped) == (["newer"], [])
    # A folder that only has the name is one like others.
    (tmp_path / "out" / "against").rename(tmp_path / "against")
    assert [item.evidence.side.build_id for item in read_folder(tmp_path)[0]] == ["older", "newer"]


def test_a_baseline_from_before_limits_were_kept_takes_none_away(tmp_path: Path, write: WriteRun) -> None:
    run = write("a", 1, cycles(11_061))
    text = to_json(baseline_of(read_evidence(run), "2026-01-05T00:00:00Z"))
    limit = ', "limit": {"min": null, "max": 12500.0}'
    assert limit in text
    (tmp_path / "base.json").write_text(text.replace("hiltest.baseline/2", "hiltest.baseline/1").replace(limit, ""))
    (measured,) = trend_of(read_folder(tmp_path)[0]).measured
    assert str(measured.limit) == "at most 12 500"
    assert [str(point.limit) for point in measured.series[0].points] == ["at most 12 500"] * 2
    # One that keeps limits knows them: what has none there has none.
    unlimited = write("b", 6, cycles(11_061, limit=None), check("x", 1.0, unit="deg", limit=Limit(max=2)))
    (tmp_path / "later.json").write_text(to_json(baseline_of(read_evidence(unlimited), "2026-01-07T00:00:00Z")))
    assert trend_of(read_folder(tmp_path)[0]).measured[0].limit is None


def test_other_files_of_hiltest_and_hidden_folders_are_no_news(tmp_path: Path, write: WriteRun) -> None:
    write("a", 1, cycles(1))
    write(".git", 2, cycles(1))
    (tmp_path / "fit.json").write_text('{"schema": "hiltest.fit/1"}')
    (tmp_path / "a" / "report.html").write_text("<p>")
    assert read(tmp_path) == (["a/run.json"], {})


def test_a_run_without_a_board_has_no_trend(tmp_path: Path, write: WriteRun) -> None:
    path = write("a", 1, cycles(1))
    content = json.loads(path.read_text()) | {"board": None}
    path.write_text(json.dumps(content))
    assert read(tmp_path) == ([], {"a/run.json": "no board answered (pass)"})


def test_a_run_that_was_cut_short_is_shown_as_far_as_it_came_and_said_to_be(tmp_path: Path) -> None:
    whole = finished_run(3, cycles(11_061))
    assert whole.board is not None
    running = Journal(tmp_path)
    recorder = Recorder(running, suite="gate", poses="all")
    recorder.begin()
    recorder.board(whole.board, 1)
    recorder.add(whole.measurements, ())
    recorder.finish_test(whole.tests[0])
    # What the disk holds when the process is killed now; a copy has no lock on it.
    (tmp_path / "killed").mkdir()
    shutil.copy(tmp_path / JOURNAL_FILE, tmp_path / "killed")
    entries, skipped = read_folder(tmp_path / "killed")
    running.release()
    assert skipped == []
    (entry,) = entries
    assert entry.file == JOURNAL_FILE
    assert entry.evidence.measurements[1]["cycles.direct.total"].value == 11_061
    assert "the run is incomplete" in entry.evidence.faults[0]
    assert "the run is incomplete" in trend_page(trend_of(entries), [])


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder"):
        read_folder(tmp_path / "gone")
