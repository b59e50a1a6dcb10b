"""The page about bisection: its options, exit codes and names in JSON are those of the command."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import click

from hiltest.campaigns.bisection import FirstWorse
from hiltest.campaigns.judged_commit import JudgedCommit
from hiltest.commands.bisect import SCHEMA, bisect

PAGE = (Path(__file__).parents[2] / "docs" / "bisect.md").read_text(encoding="utf-8")


def test_every_option_and_exit_code_is_on_the_page() -> None:
    for parameter in bisect.params:
        if isinstance(parameter, click.Option):
            assert f"{max(parameter.opts, key=len)}" in PAGE
    told = re.findall(r"^  (\d+) ", bisect.epilog or "", re.M)
    assert told == re.findall(r"^\| (\d+) \|", PAGE, re.M)


def test_every_name_in_json_is_on_the_page() -> None:
    assert f"`{SCHEMA}`" in PAGE
    for field in (*fields(FirstWorse), *fields(JudgedCommit)):
        assert f"`{field.name}`" in PAGE, field.name
