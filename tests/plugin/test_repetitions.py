"""pytest-repeat: the measurements of every repetition are recorded, and the worst one is judged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pytest_repeat")

SUITE = """
import pytest
from hiltest.measurement import Limit

currents = iter({currents})

@pytest.mark.parametrize("lamp", ["red"])
def test_lamp(measure, lamp):
    measure("lamp.current", next(currents), "mA", limit=Limit(max=3))
    measure("lamp.voltage", 12.0, "V")
"""


def run(pytester: pytest.Pytester, currents: list[float], *options: str) -> tuple[int, dict[str, Any]]:
    """Return exit code and record of a suite whose test measures these currents, one in each repetition."""
    pytester.makepyfile(SUITE.format(currents=currents))
    result = pytester.runpytest_inprocess(f"--count={len(currents)}", *options)
    record = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return int(result.ret), record


def test_every_repetition_is_recorded_and_the_worst_is_judged(pytester: pytest.Pytester) -> None:
    code, record = run(pytester, [2.0, 5.0, 4.0])
    assert code == 1
    assert [test["outcome"] for test in record["tests"]] == ["passed", "failed", "failed"]
    worst = {measurement["name"]: measurement for measurement in record["measurements"]}
    assert (worst["lamp.current"]["value"], worst["lamp.current"]["outcome"]) == (5.0, "fail")
    others = [(measurement["name"], measurement["value"]) for measurement in record["other_attempts"]]
    assert others == [("lamp.current", 2.0), ("lamp.voltage", 12.0), ("lamp.current", 4.0), ("lamp.voltage", 12.0)]
    assert record["verdict"]["sentence"].startswith("FAIL. lamp.current 5 mA (limit 3). Next: ")


def test_the_page_shows_the_spread_beside_the_value(pytester: pytest.Pytester) -> None:
    _, record = run(pytester, [2.0, 2.5, 1.5])
    notes = {measurement["name"]: measurement["note"] for measurement in record["measurements"]}
    assert notes == {"lamp.current": "worst of 3 attempts, 1.5 to 2.5", "lamp.voltage": "worst of 3 attempts, 12 to 12"}
    assert notes["lamp.current"] in (pytester.path / "hil-out" / "report.html").read_text(encoding="utf-8")


def test_repetitions_are_compared_with_a_run_without_them(pytester: pytest.Pytester) -> None:
    run(pytester, [2.0])
    base = Path(pytester.path / "hil-out" / "run.json").rename(pytester.path / "base.json")
    code, record = run(pytester, [2.0, 2.5], f"--hil-baseline={base}")
    assert code == 21
    assert record["comparison"]["obstacles"] == []
    assert {row["name"]: row["change"] for row in record["comparison"]["differences"]} == {
        "lamp.current": "worse",
        "lamp.voltage": "unchanged",
    }


def test_another_test_cannot_measure_the_same_name(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(SUITE.format(currents=[1.0] * 4).replace('["red"]', '["red", "green"]'))
    pytester.runpytest_inprocess("--count=2").assert_outcomes(passed=2, failed=2)
