"""The fixture ``measure``: soft failures, limits from the rig, properties, tables and the record."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from typing import Any

import pytest

from hiltest.run_record.journal import JOURNAL_FILE
from hiltest.run_record.reader import read_record

HEAD = "from hiltest.measurement import Limit\n\n"


def run_of(pytester: pytest.Pytester) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    read_record(pytester.path / "hil-out" / "run.json")  # every run that a test makes is valid
    return content


def measurements_of(pytester: pytest.Pytester) -> dict[str, dict[str, Any]]:
    return {measurement["name"]: measurement for measurement in run_of(pytester)["measurements"]}


def test_a_value_out_of_limit_fails_the_test_after_everything_was_measured(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
def test_two(measure):
    measure("first", 3.0, "deg", limit=Limit(max=2))
    measure("second", 1.0, "deg", limit=Limit(max=2))
"""
    )
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(failed=1)
    assert result.ret == 1
    result.stdout.fnmatch_lines(["FAIL: 1 of 2 limits missed.", "  first 3.00 deg (limit 2),*"])
    measured = measurements_of(pytester)
    assert measured["first"]["outcome"] == "fail"
    assert measured["second"]["outcome"] == "pass"
    assert measured["first"]["test"].endswith("::test_two")


@pytest.mark.parametrize("options", [(), ("-n2",)], ids=["one process", "workers"])
def test_a_failed_limit_is_said_once_with_its_place_from_where_pytest_was_started(
    pytester: pytest.Pytester, options: tuple[str, ...]
) -> None:
    (pytester.mkdir("lamps") / "test_lamp.py").write_text(
        HEAD
        + """
def test_limit(measure):
    print("seen on the way")
    measure("lamp.current", 3.125, "mA", limit=Limit(max=2))

def test_word():
    assert 1 == 2
"""
    )
    result = pytester.runpytest_inprocess("--junit-xml=junit.xml", *options)
    result.stdout.fnmatch_lines(
        [
            "  lamp.current 3.125 mA (limit 2), lamps/test_lamp.py:*",
            "*_ test_limit _*",
            "out of limit: lamp.current",
            "seen on the way",
        ]
    )
    result.stdout.fnmatch_lines(["E*assert 1 == 2"])
    assert result.stdout.str().count("3.125") == 1
    assert "lamp.current = 3.125 mA, limit at most 2: fail" in (pytester.path / "junit.xml").read_text()
    assert measurements_of(pytester)["lamp.current"]["place"].startswith("lamps/test_lamp.py:")
    assert {test["reason"] for test in run_of(pytester)["tests"]} == {"out of limit: lamp.current", "assert 1 == 2"}
    page = (pytester.path / "hil-out" / "report.md").read_text()
    assert page.count("3.125") == 3, "the verdict, the list of failures, and that of every measurement"


def test_an_assertion_still_fails_as_itself(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
def test_it(measure):
    measure("x", 3.0, "deg", limit=Limit(max=2))
    assert 1 == 2
"""
    )
    pytester.runpytest_inprocess().stdout.fnmatch_lines(["E*assert 1 == 2"])
    assert measurements_of(pytester)["x"]["outcome"] == "fail"


def test_a_limit_of_the_rig_file_applies_by_name(pytester: pytest.Pytester, default_rig: str) -> None:
    (pytester.path / "mine.toml").write_text(
        default_rig.replace("[limits]", '[limits]\n"field.strength" = { min = 45.0, max = 52.0, unit = "uT" }'),
        encoding="utf-8",
    )
    pytester.makepyfile(
        HEAD
        + """
def test_it(measure):
    measure("field.strength", 60.0, "uT")
    measure("cycles.direct.per_point", 200.0, "cycle", cycle_model="silicon-dwt")
"""
    )
    result = pytester.runpytest_inprocess("--hil-rig=mine.toml")
    result.stdout.fnmatch_lines(["  field.strength 60 uT (limit 45 to 52),*"])
    assert measurements_of(pytester)["cycles.direct.per_point"] | {"test": "", "place": ""} == {
        "name": "cycles.direct.per_point",
        "value": 200.0,
        "unit": "cycle",
        "limit": None,
        "information": {"min": None, "max": 168},
        "outcome": "information",
        "volatile": False,
        "cycle_model": "silicon-dwt",
        "note": "",
        "test": "",
        "band": None,
        "uncertainty": None,
        "place": "",
    }


def test_a_limit_that_cannot_be_judged_ends_with_22(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
def test_it(measure):
    measure("x", 1.0, "deg", limit=Limit(max=2), not_checked="no reference")
"""
    )
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(passed=1)
    assert result.ret == 22
    result.stdout.fnmatch_lines(["NOT EVALUATED. x (no reference)."])


def test_a_reason_why_there_is_nothing_to_measure_is_kept_and_no_limit_is_met_by_it(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
def test_it(measure):
    measure("x", None, "deg", not_offered="it converged at once")
    measure("y", None, "deg", limit=Limit(max=2), not_offered="it converged at once")
"""
    )
    assert pytester.runpytest_inprocess().ret == 22
    measured = measurements_of(pytester)
    assert [(measured[name]["outcome"], measured[name]["note"]) for name in "xy"] == [
        ("not offered", "it converged at once"),
        ("unset", "it converged at once"),
    ]


def test_what_a_number_is_of_is_kept_and_shown_beside_it(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
def test_it(measure):
    measure("x", 1.0, "deg", limit=Limit(max=2), note="of one cloud")
"""
    )
    result = pytester.runpytest_inprocess("-v")
    result.stdout.fnmatch_lines(["x *1.00 *deg *at most 2 *pass*", "x 1.00: of one cloud"])
    assert measurements_of(pytester)["x"]["note"] == "of one cloud"


