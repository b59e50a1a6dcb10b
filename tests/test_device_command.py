"""``hiltest listen`` as it is typed: what is understood of each line, and of all."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from tests.command_files import run
from tests.interfaces.compiled import compile_c
from tests.interfaces.test_gdb_client import SOURCE, own_server
from tests.serial_line import Line

from hiltest.boards import open_board
from hiltest.errors import SyncError, VersionMismatchError
from hiltest.rig.rig_file import load_rig

ROOT = Path(__file__).parents[1]
RIG = ROOT / "hil" / "rigs" / "text-compass.toml"
ELF = ROOT / "src" / "hiltest" / "firmware" / "compass-lines.elf"
LINES = b"T=3\r\nCAL=1 HDG=90.50 PIT=1.00 ROL=-2.00\r\nhello \x1b[2J\r\nERROR MAG3110\r\nCAL=1 HDG=nan PIT=1 ROL=2\r\n"


@pytest.fixture
def line() -> Iterator[Line]:
    """A line to a board."""
    made = Line()
    yield made
    if made.far >= 0:
        os.close(made.far)


def test_each_line_is_shown_with_what_is_understood_of_it(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    sender = line.send(LINES)
    assert run("listen", "--rig", str(RIG), "--port", line.name, "--seconds", "2") == 0
    sender.join()
    said = capsys.readouterr().out
    assert "  CAL=1 HDG=90.50 PIT=1.00 ROL=-2.00\n    heading 90.5 deg, pitch 1 deg, roll -2 deg, cal" in said
    assert "? hello ⟨U+001B⟩[2J\n    no pattern matches\n" in said
    assert "  ERROR MAG3110\n    error: MAG3110\n" in said
    assert "    pitch 1 deg, roll 2 deg, calibrated 1; heading: 'nan' is not a number\n" in said
    summary = said[said.index("\n4 understood, 1 not") :].splitlines()
    assert [row.split()[:2] for row in summary if row.startswith(("heading ", "pitch ", "calibrated "))] == [
        ["heading", "1"],
        ["pitch", "2"],
        ["calibrated", "2"],
        ["heading", "ignored"],
    ]
    assert "heading ignored 1 time: 'nan' is not a number" in summary
    assert any(row.startswith("not seen: magnetometer, ") for row in summary)
    assert "not understood, 1 time: no pattern matches" in summary


def test_ctrl_c_ends_it_with_the_summary(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    sender = line.send(LINES, signal.SIGINT)
    assert run("listen", "--rig", str(RIG), "--port", line.name) == 0
    sender.join()
    assert "4 understood, 1 not" in capsys.readouterr().out


def test_nothing_understood_ends_with_1_and_a_lost_line_with_20(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    sender = line.send(b"?\n?\n", unplugged=True)
    assert run("listen", "--rig", str(RIG), "--port", line.name) == 20
    sender.join()
    said = capsys.readouterr()
    assert "1 understood, 1 not" in said.out
    assert f"lost {line.name}: " in said.err


def test_what_is_read_from_memory_needs_no_line(line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    variables = '\n[device.memory.values]\ndip = { path = "dip", unit = "deg" }\n\n[field]'
    text = RIG.read_text().replace("\n[field]", variables)
    both, memory = tmp_path / "both.toml", tmp_path / "memory.toml"
    both.write_text(text.replace('kind = "text"', 'kind = ["text", "memory"]'))
    begin, end = text.index("[device.text]"), text.index("[device.memory.values]")
    memory.write_text((text[:begin] + text[end:]).replace('kind = "text"', 'kind = "memory"'))
    sender = line.send(LINES)
    assert run("listen", "--rig", str(both), "--port", line.name, "--seconds", "2") == 0
    sender.join()
    assert "4 understood, 1 not" in capsys.readouterr().out
    assert run("listen", "--rig", str(memory), "--port", line.name, "--seconds", "2") == 4
    assert "memory needs the ELF of the board: name it with --firmware" in capsys.readouterr().err


@pytest.fixture
def moving(require_tool: Callable[[str], str], tmp_path: Path) -> Path:
    """A program whose variables change."""
    return compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, SOURCE)


@pytest.mark.parametrize("is_virtual", [True, False])
def test_variables_are_shown_by_name_with_what_they_hold(
    is_virtual: bool, moving: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "mine.toml"
    shipped = (ROOT / "hil" / "rigs" / f"{'virtual' if is_virtual else 'frdm'}-k64f.toml").read_text()
    with nullcontext() if is_virtual else own_server(moving) as port:
        server = "" if is_virtual else f'server = "localhost:{port}"\n'
        rig.write_text(f"""{shipped}
