"""The README's commands, options and tables are what the program has."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from hiltest.cli import EXIT_CODES
from hiltest.settings import OPTIONS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SH_BLOCKS = re.findall(r"^```sh\n(.*?)^```", README, re.M | re.S)
COMMANDS = re.findall(r"`(hiltest (?:run|init)[^`]*)`", README)


def test_the_first_two_blocks_are_one_line_each() -> None:
    main_job, tests = SH_BLOCKS[:2]
    assert main_job.count("\n") == tests.count("\n") == 1
    assert main_job.rstrip().endswith("/hiltest run")
    assert tests.rstrip().endswith("/tox")


def test_exit_codes_are_those_of_the_help() -> None:
    table = {int(code): text for code, text in re.findall(r"^\| (\d+) \| (.*) \|$", README, re.M)}
    listed = re.findall(r"^ +(\d+) +(.*)$", EXIT_CODES, re.M)
    assert table == {int(code): text for code, text in listed}


def test_every_option_of_the_plugin_is_named() -> None:
    assert set(re.findall(r"--hil-[a-z]+", README)) >= {option.flag for option in OPTIONS}


@pytest.mark.parametrize("command", sorted(set(COMMANDS)))
def test_every_command_is_understood(command: str, tmp_path: Path) -> None:
    _, *arguments = shlex.split(command)
    if arguments[0] == "run":
        arguments += ([] if "--" in arguments else ["--"]) + ["--collect-only", "-q"]
    done = subprocess.run(
        [sys.executable, "-m", "hiltest", *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_file_that_is_linked_is_there() -> None:
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if "://" not in link]
    assert [link for link in links if not (ROOT / link).exists()] == []
