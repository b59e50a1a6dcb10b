"""A folder that behaves as the drive of a DAPLink: a file that is written is programmed, and the drive mounted anew."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from tests.usb_tree import K64F

_END = b":00000001FF"


class BadHexError(Exception):
    """What DAPLink would say of a file."""


def memory_of(text: bytes) -> dict[int, int]:
    """Read Intel HEX as DAPLink does: address and byte of all that is programmed."""
    results: dict[int, int] = {}
    above = 0
    for line in text.splitlines():
        raw = bytes.fromhex(line[1:].decode())
        if sum(raw) & 0xFF or len(raw) != raw[0] + 5:
            raise BadHexError("The hex file cannot be decoded. Checksum calculation failure occurred.")
        address, kind, data = int.from_bytes(raw[1:3], "big"), raw[3], raw[4:-1]
        if kind == 4:
            above = int.from_bytes(data, "big") << 16
        elif kind == 0:
            results |= {above + address + index: byte for index, byte in enumerate(data)}
        elif kind == 1:
            return results
    raise BadHexError("The transfer timed out.")


class Drive:
    """The drive, from `with` on, and the flash behind it.

    Attributes
    ----------
    flash : dict of int to int
        What was programmed last: byte by address.
    programmed : callable
        Called with the file, when it was programmed and before the drive is back.
    refusal : str
        What DAPLink finds wrong with the next files; empty for nothing.
    stops : str
        Error of its own that it stops at; empty for none.
    comes_back : bool
    back_at : Path
        Where it is mounted from the next time on.
    """

    def __init__(self, folder: Path, *, counts: bool = True, settings: str = "Auto Reset: 1") -> None:
        self.back_at = folder
        self.flash: dict[int, int] = {}
        self.programmed: Callable[[bytes], None] = lambda _text: None
        self.refusal = self.stops = ""
        self.comes_back = True
        self._folder, self._counts, self._settings = folder, counts, settings
        self._remounts = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        folder.mkdir(parents=True, exist_ok=True)
        self._mount("")

    def __enter__(self) -> Drive:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(timeout=30.0)

    def _run(self) -> None:
        while not self._ended.wait(0.01):
            for file in filter(Path.is_file, self._folder.glob("*.HEX")):
                text = file.read_bytes()
                if self.refusal or _END in text:
                    self._take(text)

    def _take(self, text: bytes) -> None:
        refusal = self.refusal
        if not refusal:
            try:
                self.flash = memory_of(text)
                self.programmed(text)
            except BadHexError as error:
                refusal = str(error)
        for path in self._folder.iterdir():
            path.unlink()
        time.sleep(0.05)
        if self.comes_back:
            self._folder = self.back_at
            self._folder.mkdir(parents=True, exist_ok=True)
            self._remounts += 1
            self._mount(refusal)

    def _mount(self, message: str) -> None:
        count = f"Remount count: {self._remounts}\r\n" if self._counts else ""
        if message:
            (self._folder / "FAIL.TXT").write_text(f"error: {message}\r\ntype: user\r\n", newline="")
        if self.stops:
            (self._folder / "ASSERT.TXT").write_text(f"Assert\r\nFile: {self.stops}\r\nLine: 42\r\n", newline="")
        details = self._folder / "DETAILS"  # whole at once, as a mounted drive is
        details.write_text(
            f"# DAPLink Firmware - see https://daplink.io\r\nUnique ID: {K64F}\r\n{self._settings}\r\n"
            f"Daplink Mode: Interface\r\nInterface Version: 0257\r\n{count}",
            newline="",
        )
        details.rename(self._folder / "DETAILS.TXT")
