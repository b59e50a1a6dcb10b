"""Images for the flash of an MK64FN1M0, and the refusal of dangerous ones."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.virtual.board.loading import refuse_wrong_vectors
from hiltest.virtual.processor.memory import FLASH, SRAM
from hiltest.virtual.program.elf import FirmwareImage, load_image
from hiltest.virtual.program.image_formats import Chunk
from hiltest.virtual.program.other_chips import other_chip

# The flash configuration field (MK64F reference manual, 29.3.1): protection and security of the chip at reset.
FIELD = range(0x400, 0x410)
_FSEC = 0x40C
_SEC, _UNSECURED = 0x03, 0x02
_MEEN, _NO_MASS_ERASE = 0x30, 0x20
_RECORD = 16
_DATA, _END, _LINEAR = 0, 1, 4


@dataclass(frozen=True, slots=True)
class FlashImage:
    """A firmware image that may be put into the flash of an MK64FN1M0."""

    image: FirmwareImage
    chunks: tuple[Chunk, ...]
    """Addresses and bytes, ascending and not adjacent."""

    @property
    def size(self) -> int:
        """Number of bytes to write."""
        return sum(len(data) for _, data in self.chunks)

    def contains(self, text: bytes) -> bool:
        """Return whether the image contains these bytes."""
        return any(text in data for _, data in self.chunks)

    def intel_hex(self) -> bytes:
        """Return the image as Intel HEX, in which truncation and damage are detected, unlike in a raw binary."""
        return b"".join(self._records())

    def _records(self) -> Iterator[bytes]:
        above = -1
        for base, data in self.chunks:
            address, end = base, base + len(data)
            while address < end:
                if address >> 16 != above:
                    above = address >> 16
                    yield _record(_LINEAR, 0, above.to_bytes(2, "big"))
                size = min(_RECORD - address % _RECORD, end - address)
                yield _record(_DATA, address & 0xFFFF, data[address - base : address - base + size])
                address += size
        yield _record(_END, 0, b"")


def load_flash_image(path: Path) -> FlashImage:
    """Read an ELF, Intel HEX or raw binary, and refuse an image that is not for this chip or would lock it.

    Raises
    ------
    ConfigError
        If the file cannot be read, is for another processor or part, does not fit the flash, has no vector table at 0,
        or would secure the chip.
    """
    image = load_image(path)
    _refuse_other_part(image)
    chunks = _chunks(image)
    stack, entry = struct.unpack("<2I", _read_bytes(chunks, 0, 8))
    refuse_wrong_vectors(image, stack, entry)
    _refuse_lock(image, _read_bytes(chunks, FIELD.start, len(FIELD), missing=b""))
    return FlashImage(image, chunks)


def _refuse_other_part(image: FirmwareImage) -> None:
    chip = other_chip(image)
    if chip is not None and chip.name:
        raise ConfigError(f"{image.name}: {chip}, and the board has an MK64FN1M0: build for MK64F12")


def _chunks(image: FirmwareImage) -> tuple[Chunk, ...]:
    """Return the bytes to write, with adjacent segments joined."""
    base, size = FLASH
    joined: list[tuple[int, bytearray]] = []
    for segment in sorted(
        (candidate for candidate in image.segments if candidate.data), key=lambda segment: segment.address
    ):
        first, end = segment.address, segment.address + len(segment.data)
        if first < base or end > base + size:
            raise ConfigError(
                f"{image.name}: built for another chip, or for RAM: {len(segment.data)} bytes load at 0x{first:08x}, "
                f"and the MK64FN1M0 has {size >> 10} KiB of flash at {base}"
            )
        if not _is_in_memories(segment.run_address, segment.run_size):
            raise ConfigError(
                f"{image.name}: built for another chip: {segment.run_size} bytes run at 0x{segment.run_address:08x}, "
                f"where the MK64FN1M0 has neither flash nor SRAM (0x{SRAM[0]:08x}, {SRAM[1] >> 10} KiB)"
            )
        last_end = joined[-1][0] + len(joined[-1][1]) if joined else -1
        if first < last_end:
            raise ConfigError(f"{image.name}: two segments load at 0x{first:08x}; correct the linker script")
        if first == last_end:
            joined[-1][1].extend(segment.data)
        else:
            joined.append((first, bytearray(segment.data)))
    return tuple((address, bytes(data)) for address, data in joined)


def _is_in_memories(address: int, size: int) -> bool:
    return any(base <= address and address + size <= base + room for base, room in (FLASH, SRAM))


def _read_bytes(chunks: tuple[Chunk, ...], address: int, size: int, missing: bytes | None = None) -> bytes:
    """Return bytes of one chunk; `missing`, or zeros, if it does not contain all of them."""
    for base, data in chunks:
        if base <= address and address + size <= base + len(data):
            return data[address - base : address - base + size]
    return bytes(size) if missing is None else missing


def _refuse_lock(image: FirmwareImage, field: bytes) -> None:
    """Refuse a field that would lock out debugger and DAPLink at the next reset."""
    place = f"the flash configuration field at 0x{FIELD.start:x}"
    mend = f"link it as the board's start-up code has it, FSEC (0x{_FSEC:x}) = 0xFE"
    if not field:
        raise ConfigError(
            f"{image.name}: {place} is incomplete in the file: erased bytes would secure the chip against all "
            "debuggers; "
            f"{mend}"
        )
    fsec = field[_FSEC - FIELD.start]
    if fsec & _SEC == _UNSECURED and fsec & _MEEN != _NO_MASS_ERASE:
        return
    harm = []
    if fsec & _SEC != _UNSECURED:
        harm.append("secures the chip against all debuggers")
    if fsec & _MEEN == _NO_MASS_ERASE:
        harm.append("forbids the mass erase that would open a secured chip again")
    raise ConfigError(f"{image.name}: {place} {', and '.join(harm)} (FSEC 0x{fsec:02X}); {mend}")


def _record(kind: int, address: int, data: bytes) -> bytes:
    body = bytes((len(data), *address.to_bytes(2, "big"), kind)) + data
    return b":" + (body + bytes((-sum(body) & 0xFF,))).hex().upper().encode() + b"\r\n"
