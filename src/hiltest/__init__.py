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
    clock_hz: float | None = None,
) -> ProfiledImage:
    """Open an ELF to count cycles of its functions, on a virtual board of its own.

    Parameters
    ----------
    elf
        Any program for a Cortex-M4; by default the packaged firmware.
    profile
        Timing profile; by default ``cortex-m4-trm/2``.
    memory
        Memories of a part other than the MK64FN1M0: ``flash=0x08000000:512K,ram=0x20000000:128K``. By default they
        follow from the ELF if it needs other ones.
    clock_hz
        Core clock that the functions are called at [Hz], by default 120 MHz: cycles do not depend on it, seconds do.

    Returns
    -------
    ProfiledImage
        ``cycles("app.elf").call("fn", 3).cycles`` is the cost of one call.

    Raises
    ------
    ConfigError
        If the ELF cannot be loaded, or the timing profile or the clock does not exist.
    """
    from hiltest.boards import default_firmware
    from hiltest.virtual.calls.call_clock import CALL_HZ
    from hiltest.virtual.model.profile_file import DEFAULT_PROFILE
    from hiltest.virtual.profiling.image import ProfiledImage

    path = default_firmware() if elf is None else Path(elf)
    at_hz = CALL_HZ if clock_hz is None else clock_hz
    return ProfiledImage(path, timing=profile or DEFAULT_PROFILE, memory=memory, clock_hz=at_hz)
