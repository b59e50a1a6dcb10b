"""Bugs that people published end red, their fixed twin ends green, and the page says what hiltest says of each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ..end_to_end.firmware_edits import FIRMWARE, FirmwareCopy
from .exhibits import PAGE, UNCHANGED, Exhibit, exhibits, page_row, visit

EVERY = exhibits()


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> FirmwareCopy:
    """The firmware's sources, to be built with a bug."""
    require_tool("arm-none-eabi-gcc")
    require_tool("cmake")
    return FirmwareCopy(tmp_path_factory.mktemp("museum"))


@pytest.mark.ci
@pytest.mark.parametrize("exhibit", EVERY, ids=[exhibit.name for exhibit in EVERY])
def test_a_published_bug_ends_red(exhibit: Exhibit, firmware: FirmwareCopy, tmp_path: Path) -> None:
    result = visit(firmware, exhibit.edit, tmp_path)
    assert result.code != 0
    assert exhibit.says in result.sentence
    assert page_row(exhibit, result) in PAGE.read_text(encoding="utf-8").splitlines()


@pytest.mark.ci
def test_the_fixed_twin_ends_green(firmware: FirmwareCopy, tmp_path: Path) -> None:
    result = visit(firmware, UNCHANGED, tmp_path)
    assert result.code == 0, result.sentence
    assert max(result.level_deg, result.tilted_deg) < 1.0


def test_the_museum_has_30_bugs_of_15_projects() -> None:
    assert len({exhibit.edit for exhibit in EVERY}) == len(EVERY) >= 30
    assert len({exhibit.project for exhibit in EVERY}) >= 15
    assert [exhibit.name for exhibit in EVERY if f"https://github.com/{exhibit.project}/" not in exhibit.report] == []


def test_every_bug_is_one_place_of_the_sources() -> None:
    counts = {
        exhibit.name: (FIRMWARE / exhibit.edit.file).read_text(encoding="utf-8").count(exhibit.edit.old)
        for exhibit in EVERY
    }
    assert {name: count for name, count in counts.items() if count != 1} == {}


def test_the_page_has_every_bug_in_order() -> None:
    rows = [line.split(" | ") for line in PAGE.read_text(encoding="utf-8").splitlines() if "](https://" in line]
    links = [f"[{exhibit.project}]({exhibit.report})" for exhibit in EVERY]
    assert [(cells[0], cells[1]) for cells in rows] == [
        (f"| {exhibit.bug}", link) for exhibit, link in zip(EVERY, links, strict=True)
    ]
