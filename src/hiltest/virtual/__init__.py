"""The virtual board: an emulated Cortex-M4F with a cycle model, and the MK64F's peripherals.

`program` reads firmware, `board` runs it, `calls` calls its functions, and `model` has the costs of instructions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.virtual.board.cortex_m4 import VirtualCortexM4
    from hiltest.virtual.board.k64f import VirtualK64F
    from hiltest.virtual.model.profile_file import load_profile
    from hiltest.virtual.model.timing import TimingProfile
    from hiltest.virtual.program.elf import FirmwareImage, load_image

__all__ = ["FirmwareImage", "TimingProfile", "VirtualCortexM4", "VirtualK64F", "load_image", "load_profile"]

__getattr__ = when_used(
    __name__,
    {
        "FirmwareImage": "program.elf",
        "TimingProfile": "model.timing",
        "VirtualCortexM4": "board.cortex_m4",
        "VirtualK64F": "board.k64f",
        "load_image": "program.elf",
        "load_profile": "model.profile_file",
    },
)
