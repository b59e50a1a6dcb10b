"""Flashing of a board under its lock, and the check of its identity afterwards."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from hiltest.boards.daplink import UsbBoard, choose_board, find_boards, plugged_in
from hiltest.boards.flashing.daplink_volume import DriveState, drop
from hiltest.boards.flashing.debug_probe import program
from hiltest.boards.flashing.flash_image import FlashImage
from hiltest.errors import (
    BenchError,
    ConfigError,
    FlashError,
    NoBoardError,
    PortNotFoundError,
    VersionMismatchError,
)
from hiltest.link.lock import BoardLock
from hiltest.link.ports import open_port, place_of
from hiltest.link.replies import Identity
from hiltest.link.session import FIRMWARE_NAME, Session
from hiltest.rig import Rig
from hiltest.text import format_number

# Time for the restart: firmware starts within a second of its reset; a port that disappeared is available again in a
# few seconds.
ANSWERS_WITHIN_S = 10.0
_ASK_AGAIN_S = 0.2
_BAUD = 115_200
_ID_DIGITS = 8  # digits that identify a build

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Target:
    """A board that may be flashed, with the known facts."""

    port: str | None
    """Its serial port."""
    board: UsbBoard | None
    """USB device of the board on this machine."""
    volume: Path | None
    """Mount point of its DAPLink's drive."""
    baud: int = _BAUD
    rig: Rig | None = None

    @property
    def serial_number(self) -> str:
        """Serial number of the board; empty if unknown."""
        return self.board.serial_number if self.board else ""

    @property
    def place(self) -> str:
        """Name of the board's lock."""
        of_port = place_of(self.port) if self.port else None
        if of_port or self.serial_number:
            return of_port or self.serial_number
        drive = DriveState.read(self.volume) if self.volume else None
        return (drive.unique_id if drive else "") or os.path.realpath(self.volume or "pyocd")

    def mounted_at(self) -> Path | None:
        """Return the present mount point of the drive."""
        volumes = (board.volume for board in find_boards() if board.serial_number == self.serial_number)
        return next((volume.path for volume in volumes if volume), None)


@dataclass(frozen=True, slots=True)
class FlashResult:
    """Result of flashing a board."""

    serial_number: str
    """Empty if it is not known."""
    identity: Identity | None
    """Identity of the firmware afterwards; None if it was not asked."""
    said: str
    """Remark on the firmware that now runs."""

    def sentence(self, image: FlashImage, target: Target) -> str:
        """Return the result as a sentence."""
        board = f"board {self.serial_number}" if self.serial_number else f"the board on {target.port or target.volume}"
        return f"{Path(image.image.name).name}: {format_number(image.size)} bytes flashed onto {board}; {self.said}"


def find_target(
    *, rig: Rig | None = None, port: str | None = None, volume: Path | None = None, by_probe: bool = False
) -> Target:
    """Find the board to flash.

    Parameters
    ----------
    port
        Port in place of the rig's; if neither is set, the only board that is plugged in.
    volume
        Mount point of its DAPLink's drive, instead of a search.
    by_probe
        True to use a debug probe, which need not be a DAPLink.

    Raises
    ------
    ConfigError
        When the board is a virtual one, or several are plugged in.
    BenchError
        When there is no board.
    """
    url = port or (rig.board.port if rig else None)
    if (url or "").startswith("hil:") or (rig is not None and url is None and rig.board.kind != "real"):
        kind = rig.board.kind if rig is not None and url is None else "virtual"
        raise ConfigError(
            f"a {kind} board cannot be flashed: it runs the ELF of --firmware. Name the port of a board with "
            "--port, or a rig of a real board with --rig"
        )
    board: UsbBoard | None = None
    if url is not None and not url.startswith("usb:"):
        real = os.path.realpath(url) if "://" not in url else None
        board = next(
            (board for board in find_boards() if real in {os.path.realpath(port) for port in board.ports}), None
        )
    elif url is None and volume is not None:
        drive = DriveState.read(volume)
        board = next((board for board in find_boards() if drive and board.serial_number == drive.unique_id), None)
    else:
        try:
            board = choose_board((url or "").partition("://")[2].strip("/"))
        except NoBoardError:
            if url is not None or not by_probe:
                raise
    if url is None or url.startswith("usb:"):
        url = str(board.port) if board and board.port else None
    if volume is None and board and board.volume:
        volume = board.volume.path
    return Target(url, board, volume, rig.link.baud if rig else _BAUD, rig)


