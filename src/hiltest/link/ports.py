"""Open serial ports by URL, and say what is wrong when one cannot be opened."""

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

# How long one read may wait before the session looks at its deadline again.
READ_SLICE_S = 0.05
# A host that cannot get 1 KiB out at 115200 baud in this time has a line that takes nothing.
WRITE_TIMEOUT_S = 2.0
# What is behind these is in this process, for it alone.
_INSIDE = frozenset({"hil", "loop"})


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


def place_of(device: str) -> str | None:
    """Return what stands for the board on a port, the same for every name of the port; None inside this process.

    That is the serial number of a USB device, since the device behind a name may change while the board is flashed, or
    else the device that links lead to; of a URL, host and port.
    """
    if device.lower().startswith("hwgrep:"):
        device = _closed_port(device).port
    if "://" in device:
        url = urlsplit(device)
        return None if url.scheme in _INSIDE else url.netloc.rpartition("@")[2].lower() or device
    real = os.path.realpath(device)
    serial_numbers = (each.serial_number for each in _list_ports.comports() if os.path.realpath(each.device) == real)
    return next(serial_numbers, None) or real


def open_port(url: str, *, baud: int = 115_200, rig: str = "") -> SerialPort:
    """Open a serial port for this process alone: the board behind it is locked until the port is closed.

    Parameters
    ----------
    url
        A device (``/dev/ttyACM0``, ``COM3``) or a pyserial URL (``rfc2217://``, ``socket://``, ``hil://``, ``usb://``).
    baud
        Line speed.
    rig
        Name of the rig, for others that want the board.

    Raises
    ------
    ConfigError
        When the URL's scheme is not known.
    PortNotFoundError
        When the device does not exist; lists those that do.
    PortRefusedError
        When it exists and may not be used: permissions, or another program has it, or the board.
    BenchError
        When it cannot be opened for another reason.
    """
    # pyserial's RFC 2217 client refuses to open with a write timeout; what it writes goes to TCP's buffer.
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
    if lock is not None:
        _release_when_closed(port, lock)
    opened: SerialPort = port
    return opened


def _closed_port(url: str, **settings: Any) -> Any:
    """Return the port of a device or a URL without opening it; ``hwgrep://`` looks for its device here."""
    try:
        return serial.serial_for_url(url, do_not_open=True, **settings)
    except (ValueError, re.error) as error:
        raise ConfigError(f"port {url!r}: {error}. Give a device, or a URL that pyserial knows.") from error
    except serial.SerialException as error:
        raise PortNotFoundError(url, list_ports()) from error


def _release_when_closed(port: Any, lock: BoardLock) -> None:
    """Bind the lock to the port: by its class, since a function of its own would keep the port from its end."""

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
            url, "permission denied",
            "Join the group that owns it: sudo usermod -aG dialout $USER (uucp on Arch), then log in again.",
        )
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return PortRefusedError(url, "another program has it open", "Close that program, then run again.")
    return BenchError(f"cannot open {url}: {error}")
