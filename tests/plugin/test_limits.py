"""Limits of the rig: which of two holds, in which unit, and what becomes of one that nothing met."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from hiltest.rig.bench_files import shipped

HEAD = "import pytest\nfrom hiltest.measurement import Limit\n\n"


@pytest.fixture
def limits(pytester: pytest.Pytester, default_rig: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rig that limits a lamp."""
    rig = default_rig[: default_rig.index("[limits]")]
    rig += '[limits]\n"lamp.current" = { max = 3.0, unit = "mA" }\n"lamp.heat" = { max = 40.0, unit = "degC" }\n'
    (pytester.path / "lamp.toml").write_text(rig, encoding="utf-8")
    monkeypatch.setenv("HIL_RIG", "lamp.toml")


def record_of(pytester: pytest.Pytester, folder: str = "hil-out") -> dict[str, Any]:
    content: dict[str, Any] = json.loads((pytester.path / folder / "run.json").read_text(encoding="utf-8"))
    return content


def outcomes_of(pytester: pytest.Pytester) -> dict[str, str]:
    return {measurement["name"]: measurement["outcome"] for measurement in record_of(pytester)["measurements"]}


BOTH = (
    HEAD
    + """
def test_current(measure):
    measure("lamp.current", 1.0, "mA")

def test_heat(measure):
    measure("lamp.heat", 30.0, "degC")
"""
)


