"""hiltest flash, and hiltest run --flash: the board that is meant, by one process at a time, and who answers then."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest
from tests.command_files import run
from tests.finished_run import run_module
from tests.flashing.bench import WAIT_S, Bench
from tests.flashing.drive import Drive
from tests.test_json_documents import checked
from tests.usb_tree import K64F, SECOND_K64F, UsbTree

from hiltest.boards import default_firmware
from hiltest.boards.flashing import flashing
from hiltest.rig.bench_files import shipped
from hiltest.virtual.program.elf import load_image

RECORDED = Path(__file__).parents[2] / "fixtures" / "recordings" / "board-silent.jsonl.gz"
LINES = default_firmware().with_name("compass-lines.elf")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with Bench(tmp_path_factory.mktemp("bench")) as board:
        yield board


@pytest.fixture
def plugged_in(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setenv("HILTEST_ROOT", str(bench.root))
    return bench


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> UsbTree:
    """A machine with nothing plugged in yet."""
    monkeypatch.setenv("HILTEST_ROOT", str(tmp_path / "machine"))
    return UsbTree(tmp_path / "machine")


def other_build(tmp_path: Path) -> Path:
    """Return the shipped firmware as another build, by its note; it still answers the build that it was."""
    elf, note = tmp_path / "other.elf", bytes.fromhex(load_image(default_firmware()).build_id)
    elf.write_bytes(default_firmware().read_bytes().replace(note, note[::-1], 1))
    assert load_image(elf).build_id == note[::-1].hex()
    return elf


@pytest.mark.slow
def test_what_is_flashed_runs_and_is_asked(plugged_in: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("flash", "--json") == 0
    said = checked(capsys.readouterr().out, "hiltest.flash/1")
    build = load_image(default_firmware()).build_id
    assert build.startswith(said["answered"])
    assert (said["build_id"], said["serial_number"], said["by"]) == (build, K64F, "daplink")
    assert said["said"].endswith("the flashed firmware runs")
    assert len(plugged_in.drive.flash) == said["bytes"]


@pytest.mark.slow
def test_a_board_that_answers_another_build_is_not_what_was_flashed(
    plugged_in: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("flash", str(other_build(tmp_path))) == 23
    err = capsys.readouterr().err
    build = load_image(default_firmware()).build_id
    assert f"is build {bytes.fromhex(build)[::-1].hex()[:16]}, and on " in err
    assert f"build {build[:16]} answers" in err


def identity_of(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the tests of a board's identity in a folder."""
    return run_module("hiltest", "run", *words, "--", "-k", "identity", folder=folder, environment=os.environ)


def board_in(out: Path) -> dict[str, object]:
    """Return what a record says of its board, but for what a replay says otherwise."""
    board = json.loads((out / "run.json").read_text(encoding="utf-8"))["board"]
    return {name: value for name, value in board.items() if name not in ("kind", "description", "recording")}


@pytest.mark.slow
def test_a_run_flashes_first_and_records_what_and_its_replay_says_the_same(plugged_in: Bench, tmp_path: Path) -> None:
    done = identity_of(tmp_path, "--flash", "--rig", "served-k64f", "--port", "usb://", "--record", "flashed.jsonl.gz")
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"bytes flashed onto board {K64F}; hiltest-frdm-k64f" in done.stdout
    flashed = board_in(tmp_path / "hil-out")
    assert flashed["firmware_sha256"] == sha256(default_firmware().read_bytes()).hexdigest()
    assert flashed["elf_build_id"] == load_image(default_firmware()).build_id
    again = identity_of(tmp_path, "--replay", "flashed.jsonl.gz", "--out", "again")
    assert again.returncode == 0, again.stdout + again.stderr
    assert board_in(tmp_path / "again") == flashed


@pytest.mark.slow
def test_of_two_boards_a_run_flashes_the_one_that_its_rig_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        Bench(tmp_path / "bench") as bench,
        Drive(bench.usb.plug_in(serial=SECOND_K64F, tty="ttyACM1", disk="sdc", mounted="/media/me/DAPLINK1")) as other,
    ):
        monkeypatch.setenv("HILTEST_ROOT", str(bench.root))
        served = (shipped() / "rigs" / "served-k64f.toml").read_text(encoding="utf-8")
        port = 'port = "socket://127.0.0.1:6464"'
        for named in ("", K64F):
            (tmp_path / "rig.toml").write_text(served.replace(port, f'port = "usb://{named}"', 1), encoding="utf-8")
            done = identity_of(tmp_path, "--flash", "--rig", "rig.toml")
            assert done.returncode == (0 if named else 4), done.stdout + done.stderr
            assert bool(bench.drive.flash) is bool(named)
        assert other.flash == {}


@pytest.mark.slow
def test_a_run_on_a_board_that_could_not_be_flashed_ends_with_20(plugged_in: Bench, tmp_path: Path) -> None:
    plugged_in.drive.refusal = "Failed to reset/halt the target MCU"
    try:
        done = identity_of(tmp_path, "--flash", "--rig", "served-k64f", "--port", "usb://")
    finally:
        plugged_in.drive.refusal = ""
    assert done.returncode == 20, done.stdout + done.stderr
    assert "FAIL.TXT: error: Failed to reset/halt the target MCU" in done.stdout


