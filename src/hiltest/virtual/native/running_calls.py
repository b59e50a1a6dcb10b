"""Calls of functions while firmware runs, seen in C: the same as `RunningCalls`, from running_calls.c."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import unicorn
from unicorn.unicorn_py3.unicorn import uclib

from hiltest.errors import ConfigError
from hiltest.virtual.call_summary import Call
from hiltest.virtual.cpu import Processor
from hiltest.virtual.engine import add_hook
from hiltest.virtual.native.accounting import NativeBlockAccounting
from hiltest.virtual.native.library import library
from hiltest.virtual.registers import register_number
from hiltest.virtual.running_calls import WatchedFunction, emptied_pipeline_costs

_CYCLES = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_uint32)
_RETURNS_TO = ctypes.CFUNCTYPE(None, ctypes.c_uint32)
_FULL = ctypes.CFUNCTYPE(None)
_UNKNOWN = 2**32 - 1
_MOST_DONE, _MOST_FUNCTIONS, _MOST_ADDRESSES = 4096, 4096, 8192


class _Function(ctypes.Structure):
    """``struct function`` of running_calls.c."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("abandoned", "open", "came_back", "lost")),
        ("looks_at", ctypes.c_uint64), ("look_size", ctypes.c_uint64),
    )  # fmt: skip


class _Done(ctypes.Structure):
    """``struct done`` of running_calls.c."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("entered", "returned", "times", "interrupts", "elsewhere")),
        ("function", ctypes.c_int32), *((name, ctypes.c_uint32) for name in ("outermost", "place", "left", "stack")),
    )  # fmt: skip


class _Calls(ctypes.Structure):
    """``struct calls`` of running_calls.c, as far as Python sees it."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in (
            "engine", "counter", "cycles", "instructions", "before_number", "running", "ends", "state", "stacks",
            "lowest", "functions", "read_register", "read_memory",
        )),
        ("before", _CYCLES), ("emptied", _CYCLES), ("returns_to", _RETURNS_TO), ("full", _FULL),
        ("stack_register", ctypes.c_int32), ("link_register", ctypes.c_int32),
        ("open_calls", ctypes.c_int64), ("paused_cycles", ctypes.c_int64), ("done_count", ctypes.c_int64),
        ("is_paused", ctypes.c_int32), ("nested", ctypes.c_int32),
        ("current", ctypes.c_int32), ("interrupted", ctypes.c_int32 * 64), ("done", _Done * _MOST_DONE),
    )  # fmt: skip


