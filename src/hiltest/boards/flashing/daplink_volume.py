"""Drag and drop: a file is written to the drive of a DAPLink, which programs the chip and then remounts its drive.

The result is on the remounted drive: FAIL.TXT has the reason of a failure, and DETAILS.TXT counts how often the drive
was mounted (DAPLink's source, ``vfs_user.c`` and ``vfs_manager.c``). All files are read with size limits, because the
folder may be anything.
"""

from __future__ import annotations

import os
import re
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hiltest.errors import FlashError
from hiltest.text import legible

# A short name in capitals, because a long one needs two directory entries.
FILE_NAME = "HILTEST.HEX"
# DAPLink aborts a stalled transfer after 20 s and disappears for 2.5 s; then the system mounts it.
BACK_WITHIN_S = 60.0
_LOOK_EVERY_S = 0.1
_PIECE = 1 << 14
_READ_MOST, _SAID_MOST = 4096, 500

Progress = Callable[[str, int, int], None]
"""Callback with the current task, the amount done, and its total."""


class DriveState(NamedTuple):
    """State of a drive in its files."""

    details: str
    """Content of DETAILS.TXT."""
    remounts: int | None
    """Number of remounts by DAPLink; None for a DAPLink that does not count."""
    stopped: str
    """Content of ASSERT.TXT, which stays on the drive until somebody deletes it."""

    @classmethod
    def read(cls, volume: Path) -> DriveState | None:
        """Read the state of a drive; return None if it is not a DAPLink's."""
        details = _text(volume / "DETAILS.TXT")
        if not details:
            return None
        count = _field(details, "Remount count")
        return cls(details, int(count) if re.fullmatch("[0-9]{1,10}", count) else None, _text(volume / "ASSERT.TXT"))

    @property
    def unique_id(self) -> str:
        """Unique id, equal to the board's serial number on USB; empty if it is missing."""
        return _field(self.details, "Unique ID")

    @property
    def resets_by_itself(self) -> bool:
        """True if the firmware starts after programming, which is DAPLink's default."""
        return _field(self.details, "Auto Reset") != "0"


def drop(
    content: bytes,
    volume: Path,
    *,
    find: Callable[[], Path | None] = lambda: None,
    progress: Progress,
    back_within_s: float = BACK_WITHIN_S,
) -> DriveState:
    """Let a DAPLink program Intel HEX, and wait for its result.

    Parameters
    ----------
    volume
        Mount point of its drive.
    find
        Returns the present mount point, which may change after a remount.
    back_within_s
        Longest absence of the drive.

    Returns
    -------
    DriveState
        State of the remounted drive.

    Raises
    ------
    FlashError
        When there is no drive of a DAPLink, it cannot be written, DAPLink refuses the file, or the drive does not
        return.
    """
    before = DriveState.read(volume)
    _refuse_drive(volume, before)
    assert before is not None
    failed = _write(volume / FILE_NAME, content, progress)
    began_s = time.monotonic()
    while (waited_s := time.monotonic() - began_s) < back_within_s:
        for place in dict.fromkeys(mount for mount in (volume, find()) if mount is not None):
            after = DriveState.read(place)
            if after is not None and _is_back(place, before, after):
                _refuse_failure(place, failed, after.stopped if after.stopped != before.stopped else "")
                return after
        progress("second until the drive is back", int(waited_s), int(back_within_s))
        time.sleep(_LOOK_EVERY_S)
    ended = f"writing {FILE_NAME} failed ({failed.strerror or failed})" if failed else f"{FILE_NAME} was written"
    raise FlashError(
        f"{volume} did not come back within {back_within_s:g} s after {ended}: the result is unknown. Mount the "
        "drive again and look for FAIL.TXT on it, or flash with --probe pyocd"
    )


def _refuse_drive(volume: Path, state: DriveState | None) -> None:
    if state is None:
        raise FlashError(
            f"{volume} is not the drive of a DAPLink: it has no DETAILS.TXT. Name its mount point with --volume"
        )
    if "daplink" not in state.details.lower() or not (state.unique_id or _field(state.details, "Daplink Mode")):
        raise FlashError(
            f"{volume} is not the drive of a DAPLink: its DETAILS.TXT does not name DAPLink and a unique id. Name the "
            "drive's mount point with --volume"
        )
    if _field(state.details, "Daplink Mode").lower() == "bootloader":
        raise FlashError(
            f"{volume} is the boot loader of DAPLink, for firmware of the interface chip: unplug the board, and plug "
            "it in again without holding its reset button"
        )


def _is_back(volume: Path, before: DriveState, after: DriveState) -> bool:
    """Return whether DAPLink has remounted its drive: by its count, or because the written file is gone."""
    if before.remounts is not None:
        return after.remounts not in (None, before.remounts)
    return not (volume / FILE_NAME).exists()


def _write(file: Path, content: bytes, progress: Progress) -> OSError | None:
    """Write the file through to the drive; return an error, which the remounted drive may explain."""
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        raise FlashError(
            f"cannot write {file}: {error.strerror or error}. Mount the drive so that you can write to it"
        ) from error
    try:
        try:
            for start in range(0, len(content), _PIECE):
                piece = content[start : start + _PIECE]
                while piece:
                    piece = piece[os.write(descriptor, piece) :]
                os.fsync(descriptor)  # after each piece, because buffered data is not programmed yet
                progress("KiB written", min(start + _PIECE, len(content)) >> 10, len(content) >> 10)
        finally:
            os.close(descriptor)
    except OSError as error:
        return error
    return None


def _refuse_failure(volume: Path, failed: OSError | None, stopped: str) -> None:
    text = _text(volume / "FAIL.TXT")
    if text or (volume / "FAIL.TXT").exists():
        raise FlashError(f"{volume}: DAPLink did not program the board; FAIL.TXT: {_join_lines(text) or 'is empty'}")
    if stopped:
        raise FlashError(
            f"{volume}: DAPLink stopped at an internal error; ASSERT.TXT: {_join_lines(stopped)}. Delete that file, "
            "or plug the board in again, and update its DAPLink (https://daplink.io)"
        )
    if failed is not None:
        raise FlashError(f"cannot write to {volume}: {failed.strerror or failed}; DAPLink gives no reason")


def _field(details: str, name: str) -> str:
    match = re.search(rf"^{re.escape(name)}:(.*)$", details, re.MULTILINE | re.IGNORECASE)
    return legible(match[1].strip()) if match else ""


def _join_lines(text: str) -> str:
    return legible("; ".join(line.strip().rstrip(".") for line in text.splitlines() if line.strip()))[:_SAID_MOST]


def _text(file: Path) -> str:
    """Return the beginning of a plain file; empty if there is none."""
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return ""
    try:
        plain = stat.S_ISREG(os.fstat(descriptor).st_mode)
        return os.read(descriptor, _READ_MOST).decode("utf-8", errors="replace") if plain else ""
    except OSError:  # the drive is being removed
        return ""
    finally:
        os.close(descriptor)