def test_firmware_with_its_own_language_is_not_asked(machine: UsbTree, capsys: pytest.CaptureFixture[str]) -> None:
    with Drive(machine.plug_in(disk="sdb", mounted="/media/me/DAPLINK")) as drive:
        assert run("flash", str(LINES)) == 0
    assert "it does not speak hiltest's protocol, so its build is unknown" in capsys.readouterr().out
    segments = load_image(LINES).segments
    assert len(drive.flash) == sum(len(segment.data) for segment in segments)


def test_a_board_that_stays_silent_ends_with_20(
    machine: UsbTree, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(flashing, "ANSWERS_WITHIN_S", 0.0)
    far, near = os.openpty()
    try:
        behind = Path(os.ttyname(near))
        settings = "Auto Reset: 0"
        with Drive(machine.plug_in(behind=behind, disk="sdb", mounted="/media/me/DAPLINK"), settings=settings):
            assert run("flash") == 20
    finally:
        os.close(far)
        os.close(near)
    err = capsys.readouterr().err
    assert "was programmed, but does not answer" in err
    assert "Press its reset button" in err


def test_a_board_that_another_process_has_is_left_alone(machine: UsbTree, capsys: pytest.CaptureFixture[str]) -> None:
    far, near = os.openpty()
    behind = Path(os.ttyname(near))
    holds = (
        "import sys; from hiltest.link.ports import open_port; port = open_port(sys.argv[1], rig='bench seven'); "
        "print(1, flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", holds, str(behind)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    assert other.stdout.readline() == "1\n"
    try:
        with Drive(machine.plug_in(behind=behind, disk="sdb", mounted="/media/me/DAPLINK")) as drive:
            assert run("flash") == 20
        assert drive.flash == {}
        err = capsys.readouterr().err
        assert f"process {other.pid} of " in err
        assert "rig bench seven" in err
    finally:
        other.communicate(timeout=WAIT_S)
        os.close(far)
        os.close(near)


def test_a_folder_that_is_no_usb_drive_is_written_to_only_with_force(
    machine: UsbTree, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Drive(tmp_path / "drive") as drive:
        assert run("flash", "--volume", str(tmp_path / "drive")) == 20
        assert drive.flash == {}
        assert "is not the mount point of a USB drive with a DAPLink" in capsys.readouterr().err
        assert run("flash", "--volume", str(tmp_path / "drive"), "--force") == 0
    assert "the serial port of the board is unknown" in capsys.readouterr().out
    assert drive.flash != {}


def test_a_drive_that_is_not_mounted_is_said_with_how_to_mount_it(
    machine: UsbTree, capsys: pytest.CaptureFixture[str]
) -> None:
    machine.plug_in(disk="sdc")
    assert run("flash") == 20
    said = f"the drive of board {K64F} is not mounted: mount it (udisksctl mount -b /dev/sdc)"
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "boards", "code", "said"),
    [
        ((), 0, 20, "no FRDM-K64F is plugged in"),
        ((), 2, 4, "--port usb://"),
        (("--rig", "virtual-k64f"), 1, 4, "a virtual board cannot be flashed"),
        (("--port", "hil://"), 1, 4, "a virtual board cannot be flashed"),
        (("--port", "socket://127.0.0.1:6464"), 1, 4, "its DAPLink drive with --volume"),
        (("--rig", "text-compass"), 1, 4, "name the ELF"),
        (("--port", "usb://9999"), 1, 20, "serial number begins with '9999'"),
    ],
)
def test_a_board_that_is_not_known_is_not_flashed(
    words: tuple[str, ...], boards: int, code: int, said: str, machine: UsbTree, capsys: pytest.CaptureFixture[str]
) -> None:
    for serial, tty, disk in [(K64F, "ttyACM0", "sdb"), (SECOND_K64F, "ttyACM1", "sdc")][:boards]:
        machine.plug_in(serial=serial, tty=tty, disk=disk, mounted=f"/media/me/{disk}")
    assert run("flash", *words) == code
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "a virtual board cannot be flashed"),
        (("--seeds", "1..2"), "--flash is for a real board"),
        (("--against", str(default_firmware())), "--flash is for a real board"),
        (("--port", "usb://", "--base", "0x8000"), "leave out --base"),
        (("--port", "usb://", "--coverage", "lcov.info"), "which --coverage excludes"),
        (("--replay", str(RECORDED)), "which --replay excludes"),
        (("--port", "usb://", "--calibration", "none.json"), "none.json"),
        (("--port", "usb://", "--firmware", str(shipped() / "rigs" / "virtual-k64f.toml")), "not a complete ELF file"),
    ],
)
def test_a_run_that_cannot_flash_is_refused(
    words: tuple[str, ...],
    said: str,
    machine: UsbTree,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    drive = machine.plug_in(disk="sdb", mounted="/media/me/DAPLINK")
    assert run("run", "--flash", *words) == 4
    assert [each.name for each in drive.iterdir()] == ["DETAILS.TXT"]
    printed = capsys.readouterr()
    assert said in printed.out + printed.err
    assert not (tmp_path / "hil-out" / "run.json").exists()