class NativeRunningCalls:
    """Sees the calls of functions while firmware runs, in C.

    Parameters
    ----------
    processor : Processor
        It counts natively; the emulator must not be running.
    accounting : NativeBlockAccounting
        What counts.
    """

    def __init__(self, processor: Processor, accounting: NativeBlockAccounting) -> None:
        self._processor, self._accounting = processor, accounting
        self._library = library()
        self._by_address: dict[int, WatchedFunction] = {}
        self._functions: list[WatchedFunction] = []
        self._in_c = (_Function * _MOST_FUNCTIONS)()
        self._hooked: set[int] = set()
        self._memory = ctypes.create_string_buffer(self._library.hiltest_calls_size())
        self._address = ctypes.addressof(self._memory)
        self._calls = _Calls.from_buffer(self._memory)
        self._set_up()
        self._library.hiltest_calls_reset(self._address)
        self.listens = True
        # By item: functions of their own without declared arguments, of which each would cost as much as the call.
        here = ctypes.c_void_p(self._address)
        self.entered = partial(self._library["hiltest_calls_entered"], here)
        self.left = partial(self._library["hiltest_calls_left"], here)

    def _set_up(self) -> None:
        calls, accounting = self._calls, self._accounting
        calls.engine = self._processor.engine._uch.value
        for name, field in (
            ("counter", "cycles"), ("cycles", "cycles"), ("instructions", "instructions"),
            ("before_number", "before_number"), ("running", "running"), ("ends", "ends"), ("state", "state"),
            ("stacks", "stacks"), ("lowest", "lowest"),
        ):  # fmt: skip
            setattr(calls, name, accounting.words(field))
        calls.functions = ctypes.addressof(self._in_c)
        calls.read_register = ctypes.cast(uclib.uc_reg_read, ctypes.c_void_p)
        calls.read_memory = ctypes.cast(uclib.uc_mem_read, ctypes.c_void_p)
        calls.before = _CYCLES(self._on_before)
        calls.emptied = _CYCLES(self._on_emptied)
        calls.returns_to = _RETURNS_TO(self._on_returns_to)
        calls.full = _FULL(self._on_full)
        calls.stack_register, calls.link_register = register_number("SP"), register_number("LR")

    # -- as `RunningCalls` --------------------------------------------------------------------

    def watch(self, address: int) -> WatchedFunction:
        """Watch the function at an address from now on; one that is watched already stays the same."""
        if address not in self._by_address:
            if len(self._functions) == _MOST_FUNCTIONS:
                raise ConfigError(f"{_MOST_FUNCTIONS} functions can be watched at once")
            self._by_address[address] = WatchedFunction(address)
            self._library.hiltest_calls_note(self._address, address, len(self._functions))
            self._functions.append(self._by_address[address])
            self._hook(address)
        return self._by_address[address]

    def look_at(self, function: WatchedFunction, address: int, size: int) -> None:
        """Have `Call.left` say what memory holds at each return of a function."""
        function.looks_at = address, size
        entry = self._in_c[self._functions.index(function)]
        entry.looks_at, entry.look_size = address, size

    def settle(self) -> None:
        """Bring the functions up to date."""
        calls = self._calls
        for done in calls.done[: calls.done_count]:
            self._functions[done.function].calls.append(Call(
                done.entered, done.returned, done.times, done.interrupts, done.elsewhere, bool(done.outermost),
                done.place, done.left, None if done.stack == _UNKNOWN else done.stack,
            ))  # fmt: skip
        calls.done_count = 0
        for function, entry in zip(self._functions, self._in_c, strict=False):
            function.abandoned, function.open = entry.abandoned, entry.open
            function.came_back, function.lost = entry.came_back, entry.lost

    def reset(self) -> None:
        """Abandon all calls under way."""
        self._library.hiltest_calls_reset(self._address)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """See nothing of what runs in the context, and count no cycle of it."""
        calls = self._calls
        if calls.is_paused:
            yield
            return
        began = self._processor.cycles
        state = self._accounting.left_by(self._library.hiltest_calls_leave(self._address))
        calls.is_paused = 1
        try:
            yield
        finally:
            calls.is_paused = 0
            gone = self._processor.cycles - began + emptied_pipeline_costs(self._processor, state)
            self._library.hiltest_calls_resume(self._address, gone)

    @property
    def is_paused(self) -> bool:
        """Whether what runs is not seen."""
        return bool(self._calls.is_paused)

    def now(self) -> int:
        """Cycles since power-on without those that were paused, while nothing runs."""
        return int(self._accounting.cycles - self._calls.paused_cycles)

    # -- called from C ------------------------------------------------------------------------

    def _hook(self, address: int) -> None:
        if address not in self._hooked:
            self._hooked.add(address)
            function, data = self._library.hiltest_calls_on_code, ctypes.c_void_p(self._address)
            add_hook(self._processor.engine, unicorn.UC_HOOK_CODE, function, data, within=(address, address))
            # What has been translated without the hook would go on without it.
            self._processor.engine.ctl_remove_cache(address, address + 2)

    def _guarded(self, action: Callable[[], None]) -> None:
        try:
            action()
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._processor.abort(error)

    def _on_before(self, address: int) -> int:
        return self._accounting.now(address) - self._accounting.cycles

    def _on_emptied(self, entry: int) -> int:
        return emptied_pipeline_costs(self._processor, self._accounting.left_by(entry))

    def _on_returns_to(self, address: int) -> None:
        self._guarded(lambda: self._await(address))

    def _await(self, address: int) -> None:
        if len(self._hooked) >= _MOST_ADDRESSES:
            raise ConfigError(f"watched functions are called from more than {_MOST_ADDRESSES} places; watch fewer")
        self._processor.between_blocks(partial(self._hook, address))

    def _on_full(self) -> None:
        self._guarded(self.settle)
