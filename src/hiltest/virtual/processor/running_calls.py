"""Every call of some functions that firmware makes while it runs, as the board sees it.

The core watches a function at its first instruction and where its calls return to (calls.c); nothing of the firmware is
changed, and no cycle count is. A call counts from the function's first instruction to its return, both included, which
is what `VirtualCortexM4.call` counts of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hiltest.errors import ConfigError
from hiltest.virtual.core.library import ffi, guarded_callback, lib
from hiltest.virtual.core.machine import Machine
from hiltest.virtual.processor.call_summary import Call

_ON_TWO_STACKS = 2**32 - 1


class WatchedFunction:
    """A function, and its calls.

    Parameters
    ----------
    address
        First instruction.
    number
        The core's number of it.
    counts
        What the core knows of it.

    Attributes
    ----------
    calls : list of Call
        Calls that have returned, in that order.
    """

    def __init__(self, address: int, number: int, counts: Any) -> None:
        self.address, self.number = address, number
        self.calls: list[Call] = []
        self._counts = counts

    @property
    def abandoned(self) -> int:
        """Calls that never returned: their stack was given up (longjmp, a task or exception that ended, a reset)."""
        return int(self._counts.abandoned)

    @property
    def open(self) -> int:
        """Calls that are under way."""
        return int(self._counts.open)

    @property
    def came_back(self) -> int:
        """Calls that returned though their stack had been given up.

        Something switches stacks without an exception, and whose cycles are whose cannot be told.
        """
        return int(self._counts.came_back)

    @property
    def lost(self) -> int:
        """Calls that there was no room for."""
        return int(self._counts.lost)

    @property
    def looks_at(self) -> tuple[int, int] | None:
        """Address and size of the word that `Call.left` tells."""
        size: int = self._counts.look_size
        return (self._counts.looks_at, size) if size else None

    def look_at(self, address: int, size: int) -> None:
        """Have `Call.left` say what memory holds at each return."""
        self._counts.looks_at, self._counts.look_size = address, size

    def tell(self) -> None:
        """Have each entry announced."""
        self._counts.tells = True


class RunningCalls:
    """Sees the calls of functions while firmware runs.

    Parameters
    ----------
    abort
        Gets any exception that a listener raises.

    Notes
    -----
    A function that is inlined is never entered. One that calls itself has a call for each level.
    """

    def __init__(self, machine: Machine, abort: Callable[[BaseException], None]) -> None:
        self._handle, self._abort = machine.handle, abort
        self._functions: list[WatchedFunction] = []
        self._listeners: dict[int, list[Callable[[int], None]]] = {}
        self._callback: Any = None
        self.is_paused = False

    def watch(self, address: int) -> WatchedFunction:
        """Watch the function at an address from now on; one that is watched already stays the same.

        Raises
        ------
        ConfigError
            Too many are watched.
        """
        number: int = lib.machine_watch(self._handle, address)
        if number < 0:
            raise ConfigError(f"{len(self._functions)} functions are watched, and no more can be; watch fewer")
        if number == len(self._functions):
            counts = lib.machine_watched(self._handle, number)
            self._functions.append(WatchedFunction(address, number, counts))
        return self._functions[number]

    def listen(self, function: WatchedFunction, listener: Callable[[int], None]) -> None:
        """Call `listener` with the cycle of each entry of a function, before its first instruction."""
        if self._callback is None:
            self._callback = guarded_callback("void(void *, int32_t, int64_t)", self._enter, self._abort)
            lib.machine_tell_entries(self._handle, self._callback, ffi.NULL)
        self._listeners.setdefault(function.number, []).append(listener)
        function.tell()

    def _enter(self, number: int, cycle: int) -> None:
        for listener in self._listeners[number]:
            listener(cycle)

    def settle(self) -> None:
        """Bring the functions up to date."""
        count = ffi.new("int64_t *")
        calls = lib.machine_calls(self._handle, count)
        if not count[0]:
            return
        for call in calls[0 : count[0]]:
            stack = None if call.stack == _ON_TWO_STACKS else call.stack
            self._functions[call.function].calls.append(Call(
                call.entered, call.returned, call.interrupted, call.interrupts, call.elsewhere, call.outermost,
                call.ended_in, call.word, stack,
            ))  # fmt: skip
        lib.machine_forget_calls(self._handle)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """See no call in what runs in the context, and count no cycle of it."""
        if self.is_paused:
            yield
            return
        lib.machine_pause_calls(self._handle)
        self.is_paused = True
        try:
            yield
        finally:
            self.is_paused = False
            lib.machine_resume_calls(self._handle)

    def now(self) -> int:
        """Cycles since power-on without those that were paused."""
        cycles: int = lib.machine_unpaused_cycles(self._handle)
        return cycles
