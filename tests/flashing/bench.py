"""A board that is plugged into an emulated machine: its drive programs a chip, a virtual board behind a tty."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from tests.flashing.drive import Drive
from tests.usb_tree import UsbTree

WAIT_S = 60.0  # for what takes a second


class Bench:
    """The machine's root, the drive, and a chip that is reset whenever it was programmed, from `with` on."""

    def __init__(self, folder: Path) -> None:
        self.root, self._folder = folder / "machine", folder
        self._chip: subprocess.Popen[str] | None = None
        self._taken: list[int] = []
        self.usb = UsbTree(self.root)
        self.drive = Drive(self.usb.plug_in(behind=folder / "chip", disk="sdb", mounted="/media/me/DAPLINK"))
        self.drive.programmed = self.run

    def __enter__(self) -> Bench:
        self.drive.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.drive.__exit__()
        self._end()
        for descriptor in self._taken:
            os.close(descriptor)

    def run(self, text: bytes) -> None:
        """Have the chip run what is in Intel HEX."""
        self._end()
        firmware = self._folder / "flash.hex"
        firmware.write_bytes(text)
        environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
        serves = ["serve", "--link", str(self._folder / "chip"), "--firmware", str(firmware)]
        self._chip = subprocess.Popen(
            [sys.executable, "-m", "hiltest", *serves],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._chip.stdout is not None
        assert self._chip.stdout.readline().startswith("board: ")

    def _end(self) -> None:
        if self._chip is not None:
            # Held, so that its terminal's number is not that of another test's while what it stands for is locked.
            with suppress(OSError):
                self._taken.append(os.open(self._folder / "chip", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
            self._chip.terminate()
            self._chip.communicate(timeout=WAIT_S)
            self._chip = None
