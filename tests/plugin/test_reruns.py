"""pytest-rerunfailures: every attempt is kept, and none makes a pass of what another measured out of its limit."""

from __future__ import annotations

import json
from typing import Any

import pytest

pytest.importorskip("pytest_rerunfailures")

HEAD = """
import pytest
from hiltest.errors import LinkLostError
from hiltest.measurement import Limit

attempts = []
"""


def run(pytester: pytest.Pytester, suite: str) -> tuple[int, dict[str, Any]]:
    """Return exit code and record of a suite whose failed tests are tried twice more."""
    pytester.makepyfile(HEAD + suite)
    result = pytester.runpytest_inprocess("--reruns=2")
    record = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return int(result.ret), record


def outcomes(record: dict[str, Any]) -> list[str]:
    return [test["outcome"] for test in record["tests"]]


def values(record: dict[str, Any]) -> dict[str, tuple[float, str, str]]:
    return {
        measurement["name"]: (measurement["value"], measurement["outcome"], measurement["note"])
        for measurement in record["measurements"]
    }


def test_what_was_out_of_its_limit_once_stays_so(pytester: pytest.Pytester) -> None:
    code, record = run(
        pytester,
        """
def test_it(measure):
    attempts.append(1)
    measure("lamp.current", [2.0, 5.0, 1.0][len(attempts) - 1], "mA", limit=Limit(max=3))
    measure("lamp.voltage", 12.0, "V")
    assert len(attempts) > 2
""",
    )
    assert code == 1
    assert outcomes(record) == ["rerun", "rerun", "passed"]
    assert [test["reason"] for test in record["tests"]] == ["assert 1 > 2", "assert 2 > 2", ""]
    assert values(record) == {
        "lamp.current": (5.0, "fail", "worst of 3 attempts, 1 to 5"),
        "lamp.voltage": (12.0, "information", ""),
    }
    assert [attempt["value"] for attempt in record["other_attempts"]] == [2.0, 1.0]
    assert record["verdict"]["sentence"].startswith("FAIL. lamp.current 5 mA (limit 3). Next: ")


def test_what_a_fixture_measured_at_its_end_stays_too(pytester: pytest.Pytester) -> None:
    code, record = run(
        pytester,
        """
@pytest.fixture
def lamp(measure):
    yield
    measure("lamp.life", [2.0, 20.0][len(attempts) > 1], "h", limit=Limit(min=10))

def test_it(lamp):
    attempts.append(1)
    assert len(attempts) > 1
""",
    )
    assert code == 1
    assert values(record)["lamp.life"] == (2.0, "fail", "worst of 2 attempts, 2 to 20")


def test_a_test_that_passes_at_last_within_its_limits_passes(pytester: pytest.Pytester) -> None:
    code, record = run(
        pytester,
        """
def test_it(measure):
    attempts.append(1)
    assert len(attempts) > 1
    measure("lamp.current", 2.0, "mA", limit=Limit(max=3))
""",
    )
    assert (code, outcomes(record)) == (0, ["rerun", "passed"])
    assert values(record) == {"lamp.current": (2.0, "pass", "")}
    assert record["other_attempts"] == []


def test_a_lost_bench_is_not_made_good_by_a_skip(pytester: pytest.Pytester) -> None:
    code, record = run(
        pytester,
        """
@pytest.mark.hil
def test_lost():
    raise LinkLostError("/dev/ttyACM0", "unplugged")

@pytest.mark.hil
def test_after():
    pass
""",
    )
    assert code == 20
    assert outcomes(record) == ["rerun", "rerun", "connection lost", "skipped"]
