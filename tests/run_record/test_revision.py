"""What a run was made for: said by its user or its job, kept in the record, and shown."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from hiltest.measurement import Measurement
from hiltest.report.comparison_overview import sides
from hiltest.report.markdown import markdown_report
from hiltest.report.render import html_report
from hiltest.run_record.comparison import Revision
from hiltest.run_record.journal import Journal
from hiltest.run_record.reader import read_record
from hiltest.run_record.recorder import Recorder
from hiltest.run_record.revision import revision_of
from hiltest.run_record.run import Findings, Run, Verdict
from hiltest.run_record.run_json import to_json
from hiltest.session.older_firmware import older_options
from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import evidence_of, evidence_of_seeds
from hiltest.verdict.wording import revision

from ..finished_run import without_volatile

SHA = "0123456789abcdef0123456789abcdef01234567"
JOB = {"GITHUB_SHA": SHA, "GITHUB_REF_NAME": "12/merge"}
WHOLE = Revision(SHA, "main", "v1.2")


@pytest.mark.parametrize(
    ("label", "environment", "result"),
    [
        (None, {}, None),
        ("v1.2", {}, Revision(label="v1.2")),
        (None, JOB, Revision(SHA, "12/merge")),
        ("v1.2", JOB, Revision(SHA, "12/merge", "v1.2")),
        ("", JOB, None),
        (None, {"GITHUB_SHA": "$(reboot)", "GITHUB_REF_NAME": "a\x1b[2Jb"}, None),
        (None, {"GITHUB_SHA": SHA, "GITHUB_REF_NAME": "b" * 201}, Revision(SHA)),
    ],
)
def test_the_label_is_the_user_s_and_the_commit_the_job_s(
    label: str | None, environment: dict[str, str], result: Revision | None
) -> None:
    assert revision_of(label, environment) == result


@pytest.fixture
def run(findings: Callable[..., Findings], good: list[Measurement]) -> Run:
    return replace(findings(*good), revision=WHOLE).finish(
        Verdict("pass", 0, "PASS.", complete=True), "2026-01-02T03:05:00Z"
    )


def test_it_is_in_the_record_and_may_differ_between_two_runs_of_one_seed(run: Run, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(to_json(run), encoding="utf-8")
    assert read_record(tmp_path).run == run
    assert "/revision" in run.volatile
    other = replace(run, revision=Revision(label="another"))
    contents = [without_volatile(json.loads(to_json(item))) for item in (run, other)]
    assert contents[0] == contents[1]


def test_a_record_from_before_it_was_kept_is_read(run: Run, tmp_path: Path) -> None:
    content = json.loads(to_json(run))
    del content["revision"]
    (tmp_path / "run.json").write_text(json.dumps(content), encoding="utf-8")
    assert read_record(tmp_path).run.revision is None


def test_a_run_that_is_cut_short_has_it(tmp_path: Path) -> None:
    recorder = Recorder(Journal(tmp_path), suite="gate", poses="all", revision=WHOLE)
    recorder.begin()
    assert read_record(tmp_path).run.revision == WHOLE
    recorder.release()


def test_the_reports_show_it(run: Run) -> None:
    page, text = html_report(run), markdown_report(run)
    for report in (page, text):
        assert "v1.2, commit 0123456789ab, branch main" in report
        assert SHA in report, "all of it, where the numbers come from"
    hostile = html_report(replace(run, revision=Revision(label="<script>x")))
    assert "<script>x" not in hostile
    assert "&lt;script&gt;x" in hostile


def test_a_comparison_shows_both_and_nothing_where_nobody_said(run: Run) -> None:
    base = evidence_of(replace(run, revision=Revision(label="v1.1")))
    rows = {name: (was, now) for name, was, now in sides(compare(base, evidence_of(run)))}
    assert rows["made for"] == ("v1.1", "v1.2, commit 0123456789ab, branch main")
    unsaid = evidence_of(replace(run, revision=None))
    assert "made for" not in {name for name, _, _ in sides(compare(unsaid, unsaid))}
    assert revision(None) == ""


def test_seeds_of_several_are_of_none(run: Run) -> None:
    other = replace(run, seed=2, revision=Revision(label="v1.1"))
    alike = replace(run, seed=3)
    assert evidence_of_seeds([evidence_of(run), evidence_of(alike)], "out").side.revision == WHOLE
    assert evidence_of_seeds([evidence_of(run), evidence_of(other)], "out").side.revision is None


def test_the_plugin_keeps_it_and_an_older_firmware_has_none(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in JOB.items():
        monkeypatch.setenv(name, value)
    pytester.makepyfile("def test_it(measure):\n    measure('a', 1.0, 'mA')\n")

    def kept(*options: str) -> object:
        assert pytester.runpytest_inprocess(*options).ret == 0
        return json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))["revision"]

    assert kept("--hil-label=v1.2") == asdict(Revision(SHA, "12/merge", "v1.2"))
    assert kept() == asdict(Revision(SHA, "12/merge"))
    (label,) = [option for option in older_options(["--hil-label=v1.2"], "old.elf")[1:] if "label" in option]
    assert kept("--hil-label=v1.2", label) is None


@pytest.mark.parametrize("label", ["a\nb", "\x1b[2J", "x" * 101])
def test_what_is_no_label_is_a_usage_error(pytester: pytest.Pytester, label: str) -> None:
    result = pytester.runpytest_inprocess(f"--hil-label={label}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*is not a label: use one line of at most 100 characters*"])
