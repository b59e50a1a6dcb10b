"""The README's commands, options and tables are what the program has."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.finished_run import run_module

from hiltest.commands.options import EXIT_CODES
from hiltest.session.settings import OPTIONS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SH_BLOCKS = re.findall(r"^```sh\n(.*?)^```", README, re.M | re.S)
SUITES = re.findall(r"^```python\n(.*?)^```", README, re.M | re.S)
COMMANDS = re.findall(r"`(hiltest [a-z][^`]*)`", README)


def test_the_first_two_blocks_are_one_line_each() -> None:
    main_job, tests = SH_BLOCKS[:2]
    assert main_job.count("\n") == tests.count("\n") == 1
    assert main_job.rstrip().endswith("/hiltest run")
    assert tests.rstrip().endswith("/tox")


def test_exit_codes_are_those_of_the_help() -> None:
    table = {int(code): text for code, text in re.findall(r"^\| (\d+) \| (.*) \|$", README, re.M)}
    listed = re.findall(r"^ +(\d+) +(.*)$", re.sub(r"\n {6}(?=\w)", " ", EXIT_CODES), re.M)
    assert table == {int(code): text for code, text in listed}


def test_every_option_of_the_plugin_is_named() -> None:
    assert set(re.findall(r"--hil-[a-z]+", README)) == {option.flag for option in OPTIONS}


@pytest.mark.parametrize("command", sorted(set(COMMANDS)))
def test_every_command_is_understood(command: str, tmp_path: Path) -> None:
    _, *arguments = shlex.split(command)
    if arguments[0] == "run":
        for elf in (argument for argument in arguments if argument.endswith(".elf")):
            (tmp_path / elf).parent.mkdir(exist_ok=True)
            shutil.copy(ROOT / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf", tmp_path / elf)
        arguments += ([] if "--" in arguments else ["--"]) + ["--collect-only", "-q"]
    if arguments[0] not in ("run", "init", "fit", "profile") or arguments[1] in ("imu", "worst"):
        # It would serve until somebody ends it, calibrate a board or want a log or a record, as the tests of their own
        # pages do. A wrong option is refused all the same.
        arguments += ["--help"]
    if arguments[0] == "fit" and arguments[1] != "imu":
        directions = np.random.default_rng(1).normal(size=(100, 3))
        readings_ut = 48.5 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [10.0, -20.0, 5.0]
        np.savetxt(tmp_path / arguments[1], readings_ut, delimiter=",", header="x_ut,y_ut,z_ut", comments="")
    done = run_module("hiltest", *arguments, folder=tmp_path)
    # A gate that no test runs for is no pass, and is told from an option or a file that is wrong, which is 4.
    gates = [f"{item[2:]} is {base}" for item, base in pairwise(arguments) if item in ("--baseline", "--against")]
    assert done.returncode == (22 if gates else 0), done.stdout + done.stderr
    assert all(f"{gate}, and no test ran" in done.stdout.rstrip().splitlines()[-1] for gate in gates)


def _run_suite(folder: Path, suite: str) -> subprocess.CompletedProcess[str]:
    (folder / "test_field.py").write_text(suite, encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    command = [sys.executable, "-m", "pytest", "-q", "test_field.py", "--hil-out", "out"]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_suite_of_one_s_own_runs_as_it_stands(tmp_path: Path) -> None:
    (suite,) = SUITES
    done = _run_suite(tmp_path, suite)
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
    measured = {measurement["name"]: measurement for measurement in record["measurements"]}["field.strength"]
    assert (measured["outcome"], measured["unit"]) == ("pass", "uT")
    # The world's field is 48.5 uT; its hard iron of 5.2 uT and soft iron of 3 % are still in the reading.
    assert measured["value"] == pytest.approx(48.5, abs=5.2 + 0.03 * 48.5)


def test_the_suite_of_one_s_own_fails_when_the_field_is_another(tmp_path: Path) -> None:
    (suite,) = SUITES
    done = _run_suite(tmp_path, suite.replace("rig.field.strength_ut", "25.0"))
    assert done.returncode == 1
    assert "field.strength" in done.stdout
