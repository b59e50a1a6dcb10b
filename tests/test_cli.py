"""The command ``hiltest``: help, usage errors, init and seed ranges. Runs on a board are in end_to_end."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hiltest.report.verdict import WORDS, ExitCode


def hiltest(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder, as a user would."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    return subprocess.run(
        [sys.executable, "-m", "hiltest", *arguments], cwd=folder, env=environment, capture_output=True, text=True,
        check=False,
    )


@pytest.mark.parametrize("command", [["--help"], ["run", "--help"]])
def test_help_lists_every_exit_code(tmp_path: Path, command: list[str]) -> None:
    result = hiltest(*command, folder=tmp_path)
    assert result.returncode == 0
    codes = [int(line.split()[0]) for line in result.stdout.split("Exit codes:")[1].strip().splitlines()]
    assert codes == sorted(ExitCode)
    assert set(WORDS) == set(ExitCode)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["run", "--sed", "1"], "No such option '--sed'"),
        (["run", "--seeds", "9..1"], "'9..1' is not a range of seeds; write for example 1..100"),
        (["run", "--seeds", "5"], "'5' is not a range of seeds"),
        (["run", "--seeds", "1..2", "--seed", "1"], "neither with --seed nor with --hil-port"),
        (["run", "--seeds", "1..2", "--hil-port", "/dev/ttyACM0"], "neither with --seed nor with --hil-port"),
        (["run", "--poses", "some"], "'some' is not one of 'all', 'level'"),
        (["run", "--seed", "x"], "'x' is not a seed"),
        (["run", "--rig", "gone"], "no rig file 'gone'; rigs here: frdm-k64f, "),
        (["dance"], "No such command 'dance'"),
    ],
)
def test_a_wrong_command_line_ends_with_4_and_says_why(tmp_path: Path, arguments: list[str], complaint: str) -> None:
    result = hiltest(*arguments, folder=tmp_path)
    assert result.returncode == 4
    assert complaint in result.stderr
    assert list(tmp_path.iterdir()) == [], "a usage error leaves nothing behind"


def test_init_copies_suites_and_rigs_and_nothing_else(tmp_path: Path) -> None:
    result = hiltest("init", "bench", folder=tmp_path)
    assert result.returncode == 0
    assert f"cd {Path('bench')} && hiltest run" in result.stdout
    copied = {path.relative_to(tmp_path / "bench").as_posix() for path in (tmp_path / "bench").rglob("*")}
    assert {"hil/suites/test_heading.py", "hil/suites/conftest.py", "hil/rigs/virtual-k64f.toml"} <= copied
    assert not [name for name in copied if "__pycache__" in name]
    assert {Path(name).parts[1] for name in copied if len(Path(name).parts) > 1} == {"suites", "rigs"}


def test_init_does_not_overwrite(tmp_path: Path) -> None:
    suite = tmp_path / "hil" / "suites" / "test_mine.py"
    suite.parent.mkdir(parents=True)
    suite.write_text("mine")
    result = hiltest("init", ".", folder=tmp_path)
    assert result.returncode == 4
    assert "is already there; nothing was copied" in result.stderr
    assert [path.name for path in (tmp_path / "hil").iterdir()] == ["suites"]
    assert suite.read_text() == "mine"


def test_the_suites_of_the_working_tree_are_the_ones_that_run(tmp_path: Path) -> None:
    suite = tmp_path / "hil" / "suites" / "test_mine.py"
    suite.parent.mkdir(parents=True)
    suite.write_text("def test_mine():\n    pass\n")
    result = hiltest("run", "--", "-v", folder=tmp_path)
    assert "hil/suites/test_mine.py::test_mine PASSED" in result.stdout
    assert result.returncode == 0


def test_what_follows_two_dashes_goes_to_pytest(tmp_path: Path) -> None:
    result = hiltest("run", "--", "--collect-only", "-q", "-k", "cycles", folder=tmp_path)
    assert result.returncode == 0
    assert "test_cycles.py::test_cycles_of_every_calibrator" in result.stdout
    assert "test_heading" not in result.stdout


def test_the_suites_run_in_their_order(tmp_path: Path) -> None:
    result = hiltest("run", "--", "--collect-only", "-q", folder=tmp_path)
    files = [line.split("::")[0].rsplit("/", maxsplit=1)[-1] for line in result.stdout.splitlines() if "::" in line]
    assert [name for name, after in zip(files, [*files[1:], ""], strict=True) if name != after] == [
        # The second time at the known angles, which the heading suite takes.
        "test_identity.py", "test_accelerometer.py", "test_gyroscope.py", "test_accelerometer.py", "test_heading.py",
        "test_cycles.py", "test_link.py",
    ]
    assert not (tmp_path / "hil-out" / "run.json").exists(), "collecting needs no board and leaves no record"
