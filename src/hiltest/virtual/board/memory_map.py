"""Memories of other parts, which the user names or which are guessed from the image."""

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
_LARGEST = 64 << 20  # of all memories together, because the host allocates them
# The architecture's region for data. Other segments are in flash unless they are copied or zeroed, since some parts
# have RAM outside the region.
_DATA_REGION = range(0x20000000, 0x40000000)
_GUESSED_ROUND = 1 << 16
_GUESSED_SPARE = 1 << 17  # RAM beyond what the image uses: stack and arguments
_FORM = "write it as flash=0x08000000:512K,ram=0x20000000:128K"


def memory_map(image: FirmwareImage, description: str | None = None) -> MemoryMap:
    """Return the memories for calling functions of an image.

    Parameters
    ----------
    description
        ``flash=0x08000000:512K,ram=0x20000000:128K``, with one item per memory. By default the MK64FN1M0's
        memories if the image fits into them, otherwise those that its segments need.

    Raises
    ------
    ConfigError
        If the description is empty, or its memories overlap or are outside the processor's memory regions.
    """
    if description is not None:
        return _parse(description)
    if fits(MK64FN1M0, image):
        return MK64FN1M0
    try:
        return _guess(image)
    except ConfigError as error:
        raise ConfigError(f"{image.name}: {error}; name its part's memories with --memory: {_FORM}") from error


def _spans(image: FirmwareImage) -> Iterable[Region]:
    for segment in image.segments:
        yield segment.address, len(segment.data)
        yield segment.run_address, segment.run_size


def fits(memory: MemoryMap, image: FirmwareImage) -> bool:
    """Return whether memories have all segments of an image."""
    regions = (*memory.flash, *memory.ram)
    return all(
        any(base <= address and address + size <= base + length for base, length in regions)
        for address, size in _spans(image)
    )


def _parse(description: str) -> MemoryMap:
    regions: dict[str, list[Region]] = {"flash": [], "ram": []}
    for item in description.split(","):
        match = _ITEM.fullmatch(item.strip())
        if match is None:
            raise ConfigError(f"--memory: {item.strip()!r} is not a memory; {_FORM}")
        kind, address, size, unit = match.groups()
        regions[kind.lower()].append((int(address, 0), int(size, 0) * _UNITS[unit.upper()]))
    if not regions["ram"]:
        raise ConfigError(f"--memory: {description!r} has no RAM for arguments and stack; {_FORM}")
    memory = MemoryMap(tuple(regions["flash"]), tuple(regions["ram"]))
    try:
        _check(memory)
    except ConfigError as error:
        raise ConfigError(f"--memory: {error}") from error
    return memory


def _check(memory: MemoryMap) -> None:
    regions = sorted((*memory.flash, *memory.ram))
    for base, size in regions:
        if base % _PAGE or size % _PAGE or not size:
            raise ConfigError(f"0x{base:08x}:0x{size:x} is not a multiple of 4 KiB")
        if not any(first <= base and base + size - 1 <= last for first, last in PLAIN):
            raise ConfigError(f"0x{base:08x}:0x{size:x} is outside the processor's memory regions")
        if base <= RETURN_ADDRESS < base + size:
            raise ConfigError(
                f"0x{base:08x}:0x{size:x} contains 0x{RETURN_ADDRESS:08x}, the return address of called functions"
            )
    for (base, size), (after, _) in itertools.pairwise(regions):
        if base + size > after:
            raise ConfigError(f"the memories at 0x{base:08x} and 0x{after:08x} overlap")
    if sum(size for _, size in regions) > _LARGEST:
        raise ConfigError(f"the memories exceed {_LARGEST >> 20} MiB in total")


def _guess(image: FirmwareImage) -> MemoryMap:
    """Return flash at the load addresses, and RAM at run addresses that differ from them."""
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
    memory = MemoryMap(tuple(_join(flash, 0)), tuple(_join(ram, _GUESSED_SPARE)))
    _check(memory)
    return memory


def _join(regions: list[Region], spare: int) -> list[Region]:
    """Round regions to 64 KiB, and join adjacent ones."""
    rounded: list[Region] = []
    for base, size in sorted(regions):
        begin = base // _GUESSED_ROUND * _GUESSED_ROUND
        end = -(-(base + size + spare) // _GUESSED_ROUND) * _GUESSED_ROUND
        if rounded and begin <= sum(rounded[-1]):
            begin, before = rounded.pop()
            end = max(end, begin + before)
        rounded.append((begin, end - begin))
    return rounded
