"""The gate set and the full set: which tests run, which limits they must meet, and what is said of the others."""

from __future__ import annotations

import json
from typing import Any

import pytest

SUITE = """
import pytest

@pytest.mark.hil
def test_current(measure):
    measure("lamp.current", 1.0, "mA")

@pytest.mark.hil
@pytest.mark.full
def test_life(measure):
    measure("lamp.life", 30.0, "h")
"""
LIFE = '"lamp.life" = { min = 10.0, unit = "h", suite = "full" }\n'


@pytest.fixture
def bench(pytester: pytest.Pytester, default_rig: str, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A rig that limits a lamp's current, and in the full set its life."""
    rig = default_rig[: default_rig.index("[limits]")]
    rig += f'[limits]\n"lamp.current" = {{ max = 3.0, unit = "mA" }}\n{LIFE}'
    (pytester.path / "lamp.toml").write_text(rig, encoding="utf-8")
    monkeypatch.setenv("HIL_RIG", "lamp.toml")
    pytester.makepyfile(test_lamp=SUITE)
    return pytester


def record_of(pytester: pytest.Pytester) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return content


def outcomes_of(pytester: pytest.Pytester) -> dict[str, str]:
    return {
        measurement["name"]: measurement["outcome"]
        for measurement in record_of(pytester)["measurements"]
        if "lamp" in measurement["name"]
    }


def replace_in(pytester: pytest.Pytester, file: str, old: str, new: str) -> None:
    path = pytester.path / file
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_the_gate_set_is_the_default_and_is_green_without_what_it_leaves_out(bench: pytest.Pytester) -> None:
    result = bench.runpytest_inprocess()
    result.assert_outcomes(passed=1, deselected=1)
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        [
            "gate set: 1 test of the full set left out; --hil-suite full runs them",
            "PASS.",
        ]
    )
    record = record_of(bench)
    assert (record["suite"], record["tests_left_out"], record["verdict"]["complete"]) == ("gate", 1, True)
    assert outcomes_of(bench) == {"lamp.current": "pass"}


def test_the_full_set_runs_all_and_judges_all(bench: pytest.Pytester) -> None:
    result = bench.runpytest_inprocess("--hil-suite=full")
    result.assert_outcomes(passed=2)
    assert (record_of(bench)["suite"], record_of(bench)["tests_left_out"]) == ("full", 0)
    assert outcomes_of(bench) == {"lamp.current": "pass", "lamp.life": "pass"}
    result.stdout.no_fnmatch_line("*left out*")


def test_a_verdict_of_the_gate_set_says_how_many_tests_of_the_full_set_it_lacks(bench: pytest.Pytester) -> None:
    assert bench.runpytest_inprocess("--hil-out=base").ret == 0
    against = "(against base/run.json): PASS: "
    gate_set = f"May be merged as far as the gate set shows, without 1 test of the full set {against}"
    for options, answer in (
        ([], gate_set),
        (["-k", "current"], gate_set),
        (["-n2"], gate_set),
        (["--hil-suite=full"], f"May be merged {against}"),
    ):
        assert bench.runpytest_inprocess("--hil-baseline=base", "--hil-out=new", *options).ret == 0
        record = json.loads((bench.path / "new" / "run.json").read_text(encoding="utf-8"))
        assert record["verdict"]["sentence"].startswith(answer)


def test_a_limit_of_the_full_set_that_it_does_not_measure_ends_with_22(bench: pytest.Pytester) -> None:
    replace_in(bench, "test_lamp.py", "lamp.life", "lamp.live")
    assert bench.runpytest_inprocess().ret == 0
    result = bench.runpytest_inprocess("--hil-suite=full")
    assert result.ret == 22
    result.stdout.fnmatch_lines(["NOT EVALUATED. lamp.life (nothing measured it)."])


def test_a_limit_that_is_not_said_to_be_of_the_full_set_must_be_met_by_the_gate_set(bench: pytest.Pytester) -> None:
    replace_in(bench, "lamp.toml", ', suite = "full"', "")
    result = bench.runpytest_inprocess()
    assert result.ret == 22
    result.stdout.fnmatch_lines(["NOT EVALUATED. lamp.life (nothing in the gate set measured it)."])


def test_a_limit_of_the_full_set_holds_for_whoever_measures_it(bench: pytest.Pytester) -> None:
    replace_in(bench, "test_lamp.py", "@pytest.mark.full\n", "")
    replace_in(bench, "test_lamp.py", "30.0", "3.0")
    result = bench.runpytest_inprocess()
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  lamp.life 3 h (limit at least 10),*"])


@pytest.mark.parametrize(
    "choice", [["-k", "life"], ["-m", "full"], ["test_lamp.py::test_life"]], ids=["-k", "-m", "node id"]
)
def test_who_asks_for_nothing_but_the_full_set_is_told_how(bench: pytest.Pytester, choice: list[str]) -> None:
    result = bench.runpytest_inprocess(*choice)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(
        ["ERROR: no test to run in the gate set: 1 test of the full set left out; --hil-suite full runs them"]
    )
    assert not (bench.path / "hil-out" / "run.json").exists()
    assert bench.runpytest_inprocess(*choice, "--hil-suite=full").ret == 0


def test_only_what_the_user_would_have_run_is_said_to_be_left_out(bench: pytest.Pytester) -> None:
    result = bench.runpytest_inprocess("-k", "current")
    assert result.ret == 0
    result.stdout.no_fnmatch_line("*left out*")
    # The full set's limit is not of this run; the gate set's are all met.
    result.stdout.fnmatch_lines(["PASS."])


def test_another_projects_mark_of_this_name_is_left_alone(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("import pytest\n\n@pytest.mark.full\ndef test_moon():\n    pass\n")
    pytester.runpytest_inprocess().assert_outcomes(passed=1)
