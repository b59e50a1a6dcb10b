"""The records and pictures of docs/studies.md are those that their script writes."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Cell, Run
from hiltest.studies import NAMES

DOCS = Path(__file__).parents[2] / "docs"
SCRIPT: dict[str, Any] = runpy.run_path(str(DOCS / "studies.py"))
# What takes longer than two seconds.
LONG = frozenset({"budget", "choose", "constraints", "estimators", "float32", "imu"})
# Another host's BLAS adds in another order. With OpenBLAS' kernels for Prescott and for Haswell in place of this
# host's, what closed forms give moved in the ninth digit, and what `geometric` does, as its search settles, by 4e-7.
RELATIVE = 1e-5
# Searches that nothing bounds: one that runs away for a while ends elsewhere for another last digit.
UNBOUNDED = frozenset({"frosio", "frosio-centred", "gauss-newton", "gauss-newton-geometric", "levenberg-marquardt"})


def record(name: str) -> Run:
    return read_record(DOCS / "studies" / f"{name}.json").run


def rows(run: Run) -> dict[str, list[Cell]]:
    """Return all numbers of a record by what they are of, and what it says of printed figures."""
    results: dict[str, list[Cell]] = {measurement.name: [measurement.value] for measurement in run.measurements}
    for table in run.tables:
        shown = (4,) if table.name.endswith(".printed") else range(len(table.columns))
        results |= {
            f"{table.name}, row {number}": [row[0], *(row[column] for column in shown)]
            for number, row in enumerate(table.rows)
        }
    return results


def is_unbounded(name: str, row: list[Cell]) -> bool:
    return bool(UNBOUNDED & {*name.split("."), *row})


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow, pytest.mark.ci] if name in LONG else []) for name in NAMES]
)
def test_a_study_renewed_at_the_record_s_size_has_its_numbers(name: str) -> None:
    stored, renewed = rows(record(name)), rows(SCRIPT["small_run"](SCRIPT["PLANS"][name]))
    again = f"if it is meant to: python docs/studies.py {name}"
    assert renewed.keys() == stored.keys(), again
    for case, expected in stored.items():
        result = renewed[case]
        if not is_unbounded(case, expected):
            assert result == [
                pytest.approx(item, rel=RELATIVE) if type(item) is float else item for item in expected
            ], f"{case}: {again}"


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_is_drawn_from_its_record_and_on_the_page(name: str) -> None:
    drawn = (DOCS / "studies" / f"{name}.svg").read_text(encoding="utf-8")
    assert drawn == SCRIPT["picture"](record(name)), f"draw it anew: python docs/studies.py {name}"
    assert f"](studies/{name}.svg)" in (DOCS / "studies.md").read_text(encoding="utf-8")
