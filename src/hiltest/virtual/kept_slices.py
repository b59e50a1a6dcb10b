"""What the slices of a solution began with, so that they can be called once more on another board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import unicorn

from hiltest.virtual.call_summary import Call
from hiltest.virtual.call_watch import CallWatch
from hiltest.virtual.code_hook import CODE_CALLBACK
from hiltest.virtual.cpu import Processor
from hiltest.virtual.engine import add_hook

_ARGUMENTS_AND_STACK = (0, 1, 2, 3, 13)


@dataclass(frozen=True, slots=True)
class Slice:
    """One call of a solution.

    Attributes
    ----------
    function : str
    arguments : tuple of int
        r0 to r3 at its entry.
    stack : int
        Stack pointer there.
    cycles : int
        What it took, without exceptions and other tasks.
    """

    function: str
    arguments: tuple[int, ...]
    stack: int
    cycles: int


@dataclass(frozen=True, slots=True)
class KeptSolution:
    """A solution that can be computed once more.

    Attributes
    ----------
    memory : bytes
        RAM when its first slice began.
    slices : tuple of Slice
    ended : int
        Cycle at which its last slice returned.
    """

    memory: bytes
    slices: tuple[Slice, ...]
    ended: int

    @property
    def cycles(self) -> int:
        """Cycles of all slices."""
        return sum(each.cycles for each in self.slices)


class _Begun:
    """A solution under way: RAM as it began, and the registers of each entry by the cycle of that."""

    def __init__(self, memory: bytes) -> None:
        self.memory = memory
        self.entries: dict[int, list[int]] = {}


class KeptSlices:
    """Keeps RAM and arguments of the latest solution.

    Parameters
    ----------
    processor : Processor
        The emulator must not be running.
    watch : CallWatch
        Of the functions whose calls are slices.
    ends : callable
        Whether a slice was the last of a solution, by the slice and by what the one before it left.
    """

    def __init__(self, processor: Processor, watch: CallWatch, ends: Callable[[Call, int], bool]) -> None:
        self._processor, self._functions, self._running, self._ends = processor, watch.functions, watch.running, ends
        self._registers = processor.registers.cores(_ARGUMENTS_AND_STACK)
        self._callback = CODE_CALLBACK(self._on_code)  # the emulator keeps only the pointer
        for address in (each.address for each in self._functions.values()):
            add_hook(processor.engine, unicorn.UC_HOOK_CODE, self._callback, within=(address, address))
            processor.engine.ctl_remove_cache(address, address + 2)

    def begin(self, before: int, *, is_whole: bool) -> None:
        """Leave out what began before now; see `solved` for the parameters."""
        self._running.settle()
        self._seen = {name: len(each.calls) for name, each in self._functions.items()}
        self._before, self._has_ended = before, is_whole
        self._begun: _Begun | None = None
        self._ended: _Begun | None = None

    def latest(self) -> KeptSolution | None:
        """Return the solution that was completed last; None where none was."""
        self._catch_up()
        ended = self._begun if self._begun and self._has_ended else self._ended
        if ended is None:
            return None
        calls = sorted(
            (call, name) for name, each in self._functions.items() for call in each.calls
            if call.entered in ended.entries
        )  # fmt: skip
        slices = [(name, ended.entries[call.entered], call.cycles) for call, name in calls]
        return KeptSolution(
            ended.memory, tuple(Slice(name, tuple(words[:-1]), words[-1], cycles) for name, words, cycles in slices),
            ended=max(call.returned for call, _ in calls),
        )  # fmt: skip

    def _catch_up(self) -> None:
        """Look at the slices that have returned meanwhile."""
        self._running.settle()
        returned = [
            call for name, each in self._functions.items() for call in each.calls[self._seen[name] :]
        ]
        for call in sorted(returned, key=lambda call: call.returned):
            self._has_ended = self._has_ended or self._ends(call, self._before)
            self._before = call.left
        self._seen = {name: len(each.calls) for name, each in self._functions.items()}

    def _on_code(self, _engine: int, address: int, _size: int, _data: int) -> None:
        """Take note of an entry; what goes wrong ends the run, for the emulator takes no exception."""
        try:
            self._enters(address)
        except BaseException as error:  # re-raised by the processor; ctypes would print and drop it
            self._processor.abort(error)

    def _enters(self, address: int) -> None:
        if self._running.is_paused:
            return
        self._catch_up()
        if self._has_ended:
            self._ended, self._has_ended = self._begun, False
            self._begun = _Begun(bytes(self._processor.memory.sram.view))
        if self._begun is not None:
            accounting = self._processor.accounting
            entered = self._running.now() + accounting.now(address) - accounting.cycles
            self._begun.entries[entered] = self._registers.read()
