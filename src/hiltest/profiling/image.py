"""Functions of one ELF, called and counted."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.virtual.call_clock import CALL_HZ, checked_clock
from hiltest.virtual.calling import CallResult
from hiltest.virtual.chip import MemoryMap
from hiltest.virtual.k64f import HANG_S, VirtualK64F
from hiltest.virtual.procedure_call import Argument
from hiltest.virtual.profile_file import DEFAULT_PROFILE, load_profile
from hiltest.virtual.profiling import CallProfile, ProfilingAccounting, profile_call, with_memories


class ProfiledImage:
    """An ELF on a virtual board of its own.

    Parameters
    ----------
    elf : Path
        Any program for a Cortex-M4.
    timing : str
        Timing profile.
    memory : str, optional
        Memories of another part, see `hiltest.virtual.memory_map`.
    clock_hz : float
        Core clock, which makes seconds of cycles [Hz].

    Raises
    ------
    ConfigError
        If the ELF cannot be loaded, or there is no such timing profile or clock.
    """

    def __init__(
        self, elf: Path, *, timing: str = DEFAULT_PROFILE, memory: str | None = None, clock_hz: float = CALL_HZ
    ) -> None:
        self._clock_hz = checked_clock(clock_hz)
        profile = load_profile(timing)
        self._board = VirtualK64F(elf, profile=profile, accounting=ProfilingAccounting, memory=memory)
        # Blocks know nothing of what the memories add: the same call is counted once more, with them.
        self._with_memories = VirtualK64F(elf, profile=profile) if profile.memory else None

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
        function : str
            Its name.
        *arguments : int, float, bytes, bytearray, numpy array or Structure
            As `VirtualK64F.call` takes them.
        timeout_s : float
            Virtual time after which it is taken to hang [s].

        Returns
        -------
        CallProfile
            ``.value``, ``.cycles``, ``.instructions``, ``.microseconds``, ``.cycle_model``, and where the cycles went.

        Raises
        ------
        ConfigError
            No such function, or arguments that do not fit it; or it did something else when memories made it wait, as
            one does that reads a timer, so that the two counts are not of the same work.
        BoardFault
            The function faulted or hung.
        """
        again = deepcopy(arguments)
        profile = profile_call(self._board, function, *arguments, timeout_s=timeout_s, clock_hz=self._clock_hz)
        if self._with_memories is None:
            return profile
        counted = self._with_memories.call(function, *again, timeout_s=timeout_s, clock_hz=self._clock_hz)
        _check_same(profile, counted)
        return with_memories(profile, counted.cycles, self._with_memories.processor.profile)


def _check_same(profile: CallProfile, counted: CallResult) -> None:
    """Refuse two counts of different work."""
    with_and_without = [(repr(each.value), each.instructions) for each in (counted, profile)]  # a NaN is like a NaN
    if with_and_without[0] == with_and_without[1]:
        return
    shown = [f"answers {value} after {count} instructions" for value, count in with_and_without]
    raise ConfigError(
        f"{profile.function} {shown[0]} when memories make it wait, and {shown[1]} when nothing does: what it does "
        f"depends on the clock, so the two counts are not of the same work; count it by {DEFAULT_PROFILE}, which "
        "knows no memories"
    )
