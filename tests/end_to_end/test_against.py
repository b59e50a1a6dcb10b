"""Two firmwares in one command: what is wrong is found before minutes are spent, and what is cut short shows it."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest
from tests.finished_run import run_module
from tests.patched_firmware import HANG, OVERFLOW, RETURN_0, UNDEFINED, patched

from hiltest.link.messages import PROTOCOL_VERSION
from hiltest.run_record.reader import read_record
from hiltest.session.gate import SessionGate
from hiltest.session.older_firmware import OlderFirmware

from .firmware_edits import NEXT_PROTOCOL, Edit, FirmwareCopy

OLD = Path(__file__).parents[2] / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf"
WAIT_S = 300.0

# The older firmware's test says that it runs, and then takes its time if it is told to.
SUITE = """
import os
import time


def test_current(board, measure, hil_settings):
    measure("lamp.current", 2.0, "mA")
    if "against" in hil_settings.out.parts:
        with open("older", "a") as file:
            print(os.getpid(), file=file, flush=True)
        time.sleep(float(os.environ.get("OLDER_TAKES_S", 0)))
"""


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A bench of one's own with a suite that takes no time, and a rig without limits."""
    for name in ("suites", "rigs"):
        (tmp_path / "hil" / name).mkdir(parents=True)
    (tmp_path / "hil" / "suites" / "test_lamp.py").write_text(SUITE, encoding="utf-8")
    rig = (Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    (tmp_path / "hil" / "rigs" / "virtual-k64f.toml").write_text(rig[: rig.index("[limits]")], encoding="utf-8")
    shutil.copy(OLD, tmp_path / "new.elf")
    return tmp_path


@pytest.fixture
def stop_older(bench: Path) -> Iterator[None]:
    """End the older firmware's run, which a killed command leaves behind."""
    yield
    for line in (bench / "older").read_text(encoding="utf-8").split():
        with_this_id = Path("/proc") / line / "cmdline"
        if with_this_id.exists() and b"hiltest" in with_this_id.read_bytes():
            os.kill(int(line), signal.SIGKILL)


def environment(**more: str) -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("HIL_")} | more


