"""Every call of a function that firmware makes, seen by the board: when it was entered and when it returned."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import unicorn

from hiltest.virtual.cpu import Processor
from hiltest.virtual.engine import add_hook

_CODE_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint32, ctypes.c_void_p)

_STACK_AND_LINK = (13, 14)


@dataclass(frozen=True, slots=True)
class WatchedCall:
    """One call of the function: cycles since power-on at its first instruction, and behind its return."""

    entered: int
    returned: int

    @property
    def cycles(self) -> int:
        """Cycles from the function's first instruction to its return, both included."""
        return self.returned - self.entered


@dataclass(frozen=True, slots=True)
class _OpenCall:
    entered: int
    stack: int
    return_address: int


class FunctionWatch:
    """Sees every call of one function while the firmware runs, whatever the firmware reads or reports of it.

    Parameters
    ----------
    processor : Processor
        The emulator must not be running.
    address : int
        First instruction of the function.

    Attributes
    ----------
    calls : list of WatchedCall
        Those that have returned since `begin`, in that order.

    Notes
    -----
    A function that is inlined is never entered. One that calls itself has a call for each level.
    """

    def __init__(self, processor: Processor, address: int) -> None:
        self.calls: list[WatchedCall] = []
        self._processor = processor
        self._address = address & ~1
        self._open: list[_OpenCall] = []
        self._callbacks: dict[int, object] = {}  # the emulator keeps only the pointers
        self._hook(self._address, self._enters)

    @property
    def cycles(self) -> list[int]:
        """Cycles of each of `calls`."""
        return [each.cycles for each in self.calls]

    def begin(self) -> None:
        """Forget the calls so far."""
        self.calls.clear()
        self._open.clear()

    def _hook(self, address: int, function: Callable[[], None]) -> None:
        def called(_engine: int, _address: int, _size: int, _data: int) -> None:
            try:
                self._processor.accounting.end_watch()  # each call is seen
                function()
            except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
                self._processor.abort(error)

        self._callbacks[address] = callback = _CODE_CALLBACK(called)
        add_hook(self._processor.engine, unicorn.UC_HOOK_CODE, callback, within=(address, address))
        # What has been translated without the hook would go on without it.
        self._processor.engine.ctl_remove_cache(address, address + 2)

    def _enters(self) -> None:
        processor = self._processor
        stack, link = processor.registers.cores(_STACK_AND_LINK).read()
        call = _OpenCall(processor.accounting.now(self._address), stack, link & ~1)
        if any((each.stack, each.return_address) == (stack, call.return_address) for each in self._open):
            return  # a loop to its beginning, or the emulator was stopped there and comes to it again
        self._open.append(call)
        if call.return_address not in self._callbacks:
            self._callbacks[call.return_address] = None  # from now on it is awaited
            returns = partial(self._returns, call.return_address)
            processor.between_blocks(lambda: self._hook(call.return_address, returns))

    def _returns(self, address: int) -> None:
        stack, _ = self._processor.registers.cores(_STACK_AND_LINK).read()
        now = self._processor.accounting.now(address)
        while self._open and self._open[-1].return_address == address and self._open[-1].stack <= stack:
            self.calls.append(WatchedCall(self._open.pop().entered, now))
