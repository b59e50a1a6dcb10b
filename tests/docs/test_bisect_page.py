"""The page about bisection: its options, exit codes and names in JSON are those of the command."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

from hiltest.campaigns.bisection import FirstWorse
from hiltest.campaigns.judged_commit import JudgedCommit
from hiltest.commands.bisect import SCHEMA, bisect

PAGE = (Path(__file__).parents[2] / "docs" / "bisect.md").read_text(encoding="utf-8")


def test_every_exit_code_is_on_the_page() -> None:
    codes = re.findall(r"^  (\d+) ", bisect.epilog or "", re.M)
    assert codes == re.findall(r"^\| (\d+) \|", PAGE, re.M)


def test_every_name_in_json_is_on_the_page() -> None:
    assert f"`{SCHEMA}`" in PAGE
    for field in (*fields(FirstWorse), *fields(JudgedCommit)):
        assert f"`{field.name}`" in PAGE, field.name
