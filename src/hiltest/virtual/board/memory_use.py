"""Memory use of firmware: flash, static RAM, and the deepest extent of each stack."""

from __future__ import annotations

from collections.abc import Iterable

from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.processor.stacks import Stack
from hiltest.virtual.program.elf import FirmwareImage


def memory_use(image: FirmwareImage, memories: MemoryMap, stacks: Iterable[Stack]) -> dict[str, int]:
    """Return the bytes used, by purpose.

    Parameters
    ----------
    stacks
        Stacks of the firmware; it starts with the first.

    Returns
    -------
    dict of str to int
        ``flash`` and ``ram``: the ELF's segments, with zeroed data and code that is copied to RAM.
        ``stack_most``: the stack that the firmware starts with, including exception frames. ``TASK.stack_most``:
        the stack of each task, by the function that it begins with; if several begin with one, the deepest.
    """
    used = {
        "flash": sum(len(segment.data) for segment in image.segments if _is_in(segment.address, memories.flash)),
        "ram": sum(segment.run_size for segment in image.segments if _is_in(segment.run_address, memories.ram)),
    }
    for index, stack in enumerate(stacks):
        function = image.function_at(stack.first_pc)
        owner = "" if index == 0 else f"{function.name if function else f'at_0x{stack.first_pc:08x}'}."
        used[f"{owner}stack_most"] = max(stack.used, used.get(f"{owner}stack_most", 0))
    return used


def _is_in(address: int, ranges: Iterable[tuple[int, int]]) -> bool:
    return any(base <= address < base + size for base, size in ranges)
