"""Functions of one ELF, called and counted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hiltest.virtual.board.cortex_m4 import HANG_S
from hiltest.virtual.board.k64f import board_for
from hiltest.virtual.calls.call_clock import CALL_HZ, check_clock
from hiltest.virtual.calls.procedure_call import Argument
from hiltest.virtual.counts.profiling import CallProfile, profile_call
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.part.chip import MemoryMap


class ProfiledImage:
    """An ELF on a virtual board of its own.

    Parameters
    ----------
    elf
        Any program for a Cortex-M4.
    timing
        Timing profile.
    memory
        Memories of another part, see `hiltest.virtual.board.memory_map`.
    clock_hz
        Core clock, which makes seconds of cycles [Hz].

    Raises
    ------
    ConfigError
        If the ELF cannot be loaded, or there is no such timing profile or clock.
    """

    def __init__(
        self, elf: Path, *, timing: str = DEFAULT_PROFILE, memory: str | None = None, clock_hz: float = CALL_HZ
    ) -> None:
        self._clock_hz = check_clock(clock_hz)
        self._board = board_for(elf, profile=load_profile(timing), memory=memory)

    @property
    def memory(self) -> MemoryMap:
        """Where its memories are."""
        return self._board.memory

    def tell(self, told: Callable[[str], None]) -> None:
        """Say who is told of a register that the function waits for and that is not modelled."""
        self._board.tell(told)

    def call(self, function: str, *arguments: Argument, timeout_s: float = HANG_S) -> CallProfile:
        """Call a function with interrupts masked, without booting; its data is what the ELF says, each time.

        Parameters
        ----------
        function
            Its name.
        *arguments
            As `VirtualCortexM4.call` takes them.
        timeout_s
            Virtual time after which it is taken to hang [s].

        Returns
        -------
        CallProfile
            ``.value``, ``.cycles``, ``.instructions``, ``.microseconds``, ``.cycle_model``, and where the cycles went.

        Raises
        ------
        ConfigError
            No such function, or arguments that do not fit it.
        BoardFault
            The function faulted or hung.
        """
        return profile_call(self._board, function, *arguments, timeout_s=timeout_s, clock_hz=self._clock_hz)
