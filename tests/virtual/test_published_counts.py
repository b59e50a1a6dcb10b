"""The cycle model beside counts that others published of their own code."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.virtual.part.part_file import load_part

from .published import (
    Published,
    count_all,
    evaluated,
    figures,
    has_range,
    is_inside,
    lines,
    mean_and_worst,
    part_errors,
    versions,
)

PAGE = Path(__file__).parents[2] / "docs" / "cycle-validation.md"
PROMISED = {"stm32f407": (0.005, 0.015), "stm32l4r5": (0.015, 0.0305), "nrf52840": (0.03, 0.05)}
"""Mean and greatest error of hand-written assembly, by part."""


@pytest.fixture(scope="module")
def counts() -> dict[Published, float]:
    """Count all figures; without the folder of programs, skip the test."""
    return count_all()


def test_the_page_has_the_counts(counts: dict[Published, float]) -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert "\n".join(lines(counts)) in page
    assert "\n".join(versions()) in page


@pytest.mark.parametrize("part", PROMISED)
def test_hand_written_assembly_is_as_close_as_promised(counts: dict[Published, float], part: str) -> None:
    errors = [figure.error(counts[figure]) for figure in evaluated(part)]
    assert all(error <= most for error, most in zip(mean_and_worst(errors), PROMISED[part], strict=True))


def test_figures_that_chose_no_rule_are_as_close(counts: dict[Published, float]) -> None:
    held_out = [figure for figure in evaluated() if not figure.chose_rules]
    mean, worst = mean_and_worst([figure.error(counts[figure]) for figure in held_out])
    assert len(held_out) >= 40
    assert mean <= 0.005
    assert worst <= 0.02


def test_most_figures_are_in_the_range_of_other_figures(counts: dict[Published, float]) -> None:
    ranged = [figure for figure in evaluated() if has_range(figure)]
    inside = sum(is_inside(figure, counts) for figure in ranged)
    assert 0.88 <= inside / len(ranged) <= 0.99


@pytest.mark.parametrize("part", ["stm32f407", "stm32l4r5"])
def test_the_file_of_a_part_has_the_errors_of_its_figures(counts: dict[Published, float], part: str) -> None:
    file = load_part(part)
    assert file.timing(20_000_000).errors["flash"].permille == part_errors(part, counts)


def test_figures_are_many_and_of_several_parts() -> None:
    assert len(evaluated()) >= 90
    assert len({figure.part for figure in evaluated()}) >= 4
    assert sum(not figure.chose_rules for figure in figures() if not figure.unclear) * 3 >= len(evaluated())