def hiltest(folder: Path, *arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
    return run_module("hiltest", *arguments, folder=folder, environment=environment(**more))


def stopped(folder: Path, by: signal.Signals, *arguments: str) -> int:
    """Run the command, and send it a signal while the older firmware runs; return its exit code."""
    command = [sys.executable, "-m", "hiltest", "run", *arguments]
    given = environment(OLDER_TAKES_S="600")
    with subprocess.Popen(command, cwd=folder, env=given, stdout=subprocess.DEVNULL) as running:
        ends_s = time.monotonic() + WAIT_S
        while not (folder / "older").exists() and running.poll() is None and time.monotonic() < ends_s:
            time.sleep(0.02)
        running.send_signal(by)
        return running.wait(WAIT_S)


UNSAID = "Cannot say whether it may be merged"
BOTH = ("--firmware", "new.elf", "--against", str(OLD))


@pytest.mark.usefixtures("stop_older")
@pytest.mark.parametrize(
    ("by", "code", "sentence"),
    [
        (signal.SIGKILL, -signal.SIGKILL, "CUT SHORT: 0 tests finished, 0 measurements kept."),
        (signal.SIGINT, 2, f"{UNSAID} (against hil-out/against): INTERRUPTED: {OLD} did not finish"),
    ],
    ids=["SIGKILL", "SIGINT"],
)
def test_stopped_while_the_older_firmware_runs_it_leaves_no_verdict_of_an_earlier_run(
    bench: Path, by: signal.Signals, code: int, sentence: str
) -> None:
    before = hiltest(bench, "run", *BOTH)
    assert before.returncode == 0, before.stdout + before.stderr
    assert "May be merged (against hil-out/against/run.json): PASS: " in " ".join(before.stdout.split())
    (bench / "older").unlink()
    assert stopped(bench, by, *BOTH) == code
    assert not (bench / "hil-out" / "against" / "run.json").exists() or by == signal.SIGINT
    result = hiltest(bench, "report", "hil-out")
    assert result.returncode == 0
    assert result.stdout.splitlines()[-1].startswith(sentence)
    assert not read_record(bench / "hil-out").run.verdict.complete
    compared = hiltest(bench, "compare", "hil-out", "hil-out")
    assert compared.returncode == 22
    assert "the run is incomplete" in compared.stdout


@pytest.mark.usefixtures("stop_older")
def test_a_campaign_that_is_killed_in_its_older_half_leaves_no_summary_of_an_earlier_one(bench: Path) -> None:
    (bench / "hil-out" / "seed-0001").mkdir(parents=True)
    for name in ("seeds.json", "seeds.md"):
        (bench / "hil-out" / name).write_text("{}", encoding="utf-8")
    assert stopped(bench, signal.SIGKILL, "--seeds", "1..1", *BOTH) == -signal.SIGKILL
    assert {path.name for path in (bench / "hil-out").iterdir()} == {"against", "command.lock"}


def no_file(elf: Path) -> None:
    elf.unlink()


def no_firmware(elf: Path) -> None:
    elf.write_text("not a firmware")


@pytest.mark.parametrize("seeds", [(), ("--seeds", "1..2"), ("--", "-n2", "--dist=loadgroup")], ids=" ".join)
@pytest.mark.parametrize(("spoil", "complaint"), [(no_file, "No such file"), (no_firmware, "new.elf: ")])
def test_a_new_firmware_that_cannot_run_is_found_before_the_older_one_runs(
    bench: Path, spoil: Callable[[Path], None], complaint: str, seeds: tuple[str, ...]
) -> None:
    if "-n2" in seeds:
        pytest.importorskip("xdist")
    spoil(bench / "new.elf")
    done = hiltest(bench, "run", *BOTH, *seeds)
    assert done.returncode == 4, done.stdout + done.stderr
    assert complaint in done.stderr
    assert not (bench / "older").exists()
    assert not (bench / "hil-out").exists(), "a usage error leaves nothing behind"


def test_a_new_firmware_of_another_protocol_is_found_before_the_older_one_runs(
    bench: Path, copy_of_the_firmware: FirmwareCopy
) -> None:
    copy_of_the_firmware.build(NEXT_PROTOCOL, bench / "new.elf")
    done = hiltest(bench, "run", *BOTH)
    assert done.returncode == 23, done.stdout + done.stderr
    assert not (bench / "older").exists()
    assert f"speaks protocol version {PROTOCOL_VERSION + 1}" in " ".join(done.stdout.split())


@pytest.mark.parametrize(
    ("arguments", "ini", "complaint"),
    [
        ({}, "hil_baseline = base.json", "--against and hil_baseline is base.json: a run has one base"),
        ({"HIL_PORT": "/dev/ttyACM0"}, "", "leave out --port"),
        ({}, "addopts = -p no:nothing --hil-baseline=base.json", "--against and --baseline is base.json"),
    ],
    ids=["ini", "port", "addopts"],
)
def test_what_does_not_go_with_it_is_found_before_the_older_firmware_runs(
    bench: Path, arguments: Mapping[str, str], ini: str, complaint: str
) -> None:
    (bench / "pytest.ini").write_text(f"[pytest]\n{ini}\n", encoding="utf-8")
    done = hiltest(bench, "run", *BOTH, **arguments)
    assert done.returncode == 4, done.stdout + done.stderr
    assert complaint in done.stderr
    assert not (bench / "older").exists()


@pytest.mark.parametrize(
    ("command", "function", "instructions", "crash"),
    [
        (
            ("--seeds", "1..2"),
            "command_average",
            HANG,
            r"the firmware is hung, in a branch to itself in command_average",
        ),
        (("--", "-n2"), "command_average", OVERFLOW, r"stack overflow: .* in command_average"),
        ((), "main", UNDEFINED, r"undefined instruction de00 at 0x\w+ in main"),
    ],
    ids=["hang in a campaign", "stack overflow in a worker", "at its start"],
)
def test_a_crash_that_the_older_firmware_does_not_have_may_not_be_merged(
    bench: Path, command: tuple[str, ...], function: str, instructions: tuple[int, ...], crash: str
) -> None:
    asks = "from hiltest.link.messages import Average\n" + SUITE.replace(
        "    measure(", "    board.session.request(Average(4))\n    measure("
    )
    (bench / "hil" / "suites" / "test_lamp.py").write_text(asks, encoding="utf-8")
    (bench / "new.elf").write_bytes(patched(OLD, [function], instructions))
    done = hiltest(bench, "run", *BOTH, *command)
    assert done.returncode == 1, done.stdout + done.stderr
    answer = " ".join(done.stdout.split())
    assert "Not to be merged (against hil-out/against" in answer
    reason = rf"the firmware crashes, and the base does not: .*{crash} \(\w+\.c:\d+\)"
    assert re.search(reason, answer)
    assert (bench / "older").exists()
    compared = hiltest(bench, "compare", "hil-out/against", "hil-out")
    assert compared.returncode == 1
    assert re.match(rf"Not to be merged .*: failed: {reason}", compared.stdout.splitlines()[1])
    crashed = hiltest(bench, "compare", "hil-out", "hil-out")
    assert crashed.returncode == 22, "the base has the same crash"
    assert "the firmware crashes: " in crashed.stdout


@pytest.mark.parametrize("limited", [False, True], ids=["worse", "out of its limit"])
def test_a_text_compass_that_rounds_to_whole_degrees_is_told_so(
    tmp_path: Path, copy_of_the_firmware: FirmwareCopy, limited: bool
) -> None:
    for decimals, name in ((1, "old.elf"), (0, "new.elf")):
        old = 'HDG=", state->heading_deg, 2)'
        copy_of_the_firmware.build_compass(
            Edit("compass/output_lines.c", old, old.replace("2)", f"{decimals})")), tmp_path / name
        )
    rig = (Path(__file__).parents[2] / "hil" / "rigs" / "text-compass.toml").read_text(encoding="utf-8")
    limit = 0.795 if limited else 1.3
    (tmp_path / "mine.toml").write_text(re.sub(r'("heading.firmware.max" = .*max = )1.3', rf"\g<1>{limit}", rig))
    command = ("run", "new.elf", "--rig", "mine.toml", "--against", "old.elf", "--", "-k", "heading_at_known_angles")
    done = hiltest(tmp_path, *command)
    assert done.returncode == (1 if limited else 21), done.stdout + done.stderr
    answer = " ".join(done.stdout.split())
    cause = r"Likely cause: whole degrees \(multiples of 1 deg, in the base of 0\.1 deg\)( and 1 more)?\."
    assert re.search(cause + " Next: Check the step from the heading to the answer: unit, type and rounding", answer)
    assert re.search(cause, read_record(tmp_path / "hil-out").run.verdict.sentence)


def test_a_build_that_no_longer_calibrates_itself_in_the_same_tumble_is_not_told_to_tumble_more(tmp_path: Path) -> None:
    lines = OLD.with_name("compass-lines.elf")
    (tmp_path / "new.elf").write_bytes(patched(lines, ["fit_is_accurate"], RETURN_0))
    command = ("run", "new.elf", "--rig", "text-compass", "--against", str(lines), "--", "-k", "calibrates_itself")
    done = hiltest(tmp_path, *command)
    assert done.returncode == 1, done.stdout + done.stderr
    answer = " ".join(done.stdout.split())
    change = r"the change of the firmware, since the base calibrated itself after \d+(\.\d+)? s of the same tumble"
    assert re.search(rf"Likely cause: {change}\. Next: Compare the calibration of both builds", answer)
    assert "tumble_s" not in answer


@pytest.mark.parametrize("seeds", [(), ("--seeds", "1..2")], ids=" ".join)
def test_a_baseline_that_does_not_exist_is_an_error_at_once_and_no_test_runs(
    bench: Path, seeds: tuple[str, ...]
) -> None:
    assert hiltest(bench, "run").returncode == 0
    (bench / "hil" / "suites" / "test_lamp.py").write_text(SUITE + "    open('ran', 'w')\n", encoding="utf-8")
    before = (bench / "hil-out" / "run.json").read_bytes()
    done = hiltest(bench, "run", "--baseline", "no-such.json", *seeds)
    assert done.returncode == 4, done.stdout + done.stderr
    assert done.stderr.startswith("ERROR: no-such.json: No such file or directory; name a run.json, its folder or a ba")
    assert not (bench / "ran").exists()
    assert (bench / "hil-out" / "run.json").read_bytes() == before, "as after any other wrong option"
    (bench / "damaged.json").write_text("no json", encoding="utf-8")
    done = hiltest(bench, "run", "--baseline", "damaged.json", *seeds, GITHUB_ACTIONS="true")
    assert done.returncode == 22, done.stdout + done.stderr
    (annotation,) = [line for line in done.stdout.splitlines() if line.startswith("::error")]
    assert "hiltest%3A not evaluated" in annotation
    answer = " ".join(done.stdout.split())
    assert "NOT EVALUATED" in answer
    assert "damaged.json: not JSON" in answer
    assert not (bench / "ran").exists()
    result = hiltest(bench, "compare", "hil-out", "hil-out")
    assert result.returncode in (4, 22), "and not the verdict of the run before"


def test_an_older_firmware_that_never_ran_because_the_newer_one_is_wrong_is_not_blamed() -> None:
    gate = SessionGate(None, "")
    gate.compare_with(OlderFirmware("old.elf", (), Path("record")))
    assert gate.missing.startswith("old.elf did not run, because this run ended first")
