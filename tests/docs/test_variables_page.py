"""The page about variables: its example prints what it shows, its rig is one, and its table has every unit."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from hiltest.interfaces.memory_interface import read_descriptions
from hiltest.interfaces.quantities import Quantity
from hiltest.interfaces.variables import Variables, function_address
from hiltest.measurement.units import conversion
from hiltest.rig.bench_files import rig_file
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.program.elf import load_image

from ..foreign_elf import foreign_elf

PAGE = (Path(__file__).parents[2] / "docs" / "variables.md").read_text(encoding="utf-8")
ALONE, BESIDE, SAMPLES = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
(EXAMPLE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
(SHOWN,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)


def test_the_example_prints_what_the_page_shows(capsys: pytest.CaptureFixture[str]) -> None:
    exec(EXAMPLE, {})
    assert capsys.readouterr().out == SHOWN


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """The rig of NXP's fusion with the page's tables in place of its own."""
    shipped = rig_file(Path(__file__).parent, "nxp-fusion-agm01").read_text(encoding="utf-8")
    others = re.sub(r"^\[device.*?(?=^\[(?!device))", "", shipped, flags=re.M | re.S)
    path = tmp_path / "mine.toml"
    path.write_text(others + ALONE, encoding="utf-8")
    return path


def test_its_rig_reads_variables_that_are_there(written: Path) -> None:
    memory = load_rig(written).device.memory
    image = load_image(foreign_elf("nxp_sensor_fusion.elf"))
    descriptions = read_descriptions(memory.values, Variables(image), str)
    assert {quantity.key for quantity in descriptions} == memory.values.keys()
    assert function_address(image, memory.at_return_of)


def test_the_second_table_names_sources_of_its_kinds() -> None:
    device = tomllib.loads(BESIDE)["device"]
    assert set(device["sources"].values()) <= set(device["kind"])


def test_every_unit_of_the_table_is_known_and_every_quantity_with_one_has_some() -> None:
    row = next(line for line in PAGE.splitlines() if line.startswith("| `unit` |"))
    without = {quantity.key for quantity in Quantity if not quantity.unit}
    named = set(re.findall(r"`([^`]+)`", row)) - {"unit"}
    assert without <= named
    units = {item.unit for item in Quantity}
    results = {word: [unit for unit in units if conversion(word, unit)] for word in named - without}
    assert all(results.values())
    assert {unit for units in results.values() for unit in units} >= {item.unit for item in Quantity if item.unit}


def test_the_samples_of_the_page_are_those_of_the_rig_that_ships() -> None:
    rig = tomllib.loads(rig_file(Path(__file__).parent, "nxp-fusion-agm01").read_text(encoding="utf-8"))
    assert tomllib.loads(SAMPLES)["device"]["memory"]["samples"] == rig["device"]["memory"]["samples"]
