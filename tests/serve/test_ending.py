"""How ``hiltest serve`` ends, and what it refuses to begin with."""

from __future__ import annotations

import os
import re
import signal
import threading
from pathlib import Path

import pytest
import serial
from tests.finished_run import run_module

from hiltest.boards import VirtualBench
from hiltest.boards.paced import PacedBench
from hiltest.boards.served_lines import PseudoTerminal
from hiltest.commands.serve import _pace
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

from .conftest import WALL_LIMIT_S, Serve, converse


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda item: item.name)
def test_a_signal_ends_it_cleanly_and_its_terminals_are_gone(
    serve: Serve, number: signal.Signals, tmp_path: Path
) -> None:
    served = serve("--link", str(tmp_path / "hil"))
    assert (served.board, served.turntable) == (str(tmp_path / "hil"), str(tmp_path / "hil-turntable"))
    terminal = os.readlink(served.board)
    converse(served.board)
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        code, answer = served.end(number)
        assert code == 0
        assert "Traceback" not in answer
        assert not any(os.path.lexists(path) for path in (served.board, served.turntable))
        # While it is open here the system does not give the name away again.
        assert not os.path.exists(terminal)
        with pytest.raises(serial.SerialException):
            client.read(1)


# pyserial shuts a connection down before it closes it, and drops it unclosed when the far end has reset it.
@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")
def test_a_client_sees_the_end_at_once(serve: Serve) -> None:
    served = serve("--tcp", "0")
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        client.write(b"\x7e")
        assert served.end()[0] == 0
        with pytest.raises(serial.SerialException):
            client.read(1)
    with pytest.raises(serial.SerialException, match="refused"):
        serial.serial_for_url(served.board)


def test_firmware_that_faults_is_named_and_ends_it_with_20(serve: Serve, foreign: Path) -> None:
    served = serve("--firmware", str(foreign), "--baud", "9600")
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        client.write(b"alive")
        assert client.read(5) == b"ALIVE"
        client.write(b"!")
        code, answer = served.ended()
    assert code == 20
    assert re.search(r"ERROR: .*undefined instruction.* in main \(upper_case\.c:\d+\)", answer)
    assert "Traceback" not in answer


def test_firmware_that_ends_in_a_loop_is_at_rest_and_its_port_stays_open(serve: Serve, foreign: Path) -> None:
    served = serve("--firmware", str(foreign), "--baud", "9600")
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        client.write(b"alive.")
        assert client.read(5) == b"ALIVE"
        client.timeout = 0.5
        client.write(b"unheard")
        assert client.read(1) == b""  # and no error: half a second later it is still there
        code, answer = served.end()
    assert (code, "ERROR" in answer) == (0, False)


def test_firmware_that_waits_for_a_register_that_is_not_modelled_is_told_while_it_does(
    serve: Serve, foreign: Path
) -> None:
    served = serve("--firmware", str(foreign), "--baud", "9600")
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        client.write(b"a?")
        assert client.read(1) == b"A"
        client.timeout = 0.5
        assert client.read(1) == b""
    _, answer = served.end()
    (told,) = [line for line in answer.splitlines() if "waits for" in line]
    assert told.startswith("firmware waits for AXBS_CRS0 at 0x40004010, which is not modelled, at 0x")
    assert re.search(r" in main \(upper_case\.c:\d+\)$", told)


def test_registers_that_are_not_modelled_are_told_once(serve: Serve, foreign: Path) -> None:
    served = serve("--firmware", str(foreign), "--baud", "9600")
    with serial.serial_for_url(served.board, timeout=WALL_LIMIT_S) as client:
        client.write(b"alive")
        assert client.read(5) == b"ALIVE"
    _, answer = served.end()
    (told,) = [line for line in answer.splitlines() if "not modelled" in line]
    assert told.startswith("AXBS_PRS0 at 0x40004000 is not modelled; write of 0x00000002 from 0x")
    assert re.search(r" in \w+ \(upper_case\.c:\d+\) was stored; 1 access$", told)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--turntable-tcp", "5000"], "--turntable-tcp and --host need --tcp PORT"),
        (["--tcp", "0", "--link", "here"], "--link is for pseudo-terminals"),
        (["--tcp", "70000"], "70000 is not in the range"),
        (["--tcp", "65535"], "there is no TCP port after 65535 for the turntable: name one with --turntable-tcp"),
        (["--rig", "frdm-k64f"], "has a real board, which cannot be served. Choose a rig with a virtual board by"),
        (["--tcp", "0", "--host", "192.0.2.1"], "Check that this machine has the address."),
        (["--firmware", "gone.elf"], "gone.elf"),
        (["--link", "gone/board"], "cannot make the link gone/board: No such file"),
    ],
)
def test_what_cannot_be_served_is_a_usage_error(tmp_path: Path, arguments: list[str], complaint: str) -> None:
    done = run_module("hiltest", "serve", *arguments, folder=tmp_path)
    assert (done.returncode, done.stdout) == (4, "")
    assert complaint in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_no_thread_is_left_behind() -> None:
    before = set(threading.enumerate())
    line = PseudoTerminal()
    with PacedBench(VirtualBench(load_rig(shipped() / "rigs" / "virtual-k64f.toml")), line) as paced:
        assert paced.running
        (thread,) = set(threading.enumerate()) - before
    line.close()
    assert not thread.is_alive()
    assert not paced.running


def test_a_board_that_falls_behind_is_told_of_when_it_begins_doubles_and_is_over(
    capsys: pytest.CaptureFixture[str],
) -> None:
    look = _pace()
    for behind_s in (0.0, 2.9, 3.2, 4.0, 6.3, 6.5, 6.6, 2.0, 1.0, 0.5, 3.0):
        look(behind_s)
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(" behind")[0] for line in lines] == [
        "board: 3 s",
        "board: 6 s",
        "board: in time again",
        "board: 3 s",
    ]
