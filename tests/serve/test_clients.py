"""Real programs on the ports of ``hiltest serve``: pyserial, miniterm, a hiltest session, ser2net in between."""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from hiltest.boards.served_lines import REFUSAL
from hiltest.errors import BenchError
from hiltest.link.messages import Average
from hiltest.link.ports import open_port
from hiltest.link.session import Session

from .conftest import WALL_LIMIT_S, Serve, converse


@pytest.mark.parametrize("arguments", [[], ["--tcp", "0"]], ids=["pty", "tcp"])
def test_a_session_is_held_again_and_again(serve: Serve, arguments: list[str]) -> None:
    served = serve(*arguments)
    for _ in range(3):
        converse(served.board)
    code, said = served.end()
    assert code == 0
    assert said.count("board: client connected") >= 1


def test_each_port_has_its_own_client(serve: Serve) -> None:
    served = serve()
    with serial.serial_for_url(served.turntable, timeout=WALL_LIMIT_S) as table:
        table.write(b"G0 X90\nG4 P0\n")
        converse(served.board)
        assert table.read_until(b"ok\r\nok\r\n") == b"ok\r\nok\r\n"
        table.write(b"?")
        assert table.read_until(b">\r\n") == b"<Idle|MPos:90.000,0.000,0.000|F:0>\r\n"


def test_a_second_tcp_client_is_refused_while_the_first_goes_on(serve: Serve) -> None:
    served = serve("--tcp", "0")
    with serial.serial_for_url(served.turntable, timeout=WALL_LIMIT_S) as first:
        first.write(b"?")
        assert first.read_until(b">\r\n").startswith(b"<Idle|")
        with socket.create_connection(("127.0.0.1", int(served.turntable.rpartition(":")[2]))) as second:
            second.settimeout(WALL_LIMIT_S)
            assert second.makefile("rb").read() == REFUSAL  # to its end: and then hung up
        first.write(b"?")
        assert first.read_until(b">\r\n").startswith(b"<Idle|")


def sent_until_full(url: str) -> None:
    """Send as much as the system takes, and leave."""
    if url.startswith("socket://"):
        with socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2]))) as client:
            client.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                for _ in range(1000):
                    client.send(b"?G0 X" * 10_000)
        return
    terminal = os.open(url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        for _ in range(1000):
            os.write(terminal, b"?G0 X" * 1000)
    os.close(terminal)


@pytest.mark.parametrize("arguments", [[], ["--tcp", "0"]], ids=["pty", "tcp"])
def test_after_a_client_that_floods_a_port_and_leaves_the_next_is_served_at_once(
    serve: Serve, arguments: list[str]
) -> None:
    served = serve("--no-wait", *arguments)
    for _ in range(3):
        sent_until_full(served.board)
        sent_until_full(served.turntable)
        # The bytes of the flood would occupy the line for minutes; the machine may be busy for seconds.
        session = Session(open_port(served.board), reply_deadline_s=30.0)
        session.synchronise()
        assert len(session.attempts) == 1
        session.close()
        with serial.serial_for_url(served.turntable, timeout=1.0) as table:
            table.write(b"?")
            assert b"<Idle|" in table.read_until(b">\r\n")
    said = served.end()[1]
    assert re.search(r"^board: \d{5,} bytes from a client were lost$", said, re.MULTILINE)


class Terminal:
    """Somebody who types at a program and reads what it shows."""

    def __init__(self, *command: str) -> None:
        self._hand, screen = os.openpty()
        self.process = subprocess.Popen(command, stdin=screen, stdout=screen, stderr=screen, start_new_session=True)
        os.close(screen)
        self.shown = ""

    def until(self, text: str) -> None:
        """Read on until a regular expression is on the screen."""
        ends_s = time.monotonic() + WALL_LIMIT_S
        while not re.search(text, self.shown):
            assert time.monotonic() < ends_s, self.shown
            if select.select([self._hand], [], [], 0.1)[0]:
                self.shown += os.read(self._hand, 4096).decode()

    def type(self, keys: str) -> None:
        os.write(self._hand, keys.encode())

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._hand)


@contextmanager
def miniterm(*arguments: str) -> Iterator[Terminal]:
    terminal = Terminal(sys.executable, "-m", "serial.tools.miniterm", *arguments)
    try:
        terminal.until("--- Miniterm on ")
        terminal.until(r"followed by Ctrl\+H ---")
        yield terminal
        terminal.type("\x1d")  # Ctrl+]
        terminal.until("--- exit ---")
        assert terminal.process.wait(WALL_LIMIT_S) == 0
    finally:
        terminal.close()


