"""Mistakes in the firmware are found and named first; harmless changes raise no alarm."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from ..end_to_end.firmware_edits import Edit, FirmwareCopy
from .edits import Mutation, mutations
from .harmless import FILE as HARMLESS
from .harmless import false_alarms, run_full_set
from .harness import FILE
from .score import run_mutation, said_first

pytestmark = pytest.mark.slow

EVERY = tomllib.loads(FILE.read_text(encoding="utf-8"))
TEN = mutations()[4::10]
"""Of all kinds; `tox -e mutation` runs all."""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> FirmwareCopy:
    """The firmware's sources, to be built with a mistake."""
    require_tool("arm-none-eabi-gcc")
    require_tool("cmake")
    return FirmwareCopy(tmp_path_factory.mktemp("mutated"))


@pytest.mark.parametrize("mutation", TEN, ids=[item.name for item in TEN])
def test_a_mistake_in_the_firmware_is_found_and_named_first(
    mutation: Mutation, copy: FirmwareCopy, tmp_path: Path
) -> None:
    result = run_mutation(copy, mutation, tmp_path / "run")
    assert result.code != 0, result.sentence
    assert said_first(mutation, result), result.first


def test_replies_3_ms_later_raise_no_alarm(copy: FirmwareCopy, tmp_path: Path) -> None:
    table = tomllib.loads(HARMLESS.read_text(encoding="utf-8"))
    (row,) = (row for row in table["edit"] if row["name"] == "replies 3 ms later")
    elf = copy.build(Edit(row["file"], row["old"], row["new"]), tmp_path / "late.elf")
    shipped, late = run_full_set(tmp_path / "shipped"), run_full_set(tmp_path / "late", "--firmware", str(elf))
    assert list(false_alarms(shipped, late, table["names"][row["may_move"]])) == []
    assert "link.reply_time" in " ".join(false_alarms(shipped, late, ""))


def test_every_change_is_a_place_of_its_own_in_the_sources() -> None:
    harmless = tomllib.loads(HARMLESS.read_text(encoding="utf-8"))["edit"]
    every = mutations()
    assert len(every) >= 80
    sources = Path(__file__).parents[2] / "firmware_stub"
    places = {entry.name: (entry.edit.file, entry.edit.old) for entry in every}
    places |= {row["name"]: (row["file"], row["old"]) for row in harmless}
    counts = {name: (sources / file).read_text(encoding="utf-8").count(old) for name, (file, old) in places.items()}
    assert {name: count for name, count in counts.items() if count != 1} == {}
    assert len({entry.edit for entry in every}) == len(every)


def test_every_mistake_in_the_package_is_a_place_of_its_own() -> None:
    package = Path(__file__).parents[2] / "src" / "hiltest"
    texts = {file: (package / file).read_text(encoding="utf-8") for file in EVERY}
    counts = {(file, edit["old"]): texts[file].count(edit["old"]) for file in EVERY for edit in EVERY[file]["edit"]}
    assert {place: count for place, count in counts.items() if count != 1} == {}