def test_one_name_measured_by_two_tests_is_an_error(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        def test_one(measure):
            measure("x", 1, "")

        def test_two(measure):
            measure("x", 2, "")
    """)
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*x was already measured by *::test_one; names are unique in a run*"])
    assert measurements_of(pytester)["x"]["value"] == 1


def test_junit_has_the_measurements_as_properties_without_a_warning(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
def test_it(measure):
    measure("heading.direct.max", 0.1 + 0.2, "deg", limit=Limit(max=2))
"""
    )
    result = pytester.runpytest_inprocess("--junit-xml=junit.xml", "-W", "error")
    result.assert_outcomes(passed=1)
    properties = {
        item.attrib["name"]: item.attrib["value"] for item in ET.parse(pytester.path / "junit.xml").iter("property")
    }
    assert properties == {
        "hil.heading.direct.max": "0.3",
        "hil.heading.direct.max.unit": "deg",
        "hil.heading.direct.max.outcome": "pass",
        "hil.heading.direct.max.limit": "at most 2",
    }


def test_a_table_is_kept_and_its_rows_are_counted(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        def test_good(measure):
            measure.table("sizes", {"n": "", "cycles": "cycle"}, [(1, 2.5), (3, float("nan"))])

        def test_bad(measure):
            measure.table("ragged", {"n": ""}, [(1, 2)])
    """)
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*ValueError: table 'ragged': every row needs 1 cells*"])
    (table,) = run_of(pytester)["tables"]
    assert table["rows"] == [[1, 2.5], [3, None]]


def test_a_hook_sees_each_measurement_and_the_finished_run(pytester: pytest.Pytester) -> None:
    pytester.makeconftest("""
        def pytest_hil_measurement(item, measurement):
            print("saw", item.name, measurement)

        def pytest_hil_finished(run):
            print("finished", run.verdict.exit_code)
    """)
    pytester.makepyfile("def test_it(measure):\n    measure('x', 1, '')\n")
    pytester.runpytest_inprocess("-s").stdout.fnmatch_lines(["*saw test_it x = 1: information*", "*finished 0*"])


def test_what_was_measured_is_on_the_disk_when_the_process_dies(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import os

        def test_one(measure):
            measure("first", 1, "")

        def test_two(measure):
            measure("second", 2, "")
            os.kill(os.getpid(), 9)
    """)
    pytester.runpytest_subprocess()
    folder = pytester.path / "hil-out"
    assert not (folder / "run.json").exists(), "an unfinished run has no record that looks finished"
    journal = (folder / JOURNAL_FILE).read_text(encoding="utf-8")
    assert '"first"' in journal
    assert '"second"' not in journal


def test_an_interrupted_run_keeps_its_code_and_what_was_measured(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        def test_one(measure):
            measure("first", 1, "")

        def test_two():
            raise KeyboardInterrupt
    """)
    assert pytester.runpytest_subprocess().ret == 2
    run = run_of(pytester)
    assert run["verdict"]["outcome"] == "interrupted"
    assert not run["verdict"]["complete"]
    assert [measurement["name"] for measurement in run["measurements"]] == ["first"]


def test_nothing_is_written_where_hiltest_is_not_used(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it():\n    pass\n")
    pytester.runpytest_inprocess().assert_outcomes(passed=1)
    assert not (pytester.path / "hil-out").exists()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("[mounting]", "[mountin]"), "*unknown key 'mountin'; did you mean 'mounting'?"),
        (("dip_deg", "dipp_deg"), "*unknown key *dipp_deg*did you mean *dip_deg*"),
        (
            ("uncertainty_deg = 0.1", "uncertainty_deg = 2.5"),
            "*heading.direct.max* is tighter than the uncertainty of the reference*",
        ),
        (("schema = 1", "schema = one"), "*not TOML*"),
    ],
)
def test_a_wrong_rig_is_a_usage_error_and_touches_nothing(
    pytester: pytest.Pytester, default_rig: str, change: tuple[str, str], complaint: str
) -> None:
    (pytester.path / "mine.toml").write_text(default_rig.replace(*change), encoding="utf-8")
    pytester.makepyfile("def test_it(measure):\n    measure('x', 1, '')\n")
    result = pytester.runpytest_inprocess("--hil-rig=mine.toml")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([f"ERROR: {complaint}"])
    assert not (pytester.path / "hil-out").exists()


def test_a_rig_that_is_not_there_lists_those_that_are(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(rig):\n    pass\n")
    result = pytester.runpytest_inprocess("--hil-rig=gone.toml")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: no rig file 'gone.toml'; rigs here: frdm-k64f, *virtual-k64f*"])


def test_a_rig_is_found_by_its_bare_name(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(rig):\n    assert rig.name == 'frdm-k64f'\n")
    pytester.runpytest_inprocess("--hil-rig=frdm-k64f").assert_outcomes(passed=1)
