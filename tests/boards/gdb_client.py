"""A small client of the GDB remote protocol, for tests that say what they send."""

from __future__ import annotations

import socket

WALL_LIMIT_S = 30.0  # for what takes milliseconds


class GdbClient:
    """One connection; acknowledgements are on, as they are at first."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=WALL_LIMIT_S)
        self._kept = b""

    def __enter__(self) -> GdbClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, content: bytes) -> None:
        """Send a packet."""
        self.socket.sendall(b"$%s#%02x" % (content, sum(content) & 0xFF))

    def receive(self) -> bytes:
        """Return the content of the next packet; acknowledgements are passed over."""
        while b"#" not in self._kept or len(self._kept) < self._kept.index(b"#") + 3:
            data = self.socket.recv(4096)
            if not data:
                raise EOFError(self._kept)
            self._kept += data
        end = self._kept.index(b"#") + 3
        packet, self._kept = self._kept[:end].lstrip(b"+"), self._kept[end:]
        assert packet[:1] == b"$", packet
        assert int(packet[-2:], 16) == sum(packet[1:-3]) & 0xFF
        return packet[1:-3]

    def ask(self, content: bytes) -> bytes:
        """Send a packet, and return the answer."""
        self.send(content)
        return self.receive()

    def register(self, number: int) -> int:
        """Read a register of 32 bits."""
        return int.from_bytes(bytes.fromhex(self.ask(b"p%x" % number).decode()), "little")

    @property
    def pc(self) -> int:
        """Address of the instruction that is next."""
        return self.register(15)

    def word(self, address: int) -> int:
        """Read a word of memory."""
        return int.from_bytes(bytes.fromhex(self.ask(b"m%x,4" % address).decode()), "little")

    def monitor(self, command: str) -> str:
        """Run a command of the board's."""
        return bytes.fromhex(self.ask(b"qRcmd,%s" % command.encode().hex().encode()).decode()).decode()
