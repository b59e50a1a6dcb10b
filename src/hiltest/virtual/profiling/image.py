"""Profiles of the functions of one ELF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.virtual.board.cortex_m4 import HANG_S, open_image
from hiltest.virtual.board.k64f import board_for
from hiltest.virtual.board.memory_map import fits
from hiltest.virtual.calls.call_clock import CALL_HZ, check_clock
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.counts.profiling import CallProfile, profile_call
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.part.chip import MemoryMap
from hiltest.virtual.part.part_file import Part, load_part
from hiltest.virtual.program.elf import FirmwareImage
from hiltest.virtual.program.other_chips import small_part


class ProfiledImage:
    """An ELF on its own virtual board.

    Parameters
    ----------
    elf
        Any program for a Cortex-M4, or for the core of the part.
    timing
        Timing profile; by default that of the part, or the default one.
    memory
        Memories of another part, see `hiltest.virtual.board.memory_map`.
    part
        Part whose memories and timing profile are used, see `hiltest.virtual.part.part_file.load_part`; by default
        one of its core for an image of a Cortex-M0 or M0+, unless `timing` is given.
    clock_hz
        Core clock [Hz], by default the highest one of the part.

    Attributes
    ----------
    part : Part or None
        The chip, if it was named or has a small core.
    board : VirtualCortexM4
        The board.

    Raises
    ------
    ConfigError
        If the ELF cannot be loaded, if there is no such timing profile, part or clock, if the part has other
        memories than `memory`, or if the core of an image for Armv6-M is unknown.
    """

    def __init__(
        self,
        elf: Path,
        *,
        timing: str | None = None,
        memory: str | None = None,
        part: str | None = None,
        clock_hz: float | None = None,
    ) -> None:
        if part is not None:
            chip: Part | None = load_part(part)
        else:
            chip = None if timing is not None else _small_part(open_image(elf), memory)
        self.part = chip
        if chip is not None and chip.memories and memory is not None:
            raise ConfigError(f"--part {part} has its own memories: leave out --memory, or name another part")
        highest_hz = CALL_HZ if chip is None else chip.clock_hz
        self._clock_hz = check_clock(highest_hz if clock_hz is None else clock_hz)
        if timing is not None or chip is None:
            profile = load_profile(timing or DEFAULT_PROFILE)
        else:
            profile = chip.timing(self._clock_hz)
        self.board = board_for(elf, profile=profile, memory=memory, part=chip)

    @property
    def memory(self) -> MemoryMap:
        """Addresses of its memories."""
        return self.board.memory

    def report_waits(self, listener: Callable[[str], None]) -> None:
        """Call `listener` with one line when the function waits for an unmodelled register."""
        self.board.report_waits(listener)

    def call(
        self, function: str, *arguments: Argument, timeout_s: float = HANG_S, keeps_ram: bool = False
    ) -> CallProfile:
        """Call a function with interrupts masked, without booting; each call starts with the ELF's initial data.

        Parameters
        ----------
        function
            Name of the function.
        *arguments
            Arguments, see `VirtualCortexM4.call`.
        timeout_s
            Virtual time after which the call counts as hung [s].
        keeps_ram
            True to start with the present data instead.

        Returns
        -------
        CallProfile
            ``.value``, ``.cycles``, ``.instructions``, ``.microseconds``, ``.cycle_model``, and the distribution of the
            cycles.

        Raises
        ------
        ConfigError
            If there is no such function, or the arguments do not fit it.
        BoardFault
            If the function faults or hangs.
        """
        return profile_call(
            self.board, function, *arguments, timeout_s=timeout_s, clock_hz=self._clock_hz, keeps_ram=keeps_ram
        )


def _small_part(image: FirmwareImage, memory: str | None) -> Part | None:
    """Return the part that counts an image for a Cortex-M0 or M0+; None for another core."""
    name = small_part(image)
    if name is None:
        return None
    part = load_part(name)
    memories = part.memory_map
    if memories is not None and (memory is not None or not fits(memories, image)):
        return load_part("generic-m0")  # a chip of the family with other memories, none of which waits
    return part
