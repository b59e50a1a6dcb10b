"""A served board waits in reset for somebody, loses nothing of what it says then, and can be reset and ended."""

from __future__ import annotations

import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from hiltest.rig.bench_files import shipped

from ..boards.gdb_client import GdbClient
from .conftest import FLAGS, HERE, START, WALL_LIMIT_S, Serve, converse

SAID = b"boot 0, RCM 82\r\n"


@pytest.fixture
def banner(tmp_path: Path, require_tool: Callable[[str], str]) -> Path:
    """Build firmware that says hello at once, and goes to sleep."""
    elf = tmp_path / "banner.elf"
    sources = [START / "start.S", HERE / "programs" / "banner.c"]
    command = [require_tool("arm-none-eabi-gcc"), *FLAGS, *map(str, sources), "-o", str(elf)]
    subprocess.run(command, check=True, timeout=WALL_LIMIT_S)
    return elf


def summary(message: str) -> tuple[float, str]:
    """Return the virtual seconds that the last line tells, and where the firmware was."""
    match = re.fullmatch(
        r"board: (\d+\.\d{3}) s of virtual time, (?:\d\.\d\d x real time, )?\d+\.\d s of it emulated; (.*)",
        message.splitlines()[-1],
    )
    assert match is not None, message
    return float(match[1]), match[2]


@pytest.mark.parametrize("arguments", [[], ["--tcp", "0"], ["--no-wait"]], ids=["pty", "tcp", "no-wait"])
def test_the_first_program_gets_what_the_board_says_first(serve: Serve, banner: Path, arguments: list[str]) -> None:
    served = serve("--firmware", str(banner), *arguments)
    time.sleep(1.0)
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        assert client.read(len(SAID)) == SAID
    assert served.end()[0] == 0


def test_without_a_program_it_stays_in_reset(serve: Serve, banner: Path) -> None:
    served = serve("--firmware", str(banner))
    time.sleep(1.0)
    code, answer = served.end()
    assert code == 0
    assert "in reset until a program opens a port" in answer
    assert summary(answer)[0] == 0.0


def test_the_coolant_output_of_the_table_resets_the_board(serve: Serve, banner: Path) -> None:
    served = serve("--firmware", str(banner))
    with (
        serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client,
        serial.serial_for_url(served.turntable, timeout=WALL_LIMIT_S) as table,
    ):
        assert client.read(len(SAID)) == SAID
        for boot in (b"1", b"2"):
            table.write(b"M8\nM9\n")
            assert table.read_until(b"ok\r\nok\r\n") == b"ok\r\nok\r\n"
            assert client.read(len(SAID)) == b"boot " + boot + b", RCM 40\r\n"  # the pin


def test_faults_of_the_board_are_served_and_those_of_the_line_are_not(serve: Serve, tmp_path: Path) -> None:
    rig = tmp_path / "faults.toml"
    faults = '\n[faults]\nlose = 1.0\nheld_line = { bus = 0, line = "sda", after_s = 60.0 }\n'
    rig.write_text((shipped() / "rigs" / "virtual-k64f.toml").read_text() + faults)
    served = serve("--rig", str(rig))
    converse(served.board)
    code, answer = served.end()
    assert code == 0
    assert "injected faults: SDA of I2C0 held low after 60 s" in answer
    assert f"the line faults of {rig} are not simulated" in answer


def test_it_ends_at_a_virtual_time_and_sums_up(serve: Serve, banner: Path) -> None:
    served = serve("--firmware", str(banner), "--no-wait", "--until", "0.75")
    code, answer = served.ended()
    assert code == 0
    assert "the time of --until is over" in answer
    time_s, where = summary(answer)
    assert time_s == 0.75
    assert re.fullmatch(r"asleep in main \(banner\.c:\d+\)", where)
    (told,) = [line for line in answer.splitlines() if "not modelled" in line]
    assert told.startswith("CMP0_CR0 at 0x40073000 is not modelled; write of 0x11 from 0x")
    assert told.endswith("stored; 3 accesses")


def test_gdb_finds_the_board_at_its_first_instruction(serve: Serve, banner: Path) -> None:
    served = serve("--firmware", str(banner), "--gdb", "0", "--until", "3")
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        assert client.read(len(SAID)) == SAID
        with GdbClient(served.gdb_port) as gdb:
            gdb.ask(b"?")
            assert gdb.monitor("reset").startswith("reset, halted")
            before = gdb.monitor("cycles")
            time.sleep(0.5)
            assert gdb.monitor("cycles") == before
            gdb.send(b"c")
            assert client.read(len(SAID)) == b"boot 1, RCM 40\r\n"
            code, answer = served.ended()
    assert code == 0
    assert summary(answer)[0] == 3.0


def test_gdb_alone_gets_the_board_out_of_reset(serve: Serve, banner: Path) -> None:
    served = serve("--firmware", str(banner), "--gdb", "0")
    with GdbClient(served.gdb_port) as gdb:
        gdb.ask(b"?")
        assert gdb.monitor("cycles").startswith("0 cycles, 0 instructions")
        for _ in range(3):
            gdb.ask(b"s")
        assert re.match(r"\d+ cycles, 3 instructions", gdb.monitor("cycles"))
        gdb.send(b"c")
        with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
            assert client.read(len(SAID)) == SAID
        gdb.socket.sendall(b"\x03")
        assert gdb.receive().startswith(b"T02")
        code, _ = served.end()  # while it is halted
    assert code == 0
