"""What firmware takes of the part's memories: flash, static RAM, and its stacks as deep as they have been."""

from __future__ import annotations

from collections.abc import Iterable

from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.processor.stacks import Stack
from hiltest.virtual.program.elf import FirmwareImage


def memory_use(image: FirmwareImage, memories: MemoryMap, stacks: Iterable[Stack]) -> dict[str, int]:
    """Return bytes by what they are for.

    Parameters
    ----------
    stacks
        The first is the one that the firmware starts with.

    Returns
    -------
    dict of str to int
        ``flash`` and ``ram``: what the ELF's segments take, zeroed data and code that is copied to RAM included.
        ``stack_most``: the stack that the firmware starts with, exceptions' frames included. ``TASK.stack_most``:
        the stack of each task, by the function that it begins with; of several that begin with one the deepest.
    """
    used = {
        "flash": sum(len(segment.data) for segment in image.segments if _within(segment.address, memories.flash)),
        "ram": sum(segment.run_size for segment in image.segments if _within(segment.run_address, memories.ram)),
    }
    for index, stack in enumerate(stacks):
        function = image.function_at(stack.first_pc)
        owner = "" if index == 0 else f"{function.name if function else f'at_0x{stack.first_pc:08x}'}."
        used[f"{owner}stack_most"] = max(stack.used, used.get(f"{owner}stack_most", 0))
    return used


def _within(address: int, ranges: Iterable[tuple[int, int]]) -> bool:
    return any(base <= address < base + size for base, size in ranges)
