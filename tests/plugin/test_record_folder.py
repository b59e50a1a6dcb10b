"""Which folder keeps the record: no run of chosen tests replaces that of a complete one."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

TWO = """
def test_current(measure):
    measure("lamp.current", 1.0, "mA")

def test_heat(measure):
    measure("lamp.heat", 30.0, "degC")
"""


def measured_in(folder: Path) -> set[str]:
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return {measurement["name"] for measurement in record["measurements"]}


@pytest.mark.parametrize(
    "choice", [["-k", "current"], ["test_both.py::test_current"], ["-k", "current", "-n2"]], ids=" ".join
)
def test_chosen_tests_are_recorded_beside_the_record_of_a_complete_run(
    pytester: pytest.Pytester, choice: list[str]
) -> None:
    if "-n2" in choice:
        pytest.importorskip("xdist")
        choice = [*choice, "--dist=loadgroup"]
    pytester.makepyfile(test_both=TWO)
    assert pytester.runpytest_inprocess().ret == 0
    complete = (pytester.path / "hil-out" / "run.json").read_bytes()
    for _ in range(2):
        result = pytester.runpytest_inprocess(*choice)
        assert result.ret == 0
        assert (pytester.path / "hil-out" / "run.json").read_bytes() == complete
        assert measured_in(pytester.path / "hil-out" / "chosen") == {"lamp.current"}
    if "-n2" not in choice:
        result.stdout.fnmatch_lines(
            ["hil-out keeps the record of its complete run; the chosen tests are recorded in hil-out/chosen"]
        )


def test_a_complete_run_replaces_a_complete_one_and_one_of_chosen_tests(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_both=TWO)
    for choice, names in (["-k", "heat"], {"lamp.heat"}), ([], {"lamp.heat", "lamp.current"}):
        assert pytester.runpytest_inprocess(*choice).ret == 0
        assert measured_in(pytester.path / "hil-out") == names
    pytester.makepyfile(test_both=TWO.replace("lamp.heat", "lamp.life"))
    assert pytester.runpytest_inprocess().ret == 0
    assert measured_in(pytester.path / "hil-out") == {"lamp.life", "lamp.current"}
    assert not (pytester.path / "hil-out" / "chosen").exists()


def test_tests_of_ones_own_do_not_replace_the_record_of_a_whole_suite(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytester.makepyfile(test_both=TWO)
    assert pytester.runpytest_inprocess().ret == 0
    monkeypatch.delenv("HIL_RIG")
    pytester.makepyfile(test_both="", test_field="def test_field(measure):\n    measure('field.strength', 48, 'uT')")
    assert pytester.runpytest_inprocess().ret == 0
    assert measured_in(pytester.path / "hil-out") == {"lamp.heat", "lamp.current"}
    assert measured_in(pytester.path / "hil-out" / "chosen") == {"field.strength"}


def test_hiltest_run_keeps_every_file_of_a_complete_run_when_tests_are_chosen(pytester: pytest.Pytester) -> None:
    suites = pytester.path / "hil" / "suites"
    suites.mkdir(parents=True)
    (suites / "test_both.py").write_text(TWO, encoding="utf-8")
    run = (sys.executable, "-m", "hiltest", "run")
    assert pytester.run(*run).ret == 0
    files = {path.name: path.read_bytes() for path in (pytester.path / "hil-out").iterdir()}
    assert {"run.json", "report.html", "junit.xml"} <= files.keys()
    result = pytester.run(*run, "--", "-k", "heat")
    assert result.ret == 0
    result.stdout.fnmatch_lines(["*the chosen tests are recorded in hil-out/chosen"])
    assert {name: (pytester.path / "hil-out" / name).read_bytes() for name in files} == files
    assert {path.name for path in (pytester.path / "hil-out" / "chosen").iterdir()} == files.keys()
