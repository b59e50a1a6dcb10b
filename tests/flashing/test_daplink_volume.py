"""Drag and drop onto the drive of a DAPLink: what came of it is said, and no other folder is written to."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from tests.flashing.drive import Drive
from tests.usb_tree import K64F

from hiltest.boards import default_firmware
from hiltest.boards.flashing.daplink_volume import FILE_NAME, drop
from hiltest.boards.flashing.flash_image import load_flash_image
from hiltest.errors import BenchError, FlashError

SHORT_S = 0.5  # the drive below is back in a twentieth of a second
IMAGE = load_flash_image(default_firmware())
HEX = IMAGE.intel_hex()


def quiet(_what: str, _done: int, _of: int) -> None:
    """Show no progress."""


def test_what_is_dropped_is_in_the_flash_then_byte_for_byte(tmp_path: Path) -> None:
    shown: list[tuple[str, int, int]] = []
    with Drive(tmp_path) as drive:
        state = drop(HEX, tmp_path, progress=lambda *item: shown.append(item))
    assert drive.flash == {base + at: byte for base, data in IMAGE.chunks for at, byte in enumerate(data)}
    assert state.unique_id == K64F
    assert state.remounts == 1
    assert ("KiB written", len(HEX) >> 10, len(HEX) >> 10) in shown


def test_fail_txt_is_read_and_said(tmp_path: Path) -> None:
    with Drive(tmp_path), pytest.raises(FlashError, match=r"FAIL.TXT: error: The hex file cannot be decoded") as caught:
        drop(HEX.replace(b":10", b":11", 1), tmp_path, progress=quiet)
    assert "type: user" in str(caught.value)
    assert isinstance(caught.value, BenchError)


def test_a_failure_of_an_earlier_time_is_not_that_of_this(tmp_path: Path) -> None:
    with Drive(tmp_path) as drive:
        drive.refusal = "An error occurred during the transfer"
        with pytest.raises(FlashError, match="during the transfer"):
            drop(HEX, tmp_path, progress=quiet)
        assert (tmp_path / "FAIL.TXT").exists()
        drive.refusal = ""
        drop(HEX, tmp_path, progress=quiet)


def test_a_drive_that_stays_away_leaves_it_unknown(tmp_path: Path) -> None:
    with Drive(tmp_path) as drive:
        drive.comes_back = False
        with pytest.raises(FlashError, match=r"did not come back within 0.5 s .* is unknown"):
            drop(HEX, tmp_path, progress=quiet, back_within_s=SHORT_S)


def test_a_drive_that_is_mounted_elsewhere_then_is_found(tmp_path: Path) -> None:
    with Drive(tmp_path / "DAPLINK") as drive:
        drive.back_at = tmp_path / "DAPLINK1"
        state = drop(HEX, tmp_path / "DAPLINK", find=lambda: tmp_path / "DAPLINK1", progress=quiet)
    assert state.remounts == 1


def test_a_daplink_that_does_not_count_is_back_when_the_file_is_gone(tmp_path: Path) -> None:
    with Drive(tmp_path, counts=False) as drive:
        assert drop(HEX, tmp_path, progress=quiet).remounts is None
        drive.refusal = "The transfer timed out."
        with pytest.raises(FlashError, match="timed out"):
            drop(HEX, tmp_path, progress=quiet)


def test_an_error_of_its_own_is_said_once(tmp_path: Path) -> None:
    with Drive(tmp_path) as drive:
        drive.stops = "flash_manager.c"
        with pytest.raises(FlashError, match=r"ASSERT.TXT: Assert; File: flash_manager.c; Line: 42"):
            drop(HEX, tmp_path, progress=quiet)
        drop(HEX, tmp_path, progress=quiet)  # the file is there until somebody deletes it


def test_a_write_that_breaks_off_is_explained_by_the_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sync, synced = os.fsync, []

    def breaks_off(descriptor: int) -> None:
        synced.append(descriptor)
        if len(synced) > 1:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        sync(descriptor)

    monkeypatch.setattr("os.fsync", breaks_off)
    with Drive(tmp_path) as drive:
        drive.refusal = "The application image is not compatible with the target."
        with pytest.raises(FlashError, match=r"FAIL.TXT: error: The application image is not compatible"):
            drop(HEX, tmp_path, progress=quiet)


@pytest.mark.parametrize(
    ("details", "message"),
    [
        (None, "it has no DETAILS.TXT"),
        ("Unique ID: 0240\r\nInterface Version: 0257\r\n", "does not name DAPLink and a unique id"),
        ("# notes about my DAPLink\r\n", "does not name DAPLink and a unique id"),
        ("Daplink Mode: Bootloader\r\n", "without holding its reset button"),
    ],
)
def test_nothing_is_written_to_another_folder(details: str | None, message: str, tmp_path: Path) -> None:
    if details is not None:
        (tmp_path / "DETAILS.TXT").write_text(details, newline="")
    with pytest.raises(FlashError, match=message):
        drop(HEX, tmp_path, progress=quiet)
    assert {path.name for path in tmp_path.iterdir()} <= {"DETAILS.TXT"}


def test_a_drive_that_cannot_be_written_to_is_an_error_at_once(tmp_path: Path) -> None:
    with Drive(tmp_path):
        (tmp_path / FILE_NAME).mkdir()
        with pytest.raises(FlashError, match=f"cannot write {tmp_path / FILE_NAME}: Is a directory"):
            drop(HEX, tmp_path, progress=quiet)
        (tmp_path / FILE_NAME).rmdir()
