"""``hiltest judge``: files, tables, the page, limits and exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.command_files import checked

from hiltest.commands.cli import main
from hiltest.judge.judge_tables import JSON_FILE, PAGE_FILE

MIDDLE = """
import numpy as np


def calibrate(samples):
    low, high = samples.min(axis=0), samples.max(axis=0)
    return 0.5 * (low + high), np.diag(2.0 / (high - low))
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MIDDLE, encoding="utf-8")
    return tmp_path


def judge(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["judge", *words])
    return int(ended.value.code or 0)


def test_a_file_to_begin_with_is_written_and_judged_beside_the_calibrators_of_hiltest(
    folder: Path, capsys: pytest.CaptureFixture[str], require_tool: Callable[[str], str]
) -> None:
    require_tool("arm-none-eabi-gcc")
    require_tool("cc")
    assert judge("--init", "first.c") == 0
    assert (folder / "hiltest_judge.h").is_file()
    assert judge("--init", "first.c") == 4, "it is not overwritten"
    assert judge("first.c", "--limit", "cycles=4875", "--limit", "flash=1000") == 0
    result = json.loads((folder / "hil-out" / "judge" / JSON_FILE).read_text(encoding="utf-8"))
    first, *others = result["entries"]
    # As exact as every count of the virtual core.
    assert (first["name"], first["cost"]["cycles"]) == ("first.c", 4875)
    assert [entry["role"] for entry in others] == ["hiltest"] * len(others)
    medians = {entry["name"]: entry["families"][-1]["median"]["value"] for entry in result["entries"]}
    assert medians["first.c"] > 5.0 * medians["direct"]
    assert {entry["cost"]["cycles"] for entry in others if entry["name"] == "direct"} == {11_270}
    page = (folder / "hil-out" / "judge" / PAGE_FILE).read_text(encoding="utf-8")
    assert page.count("<svg") > 1
    assert "first.c" in page
    assert "first.c" in capsys.readouterr().out


def test_a_limit_that_does_not_hold_fails_and_one_that_was_not_measured_is_not_evaluated(folder: Path) -> None:
    assert judge("mine.py:calibrate", "--alone", "--limit", "bound.median=1.0") == 1
    assert judge("mine.py:calibrate", "--alone", "--limit", "cycles=1000") == 22
    assert judge("mine.py:calibrate", "--alone", "--limit", "cycle=1000") == 4
    assert judge("mine.py:calibrate", "--alone", "--limit", "cycles") == 4


@pytest.mark.parametrize(
    ("answer", "counts"),
    [("np.full(3, np.nan), np.eye(3)", "0 are refused and 600 no ellipsoid"), ("None", "600 are refused and 0 no")],
)
def test_a_calibrator_without_an_accepted_answer_fails(
    folder: Path, capsys: pytest.CaptureFixture[str], answer: str, counts: str
) -> None:
    text = f"import numpy as np\ndef calibrate(samples):\n    return {answer}\n"
    (folder / "none.py").write_text(text, encoding="utf-8")
    assert judge("none.py:calibrate", "--alone") == 1
    assert f"FAIL: of 600 answers {counts}" in capsys.readouterr().out
    assert judge("none.py:calibrate", "--alone", "--limit", "bound.p99=1.5") == 1, "before 22, not evaluated"


def test_a_worse_calibrator_than_the_other_is_a_regression(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    worse = MIDDLE.replace("0.5 * (low + high)", "0.5 * (low + high) + 4.0")
    (folder / "worse.py").write_text(worse, encoding="utf-8")
    assert judge("worse.py:calibrate", "--alone", "--against", "mine.py:calibrate", "--json") == 21
    document = checked(capsys.readouterr().out, "hiltest.judge/1")
    assert document["comparison"]["error"]["low"] > 1.0
    assert document["comparison"]["cycles"] is None
    assert [entry["role"] for entry in document["entries"]] == ["judged", "against"]
    assert judge("mine.py:calibrate", "--alone", "--against", "mine.py:calibrate") == 0
