"""Boards that are plugged in, found by the USB identity of their DAPLink, and other serial ports.

The module reads sysfs and /proc below a root that the caller or ``HILTEST_ROOT`` in the environment may name: an
emulated tree, or one that was copied from another machine. Texts of USB devices and their volumes are foreign input, so
they are truncated and sanitised.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hiltest.errors import BenchError, NoBoardError, SeveralBoardsError
from hiltest.text import legible

VENDOR_ID, PRODUCT_ID = 0x0D28, 0x0204
"""USB identity of DAPLink, on every board that has it."""
BOARD_ID = "0240"
"""DAPLink's id of the FRDM-K64F: its serial numbers begin with it."""
NO_PORT = "load its driver: sudo modprobe cdc_acm"
"""Remedy for a board without a serial port."""

_DETAILS = ("DETAILS.TXT", "details.txt")  # vfat shows short names as they are, or in lower case
_READ_MOST = 4096
# A USB string has at most 126 characters; a file on a volume could have any.
_LONGEST = 126
_PORT_UNKNOWN = "0"  # type that the kernel's 8250 driver gives to a port that the machine does not have
# Name of the volume of DAPLink's bootloader, on all boards.
_BOOTLOADER_ID = "0000"
# Vendors of other programs for the board's interface chip, by USB vendor id.
_OPENSDA = {0x1357: "P&E Micro", 0x1366: "SEGGER"}


@dataclass(frozen=True, slots=True)
class Volume:
    """The mounted drive of a DAPLink, with the contents of its DETAILS.TXT; empty if it has none."""

    path: Path
    read_only: bool = False
    """Mount point."""
    interface_version: str = ""
    """Version of the interface chip's firmware, such as ``0257``."""
    unique_id: str = ""
    """The same as the serial number on USB."""


@dataclass(frozen=True, slots=True)
class UsbBoard:
    """A USB device with serial ports or DAPLink's identity."""

    vendor_id: int
    product_id: int
    serial_number: str = ""
    """Empty if the device has none."""
    product: str = ""
    """Product name of the device."""
    ports: tuple[Path, ...] = ()
    """Its serial devices: a DAPLink has one, or none without a driver."""
    disks: tuple[str, ...] = ()
    """Names of its drives, such as ``sdb``."""
    volume: Volume | None = None
    """Mounted volume on one of them."""

    @property
    def port(self) -> Path | None:
        """Its first serial device."""
        return self.ports[0] if self.ports else None

    @property
    def usb_id(self) -> str:
        """Identity as ``lsusb`` writes it."""
        return f"{self.vendor_id:04x}:{self.product_id:04x}"

    @property
    def is_daplink(self) -> bool:
        """True if it has DAPLink's identity."""
        return (self.vendor_id, self.product_id) == (VENDOR_ID, PRODUCT_ID)

    @property
    def board_id(self) -> str:
        """DAPLink's id of the board; empty for another device."""
        return self.serial_number[:4] if self.is_daplink else ""

    @property
    def not_taken(self) -> str:
        """Reason why it is not an FRDM-K64F, with a remedy if it should be; empty if it is one."""
        if self.is_daplink and self.board_id == BOARD_ID:
            return ""
        if self.is_daplink and self.board_id == _BOOTLOADER_ID:
            return "a DAPLink in its boot loader: plug it in again without holding its reset button"
        if self.is_daplink:
            identity = f"board id {self.board_id}" if self.board_id else "no serial number"
            return f"DAPLink of another board: {identity}, an FRDM-K64F has {BOARD_ID}"
        if maker := _OPENSDA.get(self.vendor_id):
            return f"a debug probe by {maker}: if it is an FRDM-K64F, put DAPLink on it, from https://daplink.io"
        return f"USB {self.usb_id}, not DAPLink's {VENDOR_ID:04x}:{PRODUCT_ID:04x}"


@dataclass(frozen=True, slots=True)
class OtherPort:
    """A serial port without a board, and the reason."""

    port: Path | None
    """Serial device; None for a DAPLink without one."""
    device: UsbBoard | None
    """USB device that it belongs to; None if it is not on USB."""

    @property
    def not_taken(self) -> str:
        """Reason why it is not used."""
        return self.device.not_taken if self.device else "not on USB; if a board is on it, name it with --port"


@dataclass(frozen=True, slots=True)
class PluggedIn:
    """FRDM-K64F boards that are plugged in, by serial number, and other serial ports."""

    boards: tuple[UsbBoard, ...]
    others: tuple[OtherPort, ...]

    def has_drive_at(self, folder: Path) -> bool:
        """Return whether the drive of a USB device with a serial port or DAPLink's identity is mounted at a folder."""
        devices = (*self.boards, *(other.device for other in self.others if other.device))
        real = os.path.realpath(folder)
        return any(device.volume is not None and os.path.realpath(device.volume.path) == real for device in devices)


def machine_root() -> Path:
    """Return the folder that holds ``sys``, ``proc`` and ``dev``: ``HILTEST_ROOT``, or the root of this machine."""
    return Path(os.environ.get("HILTEST_ROOT") or "/")


