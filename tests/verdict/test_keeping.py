"""What got better is kept by a command that does it, whatever the base is."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hiltest.verdict.compare import compare
from hiltest.verdict.evidence import Evidence
from hiltest.verdict.wording import how_to_keep

from .evidence import over_seeds

NAME = "cycles.direct.total"
BASE, BETTER = over_seeds(NAME, *[5] * 8), over_seeds(NAME, *[4] * 8)
BASELINE = replace(BASE, is_baseline=True, side=replace(BASE.side, file="hil/base line.json"))
UPDATE = "hiltest baseline update 'hil/base line.json' hil-out --accept cycles.direct.total --because TEXT"


def test_a_baseline_is_updated_by_its_file_and_the_names() -> None:
    assert how_to_keep(compare(BASELINE, BETTER), "hil-out") == f"1 better; keep it: {UPDATE}"


def test_a_run_with_fewer_seeds_than_the_baseline_is_no_way_to_update_it() -> None:
    one = over_seeds(NAME, 4)
    answer = how_to_keep(compare(BASELINE, one), "hil-out", "--firmware mine.elf")
    first = "hiltest run --firmware mine.elf --seeds 1..8 --out hil-out/seeds"
    assert answer == f"1 better; keep it: run its seeds, {first}, then {UPDATE.replace('hil-out', 'hil-out/seeds')}"
    answer = how_to_keep(compare(BASELINE, one), "hil-out", "")
    assert "run its seeds, hiltest run --seeds 1..8 --out hil-out/seeds, then " in answer


def test_where_nobody_knows_what_a_run_was_started_with_the_words_say_so() -> None:
    answer = how_to_keep(compare(BASELINE, over_seeds(NAME, 4)), "kept/run.json")
    first = "run its seeds with the OPTIONS of the run kept/run.json, hiltest run OPTIONS --seeds 1..8 --out DIR"
    assert answer == f"1 better; keep it: {first}, then {UPDATE.replace('hil-out', 'DIR')}"


def test_a_run_is_replaced_and_not_updated() -> None:
    answer = how_to_keep(compare(BASE, BETTER), "hil out")
    assert answer == "1 better; keep it: hiltest baseline save 'hil out' FILE, and --baseline FILE from then on"


@pytest.mark.parametrize(
    ("base", "new"),
    [
        (BASELINE, BASE),
        (BETTER, BASE),  # nothing better, and something worse
        (BASELINE, replace(BETTER, failed=("test_lamp.py::test_life (it broke)",))),
        (BASELINE, replace(BETTER, faults=("cut short",))),
        (replace(BASE, chosen=True), replace(BETTER, chosen=True)),  # a run of chosen tests is no base
    ],
)
def test_nothing_is_to_be_kept_of_what_is_no_pass_or_no_better(base: Evidence, new: Evidence) -> None:
    assert how_to_keep(compare(base, new), "hil-out") == ""


def test_of_two_firmwares_in_one_session_there_is_nothing_to_keep() -> None:
    assert how_to_keep(compare(BASE, BETTER, together=True), "hil-out") == ""
