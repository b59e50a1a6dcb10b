"""The page about comparing: its commands run, its codes and its rig's lines are the program's."""

from __future__ import annotations

import re
import shlex
import subprocess
from configparser import ConfigParser
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.measurement import Tolerance
from hiltest.rig.rig_file import load_rig
from hiltest.verdict.baseline_file import read_baseline

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "compare.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S) for line in block.splitlines()]


def _run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return run_module(*shlex.split(command), folder=folder)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> list[subprocess.CompletedProcess[str]]:
    """The page's commands, run one after the other in one folder."""
    folder = tmp_path_factory.mktemp("reader")
    return [_run(command, folder) for command in COMMANDS]


def test_every_command_ends_as_the_page_says(done: list[subprocess.CompletedProcess[str]]) -> None:
    answer = "\n".join(item.stdout + item.stderr for item in done)
    # The two runs are of one firmware, so that there is nothing to accept.
    ends = [4 if "baseline update" in command else 0 for command in COMMANDS]
    assert [item.returncode for item in done] == ends, answer
    assert done[ends.index(4)].stderr.startswith("ERROR: nothing changes: ")


def test_nothing_is_worse_between_two_runs_of_one_firmware(done: list[subprocess.CompletedProcess[str]]) -> None:
    (sentence,) = re.findall(r"`(May be merged .*\(against baseline\.json\): \d+ unchanged\.)`", PAGE)
    output = next(item.stdout for command, item in zip(COMMANDS, done, strict=True) if " compare " in command)
    assert sentence in output.splitlines()
    (all_of_them,) = map(int, re.findall(r": (\d+) unchanged\.", PAGE))
    ((worse, others),) = re.findall(r"(\d+) worse: .*?; (\d+) unchanged\.", PAGE, re.S)
    assert int(worse) + int(others) == all_of_them


def test_codes_are_those_of_the_help() -> None:
    answer = re.sub(r"\n {8}(?=\w)", " ", _run("hiltest compare --help", ROOT).stdout)
    listed = dict(re.findall(r"^ +(\d+) +(.*)$", answer, re.M))
    table = dict(re.findall(r"^\| (\d+) \| (.*) \|$", PAGE, re.M))
    assert table == {code: text for code, text in listed.items() if code != "2"}


def test_the_rig_s_lines_are_understood(tmp_path: Path) -> None:
    (lines,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)
    rig = (ROOT / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(f"{rig}\n{lines}", encoding="utf-8")
    assert load_rig(tmp_path / "rig.toml").tolerances == {
        "heading.direct.max": Tolerance(0.05, 0.02),
        "compass.lag": Tolerance(3.0, 0.0),
    }


def test_the_committed_baseline_is_where_the_page_says() -> None:
    (name,) = re.findall(r"`(hil/baselines/[^`]+)`", PAGE)
    assert read_baseline(ROOT / name).seeds == tuple(range(1, 9))
    tox = ConfigParser()
    tox.read(ROOT / "tox.ini", encoding="utf-8")
    assert tox.has_section("testenv:baseline")
