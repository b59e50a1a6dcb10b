"""Memories of other parts: named by the user, or guessed from what an image needs."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable

from hiltest.errors import ConfigError
from hiltest.virtual.part.chip import MemoryMap, Region
from hiltest.virtual.processor.cpu import RETURN_ADDRESS
from hiltest.virtual.processor.memory import MK64FN1M0, PLAIN
from hiltest.virtual.program.elf import FirmwareImage

_ITEM = re.compile(r"(flash|ram)=(0x[0-9a-f]{1,8}|\d{1,10}):(0x[0-9a-f]{1,8}|\d{1,10})([kKmM]?)", re.IGNORECASE)
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20}
_PAGE = 1 << 12
_LARGEST = 64 << 20  # of all memories together: the host keeps them
# The architecture has data here. Elsewhere is flash, but for what is copied there or zeroed: parts have RAM there too.
_DATA_REGION = range(0x20000000, 0x40000000)
_GUESSED_ROUND = 1 << 16
_GUESSED_SPARE = 1 << 17  # RAM beyond what the image uses: stack and arguments
_FORM = "write it as flash=0x08000000:512K,ram=0x20000000:128K"


def memory_map(image: FirmwareImage, described: str | None = None) -> MemoryMap:
    """Return the memories that an image is called on.

    Parameters
    ----------
    described
        ``flash=0x08000000:512K,ram=0x20000000:128K``, each as often as there are such memories. By default the
        MK64FN1M0's where the image fits them, and else what its segments need.

    Raises
    ------
    ConfigError
        If it describes none, or memories that overlap or lie where the processor has something else.
    """
    if described is not None:
        return _parsed(described)
    if all(_fits(MK64FN1M0, *span) for span in _spans(image)):
        return MK64FN1M0
    try:
        return _guessed(image)
    except ConfigError as error:
        raise ConfigError(f"{image.name}: {error}; name its part's memories with --memory: {_FORM}") from error


def _spans(image: FirmwareImage) -> Iterable[Region]:
    for segment in image.segments:
        yield segment.address, len(segment.data)
        yield segment.run_address, segment.run_size


def _fits(memory: MemoryMap, address: int, size: int) -> bool:
    return any(base <= address and address + size <= base + length for base, length in (*memory.flash, *memory.ram))


def _parsed(described: str) -> MemoryMap:
    found: dict[str, list[Region]] = {"flash": [], "ram": []}
    for item in described.split(","):
        match = _ITEM.fullmatch(item.strip())
        if match is None:
            raise ConfigError(f"--memory: {item.strip()!r} is no memory; {_FORM}")
        kind, address, size, unit = match.groups()
        found[kind.lower()].append((int(address, 0), int(size, 0) * _UNITS[unit.upper()]))
    if not found["ram"]:
        raise ConfigError(f"--memory: {described!r} has no RAM, where arguments and stack are; {_FORM}")
    memory = MemoryMap(tuple(found["flash"]), tuple(found["ram"]))
    try:
        _check(memory)
    except ConfigError as error:
        raise ConfigError(f"--memory: {error}") from error
    return memory


def _check(memory: MemoryMap) -> None:
    regions = sorted((*memory.flash, *memory.ram))
    for base, size in regions:
        if base % _PAGE or size % _PAGE or not size:
            raise ConfigError(f"0x{base:08x}:0x{size:x} is no multiple of 4 KiB")
        if not any(first <= base and base + size - 1 <= last for first, last in PLAIN):
            raise ConfigError(f"0x{base:08x}:0x{size:x} reaches to where the processor has no memory")
        if base <= RETURN_ADDRESS < base + size:
            raise ConfigError(f"0x{base:08x}:0x{size:x} holds 0x{RETURN_ADDRESS:08x}, where called functions return to")
    for (base, size), (after, _) in itertools.pairwise(regions):
        if base + size > after:
            raise ConfigError(f"the memories at 0x{base:08x} and 0x{after:08x} overlap")
    if sum(size for _, size in regions) > _LARGEST:
        raise ConfigError(f"more than {_LARGEST >> 20} MiB in all")


def _guessed(image: FirmwareImage) -> MemoryMap:
    """Take what segments load to as flash, and what they run in besides as RAM."""
    flash: list[Region] = []
    ram: list[Region] = []
    for segment in image.segments:
        stays = segment.address == segment.run_address and segment.data
        if stays and segment.run_address not in _DATA_REGION:
            flash.append((segment.address, segment.run_size))
            continue
        if segment.data and segment.address != segment.run_address:
            flash.append((segment.address, len(segment.data)))
        ram.append((segment.run_address, segment.run_size))
    if not any(base in _DATA_REGION for base, _ in ram):
        ram.append((_DATA_REGION.start, 0))
    memory = MemoryMap(tuple(_joined(flash, 0)), tuple(_joined(ram, _GUESSED_SPARE)))
    _check(memory)
    return memory


def _joined(regions: list[Region], spare: int) -> list[Region]:
    """Round to 64 KiB, and join what touches."""
    joined: list[Region] = []
    for base, size in sorted(regions):
        begin = base // _GUESSED_ROUND * _GUESSED_ROUND
        end = -(-(base + size + spare) // _GUESSED_ROUND) * _GUESSED_ROUND
        if joined and begin <= sum(joined[-1]):
            begin, before = joined.pop()
            end = max(end, begin + before)
        joined.append((begin, end - begin))
    return joined
