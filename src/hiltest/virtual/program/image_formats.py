"""Intel HEX and raw binary, put into the form of an ELF without symbols, so that all images are read by one parser.

The parser of HEX is our own: the libraries for it take a file without its end record, or with data behind that, for a
whole one, and half a firmware would run.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from hiltest.errors import ConfigError

_ELF = b"\x7fELF"
_HEX_SUFFIXES = frozenset({".hex", ".ihex", ".ihx"})
_BINARY_SUFFIX = ".bin"
_ADDRESSES = 1 << 32
_DATA, _END, _SEGMENT, _SEGMENT_START, _LINEAR, _LINEAR_START = range(6)
#: How many bytes a record of each type holds; one of data as many as it says.
_LENGTHS = {_END: 0, _SEGMENT: 2, _SEGMENT_START: 4, _LINEAR: 2, _LINEAR_START: 4}

Chunk = tuple[int, bytes]
"""Address, and what stands there."""


def as_elf(name: str, content: bytes, base: int | None) -> bytes:
    """Return an image as an ELF; what is none of the other formats, as it is.

    Parameters
    ----------
    name
        File name: ``.bin`` is a raw binary; ``.hex``, ``.ihex`` or ``.ihx``, or a colon first, is Intel HEX. Neither
        colon nor ELF's first byte can begin a vector table, whose first word is a multiple of four.
    base
        Address of a raw binary; says that it is one. None: 0, for a file that is called one.

    Raises
    ------
    ConfigError
        If it is damaged, or `base` is given for a format that has addresses.
    """
    suffix = Path(name).suffix.lower()
    is_hex = suffix in _HEX_SUFFIXES or content.startswith(b":")
    if content.startswith(_ELF) or is_hex:
        if base is not None:
            kind = "an ELF" if content.startswith(_ELF) else "Intel HEX"
            raise ConfigError(
                f"{name}: {kind} says itself where it belongs; leave out --base, which is for a raw binary"
            )
        return _elf(_merged(name, _chunks(name, content))) if not content.startswith(_ELF) else content
    if base is None and suffix != _BINARY_SUFFIX:
        return content
    if not content:
        raise ConfigError(f"{name}: empty; give the .bin that objcopy wrote")
    if not 0 <= (base or 0) <= _ADDRESSES - len(content):
        raise ConfigError(f"{name}: {len(content)} bytes at 0x{base:x} are beyond the last address; correct --base")
    return _elf([(base or 0, content)])


def _chunks(name: str, content: bytes) -> Iterator[tuple[int, Chunk]]:
    """Yield the data records: line, and address with bytes."""
    segment, above, ended = 0, 0, False
    number = 0
    for number, line in enumerate(content.splitlines(), start=1):
        text = line.strip()
        if not text:
            continue
        if ended:
            raise _wrong(name, number, "stands behind the end record")
        kind, offset, data = _record(name, number, text)
        if kind == _DATA:
            if segment and offset + len(data) > 1 << 16:
                raise _wrong(name, number, "data go beyond the 64 KiB of their segment")
            address = above + segment + offset
            if address + len(data) > _ADDRESSES:
                raise _wrong(name, number, "data go beyond the last address")
            yield number, (address, data)
        elif kind == _END:
            ended = True
        elif kind == _SEGMENT:
            segment, above = int.from_bytes(data, "big") << 4, 0
        elif kind == _LINEAR:
            segment, above = 0, int.from_bytes(data, "big") << 16
    if not ended:
        raise _wrong(name, max(number, 1), "the file ends without an end record: copy it again")


def _record(name: str, number: int, text: bytes) -> tuple[int, int, bytes]:
    """Parse one line: type, address field, data."""
    try:
        raw = bytes.fromhex(text[1:].decode("ascii")) if text.startswith(b":") and b" " not in text else b""
    except ValueError:
        raw = b""
    if len(raw) < 5:
        raise _wrong(name, number, "no record: a colon and at least five bytes in hexadecimal")
    length, kind = raw[0], raw[3]
    if len(raw) != length + 5:
        raise _wrong(name, number, f"says {length} bytes of data and has {len(raw) - 5}")
    if sum(raw) & 0xFF:
        raise _wrong(name, number, f"checksum is 0x{raw[-1]:02x}, and should be 0x{-sum(raw[:-1]) & 0xFF:02x}")
    if kind != _DATA and _LENGTHS.get(kind) != length:
        known = f"has {length} bytes, not {_LENGTHS[kind]}" if kind in _LENGTHS else "is unknown"
        raise _wrong(name, number, f"record type {kind} {known}")
    return kind, int.from_bytes(raw[1:3], "big"), raw[4:-1]


def _merged(name: str, chunks: Iterator[tuple[int, Chunk]]) -> list[Chunk]:
    """Join what is adjacent; refuse what is there twice."""
    merged: list[tuple[int, bytearray]] = []
    for number, (address, data) in sorted(chunks, key=lambda chunk: (chunk[1][0], chunk[0])):
        end = merged[-1][0] + len(merged[-1][1]) if merged else -1
        if address < end and data:
            raise _wrong(name, number, f"address 0x{address:08x} has data already")
        if address == end:
            merged[-1][1].extend(data)
        elif data:
            merged.append((address, bytearray(data)))
    if not merged:
        raise ConfigError(f"{name}: nothing in it to load")
    return [(address, bytes(data)) for address, data in merged]


def _wrong(name: str, number: int, what: str) -> ConfigError:
    return ConfigError(f"{name}, line {number}: no valid Intel HEX: {what}")


def _elf(chunks: list[Chunk]) -> bytes:
    """Write an executable ELF for Arm with one segment a chunk, and nothing else."""
    header_size, entry_size = 52, 32
    offset = header_size + entry_size * len(chunks)
    header = _ELF + bytes((1, 1, 1)) + bytes(9) + struct.pack(
        "<HHIIIIIHHHHHH", 2, 40, 1, 0, header_size, 0, 0x05000000, header_size, entry_size, len(chunks), 40, 0, 0
    )  # fmt: skip
    entries = b""
    for address, data in chunks:
        entries += struct.pack("<IIIIIIII", 1, offset, address, address, len(data), len(data), 5, 4)
        offset += len(data)
    return header + entries + b"".join(data for _, data in chunks)