def flash(
    image: FlashImage, target: Target, *, by_probe: bool = False, is_forced: bool = False, progress: Progress
) -> FlashResult:
    """Flash an image, and check that the board then answers with its identity.

    Parameters
    ----------
    by_probe
        True to use a debug probe with pyOCD; by default the image is copied to the drive of the board's DAPLink.
    is_forced
        True to write also to a folder that is not the mount point of a USB drive.
    progress
        Callback with the current task, the amount done, and its total.

    Raises
    ------
    PortRefusedError
        When another process has the board.
    FlashError
        When it cannot be programmed, or nothing answers afterwards.
    VersionMismatchError
        When other firmware answers afterwards.
    ConfigError
        See `program`.
    """
    with BoardLock(target.place, rig=target.rig.name if target.rig else "", name=target.port or target.serial_number):
        serial_number, hint = target.serial_number, ""
        if by_probe:
            serial_number = program(image, serial_number, progress=progress)
        else:
            volume = _find_volume(target)
            if not (is_forced or plugged_in().has_drive_at(volume)):
                raise FlashError(
                    f"{volume} is not the mount point of a USB drive with a DAPLink: mount the board's drive and name "
                    "that folder with --volume, or write to this one with --force"
                )
            after = drop(image.intel_hex(), volume, find=target.mounted_at, progress=progress)
            serial_number = serial_number or after.unique_id
            hint = "" if after.resets_by_itself else " Press its reset button: its DAPLink does not start firmware."
        if not image.contains(FIRMWARE_NAME.encode()) or (target.rig is not None and not target.rig.answers_requests):
            rig = target.rig.path if target.rig else "R"
            return FlashResult(
                serial_number,
                None,
                "it does not speak hiltest's protocol, so its build is unknown: check its output with hiltest listen "
                f"--rig {rig}",
            )
        if target.port is None:
            return FlashResult(
                serial_number,
                None,
                "the serial port of the board is unknown, so its build was not checked: name the port with --port",
            )
        try:
            identity = _ask(target.port, target)
        except BenchError as error:
            raise FlashError(f"{image.image.name} was programmed, but does not answer: {error}{hint}") from error
        return FlashResult(serial_number, identity, _identity_remark(identity, image, target.port))


def _find_volume(target: Target) -> Path:
    if target.volume is not None:
        return target.volume
    if target.board is None:
        raise ConfigError(
            f"the board on {target.port} is not among the boards on this machine: name the mount point of its "
            "DAPLink drive with --volume, or use --probe pyocd"
        )
    disks = " or ".join(f"udisksctl mount -b /dev/{disk}" for disk in target.board.disks)
    raise FlashError(
        f"the drive of board {target.serial_number} is not mounted: "
        + (f"mount it ({disks})" if disks else "its DAPLink has no drive (see MSD in its DETAILS.TXT)")
        + ", or use hiltest flash --probe pyocd"
    )


def _ask(port: str, target: Target) -> Identity:
    """Ask for the identity, repeatedly until the board answers."""
    until_s = time.monotonic() + ANSWERS_WITHIN_S
    while True:
        try:
            rig = target.rig.name if target.rig else ""
            with closing(Session(open_port(port, baud=target.baud, rig=rig))) as session:
                session.synchronise()
                return session.identify()
        except (BenchError, PortNotFoundError) as error:
            if time.monotonic() > until_s:
                raise error if isinstance(error, BenchError) else FlashError(str(error)) from error
            time.sleep(_ASK_AGAIN_S)


def _identity_remark(identity: Identity, image: FlashImage, port: str) -> str:
    answers = f"{identity.name} {identity.version} build {identity.build_id} answers"
    build_id = image.image.build_id
    if not build_id:
        return f"{answers}; the image has no build id to compare"
    if len(identity.build_id) < _ID_DIGITS or not build_id.startswith(identity.build_id.lower()):
        raise VersionMismatchError(
            f"{image.image.name} is build {build_id[:16]}, and on {port} {answers}: the port belongs to another "
            "board, or the chip still runs its earlier firmware"
        )
    return f"{answers}: the flashed firmware runs"