@pytest.mark.usefixtures("limits")
def test_a_limit_that_no_test_measures_ends_with_22(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(BOTH.replace("lamp.heat", "lamp.haet"))
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(passed=2)
    assert result.ret == 22
    result.stdout.fnmatch_lines(["NOT EVALUATED. lamp.heat (nothing measured it)."])
    assert outcomes_of(pytester) == {"lamp.current": "pass", "lamp.haet": "information", "lamp.heat": "unset"}


@pytest.mark.usefixtures("limits")
@pytest.mark.parametrize(
    "choice",
    [["-k", "current"], ["test_both.py::test_current"], ["--deselect", "test_both.py::test_heat"]],
    ids=lambda choice: choice[0],
)
def test_tests_that_the_user_left_out_make_nobody_red_and_are_said(
    pytester: pytest.Pytester, choice: list[str]
) -> None:
    pytester.makepyfile(test_both=BOTH)
    result = pytester.runpytest_inprocess(*choice)
    assert result.ret == 0
    result.stdout.fnmatch_lines(["PASS. No test measured lamp.heat, so that its limit was not checked."])
    assert record_of(pytester)["chosen"]
    assert outcomes_of(pytester) == {"lamp.current": "pass"}
    # All that was chosen ran: it is compared with a run of the same choice, though limits of the rig were left out.
    again = pytester.runpytest_inprocess(*choice, "--hil-baseline=hil-out", "--hil-out=again")
    assert again.ret == 0
    again.stdout.fnmatch_lines(
        ["May be merged as far as the chosen tests show (against*: PASS:", "1 unchanged. No test measured*"]
    )
    # It is no base of a whole run, and no part of one.
    whole = pytester.runpytest_inprocess("--hil-baseline=hil-out", "--hil-out=whole")
    assert whole.ret == 22
    assert "only chosen tests ran before, and all tests now" in record_of(pytester, "whole")["verdict"]["sentence"]
    part = pytester.runpytest_inprocess(*choice, "--hil-baseline=whole", "--hil-out=part")
    assert part.ret == 22
    assert "only chosen tests ran, without 1 measurement of whole" in record_of(pytester, "part")["verdict"]["sentence"]


@pytest.mark.usefixtures("limits")
def test_every_limit_judged_is_a_plain_pass(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(BOTH)
    result = pytester.runpytest_inprocess()
    assert result.ret == 0
    result.stdout.fnmatch_lines(["PASS."])
    assert record_of(pytester)["verdict"]["complete"]


@pytest.mark.usefixtures("limits")
def test_a_test_that_skips_itself_has_judged_nothing(pytester: pytest.Pytester) -> None:
    skip = 'pytest.skip("not today")'
    pytester.makepyfile(BOTH.replace('    measure("lamp.heat"', f'    {skip}\n    measure("lamp.heat"'))
    assert pytester.runpytest_inprocess().ret == 22


@pytest.mark.usefixtures("limits")
def test_a_session_that_was_stopped_says_what_was_not_judged(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(BOTH.replace("1.0", "9.0"))
    result = pytester.runpytest_inprocess("-x")
    assert result.ret == 1
    result.stdout.fnmatch_lines(
        [
            "FAIL: 1 of 1 limit missed.",
            "  lamp.current 9 mA (limit 3),*",
            "  This run is not complete:*",
        ]
    )


FIELD = """
def test_field(board, measure):
    measure("field.strength", 48.0, "uT")
"""


def test_a_test_of_ones_own_needs_not_meet_the_limits_of_the_packaged_rig(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HIL_RIG")
    pytester.makepyfile(FIELD)
    result = pytester.runpytest_inprocess()
    assert result.ret == 0
    result.stdout.fnmatch_lines(["PASS."])
    assert "unset" not in outcomes_of(pytester).values()
    assert record_of(pytester)["rig"]["name"] == "virtual-k64f"


@pytest.mark.parametrize("named", [True, False], ids=["named", "in hil/ of the user's"])
def test_the_limits_of_a_rig_that_was_asked_for_must_all_be_met(
    pytester: pytest.Pytester, default_rig: str, monkeypatch: pytest.MonkeyPatch, named: bool
) -> None:
    monkeypatch.delenv("HIL_RIG")
    pytester.makepyfile(FIELD)
    if not named:
        rig = pytester.path / "hil" / "rigs" / "virtual-k64f.toml"
        rig.parent.mkdir(parents=True)
        rig.write_text(default_rig, encoding="utf-8")
    assert pytester.runpytest_inprocess(*(["--hil-rig=virtual-k64f"] if named else [])).ret == 22
    assert outcomes_of(pytester)["heading.direct.max"] == "unset"


@pytest.mark.usefixtures("limits")
def test_another_unit_than_the_limits_is_an_error_that_names_both(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(BOTH.replace('"mA"', '"A"'))
    result = pytester.runpytest_inprocess()
    assert result.ret == 1
    result.stdout.fnmatch_lines(["*lamp.current is measured in 'A', but its limit in *lamp.toml has the unit 'mA'*"])
    assert outcomes_of(pytester)["lamp.current"] == "unset"


@pytest.mark.usefixtures("limits")
def test_the_rigs_limit_wins_over_the_suites(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(BOTH.replace('1.0, "mA"', '4.0, "mA", limit=Limit(max=100)'))
    result = pytester.runpytest_inprocess()
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  lamp.current 4 mA (limit 3),*"])


@pytest.mark.parametrize(
    "test",
    [
        "def test_it(measure):\n    measure('x', 3, 'V', limit=Limit(max=2))\n    pytest.skip('never mind')",
        "def test_it(measure):\n    measure('x', 3, 'V', limit=Limit(max=2))\n    pytest.xfail('never mind')",
        "@pytest.fixture\ndef lamp(measure):\n    yield\n    measure('x', 3, 'V', limit=Limit(max=2))\n\n"
        "def test_it(lamp):\n    pass",
    ],
    ids=["skip", "xfail", "teardown"],
)
def test_out_of_limit_is_red_whatever_the_test_does_then(pytester: pytest.Pytester, test: str) -> None:
    pytester.makepyfile(HEAD + test)
    result = pytester.runpytest_inprocess()
    assert result.ret == 1
    result.stdout.fnmatch_lines(["  x 3 V (limit 2),*"])


@pytest.mark.parametrize("mark", ["xfail", "xfail(strict=True)"])
@pytest.mark.parametrize("when", ["call", "teardown"])
def test_out_of_limit_is_what_a_test_marked_to_fail_is_marked_for(
    pytester: pytest.Pytester, mark: str, when: str
) -> None:
    measured = "measure('x', 3, 'V', limit=Limit(max=2))"
    body = f"    {measured}" if when == "call" else f"    yield\n    {measured}"
    fixture = f"@pytest.fixture\ndef lamp(measure):\n{body}\n\n"
    mark = f"@pytest.mark.{mark}\n"
    # In the fixture's tear-down the call itself passes, which is no failure unless the mark is strict.
    text = f"{mark}def test_it(measure):\n{body}" if when == "call" else f"{fixture}{mark}def test_it(lamp):\n    pass"
    pytester.makepyfile(HEAD + text)
    result = pytester.runpytest_inprocess()
    if when == "teardown" and "strict" in mark:
        assert result.ret == 1
        return
    assert result.ret == 0
    assert result.parseoutcomes()["xfailed"] == 1
    (test,), (measurement,) = record_of(pytester)["tests"], record_of(pytester)["measurements"]
    assert (test["outcome"], measurement["outcome"], measurement["value"]) == ("xfailed", "expected fail", 3)
    assert record_of(pytester)["verdict"]["exit_code"] == 0


def test_a_strict_mark_on_a_test_within_its_limit_is_a_failure(pytester: pytest.Pytester) -> None:
    test = "(strict=True)\ndef test_it(measure):\n    measure('x', 1, 'V', limit=Limit(max=2))"
    pytester.makepyfile(HEAD + "@pytest.mark.xfail" + test)
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(failed=1)
    assert result.ret == 1
    assert record_of(pytester)["tests"][0]["outcome"] == "failed"


def test_a_mark_for_another_exception_does_not_excuse_a_limit(pytester: pytest.Pytester) -> None:
    test = "(raises=ValueError)\ndef test_it(measure):\n    measure('x', 3, 'V', limit=Limit(max=2))"
    pytester.makepyfile(HEAD + "@pytest.mark.xfail" + test)
    assert pytester.runpytest_inprocess().ret == 1
    assert outcomes_of(pytester) == {"x": "fail"}


def test_a_test_that_fails_in_its_own_words_does_so_once(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(HEAD + "def test_it(measure):\n    measure('x', 3, 'V', limit=Limit(max=2))\n    assert 0\n")
    pytester.runpytest_inprocess().assert_outcomes(failed=1, errors=0)


BY_HAND = (
    HEAD
    + """
def test_headings(measure):
    measure("heading.direct.max", 1.0, "deg")
    measure("heading.direct.max_centred", 1.6, "deg")
    measure("heading.iterative.max", VALUE, "deg")
    measure("heading.direct.float32_error", 0.5, "deg", limit=Limit(max=0.6))
"""
)


@pytest.mark.parametrize(("value", "code"), [(1.2, 22), (2.8, 1)])
def test_angles_that_a_hand_sets_are_held_against_limits_with_their_uncertainty(
    pytester: pytest.Pytester, value: float, code: int
) -> None:
    rig = (shipped() / "rigs" / "frdm-k64f.toml").read_text(encoding="utf-8")
    rig = (
        rig[: rig.index("[limits]")]
        + "[limits]\n"
        + "".join(
            f'"heading.{name}" = {{ max = 2.0, unit = "deg" }}\n'
            for name in ("direct.max", "direct.max_centred", "iterative.max")
        )
    )
    (pytester.path / "hand.toml").write_text(rig, encoding="utf-8")
    pytester.makepyfile(BY_HAND.replace("VALUE", str(value)))
    result = pytester.runpytest_inprocess("--hil-rig=hand.toml")
    # U is 0.71 with the mounting and 0.5 without: 1.6 of a centred error cannot be told, and 2.8 is beyond 2.71.
    assert result.ret == code
    assert outcomes_of(pytester) == {
        "heading.direct.max": "pass",
        "heading.direct.max_centred": "cannot tell",
        "heading.direct.float32_error": "pass",
        "heading.iterative.max": "pass" if code == 22 else "fail",
    }
    shown = " ".join(result.stdout.str().split())
    assert "annot tell" in shown
    assert "heading.direct.max_centred 1.60 deg (limit 2 with U 0.5)" in shown
    page = (pytester.path / "hil-out" / "report.md").read_text(encoding="utf-8")
    assert "at most 2, U 0.5" in page
    uncertainties = {
        measurement["name"]: measurement["uncertainty"] for measurement in record_of(pytester)["measurements"]
    }
    assert uncertainties["heading.direct.max"] == pytest.approx(math.sqrt(0.5))
    assert uncertainties["heading.direct.float32_error"] is None
