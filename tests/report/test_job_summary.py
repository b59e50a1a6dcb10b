"""The summary of a GitHub Actions job: appended, never too long, and never in the way of the verdict."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hiltest.report.job_summary import (
    MOST_BYTES,
    VARIABLE,
    annotation,
    append_to_job_summary,
    remove_job_summary,
)
from hiltest.run_record.run import Verdict

WHOLE = Path("hil-out/report.md")


def test_a_page_is_appended_behind_what_is_there(tmp_path: Path) -> None:
    summary = tmp_path / "summary.md"
    summary.write_text("of an earlier program")
    for _ in range(2):
        assert append_to_job_summary("# PASS\n", WHOLE, {VARIABLE: str(summary)}) == ""
    assert summary.read_text() == "of an earlier program\n# PASS\n\n# PASS\n"


@pytest.mark.parametrize("environment", [{}, {VARIABLE: ""}])
def test_without_the_variable_nothing_is_written(tmp_path: Path, environment: dict[str, str]) -> None:
    assert append_to_job_summary("# PASS\n", WHOLE, environment) == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("target", [0, 1, 500_000, MOST_BYTES - 400])
def test_with_what_is_there_it_stays_below_the_limit_and_says_that_it_was_cut(tmp_path: Path, target: int) -> None:
    summary = tmp_path / "summary.md"
    summary.write_bytes(b"x" * target)
    remark = append_to_job_summary("| ä | row |\n" * 200_000, WHOLE, {VARIABLE: str(summary)})
    content = summary.read_bytes()
    assert MOST_BYTES - 40 < len(content) <= MOST_BYTES < 1024 * 1024
    assert content.decode().rstrip().endswith("The complete report is in hil-out/report.md.**")
    assert remark == "the job summary was cut to 1000 KiB; hil-out/report.md is complete"


def test_a_summary_that_is_full_is_left_alone(tmp_path: Path) -> None:
    summary = tmp_path / "summary.md"
    summary.write_bytes(b"x" * MOST_BYTES)
    remark = append_to_job_summary("# PASS\n", WHOLE, {VARIABLE: str(summary)})
    assert remark == f"no job summary: {summary} has 1000 KiB already, and its limit is 1000 KiB"
    assert summary.stat().st_size == MOST_BYTES


def test_a_summary_that_cannot_be_written_is_said_and_nothing_more(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    reasons = {
        str(tmp_path): "Is a directory",
        str(tmp_path / "gone" / "summary.md"): "No such file or directory",
        "/dev/full": "No space left on device",
        str(fifo): "No such device or address",
        "a\0b": "embedded null byte",
    }
    for name, reason in reasons.items():
        remark = append_to_job_summary("# PASS\n", WHOLE, {VARIABLE: name})
        assert remark == f"no job summary: cannot write {name}: {reason}"


def test_a_name_that_is_no_text_goes_into_the_summary_all_the_same(tmp_path: Path) -> None:
    summary = tmp_path / "summary.md"
    assert append_to_job_summary("caf\udce9\n", WHOLE, {VARIABLE: str(summary)}) == ""
    assert summary.read_text() == "caf\\udce9\n"


def test_a_part_of_a_run_has_no_summary_of_its_own() -> None:
    assert remove_job_summary({VARIABLE: "s.md", "HOME": "/"}) == {"HOME": "/"}


def test_a_red_run_is_one_annotation_and_no_line_of_it_is_another_command() -> None:
    red = Verdict("regres:sion, worse", 21, "50 % more\r\n::warning::x", complete=True)
    assert annotation(red, {"GITHUB_ACTIONS": "true"}) == (
        "::error title=hiltest%3A regres%3Asion%2C worse::50 %25 more%0D%0A::warning::x\n"
    )


@pytest.mark.parametrize(("code", "actions"), [(0, "true"), (21, "false"), (21, "")])
def test_a_green_run_or_another_place_has_no_annotation(code: int, actions: str) -> None:
    assert annotation(Verdict("pass", code, "s", complete=True), {"GITHUB_ACTIONS": actions}) == ""
