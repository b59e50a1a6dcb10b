"""Ports for UART1 to UART5 of a served board, on request."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hiltest.boards.served_lines import PortLine, PseudoTerminal, TcpLine, port_link
from hiltest.errors import ConfigError

_LAST_PORT = 65_535
_TCP = "tcp:"


@dataclass(frozen=True, slots=True)
class ServedUart:
    """A requested port: TCP if it has a number, else a pseudo-terminal, with a link to it if it has a path."""

    number: int
    """Number of the UART."""
    tcp: int | None = None
    """TCP port; 0 for any free one."""
    link: Path | None = None

    @property
    def name(self) -> str:
        """Name in the server's output."""
        return f"uart{self.number}"


def uart_port(text: str) -> ServedUart:
    """Parse ``3``, ``3=PATH`` or ``3=tcp:PORT``.

    Raises
    ------
    ConfigError
        If it is anything else.
    """
    number, equals, where = text.partition("=")
    if number not in {"1", "2", "3", "4", "5"} or (equals and not where):
        raise ConfigError(f"--uart {text} must be N, N=PATH or N=tcp:PORT, with N from 1 to 5")
    if not where.startswith(_TCP):
        return ServedUart(int(number), link=Path(where) if where else None)
    port = where.removeprefix(_TCP)
    if not port.isascii() or not port.isdigit() or int(port) > _LAST_PORT:
        raise ConfigError(f"--uart {text}: a port is a number from 0 to {_LAST_PORT}")
    return ServedUart(int(number), tcp=int(port))


def uart_ports(texts: Sequence[str]) -> tuple[ServedUart, ...]:
    """Parse requested ports, each UART at most once.

    Raises
    ------
    ConfigError
        If one is invalid, or requested twice.
    """
    ports = tuple(uart_port(text) for text in texts)
    if len({port.number for port in ports}) < len(ports):
        raise ConfigError("--uart names a UART twice: leave one out")
    return ports


@contextlib.contextmanager
def opened_ports(ports: Sequence[ServedUart], host: str) -> Iterator[list[tuple[ServedUart, PortLine, str]]]:
    """Open ports; yield each with its line and its device or URL, and close them in the end."""
    with contextlib.ExitStack() as stack:
        opened: list[tuple[ServedUart, PortLine, str]] = []
        for port in ports:
            line = PseudoTerminal() if port.tcp is None else TcpLine(host, port.tcp)
            stack.callback(line.close)
            if port.link is not None:
                stack.enter_context(port_link(port.link, line.url))
            opened.append((port, line, line.url if port.link is None else str(port.link)))
        yield opened
