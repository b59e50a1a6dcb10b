"""Open serial ports by URL, with clear errors if one cannot be opened."""

from __future__ import annotations

import errno
import os
import re
from typing import Any, Protocol
from urllib.parse import urlsplit

import serial
from serial.tools import list_ports as _list_ports

from hiltest.errors import BenchError, ConfigError, PortNotFoundError, PortRefusedError
from hiltest.link.lock import BoardLock

# Timeout of one read, after which the session checks its deadline.
READ_SLICE_S = 0.05
# Write timeout: a line that does not accept 1 KiB at 115200 baud in this time is blocked.
WRITE_TIMEOUT_S = 2.0
# Schemes whose boards are in this process, and so need no lock.
_INSIDE = frozenset({"hil", "loop"})


class SerialPort(Protocol):
    """The part of pyserial's port that a session uses.

    A port with its own clock also has ``now() -> float`` [s]; the session's deadlines then use it. It is virtual unless
    ``clock`` says otherwise, as for a recorded port.
    """

    name: str

    def read_until(self, expected: bytes) -> bytes:
        """Return bytes up to and including `expected`, fewer at the end of the read slice."""

    def write(self, data: bytes) -> int | None:
        """Send bytes."""

    def reset_input_buffer(self) -> None:
        """Drop the unread bytes."""

    def close(self) -> None:
        """Close the port."""


def list_ports() -> tuple[str, ...]:
    """Return the serial devices of this machine, sorted."""
    return tuple(sorted(port.device for port in _list_ports.comports()))


def place_of(device: str) -> str | None:
    """Return the canonical identity of the board on a port; None for one in this process.

    This is the serial number of a USB device, because its device name may change while the board is flashed; otherwise
    the device that links lead to; for a URL, host and port.
    """
    if device.lower().startswith("hwgrep:"):
        device = _closed_port(device).port
    if "://" in device:
        url = urlsplit(device)
        return None if url.scheme in _INSIDE else url.netloc.rpartition("@")[2].lower() or device
    real = os.path.realpath(device)
    serial_numbers = (port.serial_number for port in _list_ports.comports() if os.path.realpath(port.device) == real)
    return next(serial_numbers, None) or real


def open_port(url: str, *, baud: int = 115_200, rig: str = "") -> SerialPort:
    """Open a serial port for exclusive use: the board behind it is locked until the port is closed.

    Parameters
    ----------
    url
        A device (``/dev/ttyACM0``, ``COM3``) or a pyserial URL (``rfc2217://``, ``socket://``, ``hil://``, ``usb://``);
        of ``socket://TOKEN@HOST:PORT`` the token is sent as a line of its own.
    baud
        Line speed.
    rig
        Name of the rig, for messages to other processes that want the board.

    Raises
    ------
    ConfigError
        When the URL's scheme is unknown.
    PortNotFoundError
        When the device does not exist; the message lists the existing ones.
    PortRefusedError
        When it exists and may not be used: by permissions, or because another program has it or the board.
    BenchError
        When it cannot be opened for another reason.
    """
    # pyserial's RFC 2217 client refuses to open with a write timeout; its output goes to TCP's buffer.
    over_rfc2217 = url.lower().startswith(("rfc2217:", "labgrid:"))
    write_timeout_s = None if over_rfc2217 else WRITE_TIMEOUT_S
    port = _closed_port(url, baudrate=baud, timeout=READ_SLICE_S, write_timeout=write_timeout_s)
    if os.name == "posix" and isinstance(port, serial.Serial):
        port.exclusive = True
    place = place_of(port.port)
    lock = None if place is None else BoardLock(place, rig=rig, name=url)
    try:
        port.open()
    except BaseException as error:
        if lock is not None:
            lock.release()
        if isinstance(error, serial.SerialException):
            raise _refusal(url, error) from error
        raise
    if url.lower().startswith("socket://") and (token := urlsplit(url).username):
        port.write(f"{token}\n".encode())  # of a served port that is not on a loopback address
    if lock is not None:
        _release_when_closed(port, lock)
    opened: SerialPort = port
    return opened


def _closed_port(url: str, **settings: Any) -> Any:
    """Return the port of a device or a URL without opening it; ``hwgrep://`` is resolved here."""
    try:
        return serial.serial_for_url(url, do_not_open=True, **settings)
    except (ValueError, re.error) as error:
        raise ConfigError(f"port {url!r}: {error}. Name a device, or a URL that pyserial supports.") from error
    except serial.SerialException as error:
        raise PortNotFoundError(url, list_ports()) from error


def _release_when_closed(port: Any, lock: BoardLock) -> None:
    """Release the lock when the port is closed: by a subclass, as an instance attribute would keep it alive."""

    class Locked(type(port)):  # type: ignore[misc]
        def close(self) -> None:
            try:
                super().close()
            finally:
                lock.release()

    port.__class__ = Locked


def _refusal(url: str, error: serial.SerialException) -> BenchError | PortNotFoundError:
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFoundError" in str(error):
        return PortNotFoundError(url, list_ports())
    if error.errno in (errno.EACCES, errno.EPERM) or "PermissionError" in str(error):
        return PortRefusedError(
            url,
            "permission denied",
            "Join the group that owns it: sudo usermod -aG dialout $USER (uucp on Arch), then log in again.",
        )
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return PortRefusedError(url, "another program uses it", "Close that program, then run again.")
    return BenchError(f"cannot open {url}: {error}")