def plugged_in(root: Path | None = None) -> PluggedIn:
    """Look for boards and serial ports.

    Parameters
    ----------
    root
        Folder with ``sys``, ``proc`` and ``dev``; by default the environment's.
    """
    root = root or machine_root()
    mounts = _mounts(root)
    devices = [device for device in _usb_devices(root, mounts) if device.is_daplink or device.ports]
    boards = sorted((device for device in devices if not device.not_taken), key=lambda device: device.serial_number)
    others = [OtherPort(port, device) for device in devices if device.not_taken for port in device.ports or (None,)]
    on_usb = {port.name for device in devices for port in device.ports}
    others += [OtherPort(port, None) for port in _ports(root) if port.name not in on_usb]
    return PluggedIn(tuple(boards), tuple(others))


def find_boards(root: Path | None = None) -> tuple[UsbBoard, ...]:
    """Return the FRDM-K64F boards that are plugged in, by serial number."""
    return plugged_in(root).boards


def choose_board(serial_number: str = "", *, root: Path | None = None) -> UsbBoard:
    """Return the one board that is plugged in whose serial number begins so.

    Parameters
    ----------
    serial_number
        Beginning or all of it; empty for any board.
    root
        See `plugged_in`.

    Raises
    ------
    NoBoardError
        When there is none; the message lists the present boards.
    SeveralBoardsError
        When there are several.
    """
    boards = find_boards(root)
    fitting = [board for board in boards if board.serial_number.startswith(serial_number)]
    if not fitting:
        raise NoBoardError(serial_number, [board.serial_number for board in boards])
    if len(fitting) > 1:
        raise SeveralBoardsError([board.serial_number for board in fitting])
    return fitting[0]


def port_of(serial_number: str = "") -> str:
    """Return the serial device of the one board that is plugged in whose serial number begins so.

    Raises
    ------
    BenchError
        When there is no such board, or it has no serial device.
    SeveralBoardsError
        When there are several.
    """
    board = choose_board(serial_number)
    if board.port is None:
        raise BenchError(f"board {board.serial_number} has no serial port: {NO_PORT}")
    return str(board.port)


def _usb_devices(root: Path, mounts: dict[str, tuple[Path, bool]]) -> Iterator[UsbBoard]:
    for folder in _children(root / "sys/bus/usb/devices"):
        vendor, product = (_identity(folder / name) for name in ("idVendor", "idProduct"))
        if vendor is None or product is None:
            continue  # an interface, which is read with its device
        interfaces = [child for child in _children(folder) if child.name.startswith(f"{folder.name}:")]
        ttys = [tty for interface in interfaces for tty in (*interface.glob("tty/*"), *interface.glob("tty*/tty/*"))]
        disks = sorted(
            (disk for interface in interfaces for disk in interface.glob("host*/target*/*/block/*")),
            key=lambda disk: disk.name,
        )
        mounted = (mounts.get(_attribute(part / "dev")) for disk in disks for part in (disk, *_partitions(disk)))
        place = next((mount for mount in mounted if mount), None)
        yield UsbBoard(
            vendor,
            product,
            serial_number=_attribute(folder / "serial"),
            product=_attribute(folder / "product"),
            ports=tuple(root / "dev" / tty.name for tty in sorted(ttys, key=lambda tty: tty.name)),
            disks=tuple(disk.name for disk in disks),
            volume=_volume(*place) if place else None,
        )


def _ports(root: Path) -> Iterator[Path]:
    """Yield the serial ports of the machine: terminals with an existing device behind them."""
    for tty in _children(root / "sys/class/tty"):
        if (tty / "device").exists() and _attribute(tty / "type") != _PORT_UNKNOWN:
            yield root / "dev" / tty.name


def _partitions(disk: Path) -> list[Path]:
    return [child for child in _children(disk) if child.name.startswith(disk.name)]


def _mounts(root: Path) -> dict[str, tuple[Path, bool]]:
    """Return the mount point of each disk, and whether it is read-only, by its ``major:minor``."""
    try:
        lines = (root / "proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return {}
    mounts: dict[str, tuple[Path, bool]] = {}
    for fields in (line.split(" ") for line in lines):
        if len(fields) > 5 and fields[3] == "/":
            place = re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), fields[4])
            mounts.setdefault(fields[2], (root / place.lstrip("/"), "ro" in fields[5].split(",")))
    return mounts


def _volume(path: Path, read_only: bool) -> Volume:
    """Return a volume with the contents of its DETAILS.TXT, if it is readable."""
    text = next((text for name in _DETAILS if (text := _text_of(path / name))), "")
    parted = (line.partition(":") for line in text.splitlines())
    details = {key.strip().lower(): _cut(value) for key, _, value in parted}
    return Volume(path, read_only, details.get("interface version", ""), details.get("unique id", ""))


def _text_of(file: Path) -> str:
    """Return the beginning of a plain file: on a volume that is no DAPLink's it may be a pipe, or a link elsewhere."""
    with contextlib.suppress(OSError):
        number = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            if stat.S_ISREG(os.fstat(number).st_mode):
                return os.read(number, _READ_MOST).decode("utf-8", errors="replace")
        finally:
            os.close(number)
    return ""


def _identity(file: Path) -> int | None:
    text = _attribute(file)
    return int(text, 16) if re.fullmatch("[0-9a-f]{4}", text) else None


def _attribute(file: Path) -> str:
    """Return the text of a file of sysfs; empty if it cannot be read."""
    return _cut(_text_of(file))


def _cut(text: str) -> str:
    return legible(" ".join(text.split())[:_LONGEST])


def _children(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []
