"""The virtual board: an emulated Cortex-M4F with a cycle model, and the MK64F's peripherals.

`elf` reads firmware, `calling` calls one function of it, and `profile_file` reads what instructions cost.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.exports import when_used

if TYPE_CHECKING:
    from hiltest.virtual.elf import FirmwareImage
    from hiltest.virtual.k64f import VirtualK64F
    from hiltest.virtual.profile_file import load_profile
    from hiltest.virtual.timing import TimingProfile

__all__ = ["FirmwareImage", "TimingProfile", "VirtualK64F", "load_profile"]

__getattr__ = when_used(__name__, {
    "FirmwareImage": "elf", "TimingProfile": "timing", "VirtualK64F": "k64f", "load_profile": "profile_file",
})  # fmt: skip
