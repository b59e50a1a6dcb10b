"""The page about packets: its examples run, its command prints what it shows, its table has every column."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from tests.command_files import run

from hiltest.interfaces.packets import KINDS

PAGE = (Path(__file__).parents[2] / "docs" / "decode.md").read_text(encoding="utf-8")
RECORD, USE = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
DECODE, FIT = re.findall(r"^```sh\nhiltest (.*?)\n```", PAGE, re.M | re.S)
SHOWN, _ = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)


def test_the_examples_run_and_print_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(RECORD + USE, {})
    assert run(*shlex.split(DECODE)) == 0
    assert capsys.readouterr().out == SHOWN
    assert run(*shlex.split(FIT)) == 1  # points on a line are no calibration
    assert "41 points" in capsys.readouterr().out


def test_the_table_has_the_first_column_of_every_quantity() -> None:
    rows = dict(re.findall(r"^\| (\d) \| (.*) \|$", PAGE, re.M))
    for kind in KINDS:
        named = set(re.findall(r"`(\w+)`", rows[str(kind.type)]))
        quantities = {re.sub(r"_(?:[xyz]|[xyz][xyz])(?=_|$)", "", item) for item in named}
        answer = {re.sub(r"_(?:[xyz]|[xyz][xyz])(?=_|$)", "", column) for column in kind.columns()} - {"q1", "q2"}
        assert answer <= quantities
