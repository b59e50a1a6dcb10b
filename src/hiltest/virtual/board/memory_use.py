"""Memory use of firmware: flash, static RAM, and the deepest extent of each stack."""

from __future__ import annotations

from collections.abc import Iterable

from hiltest.virtual.part.chip import MemoryMap, is_in
from hiltest.virtual.processor.stacks import Stack
from hiltest.virtual.program.elf import FirmwareImage


def memory_use(image: FirmwareImage, memories: MemoryMap, stacks: Iterable[Stack]) -> dict[str, int]:
    """Return the bytes used, by purpose.

    Parameters
    ----------
    stacks
        Stacks of the firmware, which starts on the first one.

    Returns
    -------
    dict of str to int
        ``flash`` and ``ram``: the ELF's segments, with zeroed data and code that is copied to RAM.
        ``stack_most``: the stack that the firmware starts with, including exception frames. ``TASK.stack_most``:
        the stack of each task, named by its first function; if tasks share a first function, the deepest.
    """
    used = {
        "flash": sum(len(segment.data) for segment in image.segments if is_in(memories.flash, segment.address)),
        "ram": sum(segment.run_size for segment in image.segments if is_in(memories.ram, segment.run_address)),
    }
    for index, stack in enumerate(stacks):
        function = image.function_at(stack.first_pc)
        owner = "" if index == 0 else f"{function.name if function else f'at_0x{stack.first_pc:08x}'}."
        used[f"{owner}stack_most"] = max(stack.used, used.get(f"{owner}stack_most", 0))
    return used
