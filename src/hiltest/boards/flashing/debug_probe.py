"""Flashing by a debug probe with pyOCD, which the extra ``hiltest[bench]`` installs."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

from hiltest.boards.flashing.flash_image import FIELD, FlashImage
from hiltest.errors import ConfigError, FlashError, NoBoardError, SeveralBoardsError

_TARGET = "k64f"
_PERCENT = 100


def program(image: FlashImage, serial_number: str = "", *, progress: Callable[[str, int, int], None]) -> str:
    """Erase the chip, write an image, read it back, and start it.

    Parameters
    ----------
    serial_number
        Serial number of the board, or its beginning; empty for the only one.
    progress
        Callback with the current task, the amount done, and its total.

    Returns
    -------
    str
        Serial number of the probe.

    Raises
    ------
    ConfigError
        When pyOCD is not installed, or several probes match.
    FlashError
        When pyOCD cannot reach or program the chip, or its flash differs afterwards.
    NoBoardError
        When no matching probe is plugged in.
    """
    try:
        from pyocd.core.exceptions import Error
        from pyocd.core.helpers import ConnectHelper
        from pyocd.core.session import Session
        from pyocd.flash.file_programmer import FileProgrammer
    except ImportError as error:
        raise ConfigError(
            f"--probe pyocd needs pyOCD ({error}): pip install 'hiltest[bench]'; or leave it out to use the drive of "
            "the board's DAPLink"
        ) from error
    try:
        # Not ConnectHelper.session_with_chosen_probe, because it waits for a probe, and asks on the terminal.
        probes = ConnectHelper.get_all_connected_probes(blocking=False, unique_id=serial_number or None)
        if not probes and serial_number:
            raise FlashError(
                f"pyOCD sees no probe of board {serial_number}: install the udev rules with the command that "
                "`hiltest doctor` prints, then plug it in again"
            )
        if not probes:
            raise NoBoardError(serial_number, [])
        if len(probes) > 1:
            raise SeveralBoardsError([probe.unique_id for probe in probes])
        probe = probes[0]
        options = {"target_override": _TARGET, "hide_programming_progress": True}
        with Session(probe, auto_open=False, options=options) as session:
            session.delegate = _Delegate()
            session.open()
            programmer = FileProgrammer(
                session,
                progress=lambda part: progress("percent written", int(_PERCENT * part), _PERCENT),
                chip_erase="chip",
                smart_flash=False,
            )
            for address, data in image.chunks:
                programmer.add_file(io.BytesIO(data), file_format="bin", base_address=address)
            programmer.commit()
            for address, data in image.chunks:
                _refuse_difference(address, data, bytes(session.target.read_memory_block8(address, len(data))))
            session.target.reset()
        return str(probe.unique_id)
    except (Error, OSError) as error:
        raise FlashError(f"pyOCD cannot program the board: {error or type(error).__name__}") from error


class _Delegate:
    """Delegate that stops pyOCD from reading the part's register table, which takes seconds."""

    def will_init_target(self, target: Any, init_sequence: Any) -> None:
        """Change the start sequence of pyOCD, which calls this method."""
        init_sequence.remove_task("load_svd")


def _refuse_difference(address: int, written: bytes, read: bytes) -> None:
    """Compare the bytes read back; pyOCD unlocks the flash configuration field regardless of the image."""
    for at, (want, got) in enumerate(zip(written, read, strict=True), start=address):
        if want != got and at not in FIELD:
            raise FlashError(
                f"the flash has 0x{got:02x} at 0x{at:08x} where 0x{want:02x} was written: flash it again; if it stays, "
                "the chip is worn out"
            )
