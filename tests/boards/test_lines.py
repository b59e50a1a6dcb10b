"""Lines to other programs: who is there, what is lost, and that nobody reads what was meant for another."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from hiltest.boards.served_lines import REFUSAL, PseudoTerminal, TcpLine, port_link
from hiltest.errors import ConfigError
from hiltest.link.ports import open_port

WALL_LIMIT_S = 10.0  # for what takes a millisecond


@pytest.fixture(params=["pty", "tcp"])
def line(request: pytest.FixtureRequest) -> Iterator[PseudoTerminal | TcpLine]:
    line = PseudoTerminal() if request.param == "pty" else TcpLine("127.0.0.1", 0)
    yield line
    line.close()


def until(line: PseudoTerminal | TcpLine, observed: Callable[[bytes], bool], *, limit: int = 100) -> bytes:
    """Look after a line, as the board's thread does, until `seen` is true of all that has come."""
    heard, ends_s = b"", time.monotonic() + WALL_LIMIT_S
    while not observed(heard):
        assert time.monotonic() < ends_s, heard
        select.select(line.sources(), [], [], 0.002)
        heard += line.receive(limit)
    return heard


def test_bytes_go_both_ways_and_clients_may_come_and_go(line: PseudoTerminal | TcpLine) -> None:
    for greeting in (b"first\r\n", b"second\x00\xff"):
        assert not line.connected
        with serial.serial_for_url(line.url, timeout=WALL_LIMIT_S) as client:
            client.write(greeting)
            assert until(line, lambda heard, end=greeting: heard == end) == greeting
            assert line.connected
            line.send(b"\r\x03" + greeting)
            assert client.read(len(greeting) + 2) == b"\r\x03" + greeting
        until(line, lambda _: not line.connected)


def test_what_is_sent_to_nobody_or_left_unread_is_lost(line: PseudoTerminal | TcpLine) -> None:
    line.send(b"to nobody")
    with serial.serial_for_url(line.url) as client:
        client.write(b"x")
        until(line, lambda heard: heard == b"x")
        line.send(b"left unread")
    until(line, lambda _: not line.connected)
    line.send(b"to nobody either")
    if isinstance(line, PseudoTerminal):  # not pyserial, which would drop what waits itself
        client_end = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
        os.write(client_end, b"y")
        until(line, lambda heard: heard == b"y")
        line.send(b"to you")
        assert os.read(client_end, 100) == b"to you"
        os.close(client_end)
    else:
        with socket.create_connection(("127.0.0.1", line.port), timeout=WALL_LIMIT_S) as client_end:
            until(line, lambda _: line.connected)
            line.send(b"to you")
            assert client_end.recv(100) == b"to you"


def test_the_last_words_of_a_client_are_heard(line: PseudoTerminal | TcpLine) -> None:
    with serial.serial_for_url(line.url) as client:
        client.write(b"goodbye")
    assert until(line, lambda heard: heard.endswith(b"bye")) == b"goodbye"


def test_a_client_that_reads_nothing_does_not_stop_the_line(line: PseudoTerminal | TcpLine) -> None:
    with serial.serial_for_url(line.url) as client:
        client.write(b"x")
        until(line, lambda heard: heard == b"x")
        for _ in range(200):
            line.send(bytes(100_000))
        assert line.connected


def flood(url: str) -> int:
    """Send until the system takes no more, and leave; return how many bytes it took."""
    if not url.startswith("socket://"):
        client = os.open(url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        sent = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                sent += os.write(client, bytes(4096))
        os.close(client)
        return sent
    with socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2]))) as client:
        client.setblocking(False)
        sent = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                sent += client.send(bytes(100_000))
    return sent


def test_the_next_program_is_heard_after_a_flood_and_what_was_lost_is_counted(line: PseudoTerminal | TcpLine) -> None:
    line.queue.keep_limit = 10
    sent = flood(line.url)
    assert sent > 10_000
    with serial.serial_for_url(line.url, timeout=WALL_LIMIT_S) as client:  # before anybody looked at the line
        heard = line.receive(100)
        client.write(b"me")
        heard += until(line, lambda heard: heard.endswith(b"me"))
    assert len(heard) < 10_000  # 100 at each look until the end of the flood was there, and what is kept
    assert line.queue.lost == sent + 2 - len(heard)


