"""Hardware-in-the-loop tests for compass and IMU calibration firmware.

The names in ``__all__`` are the public interface, described in docs/api.md. Each is imported when it is first used.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.boards import Board
    from hiltest.measurement import Limit
    from hiltest.procedures import Turntable
    from hiltest.rig import Rig
    from hiltest.session import hookspecs
    from hiltest.session.fixtures import Measure
    from hiltest.virtual.board.k64f import VirtualK64F
    from hiltest.virtual.profiling.image import ProfiledImage

__version__ = "0.1.0"

__all__ = ["Board", "Limit", "Measure", "Rig", "Turntable", "VirtualK64F", "cycles", "hookspecs"]

__getattr__ = when_used(
    __name__,
    {
        "Board": "boards",
        "Limit": "measurement",
        "Measure": "session.fixtures",
        "Rig": "rig",
        "Turntable": "procedures",
        "VirtualK64F": "virtual.board.k64f",
        "hookspecs": "session.hookspecs",
    },
)


def cycles(
    elf: str | Path | None = None,
    *,
    profile: str | None = None,
    memory: str | None = None,
    part: str | None = None,
    clock_hz: float | None = None,
) -> ProfiledImage:
    """Open an ELF to count cycles of its functions, on a virtual board of its own.

    Parameters
    ----------
    elf
        Any program for a Cortex-M4, or for the core of the part; by default the packaged firmware.
    profile
        Timing profile; by default ``cortex-m4-trm/3``.
    memory
        Memories of a part other than the MK64FN1M0: ``flash=0x08000000:512K,ram=0x20000000:128K``. By default they
        follow from the ELF if it needs other ones.
    part
        Chip or core whose memories and timing are used, such as ``stm32f407`` or ``generic-m3``, or a part file
        (``.toml``).
    clock_hz
        Core clock that the functions are called at [Hz], by default the highest one of the part, else 120 MHz. The wait
        states of a part's flash depend on it.

    Returns
    -------
    ProfiledImage
        ``cycles("app.elf").call("fn", 3).cycles`` is the cost of one call.

    Raises
    ------
    ConfigError
        If the ELF cannot be loaded, or the timing profile, the part or the clock does not exist.
    """
    from hiltest.boards import default_firmware
    from hiltest.virtual.profiling.image import ProfiledImage

    path = default_firmware() if elf is None else Path(elf)
    return ProfiledImage(path, timing=profile, memory=memory, part=part, clock_hz=clock_hz)
