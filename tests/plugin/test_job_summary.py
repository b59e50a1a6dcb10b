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