def test_what_a_program_sent_before_it_left_is_delivered_as_long_as_no_other_comes(
    line: PseudoTerminal | TcpLine,
) -> None:
    sent = flood(line.url)
    assert until(line, lambda heard: len(heard) == sent, limit=100_000) == bytes(sent)
    assert line.queue.lost == 0


def test_a_second_tcp_client_is_told_and_the_first_goes_on() -> None:
    line = TcpLine("127.0.0.1", 0)
    first = socket.create_connection(("127.0.0.1", line.port), timeout=WALL_LIMIT_S)
    until(line, lambda _: line.connected)
    second = socket.create_connection(("127.0.0.1", line.port), timeout=WALL_LIMIT_S)
    first.sendall(b"still here")
    assert until(line, lambda heard: len(heard) == 10) == b"still here"
    assert line.receive(100) == b""  # callers are looked after when the client has nothing more to say
    assert second.recv(100) == REFUSAL
    assert second.recv(100) == b""
    line.close()
    assert first.recv(100) == b""
    first.close()
    second.close()


def test_a_client_that_is_torn_away_makes_room_for_the_next() -> None:
    line = TcpLine("127.0.0.1", 0)
    torn = socket.create_connection(("127.0.0.1", line.port), timeout=WALL_LIMIT_S)
    until(line, lambda _: line.connected)
    torn.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # closes with a reset
    torn.close()
    with socket.create_connection(("127.0.0.1", line.port), timeout=WALL_LIMIT_S) as following:
        following.sendall(b"me")
        assert until(line, lambda heard: heard == b"me") == b"me"
    line.close()


def test_a_port_that_cannot_be_listened_on_is_named() -> None:
    selected = TcpLine("127.0.0.1", 0)
    with pytest.raises(
        ConfigError, match=rf"cannot listen on 127\.0\.0\.1 port {selected.port}: Address already in use"
    ):
        TcpLine("127.0.0.1", selected.port)
    with pytest.raises(ConfigError, match=r"cannot listen on 192\.0\.2\.1 port 0: Cannot assign"):
        TcpLine("192.0.2.1", 0)
    selected.close()


def test_a_link_stays_for_its_time_and_replaces_only_what_an_earlier_start_left(tmp_path: Path) -> None:
    link, file = tmp_path / "board", tmp_path / "file"
    link.symlink_to("/dev/pts/9999")
    with port_link(link, "/dev/pts/1234"):
        assert os.readlink(link) == "/dev/pts/1234"
    assert not link.is_symlink()
    file.write_text("precious", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"cannot make the link .*/file: File exists"), port_link(file, "/dev/pts/1"):
        pass
    assert file.read_text(encoding="utf-8") == "precious"
    with (
        port_link(link, "/dev/pts/1"),
        pytest.raises(ConfigError, match=r"cannot make the link .*board: another hiltest serve uses it"),
        port_link(tmp_path / "." / "board", "/dev/pts/2"),
    ):
        pass
    with port_link(link, "/dev/pts/1"):
        link.unlink()
        link.symlink_to("elsewhere")
    assert os.readlink(link) == "elsewhere"


def test_away_from_loopback_a_client_is_let_in_by_the_token_and_others_hold_nobody_up() -> None:
    line = TcpLine("0.0.0.0", 0)
    address = ("127.0.0.1", line.port)
    strangers = [socket.create_connection(address, timeout=WALL_LIMIT_S) for _ in range(3)]
    strangers[0].sendall(b"POST / HTTP/1.1\r\n\r\n")
    strangers[1].sendall(b"0" * 33)
    for stranger in strangers[:2]:
        while not select.select([stranger], [], [], 0.01)[0]:
            assert line.receive(100) == b""
        with contextlib.suppress(ConnectionResetError):
            assert stranger.recv(100) == b""
    assert not line.connected
    token = line.url.removeprefix("socket://").partition("@")[0]
    assert len(token) == 32
    with open_port(f"socket://{token}@127.0.0.1:{line.port}") as client:
        client.write(b"me")
        assert until(line, lambda heard: heard == b"me") == b"me"
    for stranger in strangers:
        stranger.close()
    line.close()
