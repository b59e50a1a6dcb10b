"""The page about compasses that print lines: its tables are read, and its commands print what it shows."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from tests.command_files import run

from hiltest.interfaces.quantities import Quantity
from hiltest.interfaces.text_table import text_interface
from hiltest.measurement.units import conversion
from hiltest.rig.text_device import TextDevice

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "text-compass.md").read_text(encoding="utf-8")
RIG = (ROOT / "hil" / "rigs" / "text-compass.toml").read_text(encoding="utf-8")
MINE, JSON, CSV = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
TRY, RUN = re.findall(r"^```sh\nhiltest (.*?)\n```", PAGE, re.M | re.S)
PRINTED, REFUSED, TRIED, PASSED = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the page's reader: the rig that ships, with the page's table."""
    monkeypatch.chdir(tmp_path)
    begin, end = RIG.index("[device]"), RIG.index("[field]")
    Path("mine.toml").write_text(f"{RIG[:begin]}{MINE}\n{RIG[end:]}", encoding="utf-8")
    return tmp_path


def test_trying_prints_what_the_page_shows(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*shlex.split(TRY)) == 0
    assert capsys.readouterr().out == TRIED
    assert PRINTED in TRIED


def test_a_wrong_name_is_refused_as_the_page_shows(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.toml").write_text(Path("mine.toml").read_text().replace("<roll>", "<rol>"))
    assert run(*shlex.split(TRY)) == 4
    errors = capsys.readouterr().err
    place = re.compile(r"\S*mine\.toml:\d+")
    assert place.sub("", errors) == place.sub("", REFUSED)


@pytest.mark.ci
def test_running_ends_as_the_page_says(bench: Path) -> None:
    command = [sys.executable, "-m", "hiltest", *shlex.split(RUN)]
    done = subprocess.run(command, cwd=bench, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    # The worst of 36 headings moves by some hundredths with every change of the procedure.
    number = re.compile(r"\d+\.\d+")
    assert number.sub("", PASSED) in number.sub("", done.stdout)


@pytest.mark.parametrize(
    ("text", "lines", "quantities"),
    [
        (JSON, [re.findall(r"# (\{.*\})", JSON)[0]], {"heading", "magnetometer", "calibrated"}),
        (CSV, [re.findall(r"# (yaw.*)", CSV)[0], "90,251,-23,470"], {"heading", "magnetometer"}),
    ],
)
def test_the_other_forms_understand_their_lines(text: str, lines: list[str], quantities: set[str]) -> None:
    table = TypeAdapter(TextDevice).validate_json(json.dumps(tomllib.loads(text)["device"]["text"]))
    interface = text_interface(table, str)
    interface.feed(b"\n.\n", 0.0)
    (observed,) = interface.feed("\n".join([*lines, ""]).encode(), 0.0)
    assert {value.key for value in observed.values} == quantities
    magnetometer = observed.values[Quantity.named("magnetometer")]
    assert magnetometer == pytest.approx([25.1, -2.3, 47.0])


def test_the_tables_name_every_quantity_unit_and_key() -> None:
    rows = dict(re.findall(r"^\| (`.*?) \| ?([a-zA-Z%]*) \|", PAGE[PAGE.index("| quantity |") :], re.M))
    named = {name: unit for names, unit in rows.items() for name in re.findall(r"`(\w+)`", names)}
    quantities = {item.key: item.unit for item in Quantity}
    assert {name: unit for name, unit in named.items() if name in quantities} == quantities
    for unit, words in re.findall(r"^\| `.*? \| (\w+|%) \| (.+) \|$", PAGE[PAGE.index("| quantity |") :], re.M):
        assert all(conversion(word, unit) for word in re.findall(r"[^\s,()]+", words)), words
    keys = set(re.findall(r"^\| `([a-z_]+)", PAGE[PAGE.index("| key |") : PAGE.index("| quantity |")], re.M))
    assert keys | {"separator"} == {field.name for field in fields(TextDevice)}