@pytest.mark.parametrize("arguments", [[], ["--tcp", "0"]], ids=["pty", "tcp"])
def test_a_person_with_miniterm_turns_the_table(serve: Serve, arguments: list[str]) -> None:
    served = serve(*arguments)
    with miniterm(served.turntable, "115200") as terminal:
        terminal.type("G0 X45 Y-10\rG4 P0\r")
        terminal.until(r"ok\s+ok")
        terminal.type("?")
        terminal.until(r"<Idle\|MPos:45\.000,-10\.000,0\.000\|F:0>")


def test_firmware_with_a_protocol_of_its_own_is_served(serve: Serve, foreign: Path) -> None:
    served = serve("--firmware", str(foreign), "--baud", "9600")
    with miniterm(served.board, "9600") as terminal:
        terminal.type("hello, world")
        terminal.until("HELLO, WORLD")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def ser2net(program: str, folder: Path, connections: dict[str, str]) -> Iterator[None]:
    """Run ser2net with accepters and their connectors, and come back when it listens."""
    lines = [f"connection: &c{n}\n  accepter: {a}\n  connector: {c}\n" for n, (a, c) in enumerate(connections.items())]
    configuration = folder / "ser2net.yaml"
    configuration.write_text("%YAML 1.1\n---\n" + "".join(lines), encoding="utf-8")
    process = subprocess.Popen(
        [program, "-n", "-u", "-c", str(configuration)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        ends_s = time.monotonic() + WALL_LIMIT_S
        for accepter in connections:
            port = int(accepter.rpartition(",")[2])
            while not listens(port):
                assert process.poll() is None
                assert time.monotonic() < ends_s
                time.sleep(0.05)
        yield
    finally:
        process.terminate()
        process.wait(WALL_LIMIT_S)


def listens(port: int) -> bool:
    """Look into the kernel's table: a trial connection would be a client."""
    wanted = f"0100007F:{port:04X} 00000000:0000 0A"
    return wanted in Path("/proc/net/tcp").read_text(encoding="ascii")


# pyserial's, of its own RFC 2217 client.
@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")
def test_sessions_go_through_ser2net_by_rfc2217_and_raw(
    serve: Serve, require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    served = serve()
    rfc2217, raw = free_port(), free_port()
    with ser2net(
        require_tool("ser2net"),
        tmp_path,
        {
            f"telnet(rfc2217),tcp,127.0.0.1,{rfc2217}": f"serialdev,{served.board},115200n81,local",
            f"tcp,127.0.0.1,{raw}": f"serialdev,{served.turntable},115200n81,local",
        },
    ):
        # A pseudo-terminal has no modem lines, so nobody acknowledges that they were set.
        converse(f"rfc2217://127.0.0.1:{rfc2217}?ign_set_control")
        with serial.serial_for_url(f"socket://127.0.0.1:{raw}", timeout=WALL_LIMIT_S) as table:
            table.write(b"?\n")
            assert table.read_until(b"ok\r\n") == b"<Idle|MPos:0.000,0.000,0.000|F:0>\r\nok\r\n"


# pyserial's: as above, and it leaves a socket open that the far end has closed, for shutdown() fails then.
@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*socket.socket:pytest.PytestUnraisableExceptionWarning")
def test_a_connection_that_is_cut_in_the_middle_is_said_and_can_be_made_again(
    serve: Serve, require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    served, port = serve(), free_port()
    url = f"rfc2217://127.0.0.1:{port}?ign_set_control"
    accepter = {f"telnet(rfc2217),tcp,127.0.0.1,{port}": f"serialdev,{served.board},115200n81,local"}
    with ser2net(require_tool("ser2net"), tmp_path, accepter):
        session = Session(open_port(url))
        session.synchronise()
        session.identify()
    began_s = time.monotonic()
    with pytest.raises(BenchError, match="connection"):
        session.request(Average(16))
    assert time.monotonic() - began_s < WALL_LIMIT_S
    session.close()
    with ser2net(require_tool("ser2net"), tmp_path, accepter):
        converse(url)


def test_sessions_go_through_ser2net_from_one_network_port_to_another(
    serve: Serve, require_tool: Callable[[str], str], tmp_path: Path
) -> None:
    served = serve("--tcp", "0")
    port = free_port()
    served_port = served.board.rpartition(":")[2]
    with ser2net(require_tool("ser2net"), tmp_path, {f"tcp,127.0.0.1,{port}": f"tcp,127.0.0.1,{served_port}"}):
        converse(f"socket://127.0.0.1:{port}")