[device]
kind = "memory"
[device.memory]
{server}at_return_of = "update_calibration"
[device.memory.values]
heading = {{ path = "heading_rad", unit = "rad" }}
hard_iron = {{ path = "calibration.hard_iron", unit = "uT" }}
""")
        assert run("listen", "--rig", str(rig), "--firmware", str(moving), "--seconds", "0.2") == 0
    said = capsys.readouterr().out
    assert re.search(
        r"^  heading_rad\n    heading [-\d.]+ deg\n  calibration.hard_iron\n"
        r"    hard_iron ([1-9][\d ]*) \1 \1 uT\n",
        said,
        re.M,
    ), said
    assert re.search(r"^1 understood, 0 not, in 0\.\d s$", said, re.M), said


def test_a_device_that_is_only_a_comment_is_said_to_be_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "proposed.toml"
    shipped = (ROOT / "hil" / "rigs" / "virtual-k64f.toml").read_text()
    rig.write_text(f'{shipped}\n# [device]\n# kind = "memory"\n')
    assert run("listen", "--rig", str(rig), "--seconds", "1") == 4
    assert "proposed.toml: its table [device] is a comment: remove the #" in capsys.readouterr().err


@pytest.mark.slow
def test_the_virtual_board_is_listened_to_by_its_own_clock(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("listen", "--rig", str(RIG), "--firmware", str(ELF), "--seconds", "2") == 0
    (summary,) = [row for row in capsys.readouterr().out.splitlines() if row.startswith("heading ")]
    # Ten lines a second from 0.17 s after power-on, of which the first is not taken.
    assert int(summary.split()[1]) in (17, 18)


def add_faults(tmp_path: Path, fault: str) -> str:
    """Return the rig's file with a fault of the line."""
    rig = tmp_path / "faults.toml"
    rig.write_text(f"{RIG.read_text(encoding='utf-8')}\n[faults]\n{fault}\n", encoding="utf-8")
    return str(rig)


def test_it_listens_through_the_faults_of_the_rig(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sender = line.send(LINES)
    lossy = add_faults(tmp_path, "lose = 1.0")
    assert run("listen", "--rig", lossy, "--port", line.name, "--seconds", "2") == 1
    sender.join()
    said = capsys.readouterr()
    silence = r"nothing arrived in \1: the firmware sends nothing on this port"
    assert re.search(rf"^0 understood, 0 not, in (2\.\d s)\n{silence}$", said.out, re.M)
    assert "injected faults: 1 of bytes lost" in said.err


def test_bytes_without_a_line_end_are_another_sentence_than_silence(
    line: Line, capsys: pytest.CaptureFixture[str]
) -> None:
    sender = line.send(bytes(range(0x80, 0x100)))
    assert run("listen", "--rig", str(RIG), "--port", line.name, "--seconds", "2") == 1
    sender.join()
    assert (
        "\n128 bytes arrived without a line end: the firmware sends no text, or at another speed\n"
        in capsys.readouterr().out
    )


@pytest.mark.slow
def test_a_line_that_is_read_at_another_speed_is_said_with_both_speeds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "slow.toml"
    rig.write_text(RIG.read_text(encoding="utf-8") + "\n[link]\nbaud = 9600\n", encoding="utf-8")
    speeds = "the firmware runs UART0 at 115218 baud, and the line is read at 9600 baud"
    assert run("listen", "--rig", str(rig), "--firmware", str(ELF), "--seconds", "1") == 1
    assert capsys.readouterr().out.count(speeds) == 1
    assert run("serve", "--rig", str(rig), "--firmware", str(ELF), "--until", "1", "--no-wait") == 0
    assert speeds in capsys.readouterr().err
    assert run("serve", "--rig", str(rig), "--firmware", str(ELF), "--until", "1", "--no-wait", "--baud", "115200") == 0
    assert speeds not in capsys.readouterr().err
    with pytest.raises(VersionMismatchError, match=speeds):
        open_board(load_rig(rig), firmware=ELF)


@pytest.mark.slow
def test_our_own_firmware_at_another_speed_is_said_too(tmp_path: Path) -> None:
    rig = tmp_path / "slow.toml"
    shipped = (ROOT / "hil" / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    rig.write_text(f"{shipped}\n[link]\nbaud = 230400\n", encoding="utf-8")
    with pytest.raises(SyncError, match="UART0 at 115218 baud, and the line is read at 230400 baud"):
        open_board(load_rig(rig))


@pytest.mark.slow
def test_a_virtual_boards_line_has_the_faults_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gone = add_faults(tmp_path, "disappear = { after_s = 1.0 }")
    assert run("listen", "--rig", gone, "--firmware", str(ELF), "--seconds", "5") == 20
    assert 5 < int(re.findall(r"^(\d+) understood", capsys.readouterr().out, re.M)[0]) < 10  # of ten a second


@pytest.mark.slow
def test_firmware_that_prints_something_else_is_not_understood(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run("listen", "--rig", str(RIG), "--firmware", str(ELF.with_name("compass-packets.elf")), "--seconds", "2") == 1
    )
    assert "\nquantity" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--rig", "virtual-k64f"), "its firmware speaks hiltest's protocol"),
        (("--rig", "no-such-rig"), "no-such-rig"),
        (("--rig", str(RIG), "--firmware", str(ELF), "--port", "/dev/null"), "--firmware is for the virtual board"),
        (("--rig", str(RIG), "--port", "/dev/no-such-port"), "no serial port '/dev/no-such-port'"),
        (("--rig", str(RIG), "--firmware", "no.elf"), "no.elf"),
    ],
)
def test_a_wrong_option_ends_with_4(
    arguments: tuple[str, ...], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("listen", *arguments, "--seconds", "1") == 4
    assert complaint in capsys.readouterr().err
