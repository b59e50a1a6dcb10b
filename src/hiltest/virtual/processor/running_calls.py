"""Recorder of calls of watched functions in running firmware.

The core stops at the first instruction of a watched function and at the return addresses of its calls (calls.c), which
changes neither the firmware nor any cycle count. A call counts from the function's first instruction to its return,
inclusive, as in `VirtualCortexM4.call`.
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
    """A watched function and its calls.

    Parameters
    ----------
    address
        Address of the first instruction.
    number
        The core's number of the function.
    counts
        The core's record of the function.

    Attributes
    ----------
    calls : list of Call
        Calls that have returned, in the order of their returns.
    """

    def __init__(self, address: int, number: int, counts: Any) -> None:
        self.address, self.number = address, number
        self.calls: list[Call] = []
        self._counts = counts

    @property
    def abandoned(self) -> int:
        """Calls that never returned because their stack was discarded (longjmp, end of a task or exception, reset)."""
        return int(self._counts.abandoned)

    @property
    def open(self) -> int:
        """Calls that have not returned yet."""
        return int(self._counts.open)

    @property
    def came_back(self) -> int:
        """Calls that returned although they had been counted as abandoned.

        The firmware then switches stacks without an exception, and cycles cannot be attributed to calls.
        """
        return int(self._counts.came_back)

    @property
    def lost(self) -> int:
        """Calls that were not recorded because a table was full."""
        return int(self._counts.lost)

    @property
    def recorded_word(self) -> tuple[int, int] | None:
        """Address and size of the word that `Call.word` records."""
        size: int = self._counts.word_size
        return (self._counts.word_address, size) if size else None

    def record_word(self, address: int, size: int) -> None:
        """Record a word of memory in `Call.word` at each return."""
        self._counts.word_address, self._counts.word_size = address, size

    def report_entries(self) -> None:
        """Report each entry to the listeners."""
        self._counts.reports_entries = True


class RunningCalls:
    """Recorder of the calls of watched functions.

    Parameters
    ----------
    abort
        Called with any exception that a listener raises.

    Notes
    -----
    An inlined function is never entered. Each level of a recursive function is a call.
    """

    def __init__(self, machine: Machine, abort: Callable[[BaseException], None]) -> None:
        self._handle, self._abort = machine.handle, abort
        self._functions: list[WatchedFunction] = []
        self._listeners: dict[int, list[Callable[[int], None]]] = {}
        self._callback: Any = None
        self.is_paused = False

    def watch(self, address: int) -> WatchedFunction:
        """Watch the function at an address from now on; watching it again returns the same object.

        Raises
        ------
        ConfigError
            If too many functions are watched.
        """
        number: int = lib.machine_watch(self._handle, address)
        if number < 0:
            raise ConfigError(f"no more than {len(self._functions)} functions can be watched; watch fewer")
        if number == len(self._functions):
            counts = lib.machine_watched(self._handle, number)
            self._functions.append(WatchedFunction(address, number, counts))
        return self._functions[number]

    def listen(self, function: WatchedFunction, listener: Callable[[int], None]) -> None:
        """Call `listener` with the cycle of each entry of a function, before its first instruction."""
        if self._callback is None:
            self._callback = guarded_callback("void(void *, int32_t, int64_t)", self._enter, self._abort)
            lib.machine_report_entries(self._handle, self._callback, ffi.NULL)
        self._listeners.setdefault(function.number, []).append(listener)
        function.report_entries()

    def _enter(self, number: int, cycle: int) -> None:
        for listener in self._listeners[number]:
            listener(cycle)

    def fetch(self) -> None:
        """Fetch the completed calls from the core."""
        count = ffi.new("int64_t *")
        calls = lib.machine_calls(self._handle, count)
        if not count[0]:
            return
        for call in calls[0 : count[0]]:
            stack = None if call.stack == _ON_TWO_STACKS else call.stack
            self._functions[call.function].calls.append(
                Call(
                    call.entered,
                    call.returned,
                    call.interrupted,
                    call.interrupts,
                    call.elsewhere,
                    call.outermost,
                    call.ended_in,
                    call.word,
                    stack,
                )
            )
        lib.machine_forget_calls(self._handle)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Ignore calls and cycles within the context."""
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
        """Return the cycles since power-on without paused ones."""
        cycles: int = lib.machine_unpaused_cycles(self._handle)
        return cycles
