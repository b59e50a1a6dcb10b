"""Source lines whose cost differs between two builds."""

from __future__ import annotations

from hiltest.virtual.counts.profiling import LineCost
from hiltest.virtual.profiling.line_changes import LineChange, line_changes


def lines(*costs: tuple[int, int, int], file: str = "fit.c") -> list[LineCost]:
    """Return costs of lines: number, cycles and instructions."""
    return [LineCost(f"{file}:{number}", cycles, instructions, 0) for number, cycles, instructions in costs]


def test_an_inserted_line_is_the_only_change_although_it_moves_those_behind_it() -> None:
    base = lines((10, 20, 10), (11, 300, 200), (12, 50, 30))
    new = lines((10, 20, 10), (11, 300, 200), (12, 100, 100), (13, 50, 30))
    assert line_changes(base, new) == [LineChange("fit.c:12", 100, 100, "", 0, 0)]


def test_a_removed_line_has_its_place_in_the_older_build() -> None:
    (change,) = line_changes(lines((9, 4, 3), (12, 7, 5)), lines((9, 4, 3)))
    assert change == LineChange("fit.c:12", 0, 0, "fit.c:12", 7, 5)
    assert change.delta == -7


def test_the_largest_change_comes_first_in_whichever_file_and_order_lines_are_given() -> None:
    base = [*lines((5, 9, 9), (4, 6, 6)), *lines((4, 1, 1), file="sum.c")]
    new = [*lines((4, 1, 1), file="sum.c"), *lines((4, 7, 6), (5, 49, 9))]
    assert [(change.location, change.delta) for change in line_changes(base, new)] == [("fit.c:5", 40), ("fit.c:4", 1)]


def test_a_place_without_a_line_number_is_compared_as_well() -> None:
    (change,) = line_changes([LineCost("?", 5, 4, 0)], [LineCost("?", 6, 4, 0)])
    assert (change.location, change.delta) == ("?", 1)
