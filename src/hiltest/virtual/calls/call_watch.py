"""Cycles of named functions while firmware runs, not instrumented."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hiltest.errors import ConfigError
from hiltest.virtual.calls.calling import function_named
from hiltest.virtual.processor.call_summary import Call, CallSummary, summarised
from hiltest.virtual.processor.cpu import Processor

_COLD = ".cold"  # the part of a function that the compiler moves away because it hardly ever runs


class CallWatch:
    """Counts the calls of some functions; made by `VirtualCortexM4.watch_calls`.

    Parameters
    ----------
    processor
        The emulator must not be running.
    functions
        Names.

    Attributes
    ----------
    running : RunningCalls
        Sees the calls of the processor.
    functions : dict of str to WatchedFunction
        By name.
    began : int
        Cycle of the latest `begin`.

    Raises
    ------
    ConfigError
        No such function.
    """

    def __init__(self, processor: Processor, functions: Iterable[str]) -> None:
        self._image = processor.image
        self.running = processor.calls
        symbols = [function_named(self._image, name) for name in functions]
        self.functions = {symbol.name: self.running.watch(symbol.address) for symbol in symbols}
        self.begin()

    def begin(self) -> None:
        """Leave the calls out that began before now."""
        self.running.settle()
        self.began = self.running.now()
        self._before = {
            name: (len(function.calls), function.abandoned, function.came_back)
            for name, function in self.functions.items()
        }

    def look_at(self, address: int, size: int) -> None:
        """Have `Call.left` say what memory holds at each return.

        Raises
        ------
        ConfigError
            It says what another place holds already.
        """
        for name, function in self.functions.items():
            if function.looks_at not in (None, (address, size)):
                raise ConfigError(f"{name} is watched for another word already; one word ends its solutions")
            function.look_at(address, size)

    @property
    def cycles(self) -> int:
        """Cycles that have passed since `begin`, asleep or not."""
        return self.running.now() - self.began

    def calls(self, function: str) -> Sequence[Call]:
        """Return the calls of a function that began and returned since `begin`, in the order of their return."""
        self.running.settle()
        first, _, _ = self._before[function]
        return [call for call in self.functions[function].calls[first:] if call.entered >= self.began]

    def stack(self, function: str) -> int | None:
        """Return the bytes that the deepest of all its calls so far took; None where that is not known."""
        self.running.settle()
        taken = [call.stack for call in self.functions[function].calls]
        known = [each for each in taken if each is not None]
        return max(known) if known and len(known) == len(taken) else None

    def summary(self, function: str) -> CallSummary:
        """Return what the calls of a function since `begin` come to."""
        calls = self.calls(function)
        watched, (_, abandoned, came_back) = self.functions[function], self._before[function]
        return summarised(
            function, calls, self.cycles, abandoned=watched.abandoned - abandoned, open_calls=watched.open,
            came_back=watched.came_back - came_back, lost=watched.lost, ended_in=self._ended_in(function, calls),
        )  # fmt: skip

    def _ended_in(self, function: str, calls: Sequence[Call]) -> tuple[str, ...]:
        """Name the other functions that returned in the place of one."""
        own = self.functions[function].address
        found = {self._image.function_at(place) for place in {call.ended_in for call in calls}}
        names = {each.name for each in found if each is not None and each.address != own}
        return tuple(sorted(name for name in names if name.partition(_COLD)[0] != function))
