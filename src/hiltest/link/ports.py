"""Open serial ports by URL, and say what is wrong when one cannot be opened."""

from __future__ import annotations

import errno
import os
from typing import Protocol

import serial
from serial.tools import list_ports as _list_ports

from hiltest.errors import BenchError, ConfigError, PortNotFoundError, PortRefusedError

# How long one read may wait before the session looks at its deadline again.
READ_SLICE_S = 0.05
# A host that cannot get 1 KiB out at 115200 baud in this time has a line that takes nothing.
WRITE_TIMEOUT_S = 2.0


class SerialPort(Protocol):
    """The part of pyserial's port that a session uses.

    A port with its own clock also has ``now() -> float`` [s]; the session's
    deadlines then run on it. It is virtual unless ``clock`` says otherwise, as of a recorded one.
    """

    name: str

    def read_until(self, expected: bytes) -> bytes:
        """Return bytes up to and including `expected`, fewer when the read slice is over."""

    def write(self, data: bytes) -> int | None:
        """Send bytes."""

    def reset_input_buffer(self) -> None:
        """Drop what has arrived and was not read."""

    def close(self) -> None:
        """Give the port back."""


def list_ports() -> tuple[str, ...]:
    """Return the serial devices of this machine, sorted."""
    return tuple(sorted(port.device for port in _list_ports.comports()))


def open_port(url: str, *, baud: int = 115_200) -> SerialPort:
    """Open a serial port, exclusively where the system can.

    Parameters
    ----------
    url : str
        A device (``/dev/ttyACM0``, ``COM3``) or a pyserial URL (``rfc2217://``, ``socket://``, ``hil://``).
    baud : int
        Line speed.

    Raises
    ------
    ConfigError
        When the URL's scheme is not known.
    PortNotFoundError
        When the device does not exist; lists those that do.
    PortRefusedError
        When it exists and may not be used: permissions, or another program has it.
    BenchError
        When it cannot be opened for another reason.
    """
    # pyserial's RFC 2217 client refuses to open with a write timeout; what it writes goes to TCP's buffer.
    write_timeout_s = None if url.lower().startswith("rfc2217:") else WRITE_TIMEOUT_S
    try:
        port = serial.serial_for_url(
            url, do_not_open=True, baudrate=baud, timeout=READ_SLICE_S, write_timeout=write_timeout_s
        )
    except ValueError as error:
        raise ConfigError(f"port {url!r}: {error}. Give a device, or a URL that pyserial knows.") from error
    if os.name == "posix" and "://" not in url:
        port.exclusive = True
    try:
        port.open()
    except serial.SerialException as error:
        raise _refusal(url, error) from error
    opened: SerialPort = port
    return opened


def _refusal(url: str, error: serial.SerialException) -> BenchError | PortNotFoundError:
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFoundError" in str(error):
        return PortNotFoundError(url, list_ports())
    if error.errno in (errno.EACCES, errno.EPERM) or "PermissionError" in str(error):
        return PortRefusedError(
            url, "permission denied",
            "Join the group that owns it: sudo usermod -aG dialout $USER (uucp on Arch), then log in again.",
        )
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return PortRefusedError(url, "another program has it open", "Close that program, then run again.")
    return BenchError(f"cannot open {url}: {error}")
