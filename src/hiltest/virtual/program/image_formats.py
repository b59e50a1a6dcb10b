"""Conversion of Intel HEX and raw binary to an ELF without symbols, so that one parser reads all images.

The library for HEX accepts a file without an end record, or with data after it. This module rejects such a file,
because it is probably incomplete.
"""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path

from intelhex import HexReaderError, IntelHex

from hiltest.budgets import HEX, SEGMENTS, Budget, BudgetError
from hiltest.errors import ConfigError

_ELF = b"\x7fELF"
_ELF_SUFFIXES = (".elf", ".axf", ".out")
_HEX_SUFFIXES = frozenset({".hex", ".ihex", ".ihx"})
_BINARY_SUFFIX = ".bin"
_ADDRESSES = 1 << 32

Chunk = tuple[int, bytes]
"""Address and content."""


def names_image(name: str) -> bool:
    """Return whether a name is that of a firmware file: by its suffix, or by ELF's first bytes in the file."""
    if Path(name).suffix.lower() in (*_ELF_SUFFIXES, *_HEX_SUFFIXES, _BINARY_SUFFIX):
        return True
    try:
        with open(name, "rb") as file:
            return file.read(len(_ELF)) == _ELF
    except OSError:
        return False


def convert_to_elf(name: str, content: bytes, base: int | None) -> bytes:
    """Return an image as an ELF; an ELF and content of unknown format are returned unchanged.

    Parameters
    ----------
    name
        File name: ``.bin`` is a raw binary; ``.hex``, ``.ihex``, ``.ihx`` or a colon as the first byte is Intel HEX.
        Neither a colon nor ELF's first byte can begin a vector table, because its first word is a multiple of four.
    base
        Address of a raw binary; an address also selects that format. None: address 0 for a file with the suffix.

    Raises
    ------
    ConfigError
        If the content is damaged, or `base` is set for a format with addresses.
    """
    suffix = Path(name).suffix.lower()
    is_hex = suffix in _HEX_SUFFIXES or content.startswith(b":")
    if content.startswith(_ELF) or is_hex:
        if base is not None:
            kind = "an ELF" if content.startswith(_ELF) else "Intel HEX"
            raise ConfigError(f"{name}: {kind} contains its own addresses; omit --base, which is for a raw binary")
        return _elf(_chunks(name, content)) if not content.startswith(_ELF) else content
    if base is None and suffix != _BINARY_SUFFIX:
        return content
    if not content:
        raise ConfigError(f"{name}: the file is empty; name the .bin that objcopy wrote")
    _check_budget(name, SEGMENTS, size=len(content))
    if not 0 <= (base or 0) <= _ADDRESSES - len(content):
        raise ConfigError(f"{name}: {len(content)} bytes at 0x{base:x} are beyond the last address; correct --base")
    return _elf([(base or 0, content)])


def _chunks(name: str, content: bytes) -> list[Chunk]:
    """Return the data of an Intel HEX file, with adjacent bytes in one chunk."""
    _check_budget(name, HEX, size=len(content))
    lines = [(number, line.strip()) for number, line in enumerate(content.splitlines(), start=1) if line.strip()]
    ends = [place for place, (_, line) in enumerate(lines) if line[7:9] == b"01"]
    if not ends:
        raise _refusal(name, lines[-1][0] if lines else 1, "the file ends without an end record: copy it again")
    if lines[ends[0] + 1 :]:
        raise _refusal(name, lines[ends[0] + 1][0], "a record follows the end record")
    image = IntelHex()
    try:
        image.loadhex(io.StringIO(b"\n".join(line for _, line in lines).decode("ascii", errors="replace")))
    except HexReaderError as error:
        raise _refusal(name, lines[error.line - 1][0], re.sub(r" (at|on) line \d+", "", str(error))) from error
    segments = image.segments()
    _check_budget(name, HEX, items=len(segments))
    chunks = [(begin, image.tobinstr(begin, end - 1)) for begin, end in segments]
    if not chunks:
        raise ConfigError(f"{name}: it has no data to load")
    if chunks[-1][0] + len(chunks[-1][1]) > _ADDRESSES:
        raise ConfigError(f"{name}: not valid Intel HEX: data extend beyond the last address")
    return chunks


def _check_budget(name: str, budget: Budget, **counts: int) -> None:
    try:
        budget.check(**counts)
    except BudgetError as error:
        raise ConfigError(f"{name}: {error}; name the program of one chip, or its ELF") from error


def _refusal(name: str, line: int, reason: str) -> ConfigError:
    return ConfigError(f"{name}, line {line}: not valid Intel HEX: {reason}")


def _elf(chunks: list[Chunk]) -> bytes:
    """Return an executable ELF for Arm with one segment for each chunk."""
    header_size, entry_size = 52, 32
    offset = header_size + entry_size * len(chunks)
    header = (
        _ELF
        + bytes((1, 1, 1))
        + bytes(9)
        + struct.pack(
            "<HHIIIIIHHHHHH", 2, 40, 1, 0, header_size, 0, 0x05000000, header_size, entry_size, len(chunks), 40, 0, 0
        )
    )
    entries = b""
    for address, data in chunks:
        entries += struct.pack("<IIIIIIII", 1, offset, address, address, len(data), len(data), 5, 4)
        offset += len(data)
    return header + entries + b"".join(data for _, data in chunks)
