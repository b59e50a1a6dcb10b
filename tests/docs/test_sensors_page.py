"""The page about sensors: its table has every model, its keys are those of a rig, its example measures."""

from __future__ import annotations

import re
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from hiltest.rig.parts import MODELS, load_model
from hiltest.rig.rig_file import load_rig
from hiltest.rig.toml_tables import SensorPart
from hiltest.world.sensors.register_table import OutputRow, RegisterTable

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "sensors.md").read_text(encoding="utf-8")
IN_A_RIG, TABLE = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
(EXAMPLE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
OF_THE_SHIELD = {"mag3110", "fxos8700cq", "fxas21002c"}


def cells_of(section: str) -> set[str]:
    """All words in code in the first cells of a section's tables."""
    rows = re.findall(r"^\| (`.*?) \|", section, re.M)
    return {word.strip("[]") for row in rows for word in re.findall(r"`([^`]+)`", row)}


def test_every_model_has_a_row_with_its_addresses() -> None:
    rows = dict(re.findall(r"^\| `([a-z0-9]+)` \| (.*?) \|", PAGE.partition("\n## ")[0], re.M))
    assert set(rows) == OF_THE_SHIELD | set(MODELS)
    for name in MODELS:
        model = load_model(name)
        written = {int(address, 16) for address in re.findall(r"0x[0-9A-F]{2}", rows[name])}
        assert written == {address for die in (model, *model.companion_models) for address in die.table.addresses}


def test_the_part_of_the_page_is_a_rig_s_and_every_key_has_a_row(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text((ROOT / "hil" / "rigs" / "text-compass.toml").read_text() + "\n" + IN_A_RIG)
    assert load_rig(file).parts["lis3mdl"].interrupts == {"DRDY": "PTC5"}
    assert {field.name for field in fields(SensorPart)} <= cells_of(PAGE.partition("## A part in a rig")[2])


def test_every_key_of_a_table_has_a_row() -> None:
    made_by_the_reader = {"names", "words", "values", "writable", "clearing", "resetting", "fields", "outputs", "data"}
    section = PAGE.partition("## A part of your own")[2]
    assert {field.name for field in fields(RegisterTable)} - made_by_the_reader <= cells_of(section)
    row = next(line for line in section.splitlines() if line.startswith("| `[outputs.QUANTITY]`"))
    keys = {field.name for field in fields(OutputRow)} - {"quantity", "first"}
    assert keys | {"register"} <= set(re.findall(r"`([a-z_]+)`", row))


def test_the_example_measures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ak8963.toml").write_text(TABLE)
    (tmp_path / "ak8963.py").write_text(EXAMPLE)
    monkeypatch.syspath_prepend(tmp_path)
    __import__("ak8963")
    del sys.modules["ak8963"]
