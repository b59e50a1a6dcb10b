"""Ports that are asked for by text."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from hiltest.boards.uart_ports import ServedUart, opened_ports, uart_ports
from hiltest.errors import ConfigError


def test_what_is_asked_for_is_understood() -> None:
    asked = uart_ports(("3", "1=bench/uart", "5=tcp:6470"))
    assert asked == (ServedUart(3), ServedUart(1, link=Path("bench/uart")), ServedUart(5, tcp=6470))


@pytest.mark.parametrize(
    "texts",
    [("0",), ("6",), ("",), ("3=",), ("x=tcp:1",), ("3=tcp:",), ("3=tcp:65536",), ("3=tcp:-1",), ("3", "3=tcp:0")],
)
def test_what_is_no_port_is_refused(texts: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match="--uart"):
        uart_ports(texts)


def test_they_are_open_for_as_long_as_they_are_served(tmp_path: Path) -> None:
    link = tmp_path / "uart1"
    with opened_ports(uart_ports(("3=tcp:0", f"1={link}")), "127.0.0.1") as ports:
        (_, _, url), (_, terminal, at) = ports
        number = int(url.rpartition(":")[2])
        socket.create_connection(("127.0.0.1", number), timeout=10.0).close()
        assert at == str(link)
        assert str(link.resolve()) == terminal.url
    assert not link.exists()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", number), timeout=10.0)
