"""The command ``hiltest``: help, usage errors, init and seed ranges. Runs on a board are in end_to_end."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest

from hiltest import commands
from hiltest.commands.cli import every_command
from hiltest.run_record.exit_codes import WORDS, ExitCode
from hiltest.run_record.reader import read_record
from hiltest.session.settings import OPTIONS

from . import in_process

COMMANDS = Path(commands.__file__).parent
VERBS = """
Accept Begin Build Calibrate Check Compare Compile Compute Connect Copy Count Decode Diagnose End Explain Export Fail
Find Fit Flash Give Judge Keep List Listen Load Log Make Measure Name Open Pass Play Plot Print Propose Read Record
Repeat Require Run Save Search Select Serve Set Show Start Stop Take Test Time Tolerate Use Weight Write
"""

pytestmark = pytest.mark.slow


def hiltest(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder, as a user would."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    return subprocess.run(
        [sys.executable, "-m", "hiltest", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_setting_is_an_option_of_run_without_a_prefix() -> None:
    options = {name for parameter in dict(every_command())["run"].params for name in parameter.opts}
    assert {f"--{setting.name}" for setting in OPTIONS} <= options


@pytest.mark.parametrize(
    ("old", "new", "hints"),
    [
        ("calibrate --hil-port /dev/gone", "calibrate --port /dev/gone", 1),
        ("calibrate --hil-port=/dev/gone", "calibrate --port=/dev/gone", 1),
        ("device try --rig gone --for 1", "listen --rig gone --seconds 1", 2),
        ("fit-imu gone.csv", "fit imu gone.csv", 1),
        ("serve --pty --rig gone", "serve --rig gone", 1),
        ("bench --rig gone", "run --page --rig gone", 0),
        (
            "bisect HEAD HEAD --firmware a --rig gone -- make --pty",
            "bisect HEAD HEAD --firmware a --rig gone -- make",
            0,
        ),
    ],
)
def test_an_old_spelling_works_and_is_hinted_at(tmp_path: Path, old: str, new: str, hints: int) -> None:
    results = [in_process.hiltest(*words.split(), folder=tmp_path) for words in (old, new)]
    assert [result.returncode for result in results] == [4, 4]
    before, after = (result.stderr.splitlines() for result in results)
    assert before[hints:] == after
    assert [line.split(":")[0] for line in before[:hints]] == ["hint"] * hints


def test_the_help_of_bench_has_its_own_name() -> None:
    page = in_process.hiltest("bench", "--help").stdout
    assert page.startswith("Usage: hiltest bench [OPTIONS]")
    assert "pytest: hiltest bench -- -k heading" in " ".join(page.split())
    assert in_process.hiltest("bench", "--nonsense").stderr.startswith("Usage: hiltest bench [OPTIONS]")


def test_every_help_begins_with_a_verb() -> None:
    helped = [item for _, command in every_command() for item in (command, *command.params)]
    helps = [item.help or "" for item in helped if isinstance(item, click.Command | click.Option)]
    assert {text.split()[0] for text in helps} == set(VERBS.split())


@pytest.mark.parametrize("command", [["--help"], ["run", "--help"]])
def test_help_lists_every_exit_code(tmp_path: Path, command: list[str]) -> None:
    result = in_process.hiltest(*command, folder=tmp_path)
    assert result.returncode == 0
    told = result.stdout.split("Exit codes:")[1].strip().splitlines()
    codes = [int(line.split()[0]) for line in told if line.split()[0].isdigit()]
    assert codes == sorted(ExitCode)
    assert set(WORDS) == set(ExitCode)


@pytest.mark.parametrize(("command", "codes"), [("serve", [0, 4, 20]), ("profile", [0, 2, 4, 20])])
def test_help_lists_the_exit_codes_of_a_command_and_no_other(tmp_path: Path, command: str, codes: list[int]) -> None:
    told = in_process.hiltest(command, "--help", folder=tmp_path).stdout.split("Exit codes:")[1].strip().splitlines()
    assert [int(line.split()[0]) for line in told if line.split()[0].isdigit()] == codes
    assert "every test passed" not in "".join(told)


@pytest.mark.parametrize(
    "command",
    [
        "",
        "run",
        "compare",
        "baseline save",
        "baseline update",
        "bisect",
        "report trend",
        "report",
        "report export",
        "timing measure",
        "study",
        "profile worst",
    ],
)
def test_help_fits_a_terminal_of_80_columns(tmp_path: Path, command: str) -> None:
    told = in_process.hiltest(*command.split(), "--help", folder=tmp_path).stdout
    assert [line for line in told.splitlines() if len(line) > 80] == []


def test_help_shows_every_command_in_a_group_with_a_whole_sentence(tmp_path: Path) -> None:
    told = in_process.hiltest("--help", folder=tmp_path).stdout.split("Exit codes:")[0]
    lines = dict(re.findall(r"^  ([a-z][a-z ]*?)  +(.+)$", told, re.M))
    assert lines.keys() == {path.stem.replace("_", " ") for path in COMMANDS.glob("[!_]*.py")} - {"cli", "options"}
    assert [line for line in lines.values() if not line.endswith(".") or line.endswith("...")] == []


def test_a_file_name_that_is_no_text_is_told_all_the_same(tmp_path: Path) -> None:
    (tmp_path / os.fsdecode(b"caf\xe9.csv")).write_text("x,y,z\n1,2,3\n")
    result = hiltest("fit", os.fsdecode(b"caf\xe9.csv"), "--on", "host", folder=tmp_path)
    assert (result.returncode, result.stderr) == (1, "")
    assert result.stdout.startswith("caf\\udce9.csv: 1 points")


def test_a_full_disk_is_told_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "cloud.csv").write_text("x,y,z\n1,2,3\n")
    with Path("/dev/full").open("w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "hiltest", "fit", "cloud.csv", "--on", "host"],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert "ERROR: cannot write the output: No space left on device" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["run", "--", "-p", "no:hiltest"], "hiltest run needs the pytest plugin hiltest: leave out -p no:hiltest"),
        (["run", "--seeds", "1..2", "--serial", "7"], "--page and --serial are for the run of one board"),
        (["bench", "--json"], "--json hides the address of the page"),
        (["run", "--firmware", "other.elf", "--", "--hil-out=mine.elf"], "other.elf: No such file or directory"),
        (["run", "--rig", "gone"], "no rig file 'gone'; rigs here: frdm-k64f, "),
    ],
)
def test_a_mistake_that_only_the_session_sees_ends_with_4_and_is_named(
    tmp_path: Path, arguments: list[str], complaint: str
) -> None:
    result = hiltest(*arguments, folder=tmp_path)
    assert result.returncode == 4
    assert complaint in result.stderr
    assert list(tmp_path.iterdir()) == [], "a usage error leaves nothing behind"


def test_a_conftest_cannot_change_the_exit_code_of_a_failed_run(tmp_path: Path) -> None:
    suites = tmp_path / "hil" / "suites"
    suites.mkdir(parents=True)
    (suites / "conftest.py").write_text(
        "import pytest\n\n\n@pytest.hookimpl(trylast=True)\ndef pytest_sessionfinish(session):\n"
        "    session.exitstatus = 0\n"
    )
    (suites / "test_mine.py").write_text("def test_mine(board):\n    assert board.identity.slots == 3\n")
    result = hiltest("run", folder=tmp_path)
    assert result.returncode == 1
    assert "FAIL" in result.stdout


@pytest.mark.parametrize(
    ("columns", "command"),
    [("time_s,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps", ["fit", "imu"]), ("time_s,gx_dps,gy_dps,gz_dps", ["fit", "noise"])],
)
def test_fit_gives_a_log_without_a_magnetometer_to_the_command_for_its_sensors(
    tmp_path: Path, columns: str, command: list[str]
) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.1, (3000, columns.count(",")))
    rows = np.column_stack([0.01 * np.arange(len(noise)), noise])
    np.savetxt(tmp_path / "log.csv", rows, fmt="%.5f", delimiter=",", header=columns, comments="")
    one, other = (hiltest(*verb, "log.csv", "--json", folder=tmp_path) for verb in (["fit"], command))
    assert one.stdout == other.stdout != ""
    assert one.returncode == other.returncode


@pytest.mark.parametrize("name", ["folder", "file.py"])
def test_a_folder_or_a_file_without_tests_is_not_judged_by_the_suites(tmp_path: Path, name: str) -> None:
    if name == "folder":
        (tmp_path / name).mkdir()
    else:
        (tmp_path / name).write_text("def calibrate(samples):\n    return None\n", encoding="utf-8")
    result = hiltest("run", name, folder=tmp_path)
    assert result.returncode == 4
    assert f" {name} has no tests; leave it out to run only the suites" in result.stdout + result.stderr


def test_init_copies_what_a_bench_needs_and_nothing_else(tmp_path: Path) -> None:
    result = hiltest("init", "bench", folder=tmp_path)
    assert result.returncode == 0
    assert "cd bench && hiltest run --baseline hil/baselines/virtual-k64f.json" in result.stdout
    copied = {path.relative_to(tmp_path / "bench").as_posix() for path in (tmp_path / "bench").rglob("*")}
    assert {"hil/suites/test_heading.py", "hil/suites/conftest.py", "hil/rigs/virtual-k64f.toml"} <= copied
    assert not [name for name in copied if "__pycache__" in name]
    assert "conftest.py" in copied  # of `pytest-benchmark compare`
    folders = {Path(name).parts[1] for name in copied if len(Path(name).parts) > 1}
    assert folders == {"suites", "rigs", "benchmarks", "baselines"}
    assert {name for name in copied if "/baselines/" in name} == {"hil/baselines/virtual-k64f.json"}


def test_init_does_not_overwrite(tmp_path: Path) -> None:
    suite = tmp_path / "hil" / "suites" / "test_mine.py"
    suite.parent.mkdir(parents=True)
    suite.write_text("mine")
    result = hiltest("init", ".", folder=tmp_path)
    assert result.returncode == 4
    assert "already exists; nothing was copied" in result.stderr
    assert [path.name for path in (tmp_path / "hil").iterdir()] == ["suites"]
    assert suite.read_text() == "mine"


@pytest.mark.parametrize("arguments", [["run"], ["run", "--seeds", "1..2"]], ids=" ".join)
@pytest.mark.parametrize(
    ("out", "complaint"),
    [("taken", "taken is a file"), ("taken/deeper", "taken is a file"), ("/proc/hiltest", "No such file")],
)
def test_a_folder_that_cannot_be_is_refused_before_anything_runs(
    tmp_path: Path, arguments: list[str], out: str, complaint: str
) -> None:
    (tmp_path / "taken").write_text("mine")
    result = hiltest(*arguments, "--out", out, folder=tmp_path)
    assert result.returncode == 4, result.stdout + result.stderr
    assert f"ERROR: cannot write to the folder {out if out[0] == '/' else ''}" in result.stderr
    assert f"{complaint}" in result.stderr
    assert "name another folder with --out" in result.stderr
    assert "Traceback" not in result.stdout + result.stderr
    assert "test_" not in result.stdout
    assert (tmp_path / "taken").read_text() == "mine"


@pytest.mark.parametrize("folder", ["taken", "taken/deeper", "/proc/hiltest"])
def test_init_into_a_bad_place_is_a_usage_error(tmp_path: Path, folder: str) -> None:
    (tmp_path / "taken").write_text("mine")
    result = hiltest("init", folder, folder=tmp_path)
    assert result.returncode == 4
    assert "Traceback" not in result.stderr
    assert folder in result.stderr


def test_the_suites_of_the_working_tree_are_the_ones_that_run(tmp_path: Path) -> None:
    suite = tmp_path / "hil" / "suites" / "test_mine.py"
    suite.parent.mkdir(parents=True)
    suite.write_text("def test_mine():\n    pass\n")
    result = hiltest("run", "--", "-v", folder=tmp_path)
    assert "hil/suites/test_mine.py::test_mine PASSED" in result.stdout
    # And none of them measures anything: the default rig has limits.
    assert result.returncode == 22
    assert "NOT EVALUATED. heading.direct.max (nothing measured" in result.stdout
    (test,) = read_record(tmp_path / "hil-out" / "run.json").run.tests
    assert test.id == "test_mine.py::test_mine"


def test_what_follows_two_dashes_goes_to_pytest(tmp_path: Path) -> None:
    result = hiltest("run", "--", "--collect-only", "-q", "-k", "cycles", folder=tmp_path)
    assert result.returncode == 0
    assert "test_cycles.py::test_cycles_of_every_calibrator" in result.stdout
    assert "test_heading" not in result.stdout


def test_the_suites_run_in_their_order(tmp_path: Path) -> None:
    result = hiltest("run", "--suite", "full", "--", "--collect-only", "-q", folder=tmp_path)
    files = [line.split("::")[0].rsplit("/", maxsplit=1)[-1] for line in result.stdout.splitlines() if "::" in line]
    assert [name for name, after in zip(files, [*files[1:], ""], strict=True) if name != after] == [
        # The second time at the known angles, which the heading suite takes.
        "test_identity.py",
        "test_accelerometer.py",
        "test_gyroscope.py",
        "test_accelerometer.py",
        "test_heading.py",
        "test_dpi.py",
        "test_streams.py",
        "test_budget.py",
        "test_cycles.py",
        "test_fusion.py",
        "test_link.py",
        "test_commands.py",
        "test_sensors.py",
        "test_worst_case.py",
        "test_refusals.py",
        "test_hard_fits.py",
        "test_attitudes.py",
    ]
    assert not (tmp_path / "hil-out" / "run.json").exists(), "collecting needs no board and leaves no record"
