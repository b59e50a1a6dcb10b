"""A run on GitHub Actions: its report is in the job's summary once, and what keeps it out changes no verdict."""

from __future__ import annotations

from pathlib import Path

import pytest

SUITE = """
    from hiltest.measurement import Limit

    def test_field(measure):
        measure("field.strength", {value}, "uT", limit=Limit(max=50))

    def test_other(measure):
        measure("field.dip", 60, "deg")
"""


@pytest.fixture
def summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "summary.md"
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(path))
    return path


@pytest.mark.parametrize("options", [[], ["-n", "2", "--dist", "loadgroup"]])
def test_the_report_is_in_the_summary_once(pytester: pytest.Pytester, summary: Path, options: list[str]) -> None:
    pytester.makepyfile(SUITE.format(value=48))
    result = pytester.runpytest_inprocess(*options)
    assert result.ret == 0
    page = summary.read_text()
    assert page == (pytester.path / "hil-out" / "report.md").read_text()
    assert page.startswith("# PASS\n")
    assert "field.strength | 48 | uT" in page
    result.stdout.no_fnmatch_line("*job summary*")


@pytest.mark.parametrize(("value", "code"), [(48, 0), (51, 1)])
def test_a_summary_that_cannot_be_written_is_said_and_the_verdict_stays(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, value: int, code: int
) -> None:
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", "/dev/full")
    pytester.makepyfile(SUITE.format(value=value))
    result = pytester.runpytest_inprocess()
    assert result.ret == code
    result.stdout.fnmatch_lines(["no job summary: cannot write /dev/full: No space left on device"])


def test_a_red_run_annotates_its_check(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    pytester.makepyfile(SUITE.format(value=51))
    result = pytester.runpytest_inprocess()
    (line,) = [line for line in result.outlines if "::error" in line]
    assert line.startswith("::error title=hiltest%3A fail::")
    assert "field.strength 51 uT (limit 50)" in line
    pytester.makepyfile(SUITE.format(value=48))
    assert "::" not in pytester.runpytest_inprocess("-q").stdout.str().replace("/", "").replace(".py::", "")
