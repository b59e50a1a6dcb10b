"""Loader of images into the board's memories, and reader of their vector tables."""

from __future__ import annotations

from hiltest.errors import ConfigError
from hiltest.virtual.part.chip import MemoryMap, is_in
from hiltest.virtual.processor.memory import MK64FN1M0, BoardMemory
from hiltest.virtual.program.elf import FirmwareImage

_VECTOR_ALIGNMENT = 128


def load_segments(memory: BoardMemory, image: FirmwareImage) -> None:
    """Power on the memories, and write an image to its load addresses, as a programmer does.

    Raises
    ------
    ConfigError
        If the image does not fit.
    """
    memory.clear()
    for segment in image.segments:
        try:
            memory.write(segment.address, segment.data)
            memory.read(segment.run_address, segment.run_size)
        except ValueError as error:
            link = "link for 1 MiB of flash at 0 and 256 KiB of SRAM at 0x1fff0000"
            is_k64f = memory.map == MK64FN1M0
            part, advice = ("MK64FN1M0", link) if is_k64f else (f"memories {memory.map}", "name its part's memories")
            raise ConfigError(f"{image.name}: a segment does not fit the {part} ({error}); {advice}") from error


def load_running(memory: BoardMemory, image: FirmwareImage) -> None:
    """Write an image to its run addresses, as start-up code does: initialised data in RAM, and zeros after it."""
    for segment in image.segments:
        zeroed = segment.run_size - len(segment.data)
        memory.write(segment.run_address, segment.data + bytes(zeroed))


def vectors(memory: BoardMemory, image: FirmwareImage) -> tuple[int, int]:
    """Return the initial stack pointer and the reset vector.

    Raises
    ------
    ConfigError
        If one of them is invalid.
    """
    try:
        stack, entry = memory.read_words(image.vectors, 2)
    except ValueError:
        stack = entry = 0
    refuse_wrong_vectors(image, stack, entry, memory.map)
    return stack, entry


def initial_stack(memory: BoardMemory, image: FirmwareImage) -> int:
    """Return the initial stack pointer of the first vector table in an image, else the end of the largest RAM.

    A vector table begins at a multiple of 128 bytes (DDI 0403E, B3.2.5), with an address in RAM and one of code.
    """
    for segment in sorted(image.segments, key=lambda segment: segment.run_address):
        begin, end = segment.run_address, segment.run_address + len(segment.data)
        for address in range(-(-begin // _VECTOR_ALIGNMENT) * _VECTOR_ALIGNMENT, end - 7, _VECTOR_ALIGNMENT):
            stack, entry = memory.read_words(address, 2)
            if stack % 4 == 0 and memory.holds_stack(stack - 4, 4) and entry & 1 and _is_code(image, entry & ~1):
                return stack
    return memory.sram.base + memory.sram.size


def _is_code(image: FirmwareImage, address: int) -> bool:
    return any(part.run_address <= address < part.run_address + part.run_size for part in image.segments)


def refuse_wrong_vectors(image: FirmwareImage, stack: int, entry: int, memories: MemoryMap = MK64FN1M0) -> None:
    """Raise a ConfigError if the initial stack pointer or the reset vector is invalid."""
    in_sram = is_in(memories.ram, stack - 4) and stack % 4 == 0
    in_code = any(segment.address <= entry & ~1 < segment.address + len(segment.data) for segment in image.segments)
    if not (in_sram and in_code and entry & 1):
        raise ConfigError(
            f"{image.name}: no valid vector table at address 0x{image.vectors:x} (stack 0x{stack:08x}, reset "
            f"0x{entry:08x}); link the vectors to 0x{memories.flash[0][0]:x}, the stack into SRAM, and handlers with "
            "the Thumb bit"
        )
