"""Content of the flash, which is erased by sectors, programmed by phrases, and stored in a file between runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hiltest.budgets import SEGMENTS
from hiltest.errors import ConfigError, SnapshotError
from hiltest.json_files import read_bounded
from hiltest.state import Restorable
from hiltest.virtual.processor.cpu import Processor
from hiltest.virtual.processor.memory import FLASH
from hiltest.virtual.program.elf import LoadSegment

SECTOR, BLOCK, SIZE = 0x1000, 0x80000, FLASH[1]
PHRASE, RECORDS = 8, 8
ERASED = b"\xff"


class FlashArray(Restorable):
    """The two blocks of flash, and the field of records that can be programmed once.

    Parameters
    ----------
    processor
        Processor whose memory has the flash.
    file
        File that stores the flash between runs: its 1 MiB, then the records. A missing file is created.

    Attributes
    ----------
    once : bytearray
        The records that can be programmed once.
    """

    def __init__(self, processor: Processor, file: str | Path | None = None) -> None:
        self.once = bytearray(ERASED * (PHRASE * RECORDS))
        self._memory = processor.memory
        self._file = None if file is None else Path(file)

    def state(self) -> Any:
        """Return the records; the flash itself is a memory of the machine.

        Raises
        ------
        SnapshotError
            If a file stores the flash.
        """
        if self._file is not None:
            raise SnapshotError(f"{self._file} stores the board's flash and cannot return to an earlier state")
        return super().state()

    def read(self, address: int, size: int) -> bytes:
        return self._memory.read(address, size)

    def is_erased(self, address: int, size: int) -> bool:
        """Return whether all bits of a range are one."""
        return self.read(address, size) == ERASED * size

    def erase(self, address: int, size: int) -> None:
        """Set all bits of a range to one."""
        self._change(address, ERASED * size)

    def program(self, address: int, data: bytes) -> bool:
        """Clear the bits that are zero in the data; return whether the flash then has the data."""
        programmed = bytes(old & new for old, new in zip(self.read(address, len(data)), data, strict=True))
        self._change(address, programmed)
        return programmed == data

    def program_once(self, record: int, data: bytes) -> None:
        self.once[PHRASE * record : PHRASE * (record + 1)] = data
        self._save(SIZE + PHRASE * record, data)

    def _change(self, address: int, data: bytes) -> None:
        self._memory.write(address, data)
        self._save(address, data)

    # -- the file -----------------------------------------------------------------------------

    def power_on(self, segments: Iterable[LoadSegment]) -> None:
        """Restore the flash from the file, except for sectors that a segment of the image occupies."""
        if self._file is None:
            return
        content = b""
        if self._file.exists():
            whole = SIZE + len(self.once)
            budget = replace(SEGMENTS, name="a stored flash", bytes=whole)
            content = read_bounded(self._file, budget, otherwise="name a file in which a board's flash was stored")
            if len(content) != whole:
                raise ConfigError(f"{self._file} has {len(content)} bytes, but the flash with its records has {whole}")
        if content:
            self._restore(content, segments)
        try:
            self._file.write_bytes(self.read(0, SIZE) + self.once)
        except OSError as error:
            raise ConfigError(f"{self._file}: {error.strerror}") from error

    def _restore(self, content: bytes, segments: Iterable[LoadSegment]) -> None:
        loaded = {
            sector
            for segment in segments
            if segment.data
            for sector in range(segment.address // SECTOR, (segment.address + len(segment.data) - 1) // SECTOR + 1)
        }
        for sector in set(range(SIZE // SECTOR)) - loaded:
            self._memory.write(sector * SECTOR, content[sector * SECTOR : (sector + 1) * SECTOR])
        self.once[:] = content[SIZE:]

    def _save(self, position: int, data: bytes) -> None:
        if self._file is None:
            return
        try:
            with self._file.open("r+b") as file:
                file.seek(position)
                file.write(data)
        except OSError as error:
            raise ConfigError(f"{self._file}: {error.strerror}") from error
