"""A serial line of which a test has the far end."""

from __future__ import annotations

import fcntl
import os
import pty
import signal
import sys
import termios
import threading
import time
import tty
from pathlib import Path


class Line:
    """A pseudo-terminal whose far end sends."""

    def __init__(self) -> None:
        self.far, self.near = pty.openpty()
        tty.setraw(self.near)
        self.name = os.ttyname(self.near)

    def send(self, data: bytes, then: signal.Signals | None = None, *, unplugged: bool = False) -> threading.Thread:
        """Send in the background once the port is open, and end the command or the line when all was read."""

        def sending() -> None:
            while not self.is_open():
                time.sleep(0.05)
            time.sleep(1.0)  # it drops what came before
            os.write(self.far, data)
            self.wait_until_read()
            if unplugged:
                os.close(self.far)
                self.far = -1
            elif then is not None:
                os.kill(os.getpid(), then)

        os.close(self.near)
        thread = threading.Thread(target=sending)
        thread.start()
        return thread

    def wait_until_read(self) -> None:
        """Wait until nothing was left in the line for half a second: what is left when it is unplugged is lost.

        On a busy machine the system moves what was written to the near end later than it returns from the write.
        """
        near = os.open(self.name, os.O_RDONLY | os.O_NOCTTY)
        until_s = time.monotonic() + 10.0
        empty = 0
        try:
            while time.monotonic() < until_s and empty < 10:
                time.sleep(0.05)
                empty = 0 if self.unread(near) else empty + 1
        finally:
            os.close(near)

    @staticmethod
    def unread(near: int) -> int:
        """Return how many bytes lie in the line."""
        return int.from_bytes(fcntl.ioctl(near, termios.FIONREAD, bytes(4)), sys.byteorder)

    def is_open(self) -> bool:
        """Say whether this process has the near end open to read and write, as a port is."""
        for path in Path("/proc/self/fd").iterdir():
            try:
                if os.readlink(path) == self.name and fcntl.fcntl(int(path.name), fcntl.F_GETFL) & os.O_RDWR:
                    return True
            except OSError:
                continue  # closed since
        return False
