"""Every fault of a line, in a short run: it recovers or ends as lost in time, and no number in its record is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.end_to_end import line_faults
from tests.end_to_end.line_faults import DEADLINE_S, FAULTS, PAGE, Ended, Tried, begin_s, faults_of, row, run_short

pytestmark = pytest.mark.slow

# One that recovers, one that is lost at once, one by its deadlines; the others differ in what the port does.
FEW = ("lost bytes", "a device that disappears", "a stall for good")


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    ended = run_short(tmp_path_factory.mktemp("line") / "clean")
    assert ended.code == 0
    return ended


@pytest.mark.parametrize(
    "tried", [pytest.param(each, id=each.what, marks=[] if each.what in FEW else pytest.mark.ci) for each in FAULTS]
)
def test_a_fault_of_the_line_ends_as_the_page_says_and_leaves_no_wrong_number(
    tried: Tried, clean: Ended, tmp_path: Path
) -> None:
    ended = run_short(tmp_path / "run", tried.faults)
    faults = faults_of(tmp_path / "run")
    assert line_faults.wrong_numbers(ended, clean) == []
    if tried.recovers:
        assert (ended.code, ended.numbers.keys()) == (0, clean.numbers.keys())
    else:
        assert ended.code == 20
        assert 0.0 <= ended.virtual_s - begin_s(faults) <= DEADLINE_S
        assert ended.numbers.keys() < clean.numbers.keys()
    # Whoever reads the record or the terminal knows that the line was spoilt on purpose.
    assert ended.record["rig"]["faults"] == str(faults)
    assert f"faults of the line, on purpose: {faults}" in ended.output
    assert row(tried, ended, faults, clean) in line_faults.shown(PAGE.read_text(encoding="utf-8"))


def test_the_page_shows_each_fault_and_no_other() -> None:
    rows = line_faults.shown(PAGE.read_text(encoding="utf-8")).splitlines()[2:]
    assert [each.split("|")[1].strip() for each in rows] == [each.what for each in FAULTS]
