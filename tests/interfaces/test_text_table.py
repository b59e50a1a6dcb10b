"""The table of a device that prints lines: what contradicts itself is refused with its key and the nearest name."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from hiltest.errors import ConfigError
from hiltest.interfaces.quantities import Quantity
from hiltest.interfaces.text_table import text_interface
from hiltest.measurement.units import conversion, unit_words
from hiltest.rig.text_device import TextCommands, TextDevice, TextValue
from hiltest.rig.toml_tables import RigValueError

HEADING = ("(?P<heading>.*)",)


def test_what_is_offered_is_what_the_groups_and_values_name() -> None:
    patterns = ("(?P<heading>x) (?P<hard_iron_x>1)(?P<hard_iron_y>2)(?P<hard_iron_z>3)", "(?P<tmp>t)")
    device = TextDevice(patterns=patterns, values={"temperature": TextValue("tmp")})
    assert text_interface(device, str).offers == {Quantity.HEADING, Quantity.HARD_IRON, Quantity.TEMPERATURE}


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        ({}, "patterns", "require format"),
        ({"format": "json"}, "values", "is missing"),
        ({"format": "json", "patterns": HEADING}, "patterns", "require format"),
        ({"patterns": HEADING, "columns": ("a",)}, "columns", "csv"),
        ({"patterns": HEADING, "separator": ";"}, "separator", "csv"),
        ({"format": "csv", "separator": "", "values": {"roll": TextValue(1)}}, "separator", "one character"),
    ],
)
def test_keys_that_do_not_go_together_are_refused(table: dict[str, Any], key: str, words: str) -> None:
    with pytest.raises(RigValueError) as caught:
        TextDevice(**table)
    assert caught.value.key == key
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        ({"patterns": ("(?P<heading>.*",)}, "patterns", "is not a regular expression: missing )"),
        ({"patterns": HEADING, "ready": "("}, "ready", "is not a regular expression"),
        ({"patterns": HEADING, "error": "[a"}, "error", "is not a regular expression"),
        ({"patterns": (*HEADING, "heading=(.*)")}, "patterns", "'heading=(.*)' has no named group"),
        ({"patterns": ("(?P<headng>.*)",)}, "patterns", "'headng', which is not a quantity; did you mean 'heading'?"),
        ({"patterns": ("(?P<magnetometer_x>.)",)}, "patterns", "magnetometer has no magnetometer_y, magnetometer_z"),
        ({"patterns": HEADING, "values": {"pich": TextValue()}}, "values.pich", "did you mean 'pitch'?"),
        ({"patterns": HEADING, "values": {"pitch": TextValue()}}, "patterns", "pitch has no pitch"),
        ({"patterns": HEADING, "values": {"roll": TextValue("heding")}}, "values.roll.fields", "mean 'heading'?"),
        ({"patterns": HEADING, "values": {"heading": TextValue(unit="uT")}}, "values.heading.unit", "degrees, rad"),
        ({"format": "json", "values": {"dip": TextValue(("a", "b"))}}, "values.dip.fields", "are 2, and it has 1 numb"),
        ({"format": "csv", "values": {"dip": TextValue(0)}}, "values.dip.fields", "no column 0"),
        ({"format": "csv", "columns": ("a",), "values": {"dip": TextValue(2)}}, "values.dip.fields", "no column 2"),
        ({"format": "csv", "columns": ("dips",), "values": {"dip": TextValue("dib")}}, "values.dip.fields", "'dips'?"),
        ({"format": "csv", "columns": ("a",), "values": {"dip": TextValue()}}, "values.dip", "dip has no dip"),
    ],
)
def test_a_table_that_contradicts_itself_is_refused_with_its_place(table: dict[str, Any], key: str, words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)) as caught:
        text_interface(TextDevice(**table), lambda key: f"rig.toml:{len(key)}")
    assert str(caught.value).startswith(f"rig.toml:{len(key)}: device.text.{key}: ")


def test_a_count_needs_a_scale_and_a_command_bytes() -> None:
    with pytest.raises(RigValueError, match="needs a scale"):
        TextValue(unit="count")
    with pytest.raises(RigValueError, match="must not be 0"):
        TextValue(scale=0.0)
    with pytest.raises(RigValueError, match="not a byte") as caught:
        TextCommands(after_tumble="→")
    assert caught.value.key == "after_tumble"


@pytest.mark.parametrize(
    ("number", "word", "unit", "converted"),
    [
        (math.pi, "rad", "deg", 180.0),
        (1.0, "rad/s", "dps", 57.29578),
        (500.0, "mdps", "dps", 0.5),
        (3600.0, "deg/h", "dps", 1.0),
        (1000.0, "mg", "g", 1.0),
        (9.80665, "m/s2", "g", 1.0),
        (50_000.0, "nT", "uT", 50.0),
        (0.5, "G", "uT", 50.0),
        (500.0, "mG", "uT", 50.0),
        (0.05, "mT", "uT", 50.0),
        (0.5, "gauss", "uT", 50.0),
        (300.15, "K", "degC", 27.0),
        (212.0, "degF", "degC", 100.0),
        (21.0, "°C", "degC", 21.0),
    ],
)
def test_units_convert(number: float, word: str, unit: str, converted: float) -> None:
    result = conversion(word, unit)
    assert result is not None
    assert result.factor * number + result.offset == pytest.approx(converted)


@pytest.mark.parametrize("quantity", Quantity)
def test_every_quantity_takes_its_own_unit_and_no_foreign_one(quantity: Quantity) -> None:
    assert conversion(quantity.unit, quantity.unit) == conversion("", "")
    assert conversion("furlong", quantity.unit) is None
    assert all(conversion(word, quantity.unit) for word in unit_words(quantity.unit))
