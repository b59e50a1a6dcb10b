"""``--hil-coverage``: the file of LCOV that a run leaves, and what says how much it is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hiltest.virtual.coverage.lcov import Coverage, from_lcov

BOARD = """
def test_slots(board, measure):
    measure("board.slots", board.identity.slots, "")
"""


def read(path: Path) -> Coverage:
    return from_lcov(path.read_text(encoding="utf-8"), str(path))


@pytest.mark.parametrize("options", [[], ["-n1"]], ids=["alone", "in a worker"])
def test_a_run_writes_its_coverage_and_says_how_much_it_is(pytester: pytest.Pytester, options: list[str]) -> None:
    if options:
        pytest.importorskip("xdist")
    pytester.makepyfile(BOARD)
    target = pytester.path / "target.info"
    (pytester.path / "lcov.info").symlink_to(target)
    result = pytester.runpytest_inprocess("--hil-coverage=lcov.info", *options)
    assert result.ret == 0
    found = read(target)
    assert (pytester.path / "lcov.info").is_symlink()
    assert found.files["firmware_stub/app/main.c"].functions["main"][1] == 1
    assert 0 < found.lines.hit < found.lines.total
    record = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    assert record["coverage"] == {
        "file": "../lcov.info",
        "lines": list(found.lines),
        "functions": list(found.functions),
        "branches": list(found.branches),
    }
    result.stdout.fnmatch_lines(
        [f"Coverage: {found.lines.hit} of {found.lines.total} lines (* branches both ways (*): lcov.info"]
    )
    assert 'href="./../lcov.info"' in (pytester.path / "hil-out" / "report.html").read_text(encoding="utf-8")
    assert "lcov.info" in (pytester.path / "hil-out" / "report.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--hil-coverage=lcov.info", "--hil-port=socket://127.0.0.1:9"], "*does not report executed instructions*"),
        (["--hil-coverage=no/lcov.info"], "*cannot write *lcov.info: there is no folder *"),
        (["--hil-coverage=."], "*cannot write *: it is a folder*"),
    ],
    ids=["a real board", "no folder", "a folder"],
)
def test_what_cannot_be_covered_or_written_is_refused_before_the_run(
    pytester: pytest.Pytester, options: list[str], complaint: str
) -> None:
    pytester.makepyfile(BOARD)
    result = pytester.runpytest_inprocess(*options)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([complaint])
    assert not (pytester.path / "hil-out" / "run.json").exists()
